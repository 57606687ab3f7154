"""Solve a motion and mend it until its curve keeps the joint limits between the nodes as well.

A motion that rides along a joint limit can leave it a little between two nodes. Then the limit of the inner nodes is
drawn in by as much and the problem is solved again from its solution; what is left, near the ends, the curve mends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InfeasibleError
from cellwright.solvers.hermite import position_extremes
from cellwright.solvers.optimal_control.checked_motion import CheckedMotion, checked
from cellwright.solvers.optimal_control.program import DiscreteMotion, MotionProgram
from cellwright.solvers.optimal_control.starts import check_configuration, straight_start

ROUNDS = 3
"""Times that the limits are drawn in; after that the curve itself is limited (`checked`)."""
DRAWN_IN = 1.3
"""Share of what a motion exceeds a limit by that the limit is drawn in by."""
LEAST_DRAWN = 1e-5
"""Share of a joint's range that a limit is drawn in by at least."""

Boxes = tuple[FloatArray, FloatArray]
"""Lower and upper positions of the nodes, (steps + 1, joints) each."""


@dataclass(frozen=True, eq=False)
class SettledMotion:
    """A discrete motion and its checked curve.

    Attributes:
        discrete: What the solver returned.
        curve: The curve; its ``fault`` says why it is no result.
        fault: Why this is no result; empty if it is one.
    """

    discrete: DiscreteMotion
    curve: CheckedMotion
    fault: str

    @property
    def converged(self) -> bool:
        """Whether this is a result: an optimum whose curve keeps all limits."""
        return not self.fault


def settle(
    program: MotionProgram,
    start: DiscreteMotion,
    *,
    v_a: FloatArray | None = None,
    v_b: FloatArray | None = None,
    boxes: Boxes | None = None,
    warm: bool = False,
) -> SettledMotion:
    """Return the motion that the program finds from ``start``, checked; arguments as for `MotionProgram.solve`."""
    dynamics = program.dynamics
    if boxes is None:
        shape = start.q.shape
        boxes = np.broadcast_to(dynamics.lower, shape), np.broadcast_to(dynamics.upper, shape)
    lower, upper = np.maximum(boxes[0], dynamics.lower), np.minimum(boxes[1], dynamics.upper)
    found = program.solve(start, v_a=v_a, v_b=v_b, boxes=(lower, upper), warm=warm)
    low, high = dynamics.lower, dynamics.upper
    for _ in range(ROUNDS):
        under, over = _beyond(program, found)
        if not found.converged or not (np.any(under > 0.0) or np.any(over > 0.0)):
            break
        inner = slice(1, -1)
        least = LEAST_DRAWN * (dynamics.upper - dynamics.lower)
        low, high = (
            low + np.where(under > 0.0, DRAWN_IN * under + least, 0.0),
            high - np.where(over > 0.0, DRAWN_IN * over + least, 0.0),
        )
        lower[inner], upper[inner] = np.maximum(lower, low)[inner], np.minimum(upper, high)[inner]
        if np.any(lower > upper):
            break
        found = program.solve(found, v_a=v_a, v_b=v_b, boxes=(lower, upper), warm=True)
    curve = checked(program, found)
    fault = curve.fault
    if not found.converged:
        fault = f"the solver stopped with {found.status} after {found.iterations} iterations"
    return SettledMotion(found, curve, fault)


def _beyond(program: MotionProgram, found: DiscreteMotion) -> tuple[FloatArray, FloatArray]:
    """Return by how much the curve goes below and above the limits of each joint, both (joints,)."""
    low, high = position_extremes(found.time, found.q, found.node_velocity)
    dynamics = program.dynamics
    return (
        np.maximum(dynamics.lower - low.min(axis=0), 0.0),
        np.maximum(high.max(axis=0) - dynamics.upper, 0.0),
    )


def free_motion(
    program: MotionProgram,
    q_a: FloatArray,
    q_b: FloatArray,
    *,
    v_a: FloatArray | None = None,
    v_b: FloatArray | None = None,
    start: DiscreteMotion | None = None,
) -> SettledMotion:
    """Return the best motion found between two configurations (joints,) where nothing is in the way.

    ``v_a`` and ``v_b`` (joints,) are the velocities at the ends, rest if left out; ``start`` a warm start between the
    same ends, the straight motion if left out.

    Raises:
        InvalidInputError: If a configuration is malformed or outside the joint limits.
        InfeasibleError: If a boundary velocity exceeds its limit, or the torque limits do not hold the arm at an end.
    """
    for name, q, v in (("start", q_a, v_a), ("goal", q_b, v_b)):
        check_configuration(program, q, name)
        program.dynamics.check_holds(q, program.max_effort, f"the {name}")
        if v is not None and np.any(np.abs(v) > program.dynamics.max_velocity):
            joint = int(np.argmax(np.abs(v) / program.dynamics.max_velocity))
            raise InfeasibleError(
                f"joint {program.dynamics.joint_names[joint]!r} has {v[joint]:.6g} /s at the {name}, but its speed "
                f"limit is {program.dynamics.max_velocity[joint]:.6g}: slow it down"
            )
    found = settle(program, start or straight_start(program, q_a, q_b), v_a=v_a, v_b=v_b, warm=start is not None)
    if start is not None and not found.converged:
        found = settle(program, straight_start(program, q_a, q_b), v_a=v_a, v_b=v_b)
    return found
