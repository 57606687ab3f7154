"""Cover standing bodies with few spheres each: the hulls of stations and obstacles in a layout.

Boxes, cylinders, capsules and mesh files alike; each hull is proven to hold its body, unless it is asked to be k-means'
alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from cellwright.errors import CellwrightError
from schemas.body_params import BodyParams
from schemas.body_shapes import shape_of
from schemas.params import Params
from schemas.sources import SourceFile
from schemas.sphere_hull import SphereHull
from schemas.sphere_hull_columns import hull_columns
from schemas.stage import Progress, no_progress, stage

if TYPE_CHECKING:
    from cellwright.solvers.spheres.fitting import SphereFit


class CoveredBody(Params):
    """A body and how it is covered; its pose plays no part."""

    body: BodyParams
    n_spheres: int = Field(default=8, ge=1, le=512, description="Spheres of the body.")


class CoverParams(Params):
    """Which bodies are covered."""

    bodies: tuple[CoveredBody, ...] = Field(min_length=1, description="The bodies, each with its own name.")
    method: Literal["certified", "k-means"] = Field(
        default="certified", description="Our fit with proofs, or k-means as in Baumgaertner 2025, section 3."
    )
    inflate: bool = Field(default=True, description="Whether k-means' spheres are grown until the proofs hold.")
    n_starts: int = Field(default=4, ge=1, le=64, description="Starts that each certified fit chooses from.")
    seed: int = Field(default=0, ge=0, description="Seed of all random choices.")


@stage(version=2)
def cover_bodies(files: tuple[SourceFile, ...], *, params: CoverParams, progress: Progress = no_progress) -> SphereHull:
    """Fit the spheres; mesh files are found by their names.

    Raises:
        InvalidInputError: If a mesh is missing or malformed.
        SolverError: If a proof fails.
    """
    from cellwright.cell.enclosing_mesh import enclosing_mesh
    from cellwright.solvers.spheres.fitting import FitSettings, fit_spheres
    from cellwright.threads import map_slices

    contents = {file.name: file.content for file in files}
    generators = np.random.default_rng(params.seed).spawn(len(params.bodies))
    settings = FitSettings(params.method, params.n_starts, inflate=params.inflate)

    def fitted(rows: slice) -> SphereFit:
        wanted = params.bodies[rows.start]
        try:
            mesh = enclosing_mesh(shape_of(wanted.body, contents))
            return fit_spheres(mesh, wanted.n_spheres, generator=generators[rows.start], settings=settings)
        except CellwrightError as error:
            raise type(error)(f"{wanted.body.name}: {error}") from error

    fits: list[list[SphereFit]] = []
    for fit in map_slices(fitted, len(params.bodies), 1):
        fits.append([fit])
        progress(len(fits) / len(params.bodies))
    nothing = np.empty((0, 2), np.int32)
    return SphereHull(
        method=params.method,
        ignored_pair=nothing,
        ignored_reason=np.empty(0, np.int8),
        checked_pair=nothing,
        touching_share=np.empty(0),
        **hull_columns([each.body.name for each in params.bodies], fits),
    )
