"""Cover a mesh with few spheres: certified, so that no point of it is left out, or by plain k-means as published.

``certified`` (the default) begins with k-means on a cloud of surface and inner points from several starts, moves and
resizes the spheres by descent on the volume of their union (`cellwright.solvers.spheres.refinement`), adds the places
that the exact test finds uncovered to the cloud, descends again, and grows the spheres over what is left. On plump
bodies one start grows out of a hull of half as many spheres (`cellwright.solvers.spheres.growing`). Then two
proofs are run, neither of which samples anything: every point of every triangle lies in a sphere
(`cellwright.solvers.spheres.certificate`), and the spheres leave no hole inside what the surface encloses
(`cellwright.solvers.spheres.voids`). A fit that cannot be proven is not returned.

``k-means`` is the published method (Baumgaertner 2025, section 3) on the same cloud; ``inflate`` decides whether its
spheres are grown until they pass the same proofs or are left as they are.

The same mesh, settings and generator give the same bytes, on any number of threads. Cost: 0.9 s of one core for 20
spheres with four starts, proofs and metrics; it grows with the square of the number of spheres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Mesh
from cellwright.errors import InfeasibleError, InvalidInputError, SolverError
from cellwright.solvers.spheres.body import SphereBody, sphere_body
from cellwright.solvers.spheres.certificate import grow_over_surface, prove_surface
from cellwright.solvers.spheres.growing import Spheres, sow_spheres
from cellwright.solvers.spheres.kmeans import cluster_spheres
from cellwright.solvers.spheres.metrics import HullMetrics, hull_metrics, overshoots, union_volume
from cellwright.solvers.spheres.refinement import GROWTH, POLISH, shrink_union
from cellwright.solvers.spheres.voids import find_voids

Method = Literal["certified", "k-means"]
Interior = Literal["covered", "not covered", "none"]

MOST_SPHERES = 512
_COARSE_LEAF, _LEAF = 2e-3, 5e-4
"""Pieces of the surface that are not cut further, in diagonals: while starts are compared, and in the end."""
_VOID_LEAF = 1e-3
_WITNESS_LEAF, _MOST_WITNESSES = 6e-3, 1000
"""Size of the uncovered pieces that are added to the cloud, and about how many of them a round."""
_POLISHES = 3
_POINTS_A_SPHERE = 150
"""Points of the cloud on the surface at least: spheres slip between points that stand too far apart for them."""
_MOST_ROUNDS = 100
_FEWEST_GROWN, _PLUMP = 6, 1.1
"""From so many spheres on a hull of half as many is tried; it becomes a start unless it has this share of volume."""
_SEARCHING_STARTS = 2
"""Starts at most while the number of spheres for a tolerance is searched; the one found is fitted with all."""


@dataclass(frozen=True)
class FitSettings:
    """How spheres are fitted.

    Attributes:
        method: ``certified`` or ``k-means``.
        n_starts: Starts that the certified method chooses from; from two on a further one may grow
            out of a hull of half as many spheres.
        n_points: Points of the cloud on the surface; more for many spheres.
        inflate: Whether k-means' spheres are grown until they pass the proofs.
    """

    method: Method = "certified"
    n_starts: int = 4
    n_points: int = 5000
    inflate: bool = True


DEFAULTS = FitSettings()


@dataclass(frozen=True, eq=False)
class SphereFit:
    """Spheres that stand for a mesh, in its frame.

    Attributes:
        centres: (k, 3) in m.
        radii: (k,) in m, largest first.
        overshoot: By how much each sphere can stick out of the body at most, (k,) in m.
        surface_covered: Whether every point of every triangle is proven to lie in a sphere.
        interior: ``covered`` if no hole is left inside (proven), ``none`` if the mesh encloses nothing.
        margin: The proofs hold for radii smaller by this, m: what single precision may lose.
        volume_kind: What the volume ratio compares with: ``enclosed`` or ``convex`` (open meshes).
        metrics: The hull measured.
    """

    centres: FloatArray
    radii: FloatArray
    overshoot: FloatArray
    surface_covered: bool
    interior: Interior
    margin: float
    volume_kind: str
    metrics: HullMetrics


def fit_spheres(
    mesh: Mesh,
    n_spheres: int | None = None,
    *,
    tolerance: float | None = None,
    generator: np.random.Generator,
    settings: FitSettings = DEFAULTS,
) -> SphereFit:
    """Fit ``n_spheres`` spheres, or as few as keep the overshoot within ``tolerance`` m.

    The number for a tolerance is found by doubling and bisection, with two starts at most, so it is small, not proven
    smallest; that many are then fitted with all starts.

    Args:
        mesh: Any triangles: closed or open, thin, in several pieces, broken.
        n_spheres: From 1 to 512.
        tolerance: Most by which a sphere may stick out of the body, m.
        generator: Source of randomness.
        settings: Method and effort.

    Raises:
        InvalidInputError: If the mesh cannot be covered at all, or not exactly one of number and tolerance is given.
        InfeasibleError: If no number of spheres up to 512 keeps the tolerance.
        SolverError: If a proof fails.
    """
    if (n_spheres is None) == (tolerance is None):
        raise InvalidInputError("give either a number of spheres or a tolerance, not both or none")
    body = sphere_body(mesh)
    if n_spheres is not None:
        return fit_to_body(body, n_spheres, generator, settings)
    if tolerance is None or not tolerance > 0.0:
        raise InvalidInputError(f"tolerance is {tolerance} m: give a positive length")
    return _within(body, tolerance, generator, settings)


def fit_to_body(
    body: SphereBody, n_spheres: int, generator: np.random.Generator, settings: FitSettings = DEFAULTS
) -> SphereFit:
    """Fit a number of spheres to a mesh that was made ready before, for instance to compare numbers.

    Raises:
        InvalidInputError: If the number is not from 1 to 512.
        SolverError: If a proof fails.
    """
    if not 1 <= n_spheres <= MOST_SPHERES:
        raise InvalidInputError(f"{n_spheres} spheres are asked for: give a number from 1 to {MOST_SPHERES}")
    surface = body.surface_points(max(settings.n_points, _POINTS_A_SPHERE * n_spheres), generator)
    if settings.method == "k-means":
        cloud = np.concatenate([surface, body.inner_points(generator)])
        centres, radii = cluster_spheres(cloud, n_spheres, generator)
        if settings.inflate:
            radii = _grown(body, centres, radii)[0]
    else:
        centres, radii = _smallest(body, surface, n_spheres, generator, settings.n_starts)
    return _proven(body, centres, radii, generator, must=settings.method == "certified" or settings.inflate)


def _smallest(
    body: SphereBody, surface: FloatArray, n_spheres: int, generator: np.random.Generator, n_starts: int
) -> Spheres:
    """Return centres and grown radii of the start whose union is smallest, after polishing."""
    cloud = np.concatenate([surface, body.inner_points(generator)])
    inside = body.core if len(body.core) > n_spheres else cloud
    # k-means of surface and inside, of the inside (along the middle of a body), of the surface, in turn
    sources = [cloud, inside, surface]
    starts = []
    for start in range(n_starts):
        centres, radii = cluster_spheres(sources[start % 3], n_spheres, generator)
        starts.append(_priced(body, shrink_union(cloud, centres, radii, body.volume)))
    if n_starts > 1 and n_spheres >= _FEWEST_GROWN:
        # a hull of half as many says whether the body is plump; half the cloud is enough for it
        few = cluster_spheres(inside, n_spheres // 2, generator)
        volume, fewer = _priced(body, shrink_union(cloud[::2], *few, body.volume))
        if volume <= _PLUMP * min(starts, key=_volume)[0]:
            sown = sow_spheres(cloud, fewer, n_spheres, generator)
            starts.append(_priced(body, shrink_union(cloud, *sown, body.volume, schedule=GROWTH)))
    return _polished(body, cloud, *min(starts, key=_volume)[1])


def _priced(body: SphereBody, spheres: Spheres) -> tuple[float, Spheres]:
    """Return the volume that spheres have when they are grown over the surface, and the spheres as they are."""
    centres, radii = spheres
    grown = grow_over_surface(body.triangles, centres, radii, leaf=_COARSE_LEAF, margin=body.margin)
    return union_volume(centres, grown), spheres


def _volume(start: tuple[float, Spheres]) -> float:
    return start[0]


def _polished(body: SphereBody, cloud: FloatArray, centres: FloatArray, radii: FloatArray) -> Spheres:
    grown, holes = _grown(body, centres, radii)
    found = [(centres, grown)]
    for _ in range(_POLISHES):
        missed = prove_surface(body.triangles, centres, radii, leaf=_WITNESS_LEAF, margin=body.margin).witnesses
        cloud = np.concatenate([cloud, missed[:: 1 + len(missed) // _MOST_WITNESSES], holes])
        centres, radii = shrink_union(cloud, centres, radii, body.volume, schedule=POLISH)
        grown, holes = _grown(body, centres, radii)
        found.append((centres, grown))
    return min(found, key=lambda spheres: union_volume(*spheres))


def _grown(body: SphereBody, centres: FloatArray, radii: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return radii that cover the surface and the inside, and the holes inside that had to be closed, (n, 3)."""
    grown = grow_over_surface(body.triangles, centres, radii, leaf=_LEAF, margin=body.margin)
    holes = [np.empty((0, 3))]
    for _ in range(_MOST_ROUNDS if body.encloses else 0):
        voids = _voids(body, centres, grown)
        if not len(voids):
            break
        holes.append(voids[:_MOST_WITNESSES, :3])
        for x, y, z, size in voids[:_MOST_WITNESSES].tolist():
            need = np.linalg.norm(centres - [x, y, z], axis=1) + size + body.margin * 1.01
            if (need > grown).all():
                cheapest = int(np.argmin(need**3 - grown**3))
                grown[cheapest] = need[cheapest]
    return grown, np.concatenate(holes)


def _voids(body: SphereBody, centres: FloatArray, radii: FloatArray) -> FloatArray:
    return find_voids(
        centres, radii, grid=body.grid, tree=body.tree, shell=body.shell, leaf=_VOID_LEAF, margin=body.margin
    )


def _proven(
    body: SphereBody, centres: FloatArray, radii: FloatArray, generator: np.random.Generator, *, must: bool
) -> SphereFit:
    order = np.argsort(-radii, kind="stable")
    centres, radii = centres[order], radii[order]
    proof = prove_surface(body.triangles, centres, radii, leaf=_LEAF, margin=body.margin)
    interior: Interior = "none"
    if body.encloses:
        interior = "covered" if proof.covered and not len(_voids(body, centres, radii)) else "not covered"
    if must and not (proof.covered and interior != "not covered"):
        raise SolverError(
            f"{len(radii)} spheres could not be proven to hold the mesh: surface "
            f"{'covered' if proof.covered else 'not covered'}, interior {interior}: give more spheres"
        )
    return SphereFit(
        body.middle + body.unit * centres,
        body.unit * radii,
        body.unit * overshoots(body, centres, radii),
        proof.covered,
        interior,
        body.margin * body.unit,
        body.volume_kind,
        hull_metrics(body, centres, radii, generator),
    )


def _within(body: SphereBody, tolerance: float, generator: np.random.Generator, settings: FitSettings) -> SphereFit:
    """Return the fit with the fewest spheres that keeps a tolerance, by doubling and bisection."""
    quick = replace(settings, n_starts=min(settings.n_starts, _SEARCHING_STARTS))
    too_few, n_spheres, closest = 0, 4, np.inf
    while True:
        found = fit_to_body(body, n_spheres, generator, quick)
        closest = min(closest, found.metrics.overshoot)
        if found.metrics.overshoot <= tolerance:
            break
        if n_spheres >= MOST_SPHERES:
            raise InfeasibleError(
                f"{MOST_SPHERES} spheres stick out by up to {closest * 1e3:.3g} mm, more than the tolerance of "
                f"{tolerance * 1e3:.3g} mm: allow more"
            )
        too_few, n_spheres = n_spheres, min(2 * n_spheres, MOST_SPHERES)
    enough = n_spheres
    while enough - too_few > max(1, enough // 20):
        n_spheres = (too_few + enough) // 2
        tried = fit_to_body(body, n_spheres, generator, quick)
        if tried.metrics.overshoot <= tolerance:
            enough, found = n_spheres, tried
        else:
            too_few = n_spheres
    if quick == settings:
        return found
    # a smaller union may stick out further: the tolerance goes before
    best = fit_to_body(body, enough, generator, settings)
    return best if best.metrics.overshoot <= tolerance and best.metrics.volume < found.metrics.volume else found
