"""The cell as planners see it: robot, bodies, mount, and the pairs of bodies that may touch."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.cell.bodies import WORLD, Body, Mesh
from cellwright.cell.robot import Robot

PART = "part"
"""Name of the workpiece's body, always the last one of a cell."""


@dataclass(frozen=True, eq=False)
class Cell:
    """A robot with its tool among bodies.

    Attributes:
        robot: The arm; its base stands at ``T_world_base``.
        bodies: All bodies: links, scanner housing, table, obstacles, the part last if it is there.
        ignored_pairs: Pairs of rows of ``bodies`` that are not checked against each other, (pairs, 2).
        T_world_base: Pose of the robot's base in the world, (4, 4).
        T_flange_scanner: Pose of the laser-emitter frame on the flange, (4, 4).
        start: Start configuration, (joints,) in rad.
        never_touching: Those of ``ignored_pairs`` that no sampled configuration brought near each other, (pairs, 2):
            samples prove nothing, so verification checks these pairs all the same.
    """

    robot: Robot
    bodies: tuple[Body, ...]
    ignored_pairs: Int32Array
    T_world_base: FloatArray
    T_flange_scanner: FloatArray
    start: FloatArray
    never_touching: Int32Array = field(default_factory=lambda: np.empty((0, 2), np.int32))

    def with_part(self, mesh: Mesh, T_world_part: FloatArray) -> Cell:
        """Return the cell with the workpiece standing in it, as the last body."""
        return replace(self, bodies=(*self.bodies, Body(PART, mesh, WORLD, T_world_part)))
