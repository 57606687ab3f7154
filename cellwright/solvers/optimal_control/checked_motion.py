"""Turn a discrete motion into a curve that can be executed, and check the curve: limits, torques, true cost.

Through the nodes and the node velocities, which are the discrete Legendre transforms of the momenta, runs the cubic
Hermite curve. Where the mass matrix is constant this is the exact motion under torques that are constant in each step;
elsewhere it differs by the order of the step. On a dense grid pinocchio's inverse dynamics says what torques the curve
really takes. A rest-to-rest motion that exceeds a limit is slowed as a whole by as little as mends it: of the torques
only the part that is not gravity shrinks, by the square, so an arm thrown through a pose in which it cannot be held
must not be slowed too much either. What cannot be mended so is no result, and says why.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.symbolic_dynamics import SymbolicDynamics
from cellwright.solvers.hermite import interval_states, peak_velocity, position_extremes
from cellwright.solvers.optimal_control.program import CostWeights, DiscreteMotion, MotionProgram
from cellwright.solvers.path_timing import TimedMotion

SAMPLES = 8
"""Parts into which each interval is cut, an even number for Simpson's rule."""
ROUNDING = 1e-9
"""Share by which a limit may be exceeded: rounding."""
SLOWEST = 4.0
"""A motion that would have to take so many times as long is no result: something else is wrong with it."""


@dataclass(frozen=True, eq=False)
class CheckedMotion:
    """A curve that was checked on a dense grid.

    Attributes:
        motion: States of the grid; between them the cubic Hermite curve.
        torque: At the states, (states, joints) in N m or N, by inverse dynamics; where two intervals meet the later's.
        cost: The integral of the cost along the curve.
        slowed: By which factor the motion was slowed to keep all limits; 1 if it kept them.
        fault: Why it is no result; empty if it is one.
    """

    motion: TimedMotion
    torque: FloatArray
    cost: float
    slowed: float
    fault: str = ""


def checked(program: MotionProgram, found: DiscreteMotion) -> CheckedMotion:
    """Return the curve of a discrete motion, checked against the limits of the program's arm.

    The ends of the curve move as those of the motion do; only motions from rest to rest are slowed.
    """
    velocity = _within_limits(program.dynamics, found)
    motion = TimedMotion(found.time, found.q, velocity, np.zeros_like(found.q))
    return checked_curve(program.dynamics, program.weights, program.max_effort, motion)


def _within_limits(dynamics: SymbolicDynamics, found: DiscreteMotion) -> FloatArray:
    """Return the node velocities, limited for joints whose curve would leave their limits between the nodes.

    After Fritsch and Carlson 1980: with velocities of at most three times the means of the intervals on either side,
    and none where these differ in sign, the curve stays between its nodes. The ends keep theirs.
    """
    low, high = position_extremes(found.time, found.q, found.node_velocity)
    beyond = (low.min(axis=0) < dynamics.lower) | (high.max(axis=0) > dynamics.upper)
    velocity = found.node_velocity.copy()
    if not beyond.any():
        return velocity
    mean = np.diff(found.q, axis=0)[:, beyond] / found.step
    before, after = mean[:-1], mean[1:]
    most = np.where(before * after > 0.0, 3.0 * np.minimum(np.abs(before), np.abs(after)), 0.0)
    velocity[1:-1, beyond] = np.clip(velocity[1:-1, beyond], -most, most)
    # a velocity against both means goes the wrong way
    velocity[1:-1, beyond] = np.where(velocity[1:-1, beyond] * before < 0.0, 0.0, velocity[1:-1, beyond])
    return velocity


def checked_curve(
    dynamics: SymbolicDynamics, weights: CostWeights, max_effort: FloatArray, motion: TimedMotion
) -> CheckedMotion:
    """Return the cubic Hermite curve through the states of a motion, checked, slowed if need be, and its true cost."""
    dense = _Dense(motion)
    torque = dynamics.torques(dense.q, dense.v, dense.a)
    holding = dynamics.holding_torque(dense.q)
    slowed, fault = _slowing(dynamics, max_effort, motion, torque, holding)
    if slowed > 1.0:
        torque = holding + (torque - holding) / slowed**2
    cost = slowed * dense.integral(weights.rate(dense.v / slowed, torque))
    return CheckedMotion(dense.motion().slowed(slowed), torque[dense.kept], cost, slowed, fault)


def _slowing(
    dynamics: SymbolicDynamics,
    max_effort: FloatArray,
    motion: TimedMotion,
    torque: FloatArray,
    holding: FloatArray,
) -> tuple[float, str]:
    """Return the least factor of at least 1 that brings a motion within its limits, and why none does (then 1)."""
    low, high = position_extremes(motion.time, motion.position, motion.velocity)
    reach = 1e-9 * (dynamics.upper - dynamics.lower)
    beyond = np.maximum(dynamics.lower - reach - low.min(axis=0), high.max(axis=0) - dynamics.upper - reach)
    worst = int(np.argmax(beyond))
    if beyond[worst] > 0.0:
        return 1.0, f"joint {dynamics.joint_names[worst]!r} leaves its limits by {beyond[worst]:.3g} between nodes"
    speed = float(np.max(peak_velocity(motion.time, motion.position, motion.velocity) / dynamics.max_velocity))
    least, most = _torque_room(max_effort, torque - holding, holding)
    if speed > 1.0 + ROUNDING:
        most = min(most, speed**-2)
    if most <= 0.0 or least > most:
        share = np.abs(holding) / max_effort
        row, joint = np.unravel_index(int(np.argmax(share)), share.shape)
        return 1.0, (
            f"joint {dynamics.joint_names[joint]!r} needs {abs(holding[row, joint]):.6g} to hold the arm on the way, "
            f"but its limit is {max_effort[joint]:.6g}"
        )
    needed = most**-0.5
    if needed <= 1.0 + ROUNDING:
        return 1.0, ""
    if np.any(motion.velocity[[0, -1]] != 0.0):
        return 1.0, f"limits are exceeded by a factor of {needed:.4g}, and a motion that is not at rest is not slowed"
    if needed > SLOWEST:
        return 1.0, f"limits are exceeded by a factor of {needed:.4g} between nodes"
    return needed, ""


def _torque_room(max_effort: FloatArray, moving: FloatArray, holding: FloatArray) -> tuple[float, float]:
    """Return between which factors, of at most 1, the moving part of the torques (states, joints) keeps the limits.

    Slowed by s it shrinks by 1 / s^2, so each state wants ``-max <= holding + factor * moving <= max``. Where the arm
    cannot be held, but is thrown through, the factor must not be too small either.
    """
    limit = max_effort * (1.0 + ROUNDING)
    along = np.abs(moving)
    towards = np.where(moving >= 0.0, holding, -holding)  # the holding torque, counted along the moving part
    still = along <= ROUNDING * max_effort
    if np.any(still & (np.abs(holding) > limit)):
        return np.inf, 0.0
    along = np.where(still, np.inf, along)
    most = np.where(still, 1.0, (limit - towards) / along)
    least = np.where(still, 0.0, (-limit - towards) / along)
    return float(least.max()), min(1.0, float(most.min()))


class _Dense:
    """Both ends and inner points of every interval: rows run interval by interval."""

    def __init__(self, motion: TimedMotion) -> None:
        self.h = np.diff(motion.time)
        u = np.linspace(0.0, 1.0, SAMPLES + 1)
        states = interval_states(motion.time, motion.position, motion.velocity, u)
        self.q, self.v, self.a = (each.reshape(-1, motion.position.shape[1]) for each in states)
        self.time = (motion.time[:-1, None] + self.h[:, None] * u).ravel()
        # nodes between intervals appear twice: the later interval's is kept
        self.kept = np.ones(len(self.q), bool)
        self.kept[SAMPLES :: SAMPLES + 1] = False
        self.kept[-1] = True

    def integral(self, rate: FloatArray) -> float:
        """Return the integral of values on the rows by Simpson's rule."""
        factor = np.ones(SAMPLES + 1)
        factor[1:-1:2], factor[2:-1:2] = 4.0, 2.0
        return float((rate.reshape(-1, SAMPLES + 1) @ factor) @ self.h / (3.0 * SAMPLES))

    def motion(self) -> TimedMotion:
        return TimedMotion(self.time[self.kept], self.q[self.kept], self.v[self.kept], self.a[self.kept])
