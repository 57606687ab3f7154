"""What no motion undercuts, and what standing still costs: lower bounds for lazy sequencing without any planning.

Let a motion take T s from rest to rest, move the joints by dq, and lift the arm's potential energy by W. Write
Q for the integral of qdot . qdot, U for that of u . u, and D for dq . dq. Then

1. T >= T_v = max_j |dq_j| / v_j: no joint is faster than its limit.
2. Q T >= D: Cauchy-Schwarz joint by joint, (integral of qdot_j)^2 <= T integral of qdot_j^2.
3. U Q >= W^2: torques do work; from rest to rest all of it goes into potential energy, W = integral of u . qdot,
   and Cauchy-Schwarz again. Friction, which the model does not have, would only add to it.
4. Q <= T V with V = v . v, the sum of squared speed limits.

So c_t T + c_v Q + c_e U is at least the minimum of c_t T + c_v Q + c_e W^2 / Q over T >= T_v and D / T <= Q. The inner
minimum is at Q* = sqrt(c_e / c_v) |W| where that is allowed, else at Q = D / T, as the expression is convex in Q. The
outer function of T is then convex and continuously differentiable, with its minimum at
T1 = sqrt(c_v D / (c_t + c_e W^2 / D)), which lies on the branch Q = D / T because the slope at its end, T = D / Q*, is
c_t > 0. Where c_v = 0 point 4 bounds Q instead. The same holds at every T above T1 because the function rises there.

The bound knows nothing of the torques that carry the arm on its way, as no bound can that allows a fall and a catch
in between; where these dominate (heavy arms) it is far below the cost. `estimate` adds the torques that hold the arm at
both ends, as Bjorkenstam 2014, section 2.1, does. It orders motions well and proves nothing.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.symbolic_dynamics import SymbolicDynamics
from cellwright.solvers.optimal_control.program import CostWeights


def least_cost(
    dynamics: SymbolicDynamics,
    weights: CostWeights,
    q_a: FloatArray,
    q_b: FloatArray,
    *,
    least_time: FloatArray | float = 0.0,
    gained: FloatArray | float = 0.0,
) -> FloatArray:
    """Return a cost (...) that no motion from rest at ``q_a`` to rest at ``q_b``, both (..., joints), undercuts.

    A motion that is known to take ``least_time`` s (...) costs at least as much as that implies. One that is not at
    rest at its ends gains ``gained`` J (...) of kinetic energy, which torques have to do as well. The proof stands in
    the module's docstring.
    """
    q_a, q_b = np.broadcast_arrays(np.asarray(q_a, float), np.asarray(q_b, float))
    speed = dynamics.max_velocity
    least = np.maximum(np.max(np.abs(q_b - q_a) / speed, axis=-1), least_time)
    D = np.sum((q_b - q_a) ** 2, axis=-1)
    lifted_by = _potential(dynamics, q_b) - _potential(dynamics, q_a) + gained
    work = weights.effort * lifted_by**2  # c_e W^2
    if weights.velocity == 0.0:
        most = float(speed @ speed)
        T = np.maximum(least, np.sqrt(work / (weights.time * most)))
        Q = T * most
    else:
        lifting = np.divide(work, D, out=np.zeros_like(D), where=D > 0.0)
        T = np.maximum(least, np.sqrt(weights.velocity * D / (weights.time + lifting)))
        way = np.divide(D, T, out=np.zeros_like(D), where=T > 0.0)
        Q = np.maximum(way, np.sqrt(work / weights.velocity))
    lifted = np.divide(work, Q, out=np.zeros_like(D), where=Q > 0.0)
    return np.asarray(weights.time * T + weights.velocity * Q + lifted)


def holding_cost(dynamics: SymbolicDynamics, weights: CostWeights, q: FloatArray, dwell: float) -> FloatArray:
    """Return c_e u . u times ``dwell`` s (...) of the torques u that hold the arm still at ``q`` (..., joints)."""
    return np.asarray(weights.effort * np.sum(dynamics.holding_torque(q) ** 2, axis=-1) * dwell)


def estimate(dynamics: SymbolicDynamics, weights: CostWeights, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
    """Return a guess of the cost (...), no bound: `least_cost` and the mean holding cost of both ends for that long."""
    q_a, q_b = np.broadcast_arrays(np.asarray(q_a, float), np.asarray(q_b, float))
    time = np.max(np.abs(q_b - q_a) / dynamics.max_velocity, axis=-1)
    held = 0.5 * (holding_cost(dynamics, weights, q_a, 1.0) + holding_cost(dynamics, weights, q_b, 1.0))
    return np.asarray(least_cost(dynamics, weights, q_a, q_b) + time * held)


def _potential(dynamics: SymbolicDynamics, q: FloatArray) -> FloatArray:
    rows = q.reshape(-1, dynamics.n_joints)
    return np.asarray(dynamics.energies_function(rows.T, 0.0)[1], np.float64).reshape(q.shape[:-1])
