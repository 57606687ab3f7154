"""What a pose task is: where the tool has to be, which turns about its axis are free, and how it comes and goes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.cell.cell import Cell
from cellwright.cell.transforms import inverse, pose

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class PoseTask:
    """One task.

    Attributes:
        name: For people.
        T_world_tool: Pose of the tool point while the task is worked on, (4, 4).
        n_rotations: Turns about the tool's z axis that are tried, evenly spread; 1: the pose is kept as it is.
        dwell: Time at the pose in s.
        approach: Way in m along the tool's z axis in which it comes to the pose and leaves it again; 0 for none.
    """

    name: str
    T_world_tool: FloatArray
    n_rotations: int = 1
    dwell: float = 0.0
    approach: float = 0.0

    def rotations(self) -> FloatArray:
        """Return the turns about the tool's axis, (n_rotations,) in rad."""
        return 2.0 * math.pi * np.arange(self.n_rotations) / self.n_rotations

    def T_base_flange(self, cell: Cell, rotation: FloatArray, back: float = 0.0) -> FloatArray:
        """Return the flange poses (n, 4, 4) for turns (n,) in rad, ``back`` m away from the work along the axis."""
        turned = np.tile(np.eye(4), (len(rotation), 1, 1))
        c, s = np.cos(rotation), np.sin(rotation)
        turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 0], turned[:, 1, 1] = c, -s, s, c
        turned[:, 2, 3] = -back
        T_flange_tool = cell.T_flange_scanner
        return np.asarray(inverse(cell.T_world_base) @ self.T_world_tool @ turned @ inverse(T_flange_tool))


def facing(position: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the pose (4, 4) at ``position`` (3,) whose z axis points in ``direction`` (3,), of any length.

    Its x axis is the axis of the frame that is least aligned with z, projected; of equals the first.
    """
    z = direction / np.linalg.norm(direction)
    x = np.eye(3)[int(np.argmin(np.round(np.abs(z), 9)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return pose(position, np.stack([x, np.cross(z, x), z], axis=1))


def working_cell(cell: Cell, contacts: Int32Array) -> Cell:
    """Return the cell in which the pairs of bodies ``contacts`` (pairs, 2) may touch: how it is while tasks run."""
    if not len(contacts):
        return cell
    return replace(
        cell,
        ignored_pairs=np.concatenate([cell.ignored_pairs, contacts]).astype(np.int32),
        never_touching=np.array(
            [pair for pair in cell.never_touching.tolist() if sorted(pair) not in np.sort(contacts, axis=1).tolist()],
            np.int32,
        ).reshape(-1, 2),
    )
