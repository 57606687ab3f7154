"""What stands in what: overlaps of bodies that do not move, which no collision check of a motion looks at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellwright.arrays import FloatArray
from schemas.artefact import Artefact
from schemas.columns import column, fact


@dataclass(frozen=True, eq=False, repr=False)
class StandingOverlaps(Artefact):
    """Bodies that stand still and stand in one another by more than resting contact does; the part among them."""

    KIND: ClassVar[str] = "standing-overlaps"

    body: tuple[str, ...] = column("Body of the cell, or the part", dtype="str", table="overlaps")
    other: tuple[str, ...] = column("Body that it stands in", dtype="str", table="overlaps")
    depth_m: FloatArray = column(
        "They come apart by no move shorter than this; proven, the truth may be more", unit="m", table="overlaps"
    )
    finding: tuple[str, ...] = column("The same in words", dtype="str", table="overlaps")
    n_pairs: int = fact("Pairs of standing bodies that were looked at", dtype="int64")
    resting_m: float = fact("Bodies no deeper in one another rest on each other", unit="m")
    engine: str = fact("Collision engine that was asked", dtype="str")
