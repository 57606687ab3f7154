"""Compare a plan in the cell file's placement with one in the placement found, and say which of them is taken.

The new one is taken only if it passes its verification, executes every sweep that the old one executes, each at least
as far, measures no less of the verification cloud, brings no bodies into one another, lets nothing tip that stands now
or tips otherwise, and takes less time. What the search promised counts nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from cellwright.errors import listed
from schemas.motion import Trajectory
from schemas.overlaps import StandingOverlaps
from schemas.params import Params
from schemas.part import PartMesh
from schemas.placement import Placement, PlacementOutcome, motion_words
from schemas.sources import CellModel
from schemas.stage import stage
from schemas.views import Coverage

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from cellwright.figures.placement_view import PlacedPlan

SAME_TRAVEL = 1e-6
"""Metres by which a sweep may be shorter: rounding of poses."""


class ComparisonParams(Params):
    """Settings of the comparison."""

    gain_s: float = Field(default=0.01, gt=0, description="Seconds by which a placement must shorten the cycle.")
    lost_coverage: float = Field(default=0.0, ge=0, lt=1, description="Share of the cloud that it may measure less.")
    failure: str = Field(
        default="", description="Why the plan in the new placement fails its verification; empty if it does not."
    )


@stage(version=2)
def compare_placements(
    placement: Placement,
    cell: CellModel,
    mesh: PartMesh,
    trajectory: Trajectory,
    coverage: Coverage,
    overlaps: StandingOverlaps,
    moved_cell: CellModel | None = None,
    moved_trajectory: Trajectory | None = None,
    moved_coverage: Coverage | None = None,
    moved_overlaps: StandingOverlaps | None = None,
    *,
    params: ComparisonParams,
) -> PlacementOutcome:
    """Say which placement the inspection takes, with the figures of both.

    Without a plan in the new placement the old one is kept, for the reason that the search gave.
    """
    before, after = _cycle(trajectory), _cycle(trajectory)
    refusal, picture, plan, seen = "", b"", trajectory, coverage
    if moved_cell is not None and moved_trajectory is not None and moved_overlaps is not None:
        new = moved_trajectory, moved_coverage, moved_overlaps
        refusal = _refusal((trajectory, coverage, overlaps), new, params)
        if not refusal and moved_coverage is not None:
            plan, seen, after = moved_trajectory, moved_coverage, _cycle(moved_trajectory)
            picture = _picture(placement, mesh, (cell, trajectory), (moved_cell, moved_trajectory))
    moved = plan is moved_trajectory
    words = motion_words(placement.joint, placement.turns, placement.value)
    return PlacementOutcome(
        joint=placement.joint,
        turns=placement.turns,
        value=placement.value if moved else 0.0 * placement.value,
        lower=placement.lower,
        upper=placement.upper,
        carried=placement.carried,
        refused_test=placement.refused_test,
        refused_what=placement.refused_what,
        refused_cause=placement.refused_cause,
        refused_count=placement.refused_count,
        moves=placement.moves,
        moved=moved,
        reason=f"{words} looked better, but {refusal}" if refusal else placement.reason,
        refusal=refusal,
        cycle_before_s=before,
        cycle_after_s=after,
        scanning_before_s=_scanning(trajectory),
        scanning_after_s=_scanning(plan),
        coverage_before=coverage.share_measured,
        coverage_after=seen.share_measured,
        n_judged=placement.n_judged,
        n_stitched=len(placement.trial_cycle_s),
        picture=picture,
    )


def _refusal(
    old: tuple[Trajectory, Coverage, StandingOverlaps],
    new: tuple[Trajectory, Coverage | None, StandingOverlaps],
    params: ComparisonParams,
) -> str:
    """Return why the new placement is not taken, empty if it is."""
    from schemas.placement_objects import executed_spans

    if params.failure:
        return f"its plan fails its verification: {params.failure}"
    spans, moved_spans = executed_spans(old[0]), executed_spans(new[0])
    missing = [view for view in spans if view not in moved_spans]
    if missing:
        reasons = dict(zip(new[0].left_out_view.tolist(), new[0].left_out_reason))
        return listed(
            f"view {view} cannot be executed there ({reasons.get(view, 'it is left out')})" for view in missing
        )
    short = [
        view
        for view, (first, last) in spans.items()
        if moved_spans[view][0] > first + SAME_TRAVEL or moved_spans[view][1] < last - SAME_TRAVEL
    ]
    if short:
        return f"{listed(f'view {view}' for view in short)} would be shorter there"
    known = dict(zip(zip(old[2].body, old[2].other), old[2].depth_m.tolist()))
    for body, other, depth in zip(new[2].body, new[2].other, new[2].depth_m.tolist()):
        if depth > known.get((body, other), 0.0) + new[2].resting_m:
            return f"{body} and {other} would stand in one another there, by at least {1e3 * depth:.1f} mm"
    tipping = [words for words in new[2].tipping if words not in old[2].tipping]
    if tipping:
        return f"there {tipping[0]}"
    if new[1] is None:
        return "nothing was scanned there"
    if old[1].share_measured - new[1].share_measured > params.lost_coverage:
        return f"it measures {new[1].share_measured:.4%} of the surface there, not {old[1].share_measured:.4%}"
    before, after = _cycle(old[0]), _cycle(new[0])
    if after > before - params.gain_s:
        return f"its plan takes {after:.2f} s, not less than {before:.2f} s"
    return ""


def _cycle(trajectory: Trajectory) -> float:
    return float(trajectory.time_s[-1]) if len(trajectory.time_s) else 0.0


def _scanning(trajectory: Trajectory) -> float:
    lasted = zip(trajectory.kind, (trajectory.end_s - trajectory.start_s).tolist())
    return float(sum(seconds for kind, seconds in lasted if kind == "sweep"))


def _picture(
    placement: Placement, mesh: PartMesh, old: tuple[CellModel, Trajectory], new: tuple[CellModel, Trajectory]
) -> bytes:
    from cellwright.figures.placement_view import placement_picture

    words = motion_words(placement.joint, placement.turns, placement.value)
    return placement_picture(
        _placed(*old, mesh, placement.T_world_part_before, f"before: {old[1].time_s[-1]:.2f} s"),
        _placed(*new, mesh, placement.T_world_part, f"after: {new[1].time_s[-1]:.2f} s ({words})"),
    )


def _placed(
    cell: CellModel, trajectory: Trajectory, mesh: PartMesh, T_world_part: FloatArray, title: str
) -> PlacedPlan:
    import numpy as np

    from cellwright.figures.placement_view import PlacedPlan
    from schemas.cell_objects import build_cell

    is_sweep = np.array([kind == "sweep" for kind in trajectory.kind], bool)
    return PlacedPlan(
        build_cell(cell, mesh, T_world_part), trajectory.position_rad, is_sweep[trajectory.segment], title
    )
