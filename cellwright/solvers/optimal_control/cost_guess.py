"""What motions probably cost: the straight joint motion under a smooth law of time, its duration chosen best.

For a straight motion of dq whose law of time is the cubic from rest to rest, T s long, let M be the mass matrix
halfway and u_g the torques that hold the arm, the mean of whose squares is Simpson's of five configurations on the
way. Then the integral of squared speeds is 1.2 dq.dq / T, that of squared torques of inertia 12 |M dq|^2 / T^3, and
the guess is the least over T of c_t T + c_v 1.2 dq.dq / T + c_e (T mean(u_g.u_g) + 12 |M dq|^2 / T^3). It proves
nothing: it orders motions where `least_cost` is far below them all (Bjorkenstam 2014, section 2.1).
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.symbolic_dynamics import SymbolicDynamics
from cellwright.solvers.optimal_control.cost_bounds import estimate
from cellwright.solvers.optimal_control.program import CostWeights

MOST_PAIRS = 250_000
"""Pairs for which configurations on the way are looked at (some 10 us each); more are guessed from their ends."""
LONGEST, DURATIONS = 8.0, 40
"""Durations tried, as multiples of what the speed limits ask for."""
PEAK = 1.15
"""Greatest speed of an optimal motion over its mean: it cruises at its limit rather than following the cubic."""


def guessed_costs(dynamics: SymbolicDynamics, weights: CostWeights, q: FloatArray) -> FloatArray:
    """Return what motions between all configurations ``q`` (n, joints) may cost, (n, n), both directions alike."""
    n = len(q)
    guess = np.zeros((n, n))
    if n * (n - 1) // 2 > MOST_PAIRS:
        for row in range(n):  # row by row: no array of all pairs and joints at once
            guess[row] = estimate(dynamics, weights, q[row], q)
        return guess
    a, b = np.triu_indices(n, 1)
    if len(a):
        guess[a, b] = guess[b, a] = _straight(dynamics, weights, q[a], q[b])
    return guess


def _straight(dynamics: SymbolicDynamics, weights: CostWeights, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
    delta = q_b - q_a
    held = np.zeros(len(q_a))
    for share, factor in ((0.0, 1.0), (0.25, 4.0), (0.5, 2.0), (0.75, 4.0), (1.0, 1.0)):
        held += factor / 12.0 * np.sum(dynamics.holding_torque(q_a + share * delta) ** 2, axis=-1)
    matrices = np.asarray(dynamics.mass_matrix_function((q_a + 0.5 * delta).T))  # (joints, pairs * joints)
    mass = matrices.reshape(dynamics.n_joints, len(q_a), dynamics.n_joints).transpose(1, 0, 2)
    pushed = np.sum(np.einsum("kij,kj->ki", mass, delta) ** 2, axis=-1)
    way = np.sum(delta**2, axis=-1)
    least = np.maximum(PEAK * np.max(np.abs(delta) / dynamics.max_velocity, axis=-1), 1e-6)
    best = np.full(len(q_a), np.inf)
    for factor in np.geomspace(1.0, LONGEST, DURATIONS):
        T = factor * least
        cost = (weights.time + weights.effort * held) * T
        cost += 1.2 * weights.velocity * way / T + 12.0 * weights.effort * pushed / T**3
        np.minimum(best, cost, out=best)
    return best
