"""Cover the bodies of a cell, the workpiece, or both with few spheres, for solvers that need smooth distances.

The default method proves that nothing of a body sticks out of its hull (`cellwright.solvers.spheres.fitting`). Pairs of
hulls that need no check against each other are found for the hulls, which are larger than the bodies. A body without
spheres in ``n_spheres_of`` gets ``n_spheres``; a body with 0 gets no hull.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from cellwright.errors import CellwrightError, InvalidInputError, listed
from schemas.params import Params
from schemas.part import PartMesh
from schemas.sources import CellModel
from schemas.sphere_hull import SphereHull
from schemas.sphere_hull_columns import hull_columns
from schemas.stage import Progress, no_progress, stage

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from cellwright.cell.bodies import Mesh
    from cellwright.solvers.spheres.fitting import SphereFit

_FITTING = 0.95
"""Share of the progress that fitting stands for; the rest is sorting pairs."""


class SphereParams(Params):
    """Settings of the sphere hulls; those that nothing reads take their defaults: no key hangs on them."""

    method: Literal["certified", "k-means"] = Field(
        default="certified", description="Our fit with proofs, or k-means as in Baumgaertner 2025, section 3."
    )
    n_spheres: int = Field(default=20, ge=1, le=512, description="Spheres of a body.")
    n_spheres_of: dict[str, int] = Field(
        default_factory=dict, description="Other numbers for some bodies, by name; 0 leaves the body out."
    )
    tolerance_m: float | None = Field(
        default=None, gt=0, description="Instead of a number: no sphere sticks out by more; the fewest that are found."
    )
    inflate: bool = Field(default=True, description="Whether k-means' spheres are grown until the proofs hold.")
    trials: tuple[int, ...] = Field(default=(), description="Further numbers of spheres to measure, for each body.")
    n_starts: int = Field(default=4, ge=1, le=64, description="Starts that the certified method chooses from.")
    seed: int = Field(default=0, ge=0, description="Seed of all random choices.")

    @model_validator(mode="after")
    def _only_what_applies(self) -> Self:
        unread = {"inflate"} if self.method == "certified" else {"n_starts"}
        for name in unread | (set() if self.tolerance_m is None else {"n_spheres"}):
            object.__setattr__(self, name, type(self).model_fields[name].default)  # frozen for everybody else
        return self


@stage(version=2)
def fit_spheres(
    cell: CellModel | None, mesh: PartMesh | None, *, params: SphereParams, progress: Progress = no_progress
) -> SphereHull:
    """Fit the spheres.

    Raises:
        InvalidInputError: If there is no body, a body named in ``n_spheres_of`` does not exist, or a number of
            spheres is out of range.
        InfeasibleError: If no number of spheres keeps ``tolerance_m``.
        SolverError: If a proof fails.
    """
    from cellwright.threads import map_slices

    meshes = _meshes(cell, mesh)
    unknown = [name for name in params.n_spheres_of if name not in meshes]
    if unknown:
        raise InvalidInputError(
            f"spheres are asked for body {listed(unknown)}, but the bodies are {listed(meshes, 30)}"
        )
    names = list(meshes)
    generators = np.random.default_rng(params.seed).spawn(len(names) + 1)
    wanted = [params.n_spheres_of.get(name, params.n_spheres) for name in names]

    def fitted(rows: slice) -> list[SphereFit]:
        row = rows.start
        return _trials(names[row], meshes[names[row]], wanted[row], generators[row], params) if wanted[row] else []

    fits: list[list[SphereFit]] = []
    progress(0.0)
    for found in map_slices(fitted, len(names), 1):
        fits.append(found)
        progress(_FITTING * len(fits) / len(names))
    if not any(fits):
        raise InvalidInputError("every body has 0 spheres: give at least one a number")
    pairs = _pairs(cell, [found[0] if found else None for found in fits], len(names), generators[-1])
    progress(1.0)
    return SphereHull(method=params.method, **hull_columns(names, fits), **pairs)


def _meshes(cell: CellModel | None, mesh: PartMesh | None) -> dict[str, Mesh]:
    from cellwright.cell.bodies import Mesh
    from cellwright.cell.cell import PART
    from cellwright.cell.enclosing_mesh import enclosing_mesh
    from schemas.cell_objects import unpacked_bodies

    found = {} if cell is None else {body.name: enclosing_mesh(body.shape) for body in unpacked_bodies(cell)}
    if mesh is not None:
        if PART in found:
            raise InvalidInputError(f"a body of the cell is named {PART!r}: that is the workpiece's name")
        found[PART] = Mesh(mesh.vertices_m, mesh.faces)
    if not found:
        raise InvalidInputError("there is no body to cover with spheres: give a cell, a part, or both")
    return found


def _trials(
    name: str, mesh: Mesh, n_spheres: int, generator: np.random.Generator, params: SphereParams
) -> list[SphereFit]:
    """Return the hull that is kept, then those of the other numbers."""
    from cellwright.solvers.spheres.body import sphere_body
    from cellwright.solvers.spheres.fitting import FitSettings, fit_spheres, fit_to_body

    settings = FitSettings(params.method, params.n_starts, inflate=params.inflate)
    kept, *others = generator.spawn(1 + len(params.trials))
    try:
        if params.tolerance_m is not None and name not in params.n_spheres_of:
            chosen = fit_spheres(mesh, tolerance=params.tolerance_m, generator=kept, settings=settings)
        else:
            chosen = fit_spheres(mesh, n_spheres, generator=kept, settings=settings)
        body = sphere_body(mesh)
        return [chosen, *(fit_to_body(body, n, other, settings) for n, other in zip(params.trials, others))]
    except CellwrightError as error:
        raise type(error)(f"body {name!r}: {error}") from error


def _pairs(
    cell: CellModel | None, hulls: Sequence[SphereFit | None], n_bodies: int, generator: np.random.Generator
) -> dict[str, Any]:
    """Sort the pairs of the cell's own bodies; a workpiece is moved by others and stays checked against all."""
    from cellwright.cell.bodies import WORLD
    from cellwright.cell.ignored_pairs import Reason
    from cellwright.cell.sphere_pairs import N_SAMPLES, hull_pairs
    from cellwright.cell.transforms import apply
    from schemas.cell_objects import build_cell

    if cell is None:
        nothing = np.empty((0, 2), np.int32)
        return {
            "ignored_pair": nothing,
            "ignored_reason": np.empty(0, np.int8),
            "checked_pair": nothing,
            "touching_share": np.empty(0),
        }
    built = build_cell(cell)
    chain = built.robot.chain
    samples = generator.uniform(chain.lower, chain.upper, (N_SAMPLES, built.robot.n_joints))
    T_base_world = np.linalg.inv(built.T_world_base)
    # row 0 the world, row 1 the base, then the links
    groups = np.array([[T_base_world, *built.robot.link_poses(q)] for q in samples])  # (samples, groups, 4, 4)
    centres: list[FloatArray] = []
    radii: list[FloatArray] = []
    for body, hull in zip(built.bodies, hulls):
        centres.append(np.empty((0, 3)) if hull is None else apply(body.T_parent_body, hull.centres))
        radii.append(np.empty(0) if hull is None else hull.radii)
    parents = [body.parent for body in built.bodies]
    known = {
        (min(pair), max(pair)): Reason(int(reason))
        for pair, reason in zip(cell.ignored_pair.tolist(), cell.ignored_reason.tolist())
        # samples of the bodies say nothing of hulls, which are larger
        if reason != Reason.NEVER_TOUCHING
    }
    found = hull_pairs(centres, radii, parents, [groups[:, parent - WORLD] for parent in parents], (), known=known)
    return {
        "ignored_pair": found.ignored,
        "ignored_reason": found.reason,
        "checked_pair": found.checked,
        "touching_share": found.touching,
    }
