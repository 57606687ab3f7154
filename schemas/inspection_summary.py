"""The figures of an inspection plan, gathered from its artefacts: for reports, studies and the command line."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellwright.causes import Cause
from schemas.motion import ScanCloud, Trajectory, Verification
from schemas.part import PartMesh
from schemas.views import Coverage, Viewpoints, ViewSelection

METRICS = frozenset(
    {
        "area_m2",
        "area_to_measure_m2",
        "candidates",
        "coverage",
        "coverage_of_coverable",
        "coverage_of_samples",
        "duration_s",
        "greedy_sweeps",
        "scan_points",
        "scan_profiles",
        "scanning_s",
        "sweeps",
        "sweeps_lower_bound",
        "sweeps_proven_fewest",
        "uncertainty_mean_m",
        "uncertainty_median_m",
        "uncertainty_p95_m",
        "verified_states",
    }
)
"""The figures that are one number: what the table of a study holds and its pictures draw."""


def summarise(
    mesh: PartMesh,
    viewpoints: Viewpoints,
    selection: ViewSelection,
    trajectory: Trajectory,
    scan: ScanCloud,
    coverage: Coverage,
    verification: Verification | None = None,
) -> dict[str, Any]:
    """Return the figures of a plan as plain JSON values, units in the names."""
    return {
        "area_m2": float(mesh.areas_m2.sum()),
        "area_to_measure_m2": float(mesh.areas_m2[mesh.to_measure].sum()),
        "findings": list(mesh.finding),
        **_selection_figures(viewpoints, selection),
        **_motion_figures(trajectory),
        "scan_points": len(scan.points_m),
        "scan_profiles": len(scan.time_s),
        **_coverage_figures(coverage),
        "verified_states": verification.n_states if verification else None,
        "verified_by": verification.engine if verification else None,
    }


def blocking_bodies(coverage: Coverage) -> dict[str, int]:
    """Count the points that collisions keep from being measured, by the body that stops the most candidates."""
    rows = coverage.blocked_by[coverage.blocked_by >= 0]
    return {coverage.body[row]: int(count) for row, count in enumerate(np.bincount(rows)) if count}


def _selection_figures(viewpoints: Viewpoints, selection: ViewSelection) -> dict[str, Any]:
    # every planning sample has views of its own; the gaps that refinement appends behind them have none
    n_samples = int(viewpoints.sample.max(initial=-1)) + 1
    is_covered = selection.cause[:n_samples] == Cause.NONE
    return {
        "candidates": len(viewpoints.sample),
        "sweeps": len(selection.view),
        "greedy_sweeps": len(selection.greedy_view),
        "sweeps_lower_bound": selection.lower_bound,
        "sweeps_proven_fewest": selection.proven,
        "cover_method": selection.method,
        "coverage_of_samples": float(np.mean(is_covered)) if len(is_covered) else 0.0,
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
    }


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
