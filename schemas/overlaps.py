"""How what does not move stands: bodies in one another, and a part that would tip, sticks out or hangs in the air."""

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
    supported_by: tuple[str, ...] = column("Body that carries the part from below", dtype="str", table="supports")
    tipping: tuple[str, ...] = column("That the part would tip, in words", dtype="str", table="tipping")
    note: tuple[str, ...] = column(
        "What else is to be known of how the part stands, in words", dtype="str", table="notes"
    )
    n_pairs: int = fact("Pairs of standing bodies that were looked at", dtype="int64")
    resting_m: float = fact("Bodies no deeper in one another rest on each other", unit="m")
    support_margin_m: float = fact(
        "How far the part's centre of mass lies inside of what supports it, seen from above; negative outside, "
        "infinite if nothing supports it",
        unit="m",
    )
    overhang_m: float = fact("How far the part's foot reaches beyond what supports it", unit="m")
    engine: str = fact("Collision engine that was asked", dtype="str")

    @property
    def attention(self) -> tuple[str, ...]:
        """What must be told before a plan is used: overlaps, then that the part would tip."""
        return (*self.finding, *self.tipping)
