"""Measure what the executed scan covers, on a cloud that no planning stage has seen, and say why it misses the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from cellwright.causes import Cause
from schemas.motion import ScanCloud, Trajectory
from schemas.part import PartMesh, SurfaceSamples, Surroundings
from schemas.scanner import SensingParams
from schemas.stage import Progress, no_progress, stage
from schemas.views import Coverage, Reachability, Viewpoints, ViewSelection

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray


class CoverageParams(SensingParams):
    """Settings of the coverage measurement."""

    radius_m: float = Field(default=2e-3, gt=0, description="Largest distance of a scan point that measures a point.")


@stage(version=2)
def measure_coverage(
    mesh: PartMesh,
    surroundings: Surroundings,
    cloud: SurfaceSamples,
    scan: ScanCloud,
    viewpoints: Viewpoints,
    reachability: Reachability,
    selection: ViewSelection,
    trajectory: Trajectory | None = None,
    *,
    params: CoverageParams,
    progress: Progress = no_progress,
) -> Coverage:
    """Return which points of the cloud the scan measured; all pieces of all candidates are asked about the others.

    What only views measure that the ``trajectory`` leaves out or replaces has the cause not connected. It is coverable
    all the same: the share of the coverable counts what any executable sweep can measure, connected or not, and is 0
    if none can measure anything.

    Raises:
        InvalidInputError: If the artefacts do not belong together.
    """
    from cellwright.solvers.coverage import explain_misses, match_points
    from schemas.plan_objects import unconnected_views
    from schemas.sweep_objects import candidate_pieces, occluder_of

    n_views = len(viewpoints.sample)
    uncertainty = match_points(
        cloud.points_m,
        cloud.normals,
        scan.points_m.astype(float),
        _scanned_normals(mesh, scan),
        scan.uncertainty_m,
        params.radius_m,
    )
    missed = np.flatnonzero(np.isnan(uncertainty))
    selected = np.zeros(n_views, bool)
    selected[selection.view] = True
    connected = np.ones(n_views, bool)
    if trajectory is not None:
        connected[list(unconnected_views(trajectory))] = False
    misses = explain_misses(
        params.scanner.scanner(),
        params.max_uncertainty_m,
        occluder_of(mesh, surroundings),
        cloud.points_m[missed],
        cloud.normals[missed],
        candidate_pieces(viewpoints, reachability, selected & connected, connected),
        progress=progress,
    )
    n_points = len(uncertainty)
    coverable, cause = np.ones(n_points, bool), np.full(n_points, Cause.NONE, np.int8)
    blocked_by = np.full(n_points, -1, np.int32)
    coverable[missed], cause[missed], blocked_by[missed] = misses.coverable, misses.cause, misses.blocked_by
    n_measured = n_points - len(missed)
    return Coverage(
        measured=~np.isnan(uncertainty),
        coverable=coverable,
        cause=cause,
        blocked_by=blocked_by,
        uncertainty_m=uncertainty,
        body=reachability.body,
        radius_m=params.radius_m,
        share_measured=n_measured / max(n_points, 1),
        share_of_coverable=n_measured / max(int(coverable.sum()), 1),
    )


def _scanned_normals(mesh: PartMesh, scan: ScanCloud) -> FloatArray:
    """Return the normals of the sides that were hit, (points, 3): on two-sided meshes the side that faces the laser."""
    normals = mesh.normals[scan.face]
    if mesh.two_sided:
        rays = scan.points_m - scan.position_m[scan.profile]
        behind = np.einsum("ij,ij->i", normals, rays) > 0
        normals = np.where(behind[:, None], -normals, normals)
    return np.asarray(normals)
