"""Say for each planning sample what stands in the way of measuring it: for plans that come to nothing."""

from __future__ import annotations

import numpy as np

from schemas.findings import SampleFindings
from schemas.part import PartMesh, SurfaceSamples, Surroundings
from schemas.scanner import SensingParams
from schemas.stage import Progress, no_progress, stage
from schemas.views import Reachability, Viewpoints, ViewSelection


class ExplanationParams(SensingParams):
    """Settings of the explanation: those of the measurability analysis."""


@stage(version=1)
def explain_samples(
    mesh: PartMesh,
    surroundings: Surroundings,
    samples: SurfaceSamples,
    viewpoints: Viewpoints,
    reachability: Reachability,
    selection: ViewSelection | None,
    *,
    params: ExplanationParams,
    progress: Progress = no_progress,
) -> SampleFindings:
    """Return the cause of each sample, as `measure_coverage` would for a scan that measured nothing.

    A sample that a selected sweep would measure is not scanned, one that any other executable sweep would is not
    selected; without a selection there is only the latter.

    Raises:
        InvalidInputError: If the artefacts do not belong together.
    """
    from cellwright.solvers.coverage import explain_misses
    from schemas.sweep_objects import candidate_pieces, occluder_of

    n_views = len(viewpoints.sample)
    selected = np.zeros(n_views, bool)
    if selection is not None:
        selected[selection.view] = True
    misses = explain_misses(
        params.scanner.scanner(),
        params.max_uncertainty_m,
        occluder_of(mesh, surroundings),
        samples.points_m,
        samples.normals,
        candidate_pieces(viewpoints, reachability, selected, np.ones(n_views, bool)),
        progress=progress,
    )
    return SampleFindings(
        coverable=misses.coverable, cause=misses.cause, blocked_by=misses.blocked_by, body=reachability.body
    )
