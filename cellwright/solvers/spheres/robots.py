"""Spheres for a whole robot: a URDF in, the same URDF with certified sphere hulls as collision geometry out.

All collision shapes of a link become one hull. Links that are spheres already keep them. With the URDF comes an SRDF of
the pairs that need no check against each other, found for the hulls and not for the bodies (see
`cellwright.cell.sphere_pairs`). Links are fitted side by side; each has its own random generator, so the result does
not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Mesh
from cellwright.cell.ignored_pairs import Reason
from cellwright.cell.sphere_pairs import N_SAMPLES, HullPairs, hull_pairs
from cellwright.cell.spherized_urdf import (
    link_shapes,
    merged_mesh,
    rigid_groups,
    sampled_link_poses,
    spheres_among,
    spherized_urdf,
    srdf_text,
)
from cellwright.cell.urdf_geometry import ReadMesh
from cellwright.cell.urdf_tree import parse_urdf
from cellwright.errors import CellwrightError, InvalidInputError, listed
from cellwright.solvers.spheres.fitting import DEFAULTS, MOST_SPHERES, FitSettings, SphereFit, fit_spheres
from cellwright.threads import map_slices

_SHARING, _FITTING = 0.2, 0.9
"""Shares of the progress at which spheres are shared out, and links fitted."""
_EVENING = 1.6
"""Power of the excess volume that spheres are shared by."""


@dataclass(frozen=True, eq=False)
class LinkHull:
    """A link's spheres in its frame, (k, 3) and (k,) in m; ``fit`` is ``None`` if the URDF had them."""

    link: str
    centres: FloatArray
    radii: FloatArray
    fit: SphereFit | None


@dataclass(frozen=True, eq=False)
class SpherizedRobot:
    """A robot of spheres.

    Attributes:
        urdf: With spheres as collision geometry.
        srdf: With the pairs of links that need no check.
        links: The hulls, of the links that have collision geometry, in the order of the URDF.
        pairs: Which of them need no check, by rows of ``links``.
    """

    urdf: str
    srdf: str
    links: tuple[LinkHull, ...]
    pairs: HullPairs

    def ignored(self) -> list[tuple[str, str, Reason]]:
        """Return the pairs of links that need no check, and why."""
        rows = zip(self.pairs.ignored.tolist(), self.pairs.reason.tolist())
        return [(self.links[a].link, self.links[b].link, Reason(reason)) for (a, b), reason in rows]


def spherize_robot(
    urdf_text: str,
    read_mesh: ReadMesh,
    n_spheres: int | Mapping[str, int] = 20,
    *,
    generator: np.random.Generator,
    settings: FitSettings = DEFAULTS,
    share: bool = True,
    n_threads: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> SpherizedRobot:
    """Fit spheres to every link.

    Args:
        urdf_text: The URDF.
        read_mesh: Gives the bytes of its meshes, for example `cellwright.cell.urdf_geometry.meshes_in`.
        n_spheres: Spheres a link on average, or by link: then all links with geometry must be named.
        generator: Source of randomness.
        settings: How spheres are fitted.
        share: Whether links that are hard to fit get more spheres and others fewer, as many in all; not where
            ``n_spheres`` names the links.
        n_threads: Threads; ``None`` takes the cores that the process may use.
        progress: Hears the share of the work done.

    Raises:
        InvalidInputError: If the URDF or a mesh is malformed or missing, or a link has no number of spheres.
        SolverError: If a proof fails.
    """
    tree = parse_urdf(urdf_text)
    shapes = link_shapes(tree, read_mesh)
    fitted = {link: merged_mesh(found) for link, found in shapes.items() if spheres_among(found) is None}
    if isinstance(n_spheres, Mapping):
        missing = [link for link in fitted if link not in n_spheres]
        if missing:
            raise InvalidInputError(f"link {listed(missing)} is given no number of spheres: add it")
    numbers = [n_spheres[link] if isinstance(n_spheres, Mapping) else n_spheres for link in fitted]
    begun = 0.0
    if share and not isinstance(n_spheres, Mapping):
        numbers = shared_numbers(
            fitted, numbers, generator, settings, n_threads=n_threads, progress=lambda done: progress(_SHARING * done)
        )
        begun = _SHARING
    found_fits = fit_many(
        fitted,
        numbers,
        generator,
        settings,
        n_threads=n_threads,
        progress=lambda done: progress(begun + (_FITTING - begun) * done),
    )
    fits = dict(zip(fitted, found_fits))
    links = []
    for link, found in shapes.items():
        given = spheres_among(found)
        fit = fits.get(link)
        centres, radii = given if fit is None and given is not None else (fits[link].centres, fits[link].radii)
        links.append(LinkHull(link, centres, radii, fit))
    pairs = _pairs(urdf_text, links, generator)
    hulls = {hull.link: (hull.centres, hull.radii) for hull in links}
    progress(1.0)
    robot = SpherizedRobot(spherized_urdf(urdf_text, hulls), "", tuple(links), pairs)
    return SpherizedRobot(robot.urdf, srdf_text(tree.name, robot.ignored()), robot.links, pairs)


def shared_numbers(
    meshes: Mapping[str, Mesh],
    n_spheres: Sequence[int],
    generator: np.random.Generator,
    settings: FitSettings = DEFAULTS,
    *,
    n_threads: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> list[int]:
    """Share the same number of spheres out anew: more to meshes whose hull has more volume than they have.

    Shares go by the volume that a quick fit has too much, as a share of the body's, to the power 1.6. That evens the
    volume ratios out on arms with flat and long links. The numbers depend on the meshes alone, not on threads.

    Raises:
        CellwrightError: As `fit_spheres` does.
    """
    quick = replace(settings, n_starts=1)
    fits = fit_many(meshes, n_spheres, generator, quick, n_threads=n_threads, progress=progress)
    excess = np.array([max(fit.metrics.volume_ratio - 1.0, 0.05) for fit in fits])
    weight = excess**_EVENING
    # everybody keeps a quarter of what they had: a quick fit says little of much smaller numbers
    least = np.maximum(np.array(n_spheres) // 4, 1)
    wanted = least + (sum(n_spheres) - least.sum()) * weight / weight.sum()
    numbers = np.floor(wanted).astype(int)
    for row in np.argsort(numbers - wanted, kind="stable")[: sum(n_spheres) - numbers.sum()]:
        numbers[row] += 1
    return [min(int(number), MOST_SPHERES) for number in numbers]


def fit_many(
    meshes: Mapping[str, Mesh],
    n_spheres: Sequence[int],
    generator: np.random.Generator,
    settings: FitSettings = DEFAULTS,
    *,
    n_threads: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> list[SphereFit]:
    """Fit spheres to several named meshes side by side; errors name the mesh.

    Raises:
        CellwrightError: As `fit_spheres` does.
    """
    names, generators = list(meshes), generator.spawn(len(meshes))

    def fit(rows: slice) -> SphereFit:
        name = names[rows.start]
        try:
            return fit_spheres(meshes[name], n_spheres[rows.start], generator=generators[rows.start], settings=settings)
        except CellwrightError as error:
            raise type(error)(f"{name}: {error}") from error

    fits: list[SphereFit] = []
    for each in map_slices(fit, len(names), 1, n_threads=n_threads):
        fits.append(each)
        progress(len(fits) / len(names))
    return fits


def _pairs(urdf_text: str, links: Sequence[LinkHull], generator: np.random.Generator) -> HullPairs:
    tree = parse_urdf(urdf_text)
    group, joined = rigid_groups(tree)
    poses = sampled_link_poses(tree, N_SAMPLES, generator)
    return hull_pairs(
        [hull.centres for hull in links],
        [hull.radii for hull in links],
        [group[hull.link] for hull in links],
        [poses[hull.link] for hull in links],
        joined,
    )
