"""Prove that spheres that cover a body's surface leave no hole inside it, or find the holes.

Let ``f(x)`` be the least of ``|x - c|^2 - r^2`` over all balls: positive where no ball reaches. A hole in a body whose
surface is covered is a bounded piece of ``f > 0`` with ``f = 0`` on its rim, so ``f`` has a local maximum in it. At a
local maximum no direction leads away from all balls that are nearest there, hence it lies among their centres. Boxes
about the centres are cut in two until each is shown to hold no such place, because

1. one ball holds the box as a whole, or
2. a direction leads away from every ball that may be nearest anywhere in the box (found by Gilbert's method for the
   point of a convex hull nearest to the origin, then tested for the whole box), or
3. the box lies outside the body: where the flooded grid says so, or, for a single closed shell, where the exact
   distance says that the surface does not cross the box and a ray's parity that its middle is outside.

Boxes of size ``leaf`` that withstand are reported. Like the surface test this errs to the safe side only, and balls are
tested with radii smaller by ``margin``, far above rounding. What the surface encloses is what the grid's flood does not
reach, so cavities count as inside.

Cost: a few ms for 20 balls.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bounding_volumes import TriangleTree
from cellwright.cell.containment import ClosedMesh, inside_all
from cellwright.cell.solid_grid import SolidGrid
from cellwright.cell.surface_distance import distances

_MOST_BOXES = 20_000
_STACK = 1024
_GILBERT_STEPS = 24


def find_voids(
    centres: FloatArray,
    radii: FloatArray,
    *,
    grid: SolidGrid,
    tree: TriangleTree,
    shell: ClosedMesh | None,
    leaf: float,
    margin: float,
) -> FloatArray:
    """Return balls (n, 4), centre and radius, around all places inside the body that may be in no sphere.

    None means proven: no hole.

    Args:
        centres, radii: The spheres, (k, 3) and (k,) in m; they cover the surface.
        grid: Where it is outside.
        tree: The surface.
        shell: The surface as one closed shell; ``None`` if it is not: then the grid alone tells.
        leaf: Boxes of this half diagonal are not cut further, m.
        margin: By how much smaller the spheres are taken, m.
    """
    reach = np.maximum(radii - margin, 0.0)
    clearance = np.ascontiguousarray(grid.clearance)
    boxes, n_boxes = _search(np.ascontiguousarray(centres), reach, grid.origin, grid.spacing, clearance, leaf)
    held: FloatArray = boxes[:n_boxes]
    # a search that was cut short has not looked everywhere: nothing of it may be dismissed
    if shell is None or not n_boxes or n_boxes == _MOST_BOXES:
        return held
    away = distances(tree, held[:, :3]) > held[:, 3]
    return np.asarray(held[~away | inside_all(held[:, :3], shell)])


@numba.njit(cache=True, nogil=True)
def _covers(centres, reach, x, half):  # type: ignore[no-untyped-def]
    """Return the least over balls of the greatest value of ``|x - c|^2 - r^2`` over a box."""
    least = np.inf
    for ball in range(len(centres)):
        far = 0.0
        for k in range(3):
            far += (abs(x[k] - centres[ball, k]) + half[k]) ** 2
        least = min(least, far - reach[ball] ** 2)
    return least


@numba.njit(cache=True, nogil=True)
def _leads_away(centres, reach, x, half, most, active, unit):  # type: ignore[no-untyped-def]
    """Tell whether one direction leads away from all balls that may be nearest anywhere in the box."""
    n = 0
    for ball in range(len(centres)):
        near = 0.0
        for k in range(3):
            near += max(abs(x[k] - centres[ball, k]) - half[k], 0.0) ** 2
        if near - reach[ball] ** 2 <= most:
            active[n] = ball
            length = 0.0
            for k in range(3):
                unit[n, k] = x[k] - centres[ball, k]
                length += unit[n, k] ** 2
            length = math.sqrt(length)
            if length == 0.0:
                return False
            for k in range(3):
                unit[n, k] /= length
            n += 1
    way = np.zeros(3)
    for i in range(n):
        for k in range(3):
            way[k] += unit[i, k] / n
    for _ in range(_GILBERT_STEPS):
        away, worst, least = True, 0, np.inf
        spread = abs(way[0]) * half[0] + abs(way[1]) * half[1] + abs(way[2]) * half[2]
        for i in range(n):
            ball, along, ahead = active[i], 0.0, 0.0
            for k in range(3):
                along += way[k] * unit[i, k]
                ahead += way[k] * (x[k] - centres[ball, k])
            away = away and ahead > spread * (1.0 + 1e-9)
            if along < least:
                worst, least = i, along
        if away:
            return True
        step, length = 0.0, 0.0
        for k in range(3):
            step -= way[k] * (unit[worst, k] - way[k])
            length += (unit[worst, k] - way[k]) ** 2
        if length == 0.0 or step <= 0.0:
            return False
        for k in range(3):
            way[k] += min(step / length, 1.0) * (unit[worst, k] - way[k])
    return False


@numba.njit(cache=True, nogil=True)
def _is_outside(origin, spacing, clearance, x, radius):  # type: ignore[no-untyped-def]
    """Tell whether all cells that a ball about x meets have outside nodes only."""
    off, node = 0.0, np.empty(3, np.int64)
    for k in range(3):
        place = (x[k] - origin[k]) / spacing
        node[k] = min(max(math.floor(place + 0.5), 0), clearance.shape[k] - 1)
        off += (place - node[k]) ** 2
    room = clearance[node[0], node[1], node[2]] - spacing * math.sqrt(off)
    return room > radius + 1.7321 * spacing


@numba.njit(cache=True, nogil=True)
def _search(centres, reach, origin, spacing, clearance, leaf):  # type: ignore[no-untyped-def]
    found, n_found = np.empty((_MOST_BOXES, 4)), 0
    todo = np.empty((_STACK, 6))
    active, unit = np.empty(len(centres), np.int64), np.empty((len(centres), 3))
    for k in range(3):
        low, high = centres[:, k].min(), centres[:, k].max()
        todo[0, k] = 0.5 * (low + high)
        todo[0, 3 + k] = 0.5 * (high - low) + 1e-3 * leaf
    n = 1
    while n > 0 and n_found < _MOST_BOXES:
        n -= 1
        x, half = todo[n, :3].copy(), todo[n, 3:].copy()
        most = _covers(centres, reach, x, half)
        if most <= 0.0:
            continue
        radius = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
        if _is_outside(origin, spacing, clearance, x, radius):
            continue
        if _leads_away(centres, reach, x, half, most, active, unit):
            continue
        if radius <= leaf or n + 2 > _STACK:
            for k in range(3):
                found[n_found, k] = x[k]
            found[n_found, 3] = radius
            n_found += 1
            continue
        axis = int(np.argmax(half))
        half[axis] *= 0.5
        for side in range(2):
            for k in range(3):
                todo[n, k], todo[n, 3 + k] = x[k], half[k]
            todo[n, axis] += half[axis] * (2 * side - 1)
            n += 1
    return found, n_found
