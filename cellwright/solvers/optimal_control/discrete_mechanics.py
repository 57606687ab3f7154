"""The midpoint discrete Lagrangian of an arm, its discrete Legendre transforms, and the integrator they make.

Bjorkenstam 2014, section 2.3, after Marsden and West 2001: the action of a step from ``q0`` to ``q1`` in time ``h`` is
L_d = h L((q0 + q1) / 2, (q1 - q0) / h), a torque u of the step's middle acts as h u / 2 on either end. With

    P = dL/dv and F = dL/dq at the step's middle,
    D1 L_d = h F / 2 - P,    D2 L_d = h F / 2 + P,

the discrete Euler-Lagrange equations say that the momentum with which a step ends, D2 L_d + h u / 2, is the one with
which the next begins, -D1 L_d - h u / 2. So made, motions keep momenta exactly and drift in energy no more than a
symplectic method does: errors are of second order in h and stay bounded over very long times.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.symbolic_dynamics import SymbolicDynamics
from cellwright.errors import SolverError

NEWTON_TOLERANCE = 1e-13
"""Relative residual of a step's momentum: near rounding, so that what drifts is the method and not its solution."""
MOST_NEWTON = 30


class DiscreteMechanics:
    """Discrete Lagrangian mechanics of an arm, as CasADi expressions and numbers.

    Attributes:
        dynamics: The arm.
    """

    def __init__(self, dynamics: SymbolicDynamics) -> None:
        self.dynamics = dynamics

    def ends(self, middle: Any, v: Any, h: Any) -> tuple[Any, Any]:
        """Return -D1 L_d and D2 L_d (joints,) of a step of ``h`` s about ``middle`` at velocity ``v``, CasADi."""
        P, F = self.dynamics.momentum_function.call([middle, v], True, False)
        return P - 0.5 * h * F, P + 0.5 * h * F

    def momentum_expression(self, q: Any, v: Any) -> Any:
        """Return the momentum D2 L = M(q) v (joints,), CasADi."""
        return self.dynamics.momentum_function.call([q, v], True, False)[0]

    @cached_property
    def ends_function(self) -> Any:
        """(q0, q1, h) to (-D1 L_d, D2 L_d), the momenta in which a step without torque begins and ends."""
        n = self.dynamics.n_joints
        q0, q1, h = casadi.SX.sym("q0", n), casadi.SX.sym("q1", n), casadi.SX.sym("h")
        return casadi.Function("ends", [q0, q1, h], list(self.ends(0.5 * (q0 + q1), (q1 - q0) / h, h)))

    @cached_property
    def _slope_function(self) -> Any:
        n = self.dynamics.n_joints
        q0, q1, h = casadi.SX.sym("q0", n), casadi.SX.sym("q1", n), casadi.SX.sym("h")
        begin = self.ends(0.5 * (q0 + q1), (q1 - q0) / h, h)[0]
        return casadi.Function("slope", [q0, q1, h], [begin, casadi.jacobian(begin, q1)])

    def momentum(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the momentum M(q) v, (joints,)."""
        return self.dynamics.mass_matrix(q) @ v

    def velocity(self, q: FloatArray, p: FloatArray) -> FloatArray:
        """Return the velocity (joints,) of momentum ``p`` at ``q``: the inverse Legendre transform."""
        return np.asarray(np.linalg.solve(self.dynamics.mass_matrix(q), p))

    def node_velocities(self, q: FloatArray, torque: FloatArray, h: float) -> FloatArray:
        """Return the velocities (nodes, joints) at the nodes ``q`` of a motion under step torques (nodes - 1, joints).

        At inner nodes both steps agree by the discrete Euler-Lagrange equations; the first node is seen from the
        first step, all others from the step before.
        """
        begin, end = self.ends_function(q[:-1].T, q[1:].T, h)
        p = np.vstack([np.asarray(begin).T[:1] - 0.5 * h * torque[:1], np.asarray(end).T + 0.5 * h * torque])
        M = np.asarray(self.dynamics.mass_matrix_function(q.T))
        n = self.dynamics.n_joints
        return np.linalg.solve(M.reshape(n, -1, n).transpose(1, 0, 2), p[:, :, None])[:, :, 0]

    def step(self, q: FloatArray, p: FloatArray, h: float, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position and momentum (joints,) one step of ``h`` s after ``q`` and ``p``.

        Raises:
            SolverError: If Newton's method finds no solution: the step is too long.
        """
        q1 = q + h * self.velocity(q, p)
        scale = max(1.0, float(np.abs(p).max()))
        best = np.inf
        for _ in range(MOST_NEWTON):
            begin, slope = self._slope_function(q, q1, h)
            residual = np.asarray(begin)[:, 0] - 0.5 * h * torque - p
            size = float(np.abs(residual).max())
            if size <= NEWTON_TOLERANCE * scale or (size >= best and size <= 1e-9 * scale):
                end = np.asarray(self.ends_function(q, q1, h)[1])[:, 0]
                return q1, end + 0.5 * h * torque
            best = min(best, size)
            q1 = q1 - np.linalg.solve(np.asarray(slope), residual)
        raise SolverError(f"a step of {h:g} s has a momentum residual of {best:.3g} after Newton's method: shorten it")

    def integrate(
        self, q: FloatArray, v: FloatArray, h: float, n_steps: int, torque: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (n_steps + 1, joints) of the motion from ``q``, ``v`` (joints,).

        ``torque`` (n_steps, joints) acts in the steps; none if left out.

        Raises:
            SolverError: If a step has no solution: it is too long.
        """
        q, p = np.asarray(q, float), self.momentum(q, v)
        positions, velocities = [q], [np.asarray(v, float)]
        still = np.zeros(len(q))
        for number in range(n_steps):
            q, p = self.step(q, p, h, still if torque is None else torque[number])
            positions.append(q)
            velocities.append(self.velocity(q, p))
        return np.array(positions), np.array(velocities)

    def energy(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the total energy (states,) in J of states (states, joints)."""
        kinetic, potential = self.dynamics.energies_function(q.T, v.T)
        return np.asarray(kinetic + potential, np.float64).ravel()


def explicit_euler(
    dynamics: SymbolicDynamics, q: FloatArray, v: FloatArray, h: float, n_steps: int
) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (n_steps + 1, joints) of the free arm by Euler's method: it gains energy.

    Here to be compared with. ``q``, ``v`` (joints,).
    """
    import pinocchio

    data = dynamics.model.createData()
    still = np.zeros(len(q))
    positions, velocities = [np.asarray(q, float)], [np.asarray(v, float)]
    for _ in range(n_steps):
        a = pinocchio.aba(dynamics.model, data, positions[-1], velocities[-1], still)
        positions.append(positions[-1] + h * velocities[-1])
        velocities.append(velocities[-1] + h * np.asarray(a))
    return np.array(positions), np.array(velocities)
