"""Where the solver begins: a path followed smoothly, as fast as speed and torque limits let it."""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError
from cellwright.solvers.optimal_control.program import DiscreteMotion, MotionProgram

SHARE_OF_LIMITS = 0.9
"""What the first point uses of its limits at most: an interior-point method begins inside them."""
SLOWER, MOST_SLOWINGS = 1.25, 25
SHORTEST = 0.05
"""Seconds that a first point takes at least."""


def straight_start(program: MotionProgram, q_a: FloatArray, q_b: FloatArray) -> DiscreteMotion:
    """Return the straight motion between two configurations (joints,), rest to rest, as a start for the solver.

    Raises:
        InvalidInputError: If a configuration is not finite, of another size, or outside the joint limits.
    """
    dynamics = program.dynamics
    for name, q in (("start", q_a), ("goal", q_b)):
        check_configuration(program, q, name)
    share = np.linspace(0.0, 1.0, program.n_steps + 1)[:, None]
    eased = share**2 * (3.0 - 2.0 * share)
    q = q_a + eased * (q_b - q_a)
    # the cubic's greatest speed is 1.5 times its mean
    duration = 1.5 * float(np.max(np.abs(q_b - q_a) / dynamics.max_velocity))
    return nodes_start(program, q, duration)


def nodes_start(program: MotionProgram, q: FloatArray, duration: float) -> DiscreteMotion:
    """Return nodes (steps + 1, joints), evenly spaced in time, as a start; it takes at least ``duration`` s."""
    dynamics, steps = program.dynamics, program.n_steps
    T = max(duration, SHORTEST) / SHARE_OF_LIMITS
    middle = 0.5 * (q[1:] + q[:-1])
    for _ in range(MOST_SLOWINGS):
        h = T / steps
        v = np.diff(q, axis=0) / h
        at_nodes = np.vstack([np.zeros_like(q[:1]), 0.5 * (v[1:] + v[:-1]), np.zeros_like(q[:1])])
        torque = dynamics.torques(middle, v, np.diff(at_nodes, axis=0) / h)
        too_fast = float(np.max(np.abs(v) / dynamics.max_velocity)) > SHARE_OF_LIMITS
        if not too_fast and float(np.max(np.abs(torque) / program.max_effort)) <= SHARE_OF_LIMITS:
            break
        T *= SLOWER
    torque = np.clip(torque, -program.max_effort, program.max_effort)
    cost = h * float(program.weights.rate(v, torque).sum())
    return DiscreteMotion(h, q, v, torque, at_nodes, cost, False, "start", 0, np.inf)


def neighbouring_start(neighbour: DiscreteMotion, q_a: FloatArray, q_b: FloatArray) -> DiscreteMotion:
    """Return a solved motion bent linearly to other ends (joints,): a warm start where they are near its own."""
    share = np.linspace(0.0, 1.0, len(neighbour.q))[:, None]
    shift = (1.0 - share) * (q_a - neighbour.q[0]) + share * (q_b - neighbour.q[-1])
    q = neighbour.q + shift
    return DiscreteMotion(
        neighbour.step,
        q,
        np.diff(q, axis=0) / neighbour.step,
        neighbour.torque,
        neighbour.node_velocity,
        neighbour.cost,
        False,
        "neighbour",
        0,
        np.inf,
        neighbour.multipliers,
    )


def check_configuration(program: MotionProgram, q: FloatArray, name: str) -> None:
    """Check an end of a motion, called ``name``.

    Raises:
        InvalidInputError: If ``q`` is not finite, of another size, or outside the joint limits.
    """
    dynamics = program.dynamics
    if np.shape(q) != (dynamics.n_joints,) or not np.isfinite(q).all():
        raise InvalidInputError(f"the {name} is {np.array(q)}: give {dynamics.n_joints} finite joint positions")
    for row in np.flatnonzero((q < dynamics.lower) | (q > dynamics.upper)):
        unit = "rad" if dynamics.kinematics.revolute[row] else "m"
        raise InvalidInputError(
            f"joint {dynamics.joint_names[row]!r} is at {q[row]:.6g} {unit} at the {name}, but may move between "
            f"{dynamics.lower[row]:.6g} and {dynamics.upper[row]:.6g} {unit}"
        )
