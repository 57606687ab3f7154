"""From a `SphereHull` to the library's spheres."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from schemas.sphere_hull import SphereHull

if TYPE_CHECKING:
    from cellwright.solvers.layout.bodies import Spheres


def spheres_by_body(hulls: Iterable[SphereHull]) -> dict[str, Spheres]:
    """Return the spheres of every body that has some, in its own frame, by its name."""
    from cellwright.solvers.layout.bodies import Spheres

    found = {}
    for hull in hulls:
        for name, first, count in zip(hull.body, hull.first_sphere.tolist(), hull.n_spheres.tolist()):
            if count:
                own = slice(first, first + count)
                found[name] = Spheres(hull.centre_m[own], hull.radius_m[own])
    return found
