"""How well spheres stand for a body: coverage, protrusion, gap, volume ratio.

- *coverage*: share of the surface that lies in a sphere, from samples of even density (a proof is another matter:
  `cellwright.solvers.spheres.certificate`);
- *gap*: how far surface points lie from the nearest sphere, 0 where they are covered;
- *protrusion*: how far points of the hull's own skin lie from the body, over the skin that is outside it;
- *volume ratio*: volume of the union of spheres over the volume within the body's outer surface (see
  `cellwright.cell.solid_grid.enclosed_volume`; of an open mesh, over its convex hull's);
- *overshoot*: for each sphere a bound, not an estimate, on how far it can stick out: its radius less the depth of its
  centre, since the ball of that depth lies within the body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.surface_distance import distances
from cellwright.cell.surface_sampling import sample_randomly
from cellwright.solvers.spheres.body import SphereBody
from cellwright.solvers.spheres.refinement import directions

N_SURFACE = 10_000
N_SKIN = 6_000
"""Points on the surface and on the spheres' skins."""
_COLUMNS = 260
"""Columns along an edge of the box in which the union's volume is summed: right to about 1e-4."""


@dataclass(frozen=True)
class HullMetrics:
    """Lengths in m, volumes in m^3.

    Attributes:
        n_spheres: How many.
        coverage: Share of surface samples in a sphere.
        protrusion_mean, protrusion_p95, protrusion_max: Of the skin outside the body, by area.
        gap_mean, gap_p95, gap_max: Of surface samples from the union, 0 inside.
        overshoot: No point of the union is further from the body than this: proven.
        volume: Of the union.
        volume_ratio: To the body's.
    """

    n_spheres: int
    coverage: float
    protrusion_mean: float
    protrusion_p95: float
    protrusion_max: float
    gap_mean: float
    gap_p95: float
    gap_max: float
    overshoot: float
    volume: float
    volume_ratio: float


def hull_metrics(
    body: SphereBody, centres: FloatArray, radii: FloatArray, generator: np.random.Generator
) -> HullMetrics:
    """Measure spheres, (k, 3) and (k,) in the body's own unit, against it; the result is in m."""
    points = sample_randomly(body.triangles, N_SURFACE, generator).points
    gaps = np.maximum(union_gaps(points, centres, radii), 0.0)
    protrusion, weight = _protrusion(body, centres, radii)
    volume = union_volume(centres, radii)
    unit = body.unit
    skin, gap = _spread(protrusion, weight), _spread(gaps, np.ones(len(gaps)))
    return HullMetrics(
        n_spheres=len(radii),
        coverage=float(np.mean(gaps <= 0.0)),
        protrusion_mean=unit * skin[0],
        protrusion_p95=unit * skin[1],
        protrusion_max=unit * skin[2],
        gap_mean=unit * gap[0],
        gap_p95=unit * gap[1],
        gap_max=unit * gap[2],
        overshoot=unit * float(overshoots(body, centres, radii).max()),
        volume=unit**3 * volume,
        volume_ratio=volume / body.volume,
    )


def overshoots(body: SphereBody, centres: FloatArray, radii: FloatArray) -> FloatArray:
    """Return for each sphere the most by which it can stick out of the body, (k,), in the body's unit."""
    depth = distances(body.tree, centres)
    return np.asarray(np.maximum(np.where(body.contains(centres), radii - depth, radii + depth), 0.0))


def _protrusion(body: SphereBody, centres: FloatArray, radii: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far skin points outside the body lie from it, and the area that each stands for."""
    ways = directions(max(24, N_SKIN // len(radii)))
    points = (centres[:, None] + radii[:, None, None] * ways).reshape(-1, 3)
    weight = np.repeat(radii**2, len(ways))
    # a point on a sphere's own skin may fall either way by rounding
    bare = union_gaps(points, centres, radii) > -1e-9
    points, weight = points[bare], weight[bare]
    away = distances(body.tree, points)
    outside = ~body.contains(points)
    return away[outside], weight[outside]


def _spread(values: FloatArray, weights: FloatArray) -> tuple[float, float, float]:
    """Return the weighted mean and 95th percentile, and the largest."""
    if not len(values):
        return 0.0, 0.0, 0.0
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order]) / weights.sum()
    p95 = values[order][min(int(np.searchsorted(share, 0.95)), len(values) - 1)]
    return float(np.average(values, weights=weights)), float(p95), float(values.max())


def union_gaps(points: FloatArray, centres: FloatArray, radii: FloatArray) -> FloatArray:
    """Return the distance of points (n, 3) to a union of balls, negative inside of one, (n,)."""
    gaps: FloatArray = _gaps(np.ascontiguousarray(points), np.ascontiguousarray(centres), radii)
    return gaps


def union_volume(centres: FloatArray, radii: FloatArray) -> float:
    """Return the volume of a union of balls: columns along z, each an exact union of intervals."""
    return float(_volume(np.ascontiguousarray(centres), np.ascontiguousarray(radii), _COLUMNS))


@numba.njit(cache=True, nogil=True)
def _gaps(points, centres, radii):  # type: ignore[no-untyped-def]
    out = np.empty(len(points))
    for p in range(len(points)):
        least = np.inf
        for i in range(len(centres)):
            dx, dy, dz = points[p, 0] - centres[i, 0], points[p, 1] - centres[i, 1], points[p, 2] - centres[i, 2]
            least = min(least, math.sqrt(dx * dx + dy * dy + dz * dz) - radii[i])
        out[p] = least
    return out


@numba.njit(cache=True, nogil=True)
def _volume(centres, radii, n_columns):  # type: ignore[no-untyped-def]
    low_x, high_x = (centres[:, 0] - radii).min(), (centres[:, 0] + radii).max()
    low_y, high_y = (centres[:, 1] - radii).min(), (centres[:, 1] + radii).max()
    edge = max(high_x - low_x, high_y - low_y) / n_columns
    if edge <= 0.0:
        return 0.0
    low = np.sort(centres[:, 2] - radii)
    order = np.argsort(centres[:, 2] - radii)
    begin, end = np.empty(len(radii)), np.empty(len(radii))
    length = 0.0
    for i in range(math.ceil((high_x - low_x) / edge)):
        x = low_x + (i + 0.5) * edge
        for j in range(math.ceil((high_y - low_y) / edge)):
            y = low_y + (j + 0.5) * edge
            n = 0
            for ball in order:
                rest = radii[ball] ** 2 - (x - centres[ball, 0]) ** 2 - (y - centres[ball, 1]) ** 2
                if rest <= 0.0:
                    continue
                half = math.sqrt(rest)
                # intervals come by the balls' lowest points, not their own: they are put in order as they come
                first, last = centres[ball, 2] - half, centres[ball, 2] + half
                m = n
                while m > 0 and begin[m - 1] > first:
                    begin[m], end[m] = begin[m - 1], end[m - 1]
                    m -= 1
                begin[m], end[m] = first, last
                n += 1
            reached = low[0] - 1.0
            for m in range(n):
                if end[m] > reached:
                    length += end[m] - max(begin[m], reached)
                    reached = end[m]
    return length * edge * edge
