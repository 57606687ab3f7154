"""Where a finished plan fails its verification: which motion, and the cell with the robot at that moment."""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cellwright.errors import UnsafePlanError

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from flows.requests import InspectionRequest
    from schemas.motion import Trajectory


@dataclass(frozen=True)
class FailedMotion:
    """The moment at which a plan fails.

    Attributes:
        where: The moment and the motion it belongs to, in words.
        picture: The cell with the robot at that moment, as PNG bytes.
    """

    where: str
    picture: bytes


def failed_motion(error: UnsafePlanError, request: InspectionRequest, trajectory: Trajectory) -> FailedMotion | None:
    """Return where the plan fails; nothing if what it fails has no moment.

    Raises:
        InvalidInputError: If the cell cannot be drawn.
    """
    from flows.cell_picture import picture_of

    if error.time_s is None or not trajectory.kind:
        return None
    moment = f"{error.time_s:.2f} s"
    picture = picture_of(request, state_at(trajectory, error.time_s), f"at {moment}, where the plan fails")
    total = f"of {float(trajectory.time_s[-1]):.2f} s"
    return FailedMotion(f"The plan fails at {moment} {total}, {motion_at(trajectory, error.time_s)}.", picture)


def state_at(trajectory: Trajectory, time_s: float) -> FloatArray:
    """Return the joint positions (joints,) in rad at a time in s, between two states on a straight line."""
    import numpy as np

    columns = trajectory.position_rad.T
    return np.array([np.interp(time_s, trajectory.time_s, column) for column in columns])


def motion_at(trajectory: Trajectory, time_s: float) -> str:
    """Return in words what the robot does at a time in s: which sweep, or the way between which."""
    segment = min(bisect.bisect_left(trajectory.end_s.tolist(), time_s), len(trajectory.kind) - 1)
    n_before = trajectory.kind[:segment].count("sweep")
    n_sweeps = trajectory.kind.count("sweep")
    if trajectory.kind[segment] == "sweep":
        return f"on sweep {n_before + 1} of {n_sweeps} (view {int(trajectory.view[segment])})"
    after = f"to sweep {n_before + 1}" if n_before < n_sweeps else "back to the start"
    return f"on the way from {f'sweep {n_before}' if n_before else 'the start'} {after}"
