"""Find what the selected sweeps miss: points of a denser cloud that no planning stage has seen so far.

Coverage of the planning samples says little about the surface between them. Points that the selection misses although
some executable sweep measures them become further samples to cover.
"""

from __future__ import annotations

import numpy as np

from schemas.part import PartMesh, SurfaceSamples, Surroundings
from schemas.scanner import SensingParams
from schemas.stage import Progress, no_progress, stage
from schemas.views import CoverageGaps, Reachability, Viewpoints, ViewSelection


class GapParams(SensingParams):
    """Settings of the search for gaps."""


@stage(version=1)
def find_gaps(
    mesh: PartMesh,
    surroundings: Surroundings,
    cloud: SurfaceSamples,
    viewpoints: Viewpoints,
    reachability: Reachability,
    selection: ViewSelection,
    earlier: tuple[CoverageGaps, ...],
    *,
    params: GapParams,
    progress: Progress = no_progress,
) -> CoverageGaps:
    """Return the points of the cloud that the best pieces of the selected views miss and some best piece measures.

    Points of ``earlier`` gaps, which are samples already, are not listed again.

    Raises:
        InvalidInputError: If the mesh has vertices that are not finite.
    """
    from cellwright.solvers.measurability import measured_by_any
    from schemas.sweep_objects import best_pieces, occluder_of, piece_sweeps

    scanner, occluder = params.scanner.scanner(), occluder_of(mesh, surroundings)
    points, normals = cloud.points_m, cloud.normals
    selected = piece_sweeps(viewpoints, reachability, best_pieces(reachability, selection.view))
    seen = measured_by_any(
        scanner,
        params.max_uncertainty_m,
        occluder,
        points,
        normals,
        selected,
        progress=lambda share: progress(0.5 * share),
    )
    missed = np.flatnonzero(~seen)
    candidates = piece_sweeps(viewpoints, reachability, best_pieces(reachability))
    coverable = measured_by_any(
        scanner,
        params.max_uncertainty_m,
        occluder,
        points[missed],
        normals[missed],
        candidates,
        progress=lambda share: progress(0.5 + 0.5 * share),
    )
    known = np.concatenate([np.empty(0, np.int32), *(gaps.point for gaps in earlier)])
    return CoverageGaps(
        point=np.setdiff1d(missed[coverable], known).astype(np.int32),
        n_checked=len(points),
        n_missed=len(missed),
    )
