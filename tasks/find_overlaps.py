"""Find bodies that stand in one another, and a part that cannot stand where it is put.

A part sunk into its table, a fixture through the floor, a part that would tip over the table's edge: nothing of this
moves, so no plan fails of it; but what is planned around a part that cannot stand there is worth little. So these are
findings, told with the bodies and by how much (see `cellwright.cell.standing_overlaps` and `part_standing`). That a
part reaches beyond its table, or touches nothing at all, may well be meant: that is a note.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from cellwright.errors import listed
from schemas.overlaps import StandingOverlaps
from schemas.params import Params
from schemas.part import PartMesh
from schemas.poses import Pose
from schemas.sources import CellModel
from schemas.stage import stage

if TYPE_CHECKING:
    from cellwright.cell.part_standing import PartStanding


class OverlapParams(Params):
    """Settings of the search for overlaps."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    resting_m: float = Field(default=1e-3, ge=0, description="Depth at which bodies still count as resting in contact.")


@stage(version=2)
def find_overlaps(cell: CellModel, mesh: PartMesh, *, params: OverlapParams) -> StandingOverlaps:
    """Find the pairs of standing bodies that overlap, less those declared as harmless, and how the part stands."""
    import numpy as np

    from cellwright.cell.ignored_pairs import Reason
    from cellwright.cell.part_standing import part_standing
    from cellwright.cell.standing_overlaps import standing_overlaps, standing_pairs
    from schemas.cell_objects import build_cell

    built = build_cell(cell, mesh, params.T_world_part.matrix())
    declared = [(int(a), int(b)) for a, b in cell.ignored_pair[cell.ignored_reason == Reason.DECLARED]]
    overlaps, engine = standing_overlaps(built, resting=params.resting_m, permitted=declared)
    stands = part_standing(built, resting=params.resting_m)
    tips = _tips(stands, params)
    return StandingOverlaps(
        body=tuple(overlap.body for overlap in overlaps),
        other=tuple(overlap.other for overlap in overlaps),
        depth_m=np.array([overlap.depth for overlap in overlaps], float),
        finding=tuple(
            f"{overlap.body} and {overlap.other} stand in one another, by at least {1e3 * overlap.depth:.1f} mm: "
            "move one of them or correct its size"
            for overlap in overlaps
        ),
        supported_by=stands.supports,
        tipping=(_tipping(stands),) if tips else (),
        note=() if tips else _notes(stands, params),
        n_pairs=len(standing_pairs(built, declared)),
        resting_m=params.resting_m,
        support_margin_m=stands.margin if stands.supports else math.inf,
        overhang_m=stands.overhang,
        engine=engine,
    )


def _tips(stands: PartStanding, params: OverlapParams) -> bool:
    """Whether gravity turns it over; what something else touches may be held."""
    return bool(stands.supports) and stands.margin < -params.resting_m and not stands.others


def _tipping(stands: PartStanding) -> str:
    return (
        f"the part would tip: its centre of mass lies {-1e3 * stands.margin:.1f} mm outside of where it stands on "
        f"{listed(stands.supports)}: move it, or model what holds it"
    )


def _notes(stands: PartStanding, params: OverlapParams) -> tuple[str, ...]:
    if stands.nearest:
        return (
            f"the part touches nothing: it hangs in the air, {1e3 * stands.gap:.1f} mm from {stands.nearest}; "
            "let it rest on a body",
        )
    if stands.supports and stands.margin < -params.resting_m:
        return (
            f"the part stands on {listed(stands.supports)} only if {listed(stands.others)} holds it: its centre of "
            f"mass lies {-1e3 * stands.margin:.1f} mm outside of where it stands",
        )
    if stands.overhang > params.resting_m:
        return (
            f"the part reaches {1e3 * stands.overhang:.1f} mm beyond {listed(stands.supports)}; its centre of mass "
            f"is supported, {1e3 * max(stands.margin, 0.0):.1f} mm from the edge",
        )
    return ()
