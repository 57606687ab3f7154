"""Find which samples each candidate sweep measures, at which uncertainty (Kaiser 2021, section 4.2)."""

from __future__ import annotations

from schemas.part import PartMesh, SurfaceSamples, Surroundings
from schemas.scanner import SensingParams
from schemas.stage import Progress, no_progress, stage
from schemas.views import Measurability, Viewpoints


class MeasurabilityParams(SensingParams):
    """Settings of the measurability analysis."""


@stage(version=1)
def measure_samples(
    mesh: PartMesh,
    surroundings: Surroundings,
    samples: SurfaceSamples,
    viewpoints: Viewpoints,
    *,
    params: MeasurabilityParams,
    progress: Progress = no_progress,
) -> Measurability:
    """Test every sample against every sweep of unlimited travel, the part and what stands around it in the way.

    Raises:
        InvalidInputError: If the mesh has vertices that are not finite.
    """
    from cellwright.solvers.measurability import measure_pairs
    from schemas.sweep_objects import candidate_sweeps, occluder_of

    found = measure_pairs(
        params.scanner.scanner(),
        params.max_uncertainty_m,
        occluder_of(mesh, surroundings),
        samples.points_m,
        samples.normals,
        candidate_sweeps(viewpoints),
        progress=progress,
    )
    start_m, end_m = found.travel_range(len(viewpoints.sample))
    return Measurability(
        view=found.sweep,
        sample=found.point,
        uncertainty_m=found.uncertainty,
        start_m=start_m,
        end_m=end_m,
        cause=found.cause,
    )
