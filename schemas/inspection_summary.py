"""The figures of an inspection plan, gathered from its artefacts: for reports, studies and the command line."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cellwright.arrays import Int32Array
from cellwright.causes import Cause
from cellwright.errors import listed
from schemas.motion import ScanCloud, Trajectory, Verification
from schemas.overlaps import StandingOverlaps
from schemas.part import PartMesh
from schemas.plan_objects import covered_samples
from schemas.views import Coverage, Measurability, Reachability, Viewpoints, ViewSelection

METRICS = frozenset(
    {
        "area_m2",
        "area_to_measure_m2",
        "candidates",
        "coverage",
        "coverage_of_coverable",
        "coverage_of_samples",
        "duration_s",
        "executed_sweeps",
        "greedy_sweeps",
        "least_distance_m",
        "order_lower_bound_s",
        "order_proven_shortest",
        "proven_distance_m",
        "scan_points",
        "scan_profiles",
        "samples_not_connected",
        "scanning_s",
        "sweeps",
        "sweeps_excluded",
        "sweeps_lower_bound",
        "sweeps_proven_fewest",
        "uncertainty_mean_m",
        "uncertainty_median_m",
        "uncertainty_p95_m",
        "unsettled_sweeps",
        "verified_states",
    }
)
"""The figures that are one number: what the table of a study holds and its pictures draw."""


def summarise(
    mesh: PartMesh,
    viewpoints: Viewpoints,
    measurability: Measurability,
    selection: ViewSelection,
    trajectory: Trajectory,
    scan: ScanCloud,
    coverage: Coverage,
    verification: Verification | None = None,
    *,
    overlaps: StandingOverlaps | None = None,
    reachability: Reachability | None = None,
) -> dict[str, Any]:
    """Return the figures of a plan as plain JSON values, units in the names.

    ``measurability`` is what the selection was made from.
    """
    summary = {
        "area_m2": float(mesh.areas_m2.sum()),
        "area_to_measure_m2": float(mesh.areas_m2[mesh.to_measure].sum()),
        "findings": list(mesh.finding),
        "overlaps": _overlap_figures(overlaps),
        "unsettled_sweeps": reachability.n_unsettled if reachability else None,
        **_selection_figures(viewpoints, measurability, selection, trajectory),
        **_motion_figures(trajectory),
        "scan_points": len(scan.points_m),
        "scan_profiles": len(scan.time_s),
        **_coverage_figures(coverage),
        **_verification_figures(verification),
    }
    tipping, notes = (list(overlaps.tipping), list(overlaps.note)) if overlaps else ([], [])
    return {**summary, "attention": [*_attention(summary), *tipping], "notes": notes}


def _attention(summary: dict[str, Any]) -> list[str]:
    """Return what a reader has to know before the plan is used, in words."""
    found = [overlap["finding"] for overlap in summary["overlaps"]]
    found += [
        f"the sweep of view {sweep['view']} is left out: {sweep['reason']}" for sweep in summary["left_out_sweeps"]
    ]
    if summary["samples_not_connected"]:
        replaced = listed(f"view {sweep['view']}: {sweep['reason']}" for sweep in summary["replaced_sweeps"])
        count = summary["samples_not_connected"]
        found.append(
            f"{'1 sample is' if count == 1 else f'{count:,} samples are'} measured only by sweeps that cannot be "
            f"executed or connected ({replaced})"
        )
    if summary["unsettled_sweeps"]:
        found.append(
            f"{summary['unsettled_sweeps']:,} candidate sweeps may be executable further than the plan takes them to "
            "be: the limit on exact collision checks ended the search, which took the undecided poses as colliding"
        )
    return found


def _verification_figures(verification: Verification | None) -> dict[str, Any]:
    if verification is None:
        distances = ("least_distance_m", "proven_distance_m", "nearest")
        return dict.fromkeys(("verified_states", "verified_by", *distances))
    nearest = {"bodies": list(verification.nearest_bodies), "time_s": verification.nearest_s}
    is_apart = np.isfinite(verification.least_distance_m)  # infinite if nothing can be hit
    return {
        "verified_states": verification.n_states,
        "verified_by": verification.engine,
        "least_distance_m": verification.least_distance_m if is_apart else None,
        "proven_distance_m": verification.proven_distance_m if is_apart else None,
        "nearest": nearest if is_apart else None,
    }


def _overlap_figures(overlaps: StandingOverlaps | None) -> list[dict[str, Any]]:
    if overlaps is None:
        return []
    return [
        {"bodies": [body, other], "depth_at_least_m": depth, "finding": finding}
        for body, other, depth, finding in zip(
            overlaps.body, overlaps.other, overlaps.depth_m.tolist(), overlaps.finding
        )
    ]


def blocking_bodies(coverage: Coverage) -> dict[str, int]:
    """Count the points that collisions keep from being measured, by the body that stops the most candidates."""
    rows = coverage.blocked_by[coverage.blocked_by >= 0]
    return {coverage.body[row]: int(count) for row, count in enumerate(np.bincount(rows)) if count}


def _selection_figures(
    viewpoints: Viewpoints, measurability: Measurability, selection: ViewSelection, trajectory: Trajectory
) -> dict[str, Any]:
    # every planning sample has views of its own; the gaps that refinement appends behind them have none
    n_samples = int(viewpoints.sample.max(initial=-1)) + 1
    is_covered = covered_samples(measurability, trajectory)[:n_samples]
    return {
        "candidates": len(viewpoints.sample),
        "sweeps": len(selection.view),
        "greedy_sweeps": len(selection.greedy_view),
        "sweeps_lower_bound": selection.lower_bound,
        "sweeps_proven_fewest": selection.proven and selection.n_excluded == 0,
        "sweeps_excluded": selection.n_excluded,
        "cover_method": selection.method,
        "coverage_of_samples": float(np.mean(is_covered)) if len(is_covered) else 0.0,
        "samples_not_connected": int((selection.cause == Cause.NOT_CONNECTED).sum()),
    }


def _motion_figures(trajectory: Trajectory) -> dict[str, Any]:
    is_sweep = np.array([kind == "sweep" for kind in trajectory.kind], bool)
    lasted = trajectory.end_s - trajectory.start_s
    orders = dict(zip(trajectory.order_method, trajectory.order_duration_s.tolist()))
    chosen = [name for name, is_chosen in zip(trajectory.order_method, trajectory.order_chosen) if is_chosen]
    return {
        "duration_s": float(trajectory.time_s[-1]) if len(trajectory.time_s) else 0.0,
        "scanning_s": float(lasted[is_sweep].sum()),
        "orders_s": orders,
        "order": chosen[0] if chosen else "",
        "order_lower_bound_s": trajectory.order_lower_bound_s,
        "order_proven_shortest": trajectory.order_proven,
        "executed_sweeps": int(is_sweep.sum()),
        "left_out_sweeps": _reasons(trajectory.left_out_view, trajectory.left_out_reason),
        "replaced_sweeps": _reasons(trajectory.replaced_view, trajectory.replaced_reason),
    }


def _reasons(views: Int32Array, reasons: tuple[str, ...]) -> list[dict[str, Any]]:
    return [{"view": view, "reason": reason} for view, reason in zip(views.tolist(), reasons, strict=True)]


def cover_words(summary: dict[str, Any]) -> str:
    """Return in words how few sweeps there could be: proven, or at least so many, and of which candidates."""
    if summary["sweeps_proven_fewest"]:
        return "proven fewest"
    at_least = f"at least {math.ceil(summary['sweeps_lower_bound'] - 1e-6)} needed"  # a bound may end a bit above
    excluded = summary["sweeps_excluded"]
    return f"{at_least} without the {excluded} that cannot be executed or connected" if excluded else at_least


def _coverage_figures(coverage: Coverage) -> dict[str, Any]:
    uncertainty = coverage.uncertainty_m[np.isfinite(coverage.uncertainty_m)]
    causes = np.bincount(coverage.cause, minlength=len(Cause))
    return {
        "coverage": coverage.share_measured,
        "coverage_of_coverable": coverage.share_of_coverable,
        "uncertainty_median_m": float(np.median(uncertainty)) if len(uncertainty) else None,
        "uncertainty_p95_m": float(np.quantile(uncertainty, 0.95)) if len(uncertainty) else None,
        "uncertainty_mean_m": float(np.mean(uncertainty)) if len(uncertainty) else None,
        "causes": {cause.label: int(causes[cause]) for cause in Cause if cause and causes[cause]},
        "collides_with": blocking_bodies(coverage),
    }
