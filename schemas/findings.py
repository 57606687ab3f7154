"""The artefact of a plan that came to nothing: what stands in the way of each sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellwright.arrays import BoolArray, Int8Array, Int32Array
from schemas.artefact import Artefact
from schemas.columns import column


@dataclass(frozen=True, eq=False, repr=False)
class SampleFindings(Artefact):
    """Why the planning samples are not measured, where planning ended without a plan."""

    KIND: ClassVar[str] = "sample-findings"

    coverable: BoolArray = column(
        "Whether any executable candidate sweep could measure the sample", dtype="bool", table="samples"
    )
    cause: Int8Array = column(
        "The furthest test that a candidate reached, `Cause`; not selected or not scanned where one passes them all",
        dtype="int8",
        table="samples",
    )
    blocked_by: Int32Array = column(
        "For collisions: body that stopped the most candidates (row of `body`); -1 none",
        dtype="int32",
        table="samples",
    )
    body: tuple[str, ...] = column("Names of the bodies in the cell", dtype="str", table="bodies")
