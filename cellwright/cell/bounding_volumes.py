"""A bounding volume hierarchy over triangles, and ray queries on it that never slip through a shared edge.

The tree is split by the surface area heuristic over bins (Wald 2007, "On fast construction of SAH-based bounding
volume hierarchies"). A ray meets a triangle by the test of Woop, Benthin and Wald 2013 ("Watertight ray/triangle
intersection"), in double precision. Why nothing leaks:

1. Each vertex is sheared into the ray's frame by a computation that uses the vertex and the ray alone, so triangles
   that share a vertex see the same point: the rounded mesh is as closed as the given one.
2. The sign of an edge function ``a * b - c * d`` is right or zero: rounding is monotone, so ``a * b > c * d`` can
   become equal, but never turn round. (This needs products that are rounded before they are subtracted; numba
   fuses them only under ``fastmath``.) Zeros count as inside, so the test accepts a closed superset of the triangle.
3. A triangle whose three edge functions all vanish, seen from its edge or degenerate, is hit if the ray passes
   through its bounding rectangle.
4. Boxes are padded by `BOX_PADDING` of the scene's diagonal and slab distances are widened by `SLAB_SLACK`, thousands
   of times the rounding errors of rays up to ten thousand diagonals long.

The price is that a ray within a few ulp of an outline may count as blocked. Cost: about 0.2 us a ray.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from cellwright.arrays import FloatArray, Int32Array, IntArray

LEAF_SIZE = 4
"""Triangles that are not split further."""
N_BINS = 16
MAX_SPLIT_DEPTH = 48
"""Below this depth ranges are halved, which bounds the depth of the tree by 48 + 31."""
STACK_SIZE = 96
BOX_PADDING = 1e-10
SLAB_SLACK = 1.0 + 1e-12
LARGEST_INVERSE = 1e300
"""Stands for 1/0 without becoming infinite, so that no product is NaN."""
MISS = -1


class TriangleTree(NamedTuple):
    """The hierarchy as plain arrays, as kernels take it.

    Attributes:
        boxes: Both children's boxes of each inner node, lower then upper corner of each, (nodes, 12) in m.
        child: Inner node, or first row of ``corners`` of a leaf, (nodes, 2).
        n_leaf: Triangles of a leaf, 0 for an inner node, (nodes, 2).
        corners: The triangles in the order of the leaves, (faces, 9) in m.
        face: Row of the given faces for each row of ``corners``, (faces,).
    """

    boxes: FloatArray
    child: Int32Array
    n_leaf: Int32Array
    corners: FloatArray
    face: Int32Array


def build_tree(vertices: FloatArray, faces: IntArray | Int32Array) -> TriangleTree:
    """Build the hierarchy over triangles, ``vertices`` (n, 3) in m, ``faces`` (m, 3)."""
    triangles = np.ascontiguousarray(vertices[faces], float)  # (faces, 3, 3)
    n_faces = len(triangles)
    boxes = np.empty((max(n_faces, 1), 12))
    boxes[:, [0, 1, 2, 6, 7, 8]] = LARGEST_INVERSE  # an empty box that no ray enters
    boxes[:, [3, 4, 5, 9, 10, 11]] = -LARGEST_INVERSE
    child = np.zeros((len(boxes), 2), np.int32)
    n_leaf = np.zeros((len(boxes), 2), np.int32)
    order = np.arange(n_faces, dtype=np.int32)
    if n_faces == 0:
        return TriangleTree(boxes, child, n_leaf, np.empty((0, 9)), order)
    lower, upper = triangles.min(axis=1), triangles.max(axis=1)
    padding = BOX_PADDING * float(np.linalg.norm(upper.max(axis=0) - lower.min(axis=0)))
    n_nodes = _split(lower, upper, padding, order, boxes, child, n_leaf)
    corners = triangles[order].reshape(-1, 9)
    return TriangleTree(boxes[:n_nodes].copy(), child[:n_nodes].copy(), n_leaf[:n_nodes].copy(), corners, order)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _split(lower, upper, padding, order, boxes, child, n_leaf):  # type: ignore[no-untyped-def]
    """Split the range of all triangles top down; ``order`` is permuted in place. Returns the number of nodes."""
    todo = np.zeros((2 * STACK_SIZE, 5), np.int64)  # begin, end, parent, side, depth
    bins, right_cost = np.empty((N_BINS, 7)), np.empty(N_BINS)
    n_todo, n_nodes = 1, 1
    todo[0, 1] = len(order)
    if len(order) > LEAF_SIZE:
        middle = _partition(lower, upper, order, 0, len(order), bins, right_cost)
        n_todo = 2
        todo[1, 0], todo[1, 1], todo[1, 3] = middle, len(order), 1
        todo[0, 1] = middle
    while n_todo > 0:
        n_todo -= 1
        begin, end, parent, side, depth = (
            todo[n_todo, 0],
            todo[n_todo, 1],
            todo[n_todo, 2],
            todo[n_todo, 3],
            todo[n_todo, 4],
        )
        for axis in range(3):
            low, high = np.inf, -np.inf
            for i in range(begin, end):
                low, high = min(low, lower[order[i], axis]), max(high, upper[order[i], axis])
            boxes[parent, 6 * side + axis] = low - padding
            boxes[parent, 6 * side + 3 + axis] = high + padding
        if end - begin <= LEAF_SIZE:
            child[parent, side] = begin
            n_leaf[parent, side] = end - begin
            continue
        child[parent, side] = n_nodes
        middle = (begin + end) // 2
        if depth < MAX_SPLIT_DEPTH:
            middle = _partition(lower, upper, order, begin, end, bins, right_cost)
        for k in range(2):
            todo[n_todo, 0] = begin if k == 0 else middle
            todo[n_todo, 1] = middle if k == 0 else end
            todo[n_todo, 2], todo[n_todo, 3], todo[n_todo, 4] = n_nodes, k, depth + 1
            n_todo += 1
        n_nodes += 1
    return n_nodes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _partition(lower, upper, order, begin, end, bins, right_cost):  # type: ignore[no-untyped-def]
    """Reorder ``order[begin:end]`` into two sides of the cheapest binned split; returns where the second begins.

    ``bins`` (bins, 7) is scratch: box and number of triangles of each bin; so is ``right_cost`` (bins,).
    """
    best_cost, best_axis, best_bin, best_low, best_scale = np.inf, -1, 0, 0.0, 0.0
    for axis in range(3):
        low, high = np.inf, -np.inf
        for i in range(begin, end):
            centre = lower[order[i], axis] + upper[order[i], axis]
            low, high = min(low, centre), max(high, centre)
        scale = N_BINS * (1.0 - 1e-9) / (high - low)
        if not (high > low and scale < LARGEST_INVERSE):
            continue
        for b in range(N_BINS):
            for k in range(3):
                bins[b, k], bins[b, 3 + k] = np.inf, -np.inf
            bins[b, 6] = 0.0
        for i in range(begin, end):
            row = order[i]
            b = int((lower[row, axis] + upper[row, axis] - low) * scale)
            for k in range(3):
                bins[b, k], bins[b, 3 + k] = min(bins[b, k], lower[row, k]), max(bins[b, 3 + k], upper[row, k])
            bins[b, 6] += 1.0
        # cost of a side: its triangles times half the area of its box; first all right sides, then the left ones
        for from_left in range(2):
            x0 = y0 = z0 = np.inf
            x1 = y1 = z1 = -np.inf
            n = 0.0
            for step in range(N_BINS - 1):
                b = step if from_left else N_BINS - 1 - step
                x0, y0, z0 = min(x0, bins[b, 0]), min(y0, bins[b, 1]), min(z0, bins[b, 2])
                x1, y1, z1 = max(x1, bins[b, 3]), max(y1, bins[b, 4]), max(z1, bins[b, 5])
                n += bins[b, 6]
                if n == 0:
                    right_cost[b] = 0.0
                    continue
                cost = n * ((x1 - x0) * (y1 - y0) + (y1 - y0) * (z1 - z0) + (z1 - z0) * (x1 - x0))
                if not from_left:
                    right_cost[b] = cost
                elif n < end - begin and cost + right_cost[b + 1] < best_cost:
                    best_cost = cost + right_cost[b + 1]
                    best_axis, best_bin, best_low, best_scale = axis, b, low, scale
    if best_axis < 0:
        return (begin + end) // 2
    i, j = begin, end - 1
    while i <= j:
        row = order[i]
        if int((lower[row, best_axis] + upper[row, best_axis] - best_low) * best_scale) <= best_bin:
            i += 1
        else:
            order[i], order[j] = order[j], row
            j -= 1
    return i


@numba.njit(cache=True, nogil=True, error_model="numpy")
def trace_rays(tree, n_rays, origins, directions, near, far, any_hit, hit):  # type: ignore[no-untyped-def]
    """Follow the first ``n_rays`` rays ``origin + t * direction`` for ``near < t < far``.

    Rays are taken in batches because a call costs as much as a ray: it counts references to the tree's arrays.

    Args:
        tree: `TriangleTree`.
        n_rays: Rays to follow.
        origins, directions: (rays, 3) in m; no direction is zero, all may have any length.
        near: Lower bounds of t, at least 0, (rays,).
        far: Upper bounds of t, (rays,); overwritten by the t of a hit.
        any_hit: Stop at any triangle instead of finding the nearest.
        hit: Overwritten by the row of ``tree.corners`` that is hit, or `MISS`, (rays,).
    """
    boxes, child, n_leaf, corners = tree.boxes, tree.child, tree.n_leaf, tree.corners
    stack = np.empty(STACK_SIZE, np.int32)
    for ray in range(n_rays):
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        ix, iy, iz = _inverse(dx), _inverse(dy), _inverse(dz)
        # the side of a box at which the ray enters, for each axis
        nx, ny, nz = (0 if dx >= 0 else 3), (1 if dy >= 0 else 4), (2 if dz >= 0 else 5)
        fx, fy, fz = 3 - nx, 5 - ny, 7 - nz
        low, high, found = near[ray], far[ray], MISS
        stack[0] = 0
        top = 1
        while top > 0:
            top -= 1
            node = stack[top]
            entry0 = entry1 = np.inf
            for side in range(2):
                base = 6 * side
                enter = max(
                    max((boxes[node, base + nx] - ox) * ix, (boxes[node, base + ny] - oy) * iy),
                    max((boxes[node, base + nz] - oz) * iz, low),
                )
                leave = min(
                    min((boxes[node, base + fx] - ox) * ix, (boxes[node, base + fy] - oy) * iy),
                    min((boxes[node, base + fz] - oz) * iz, high),
                )
                if enter > leave * SLAB_SLACK:
                    continue
                n_triangles = n_leaf[node, side]
                if n_triangles == 0:
                    entry0, entry1 = (enter, entry1) if side == 0 else (entry0, enter)
                    continue
                begin = child[node, side]
                for row in range(begin, begin + n_triangles):
                    t = _meet(corners, row, ox, oy, oz, dx, dy, dz, low, high)
                    if low < t < high:
                        high, found = t, row
                if any_hit and found != MISS:
                    break
            if any_hit and found != MISS:
                break
            # the nearer child is followed first
            near_side = 0 if entry0 <= entry1 else 1
            if max(entry0, entry1) < np.inf:
                stack[top] = child[node, 1 - near_side]
                top += 1
            if min(entry0, entry1) < np.inf:
                stack[top] = child[node, near_side]
                top += 1
        far[ray] = high
        hit[ray] = found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _meet(corners, row, ox, oy, oz, dx, dy, dz, near, far):  # type: ignore[no-untyped-def]
    """Return t at which a ray meets a triangle, infinite if it misses."""
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if az >= ax and az >= ay:
        kx, ky, kz = 0, 1, 2
        okx, oky, okz, sx, sy, sz = ox, oy, oz, dx / dz, dy / dz, 1.0 / dz
    elif ay >= ax:
        kx, ky, kz = 2, 0, 1
        okx, oky, okz, sx, sy, sz = oz, ox, oy, dz / dy, dx / dy, 1.0 / dy
    else:
        kx, ky, kz = 1, 2, 0
        okx, oky, okz, sx, sy, sz = oy, oz, ox, dy / dx, dz / dx, 1.0 / dx
    za, zb, zc = corners[row, kz] - okz, corners[row, 3 + kz] - okz, corners[row, 6 + kz] - okz
    xa, ya = corners[row, kx] - okx - sx * za, corners[row, ky] - oky - sy * za
    xb, yb = corners[row, 3 + kx] - okx - sx * zb, corners[row, 3 + ky] - oky - sy * zb
    xc, yc = corners[row, 6 + kx] - okx - sx * zc, corners[row, 6 + ky] - oky - sy * zc
    u, v, w = xc * yb - yc * xb, xa * yc - ya * xc, xb * ya - yb * xa
    if (u < 0 or v < 0 or w < 0) and (u > 0 or v > 0 or w > 0):
        return np.inf
    total = u + v + w
    if total != 0:
        return sz * (u * za + v * zb + w * zc) / total
    if min(xa, min(xb, xc)) <= 0 <= max(xa, max(xb, xc)) and min(ya, min(yb, yc)) <= 0 <= max(ya, max(yb, yc)):
        # seen from its edge: the ray runs inside it between its ends along the ray
        t0, t1 = sz * min(za, min(zb, zc)), sz * max(za, max(zb, zc))
        if max(t0, t1) > near:
            return max(min(t0, t1), near + (far - near) * 1e-12)
    return np.inf


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _inverse(component):  # type: ignore[no-untyped-def]
    if abs(component) * LARGEST_INVERSE <= 1.0:
        return LARGEST_INVERSE if component >= 0 else -LARGEST_INVERSE
    return 1.0 / component
