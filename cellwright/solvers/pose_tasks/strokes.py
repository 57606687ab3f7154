"""The strokes of a task: straight along the tool's axis to the pose, and back out the same way.

A stroke is followed by Newton's method in small steps, so that the joint path stays on its branch; between the steps
it is a cubic spline, timed under the joints' limits. Coming and going take the same path.
"""

from __future__ import annotations

import math

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import track_pose
from cellwright.errors import SolverError
from cellwright.solvers.path_timing import Limits, TimedMotion, time_path
from cellwright.solvers.pose_tasks.task import PoseTask

STEP = 0.002
"""Metres between traced poses: the spline between them leaves the straight line by some micrometres."""
TOLERANCE = 1e-8
"""Metres and rad: far below what is verified, far above rounding."""
TRACKING_STEPS = 20
LARGEST_TURN = 0.2
"""Rad of any joint between two traced poses; more means that the path has left its branch near a singularity."""


def trace_stroke(cell: Cell, task: PoseTask, rotation: float, q_task: FloatArray) -> FloatArray | None:
    """Return the joint path (poses, joints) from the retracted pose to the task's, ``None`` if the arm cannot follow.

    The last row is ``q_task`` (joints,) itself; joint limits are looked at. Without approach it is the only row.
    """
    if task.approach <= 0.0:
        return np.array(q_task, float)[None]
    chain = cell.robot.chain
    count = max(2, math.ceil(task.approach / STEP)) + 1
    q, rows = np.ascontiguousarray(q_task, float), [np.array(q_task, float)]
    for back in np.linspace(0.0, task.approach, count)[1:].tolist():
        target = task.T_base_flange(cell, np.array([rotation]), back)[0]
        following, reached = track_pose(
            chain.T_parent_joint, chain.axis, chain.T_last_flange, q, target, TOLERANCE, TRACKING_STEPS
        )
        within = bool(np.all(following >= chain.lower) and np.all(following <= chain.upper))
        if not (reached and within and float(np.abs(following - q).max()) <= LARGEST_TURN):
            return None
        q = following
        rows.append(q)
    return np.stack(rows[::-1])


def time_stroke(path: FloatArray, approach: float, limits: Limits, sample: float) -> TimedMotion | None:
    """Time a traced stroke of ``approach`` m from rest to rest, ``None`` if no timing was found."""
    from scipy.interpolate import CubicSpline

    travel = np.linspace(0.0, approach, len(path))
    try:
        return time_path(CubicSpline(travel, path), travel, limits, sample)
    except SolverError:
        return None


def at_work(stroke: TimedMotion | None, q_task: FloatArray, dwell: float) -> TimedMotion | None:
    """Return stroke, dwell and way back as one motion; ``None`` if there is neither stroke nor dwell."""
    rest: TimedMotion | None = None
    if dwell > 0.0:
        still = np.zeros((3, len(q_task)))
        rest = TimedMotion(np.array([0.0, 0.5 * dwell, dwell]), np.tile(q_task, (3, 1)), still, still)
    if stroke is None:
        return rest
    return (stroke if rest is None else stroke.then(rest)).then(stroke.reversed())
