"""Sample the faces to be measured at a density, evenly (blue noise) or independently (random, as in Kaiser 2021)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from cellwright.errors import InvalidInputError
from schemas.params import Params
from schemas.part import PartMesh, SurfaceSamples
from schemas.stage import stage

_MOST_SAMPLES = {"blue-noise": 300_000, "random": 3_000_000}
"""More need over 2 GB while they are spread, and no planner uses them."""


class SurfaceParams(Params):
    """Settings of the surface sampling."""

    method: Literal["blue-noise", "random"] = Field(default="blue-noise", description="How samples are spread.")
    density_per_m2: float = Field(default=5000.0, gt=0, description="Samples a square metre.")
    at_least: int = Field(default=1, ge=1, description="Fewest samples, however small the surface is.")
    seed: int = Field(default=0, ge=0, description="Seed of the random numbers.")


@stage(version=1)
def sample_surface(mesh: PartMesh, *, params: SurfaceParams) -> SurfaceSamples:
    """Sample ``round(density * area)`` points, or ``at_least`` where these are more.

    Both sides of a two-sided mesh are sampled, each with its own normal.

    Raises:
        InvalidInputError: If the density asks for more samples than can be handled.
    """
    from cellwright.cell.surface_sampling import sample_blue_noise, sample_randomly

    faces = np.flatnonzero(mesh.to_measure)
    normals, area = mesh.normals[faces], float(mesh.areas_m2[faces].sum())
    if mesh.two_sided:
        faces, normals, area = np.tile(faces, 2), np.concatenate([normals, -normals]), 2 * area
    n_samples = max(params.at_least, round(params.density_per_m2 * area))
    most = _MOST_SAMPLES[params.method]
    if n_samples > most:
        raise InvalidInputError(
            f"{params.density_per_m2 * 1e-6:g} /mm^2 on {area * 1e6:.0f} mm^2 asks for {n_samples} samples but at most "
            f"{most} can be handled: lower density_per_m2, or the density_factor of this cloud, to "
            f"reach at most {most / area * 1e-6:.3g} /mm^2"
        )
    triangles = mesh.vertices_m[mesh.faces[faces]]
    rng = np.random.default_rng(params.seed)
    if params.method == "random":
        chosen = sample_randomly(triangles, n_samples, rng)
    else:
        chosen = sample_blue_noise(triangles, normals, n_samples, rng)
    return SurfaceSamples(
        points_m=chosen.points,
        normals=normals[chosen.face],
        face=faces[chosen.face].astype(np.int32),
        method=params.method,
        density_per_m2=params.density_per_m2,
        area_m2=area,
    )
