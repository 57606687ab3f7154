"""What the scanner does while the joints follow their curves: the curve's own bend and acceleration, not the plan's.

Between traced poses a joint path is a cubic spline, and between the states of a timed motion a cubic Hermite curve.
Near a singular pose joints turn so fast along a sweep that either leaves the sweep's straight line by micrometres,
over so short a travel that the scanner shakes. The path is then traced in finer steps where it bends; what shaking
is left is told by `scanner_acceleration`, so that the motion can be slowed.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import track_pose
from cellwright.solvers.motion_steps import link_poses_of
from cellwright.solvers.path_timing import Path, TimedMotion

REFINEMENTS = 6
"""Halvings of a trace step: 2 mm become 30 micrometres; below that, second differences of poses have no digits left."""
EXACT = 1e-11
"""Metres and rad to which finer poses are traced."""
ROUNDING_BEND = 12.0
"""An error e of poses at steps h bends a cubic spline through them by about 12 e / h^2."""
EXACT_STEPS = 60
LARGEST_CORRECTION = 0.2
"""Rad that Newton's method may turn a joint away from the spline; more means another branch."""
LOOKED_AT = np.array([0.0, 0.25, 0.5, 0.75])
"""Shares of a trace step at which the bend is looked at."""
TRAVEL_STEP = 1e-5
"""Metres of the central differences over the travel."""
TIME_STEP = 1e-4
"""Seconds of the central differences over time."""


def refined_trace(cell: Cell, targets: FloatArray, position: FloatArray) -> FloatArray | None:
    """Return ``position`` (poses, joints) moved exactly to the flange poses ``targets`` (poses, 4, 4).

    ``None`` if a pose is not reached nearby.
    """
    chain = cell.robot.chain
    exact = np.empty_like(position)
    for row, (q, target) in enumerate(zip(position, targets, strict=True)):
        exact[row], reached = track_pose(
            chain.T_parent_joint, chain.axis, chain.T_last_flange, np.ascontiguousarray(q), target, EXACT, EXACT_STEPS
        )
        if not reached or float(np.abs(exact[row] - q).max()) > LARGEST_CORRECTION:
            return None
    return exact


def steps_that_bend(cell: Cell, path: Path, travel: FloatArray, largest_bend: float) -> FloatArray:
    """Return the middles (m) of the steps between traced poses on which the scanner's path bends too much.

    Args:
        cell: The cell.
        path: Joint positions over the travel.
        travel: Travel of the traced poses, rising, (poses,) in m.
        largest_bend: Second derivative of the scanner's position by the travel, in 1/m; on a straight line it is 0.
    """
    steps = np.diff(travel)
    at = (travel[:-1, None] + LOOKED_AT * steps[:, None]).ravel()
    before, here, after = (_scanner_position(cell, path(at + d)) for d in (-TRAVEL_STEP, 0.0, TRAVEL_STEP))
    bend = np.linalg.norm(after - 2.0 * here + before, axis=1) / TRAVEL_STEP**2
    bent = bend.reshape(len(steps), -1).max(axis=1) > largest_bend
    bent &= steps**2 > 2.0 * ROUNDING_BEND * EXACT / largest_bend  # finer poses would bend it by what they are off
    return np.asarray(0.5 * (travel[:-1] + travel[1:])[bent])


def scanner_acceleration(cell: Cell, motion: TimedMotion) -> FloatArray:
    """Return the scanner's greatest acceleration in m/s^2 on each interval of a motion of the joints, (intervals,).

    It is that of the cubic Hermite curve, at both ends and the middle of each interval.
    """
    h = np.diff(motion.time)[:, None]
    v0, v1 = motion.velocity[:-1], motion.velocity[1:]
    slope = np.diff(motion.position, axis=0) / h
    b, c = 6.0 * slope - 4.0 * v0 - 2.0 * v1, 3.0 * (v0 + v1) - 6.0 * slope
    worst = np.zeros(len(h))
    for u in (0.0, 0.5, 1.0):
        q = motion.position[:-1] + h * u * (v0 + u * (b / 2.0 + u * c / 3.0))
        moved = TIME_STEP * (v0 + u * (b + u * c))
        curved = 0.5 * TIME_STEP**2 * (b + 2.0 * u * c) / h
        before, here, after = (_scanner_position(cell, each) for each in (q - moved + curved, q, q + moved + curved))
        np.maximum(worst, np.linalg.norm(after - 2.0 * here + before, axis=1) / TIME_STEP**2, out=worst)
    return worst


def _scanner_position(cell: Cell, position: FloatArray) -> FloatArray:
    """Return where the scanner is, in the base frame, (states, 3) in m."""
    chain = cell.robot.chain
    p_last = (chain.T_last_flange @ cell.T_flange_scanner)[:, 3]
    return np.asarray((link_poses_of(chain, position)[:, -1] @ p_last)[:, :3])
