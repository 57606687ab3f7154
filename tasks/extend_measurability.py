"""Append the gaps that the selection left as further samples, with all executable sweeps that measure them."""

from __future__ import annotations

import numpy as np

from cellwright.errors import InvalidInputError
from schemas.part import PartMesh, SurfaceSamples, Surroundings
from schemas.scanner import SensingParams
from schemas.stage import Progress, no_progress, stage
from schemas.views import CoverageGaps, Measurability, Reachability, Viewpoints


class ExtensionParams(SensingParams):
    """Settings of the extension: those of the search for gaps."""


@stage(version=1)
def extend_measurability(
    mesh: PartMesh,
    surroundings: Surroundings,
    cloud: SurfaceSamples,
    gaps: CoverageGaps,
    viewpoints: Viewpoints,
    measurability: Measurability,
    reachability: Reachability,
    *,
    params: ExtensionParams,
    progress: Progress = no_progress,
) -> Measurability:
    """Return ``measurability`` with gap ``i`` as sample ``n + i``, ``n`` the samples that it has so far.

    Extending an extended one appends: rows of earlier rounds stay where they are. Entries are ordered by view, then
    by sample.

    Raises:
        InvalidInputError: If a gap is not a point of the cloud, or the artefacts have different numbers of views.
    """
    from cellwright.solvers.measurability import measure_pairs
    from schemas.sweep_objects import best_pieces, occluder_of, piece_sweeps

    n_samples, n_views = len(measurability.cause), len(measurability.start_m)
    if len(gaps.point) and gaps.point.max() >= len(cloud.face):
        raise InvalidInputError(
            f"gap {gaps.point.max()} is not among the {len(cloud.face)} points of the cloud: give the cloud that was "
            "searched for gaps"
        )
    if n_views != len(viewpoints.sample):
        raise InvalidInputError(
            f"measurability has {n_views} views but there are {len(viewpoints.sample)} viewpoints: "
            "give those that it was made of"
        )
    rows = best_pieces(reachability)
    found = measure_pairs(
        params.scanner.scanner(),
        params.max_uncertainty_m,
        occluder_of(mesh, surroundings),
        cloud.points_m[gaps.point],
        cloud.normals[gaps.point],
        piece_sweeps(viewpoints, reachability, rows),
        progress=progress,
    )
    view = np.concatenate([measurability.view, reachability.view[rows][found.sweep]])
    sample = np.concatenate([measurability.sample, found.point + np.int32(n_samples)])
    uncertainty_m = np.concatenate([measurability.uncertainty_m, found.uncertainty])
    order = np.lexsort((sample, view))
    first, last = np.full(n_views, np.nan), np.full(n_views, np.nan)
    first[reachability.view[rows]], last[reachability.view[rows]] = found.travel_range(len(rows))
    return Measurability(
        view=view[order],
        sample=sample[order],
        uncertainty_m=uncertainty_m[order],
        start_m=np.fmin(measurability.start_m, first),
        end_m=np.fmax(measurability.end_m, last),
        cause=np.concatenate([measurability.cause, found.cause]),
    )
