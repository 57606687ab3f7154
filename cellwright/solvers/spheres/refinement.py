"""Move and resize spheres until their union is small and still holds a cloud of points.

Minimised is ``V / V_body + mu * mean(gap^2)``: the volume of the union, and the gaps by which the nearest sphere misses
the points. The union's volume has a simple exact gradient: per unit of radius it grows by the area of the sphere's skin
that no other sphere holds, and per unit of displacement by the integral of the outward normal over that area. Both are
sums over fixed directions (a Fibonacci lattice). A point pulls only at the sphere nearest to it (by ``d^2 - r^2``), as
in Lloyd's iteration. Steps are those of Adam (Kingma & Ba 2015); the penalty ``mu`` rises geometrically while the
steps shrink, from a soft start, where spheres can still trade places, to gaps of a few ten-thousandths of the body.

The idea of fitting spheres by descent on volume and coverage is MorphIt's (2025); the exact gradient, and with it a
cost of 0.3 ms a step for 20 spheres and 5,000 points on one core, is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import FloatArray

N_DIRECTIONS = 128
_FEW = 40
"""Up to so many spheres each skin is summed over all directions, beyond over half of them."""
_LEAST_RADIUS = 1e-3


@dataclass(frozen=True)
class Schedule:
    """How a descent goes; both ranges are run through geometrically.

    Attributes:
        n_steps: Steps.
        lengths: Of Adam's steps at begin and end, in diagonals of the body.
        penalties: Weight of the gaps at begin and end.
    """

    n_steps: int
    lengths: tuple[float, float]
    penalties: tuple[float, float]


WHOLE = Schedule(500, (1e-2, 3e-4), (1e3, 1e7))
"""From any start."""
POLISH = Schedule(150, (1e-3, 3e-4), (1e6, 1e7))
"""From a good place, when points were added to the cloud."""
GROWTH = Schedule(300, (5e-3, 3e-4), (1e5, 1e7))
"""From a hull of fewer spheres and small ones sown on its skin."""


def directions(n: int) -> FloatArray:
    """Return ``n`` evenly spread unit vectors, (n, 3): a Fibonacci lattice."""
    row = np.arange(n) + 0.5
    z = 1.0 - 2.0 * row / n
    angle = math.pi * (1.0 + math.sqrt(5.0)) * row
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def shrink_union(
    cloud: FloatArray,
    centres: FloatArray,
    radii: FloatArray,
    body_volume: float,
    schedule: Schedule = WHOLE,
) -> tuple[FloatArray, FloatArray]:
    """Return refined centres (k, 3) and radii (k,); lengths are in units of the body's diagonal.

    Args:
        cloud: Points to hold, (n, 3): the more, the closer they stand.
        centres, radii: Where to begin, (k, 3) and (k,).
        body_volume: Volume that the union is measured by.
        schedule: How many steps, and how bold.
    """
    spheres = np.column_stack([centres, np.maximum(radii, _LEAST_RADIUS)])
    ways = directions(N_DIRECTIONS if len(centres) <= _FEW else N_DIRECTIONS // 2)
    _descend(
        np.ascontiguousarray(cloud),
        spheres,
        ways,
        body_volume,
        schedule.n_steps,
        schedule.lengths,
        schedule.penalties,
    )
    return spheres[:, :3].copy(), spheres[:, 3].copy()


@numba.njit(cache=True, nogil=True)
def _add_volume(spheres, ways, volume, others, slope):  # type: ignore[no-untyped-def]
    """Add the gradient of the union's volume over ``volume`` to ``slope`` (k, 4)."""
    for i in range(len(spheres)):
        n, r = 0, spheres[i, 3]
        for j in range(len(spheres)):
            if j != i:
                dx, dy, dz = spheres[j, 0] - spheres[i, 0], spheres[j, 1] - spheres[i, 1], spheres[j, 2] - spheres[i, 2]
                if dx * dx + dy * dy + dz * dz < (r + spheres[j, 3]) ** 2:
                    others[n] = j
                    n += 1
        share = 4.0 * math.pi * r * r / len(ways) / volume
        for k in range(len(ways)):
            x, y, z = spheres[i, 0] + r * ways[k, 0], spheres[i, 1] + r * ways[k, 1], spheres[i, 2] + r * ways[k, 2]
            bare = True
            for m in range(n):
                j = others[m]
                dx, dy, dz = x - spheres[j, 0], y - spheres[j, 1], z - spheres[j, 2]
                if dx * dx + dy * dy + dz * dz < spheres[j, 3] ** 2:
                    # asked first for the next direction, which is likely to be in it too
                    others[m], others[0], bare = others[0], j, False
                    break
            if bare:
                for c in range(3):
                    slope[i, c] += share * ways[k, c]
                slope[i, 3] += share


@numba.njit(cache=True, nogil=True)
def _add_gaps(cloud, spheres, penalty, slope):  # type: ignore[no-untyped-def]
    """Add the gradient of the penalty on gaps to ``slope`` (k, 4)."""
    for p in range(len(cloud)):
        least, nearest = np.inf, 0
        for i in range(len(spheres)):
            dx, dy, dz = cloud[p, 0] - spheres[i, 0], cloud[p, 1] - spheres[i, 1], cloud[p, 2] - spheres[i, 2]
            value = dx * dx + dy * dy + dz * dz - spheres[i, 3] * spheres[i, 3]
            if value < least:
                least, nearest = value, i
        if least > 0.0:
            r = spheres[nearest, 3]
            d = math.sqrt(least + r * r)
            pull = 2.0 * penalty * (d - r) / len(cloud)
            for c in range(3):
                slope[nearest, c] -= pull * (cloud[p, c] - spheres[nearest, c]) / d
            slope[nearest, 3] -= pull


@numba.njit(cache=True, nogil=True)
def _descend(cloud, spheres, ways, volume, n_steps, lengths, penalties):  # type: ignore[no-untyped-def]
    n = len(spheres)
    slope, mean, square = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros((n, 4))
    others = np.empty(n, np.int64)
    for step in range(n_steps):
        share = step / n_steps
        length = lengths[0] * (lengths[1] / lengths[0]) ** share
        penalty = penalties[0] * (penalties[1] / penalties[0]) ** share
        slope[:] = 0.0
        _add_volume(spheres, ways, volume, others, slope)
        _add_gaps(cloud, spheres, penalty, slope)
        done = step + 1
        for i in range(n):
            for c in range(4):
                mean[i, c] = 0.9 * mean[i, c] + 0.1 * slope[i, c]
                square[i, c] = 0.99 * square[i, c] + 0.01 * slope[i, c] ** 2
                size = math.sqrt(square[i, c] / (1.0 - 0.99**done)) + 1e-12
                spheres[i, c] -= length * mean[i, c] / (1.0 - 0.9**done) / size
            spheres[i, 3] = max(spheres[i, 3], _LEAST_RADIUS)
