"""What a plan has to execute: straight sweeps of the scanner, and the pieces of motion that can execute them."""

from __future__ import annotations

from dataclasses import dataclass

from cellwright.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class ExecutablePiece:
    """A piece of a sweep on one inverse kinematics branch.

    Attributes:
        branch: Number of the branch.
        start, end: First and last travel in m.
        q_start: Configuration at the first travel, (joints,) in rad.
    """

    branch: int
    start: float
    end: float
    q_start: FloatArray


@dataclass(frozen=True, eq=False)
class PlannedSweep:
    """A sweep that must be executed.

    Attributes:
        name: What to call it.
        T_world_scanner: Pose of the scanner at travel 0, (4, 4); it moves along its x axis.
        interval: First and last travel in m that must be executed.
        pieces: Pieces that hold the whole interval.
    """

    name: str
    T_world_scanner: FloatArray
    interval: tuple[float, float]
    pieces: tuple[ExecutablePiece, ...] = ()
