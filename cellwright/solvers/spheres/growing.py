"""Begin with a hull of fewer spheres: its own, and small ones where it reaches the surface.

k-means spreads spheres evenly, which suits long bodies. On plump ones few large spheres along the middle are better,
and further ones pay only as whole rings along the rims: no descent gets there from an even spread. Small spheres sown
where the fewer ones just reach the surface take it over from them, so that these can shrink.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.spheres.metrics import union_gaps

_CANDIDATES = 40
"""Points of the cloud nearest to the hull's skin that one sphere is sown from, on average."""
_LEAST_SHARE = 20
"""At least one in so many of the cloud's points is such a candidate."""
_SOWN = (0.3, 0.1)
"""Radius of a sown sphere: of the one it is sown in, and at most in diagonals of the body."""
_INWARD = 0.7
"""How far inside of the skin it stands, in its radii."""

Spheres = tuple[FloatArray, FloatArray]
"""Centres (k, 3) and radii (k,)."""


def sow_spheres(cloud: FloatArray, fewer: Spheres, n_spheres: int, generator: np.random.Generator) -> Spheres:
    """Return spheres and further small ones along their skin, ``n_spheres`` in all.

    Args:
        cloud: Points that are to be held, (n, 3), in diagonals of the body.
        fewer: Spheres that hold them.
        n_spheres: As many as there are, or more.
        generator: Source of randomness.
    """
    centres, radii = fewer
    n_sown = n_spheres - len(radii)
    gaps = union_gaps(cloud, centres, radii)
    outermost = cloud[np.argsort(-gaps, kind="stable")[: max(_CANDIDATES * n_sown, len(cloud) // _LEAST_SHARE)]]
    seeds = _spread(outermost, n_sown, generator)
    own = np.argmin(np.linalg.norm(seeds[:, None] - centres, axis=2) - radii, axis=1)
    size = np.minimum(_SOWN[0] * radii[own], _SOWN[1])
    inward = centres[own] - seeds
    length = np.maximum(np.linalg.norm(inward, axis=1), np.finfo(float).tiny)
    places = seeds + (_INWARD * size / length)[:, None] * inward
    return np.concatenate([centres, places]), np.concatenate([radii, size])


def _spread(points: FloatArray, n_points: int, generator: np.random.Generator) -> FloatArray:
    """Draw points that stand far apart, each by its squared distance from those before, (n_points, 3)."""
    chosen = np.empty((n_points, 3))
    way = np.ones(len(points))
    for row in range(n_points):
        cumulated = np.cumsum(way)
        drawn = int(np.searchsorted(cumulated, generator.random() * cumulated[-1], side="right"))
        chosen[row] = points[min(drawn, len(points) - 1)]
        away = ((points - chosen[row]) ** 2).sum(axis=1)
        way = away if row == 0 else np.minimum(way, away)
    return chosen
