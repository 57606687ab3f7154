"""What may move, and which sweeps must be executed wherever it stands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import WORLD
from cellwright.cell.cell import Cell
from cellwright.cell.harness import Harness
from cellwright.cell.standing_overlaps import RESTING
from cellwright.cell.transforms import inverse
from cellwright.solvers.sweeps.poses import CandidateSweeps, FollowSettings


@dataclass(frozen=True, eq=False)
class PlacementProblem:
    """What may move, and what must be executed wherever it stands.

    Attributes:
        cell: The cell in its present placement, with the part.
        harness: Motion of the part, or of the robot's base, in the world; the identity at zero.
        moves_base: Whether the base moves; else the part.
        carried: Names of the bodies that move along with the part; the part itself is always one.
        sweeps: The sweeps as they are looked at now, in the world.
        required: First and last travel of each that must be executed, (sweeps, 2) in m.
        names: What to call each sweep.
        follow: How they are followed.
        scan_speed, tool_acceleration: Limits of the scanner while it executes a sweep, m/s and m/s^2.
        returns: Whether the cycle ends in the start configuration.
        most_alternatives: Branches and windings of each sweep that an estimate looks at.
        resting: Bodies no deeper in one another rest on each other, m.
        permitted: Pairs of rows of bodies that may stand in one another.
    """

    cell: Cell
    harness: Harness
    moves_base: bool
    carried: tuple[str, ...]
    sweeps: CandidateSweeps
    required: FloatArray
    names: tuple[str, ...]
    follow: FollowSettings
    scan_speed: float
    tool_acceleration: float
    returns: bool
    most_alternatives: int = 8
    resting: float = RESTING
    permitted: tuple[tuple[int, int], ...] = ()

    def motion(self, values: FloatArray) -> FloatArray:
        """Return the motion (4, 4) in the world of what moves, at design joints ``values`` (joints,)."""
        return self.harness.poses(np.asarray(values, float))

    def shift(self, values: FloatArray) -> FloatArray:
        """Return how the sweeps shift as seen from the base, (4, 4)."""
        D, T = self.motion(values), self.cell.T_world_base
        return inverse(D @ T) @ T if self.moves_base else inverse(T) @ D @ T

    def is_shifted(self, row: int) -> bool:
        """Whether a body of the cell shifts, as seen from the base, with the sweeps."""
        body = self.cell.bodies[row]
        return body.parent == WORLD and (self.moves_base or body.name in self.carried or self.is_part(row))

    def is_part(self, row: int) -> bool:
        """Whether a body is the workpiece: always the last one of a cell."""
        return row == len(self.cell.bodies) - 1

    def moved_cell(self, values: FloatArray) -> Cell:
        """Return the cell at a design."""
        D = self.motion(values)
        if self.moves_base:
            return replace(self.cell, T_world_base=D @ self.cell.T_world_base)
        bodies = tuple(
            replace(body, T_parent_body=D @ body.T_parent_body) if self.is_shifted(row) else body
            for row, body in enumerate(self.cell.bodies)
        )
        return replace(self.cell, bodies=bodies)

    def moved_sweeps(self, values: FloatArray) -> CandidateSweeps:
        """Return the sweeps in the world at a design."""
        if self.moves_base:
            return self.sweeps
        return replace(self.sweeps, T_world_scanner=self.motion(values) @ self.sweeps.T_world_scanner)
