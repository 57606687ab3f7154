"""Find bodies that stand in one another: a part sunk into its table, a fixture through the floor.

Nothing of this moves, so no plan fails of it; but what is planned around a part that stands where it cannot stand is
worth little. So it is a finding, told with the bodies and how deep (see `cellwright.cell.standing_overlaps`).
"""

from __future__ import annotations

from pydantic import Field

from schemas.overlaps import StandingOverlaps
from schemas.params import Params
from schemas.part import PartMesh
from schemas.poses import Pose
from schemas.sources import CellModel
from schemas.stage import stage


class OverlapParams(Params):
    """Settings of the search for overlaps."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    resting_m: float = Field(default=1e-3, ge=0, description="Depth at which bodies still count as resting in contact.")


@stage(version=1)
def find_overlaps(cell: CellModel, mesh: PartMesh, *, params: OverlapParams) -> StandingOverlaps:
    """Find the pairs of standing bodies that overlap; pairs that the cell declares as harmless are left out."""
    import numpy as np

    from cellwright.cell.ignored_pairs import Reason
    from cellwright.cell.standing_overlaps import standing_overlaps, standing_pairs
    from schemas.cell_objects import build_cell

    built = build_cell(cell, mesh, params.T_world_part.matrix())
    declared = [(int(a), int(b)) for a, b in cell.ignored_pair[cell.ignored_reason == Reason.DECLARED]]
    overlaps, engine = standing_overlaps(built, resting=params.resting_m, permitted=declared)
    return StandingOverlaps(
        body=tuple(overlap.body for overlap in overlaps),
        other=tuple(overlap.other for overlap in overlaps),
        depth_m=np.array([overlap.depth for overlap in overlaps], float),
        finding=tuple(
            f"{overlap.body} and {overlap.other} stand in one another, by at least {1e3 * overlap.depth:.1f} mm: "
            "move one of them or correct its size"
            for overlap in overlaps
        ),
        n_pairs=len(standing_pairs(built, declared)),
        resting_m=params.resting_m,
        engine=engine,
    )
