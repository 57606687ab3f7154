"""What a motion takes, whoever planned it: time, torque, mechanical work, and the cost that weighs them.

Between states a motion is the cubic Hermite curve; pinocchio's inverse dynamics is asked at both ends and the middle
of each interval (Simpson's rule; accelerations may jump between intervals).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.symbolic_dynamics import SymbolicDynamics
from cellwright.solvers.hermite import interval_states
from cellwright.solvers.optimal_control.program import CostWeights
from cellwright.solvers.path_timing import TimedMotion


@dataclass(frozen=True)
class Measures:
    """What motions take together.

    Attributes:
        duration: In s.
        effort: Integral of u . u, in (N m)^2 s.
        work: Integral of the sum of abs(u_j qdot_j), in J: mechanical work where nothing is fed back.
        cost: Integral of the weighted cost.
        torque_share: Greatest share of a torque limit.
        speed_squared: Integral of qdot . qdot, in rad^2 / s.
    """

    duration: float = 0.0
    effort: float = 0.0
    work: float = 0.0
    cost: float = 0.0
    torque_share: float = 0.0
    speed_squared: float = 0.0


def together(parts: Iterable[Measures]) -> Measures:
    """Return what several motions take, one after the other."""
    listed = list(parts)
    return Measures(
        sum(part.duration for part in listed),
        sum(part.effort for part in listed),
        sum(part.work for part in listed),
        sum(part.cost for part in listed),
        max((part.torque_share for part in listed), default=0.0),
        sum(part.speed_squared for part in listed),
    )


def measure(dynamics: SymbolicDynamics, weights: CostWeights, max_effort: FloatArray, motion: TimedMotion) -> Measures:
    """Return what a motion of the arm's joints takes; further coordinates are left out."""
    h, v, torque = _on_curve(dynamics, motion)
    factor = np.array([1.0, 4.0, 1.0]) / 6.0

    def integral(rate: FloatArray) -> float:
        return float(rate @ factor @ h)

    return Measures(
        motion.duration,
        integral(np.sum(torque**2, axis=2)),
        integral(np.sum(np.abs(torque * v), axis=2)),
        integral(weights.rate(v, torque)),
        float(np.max(np.abs(torque) / max_effort)),
        integral(np.sum(v**2, axis=2)),
    )


def power_over_time(dynamics: SymbolicDynamics, motion: TimedMotion) -> tuple[FloatArray, FloatArray]:
    """Return the middles of the intervals in s and the sum of abs(u_j qdot_j) there in W, both (intervals,)."""
    h, v, torque = _on_curve(dynamics, motion)
    return motion.time[:-1] + 0.5 * h, np.sum(np.abs(torque * v), axis=2)[:, 1]


def _on_curve(dynamics: SymbolicDynamics, motion: TimedMotion) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return durations (intervals,), velocities and torques (intervals, 3, joints) at begin, middle and end of each."""
    n = dynamics.n_joints
    q, v, a = interval_states(motion.time, motion.position[:, :n], motion.velocity[:, :n], np.array([0.0, 0.5, 1.0]))
    torque = dynamics.torques(*(each.reshape(-1, n) for each in (q, v, a))).reshape(q.shape)
    return np.diff(motion.time), v, torque
