"""Exact distances from points to a triangle mesh, in double precision, by a bounding volume hierarchy.

The nearest point of a triangle by its Voronoi regions (Ericson 2005, "Real-Time Collision Detection", section 5.1.5).
Unsigned: what is inside is for `cellwright.cell.containment` to say. Cost: 1 to 5 us a point.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bounding_volumes import STACK_SIZE, TriangleTree

_NEEDLE = 1e-14
"""Squared doubled area over squared edges below which a triangle counts as its edges only."""


def distances(tree: TriangleTree, points: FloatArray) -> FloatArray:
    """Return the distance of each point (n, 3) to the nearest point of the mesh, (n,), in the unit of the tree."""
    found: FloatArray = _distances(
        tree.boxes, tree.child, tree.n_leaf, tree.corners, np.ascontiguousarray(points, np.float64)
    )
    return found


@numba.njit(cache=True, nogil=True)
def _distances(boxes, child, n_leaf, corners, points):  # type: ignore[no-untyped-def]
    out = np.empty(len(points))
    stack = np.empty(2 * STACK_SIZE, np.int64)
    way = np.empty(2 * STACK_SIZE)
    for row in range(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        best = np.inf
        stack[0], way[0], n = 0, 0.0, 1
        while n > 0:
            n -= 1
            if way[n] >= best:
                continue
            node = stack[n]
            first = 0 if box_way(boxes, node, 0, x, y, z) >= box_way(boxes, node, 1, x, y, z) else 1
            for turn in range(2):  # the nearer child is pushed last and so visited first
                side = first if turn == 0 else 1 - first
                near = box_way(boxes, node, side, x, y, z)
                if near >= best:
                    continue
                if n_leaf[node, side] > 0:
                    begin = child[node, side]
                    for k in range(begin, begin + n_leaf[node, side]):
                        best = min(best, triangle_way(corners, k, x, y, z))
                elif child[node, side] > 0:
                    stack[n], way[n] = child[node, side], near
                    n += 1
        out[row] = math.sqrt(best)
    return out


@numba.njit(cache=True, nogil=True)
def box_way(boxes, node, side, x, y, z):  # type: ignore[no-untyped-def]
    """Return the squared distance of a point to one child's box."""
    k = 6 * side
    dx = max(boxes[node, k] - x, x - boxes[node, k + 3], 0.0)
    dy = max(boxes[node, k + 1] - y, y - boxes[node, k + 4], 0.0)
    dz = max(boxes[node, k + 2] - z, z - boxes[node, k + 5], 0.0)
    return dx * dx + dy * dy + dz * dz


@numba.njit(cache=True, nogil=True)
def triangle_way(corners, row, x, y, z):  # type: ignore[no-untyped-def]
    """Return the squared distance of a point to triangle ``row`` of ``corners`` (m, 9)."""
    ax, ay, az = corners[row, 0], corners[row, 1], corners[row, 2]
    ux, uy, uz = corners[row, 3] - ax, corners[row, 4] - ay, corners[row, 5] - az
    vx, vy, vz = corners[row, 6] - ax, corners[row, 7] - ay, corners[row, 8] - az
    px, py, pz = x - ax, y - ay, z - az
    d1, d2 = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    s = t = 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        s = t = 0.0
    elif d3 >= 0.0 and d4 <= d3:
        s = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        t = 1.0
    else:
        va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
        if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
            s = d1 / uu if uu > 0.0 else 0.0
        elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
            t = d2 / vv if vv > 0.0 else 0.0
        elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
            whole = (d4 - d3) + (d5 - d6)
            t = (d4 - d3) / whole if whole > 0.0 else 0.0
            s = 1.0 - t
        elif va + vb + vc > _NEEDLE * uu * vv:
            s, t = vb / (va + vb + vc), vc / (va + vb + vc)
        else:  # a needle has no inside: its nearest point lies on one of its edges
            along = _edge_way(px, py, pz, ux, uy, uz)
            across = _edge_way(px, py, pz, vx, vy, vz)
            return min(along, across, _edge_way(px - ux, py - uy, pz - uz, vx - ux, vy - uy, vz - uz))
    qx, qy, qz = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
    return qx * qx + qy * qy + qz * qz


@numba.njit(cache=True, nogil=True)
def _edge_way(px, py, pz, ux, uy, uz):  # type: ignore[no-untyped-def]
    """Return the squared distance of a point to the segment from the origin to u."""
    uu = ux * ux + uy * uy + uz * uz
    s = min(max((px * ux + py * uy + pz * uz) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    qx, qy, qz = px - s * ux, py - s * uy, pz - s * uz
    return qx * qx + qy * qy + qz * qz
