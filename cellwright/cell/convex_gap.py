"""Bounds on the gap between two convex bodies, by the algorithm of Gilbert, Johnson and Keerthi (1988).

The bounds are certificates, whatever the iteration does: a direction whose supports lie apart proves a gap of at
least that much, and a point of the Minkowski difference proves one of at most its length. So the search may stop as
soon as either bound decides the question, and started from the direction of the last answer it mostly does at once.

A body is the hull of points, thickened by a radius (sphere, capsule) or by a disc about an axis (cylinder). About
0.2 us a support of bodies with 150 points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.distance_field import is_closed

_CONVERGED = 1e-7
"""Metres between the two bounds at which the search ends."""
_ROUNDS = 32
_FILLED = 1e-5
"""A closed mesh that leaves no more than this share of its hull empty counts as convex."""


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of a body in the frame that carries it.

    Attributes:
        points: Corners, (n, 3) in m.
        radius: Thickness of the ball about them in m.
        disc: Thickness of the disc about them, across ``axis``, in m.
        axis: Unit vector, (3,).
        solid: Whether the body fills its hull.
    """

    points: FloatArray
    radius: float
    disc: float
    axis: FloatArray
    solid: bool


def hull_of(shape: Shape, T_frame_body: FloatArray) -> Hull:
    """Return the hull of a shape at a pose (4, 4) in the frame that carries it."""
    radius = disc = 0.0
    solid = True
    match shape:
        case Box(size):
            points = 0.5 * np.array(size) * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
        case Sphere(radius):
            points = np.zeros((1, 3))
        case Capsule(radius, length):
            points = np.array([[0.0, 0.0, -0.5 * length], [0.0, 0.0, 0.5 * length]])
        case Cylinder(disc, length):
            points = np.array([[0.0, 0.0, -0.5 * length], [0.0, 0.0, 0.5 * length]])
        case Mesh():
            points, solid = _mesh_hull(shape)
    R = T_frame_body[:3, :3]
    return Hull(points @ R.T + T_frame_body[:3, 3], float(radius), float(disc), R[:, 2].copy(), solid)


def _mesh_hull(mesh: Mesh) -> tuple[FloatArray, bool]:
    """Return the corners of a mesh's hull and whether the mesh fills it."""
    from scipy.spatial import ConvexHull, QhullError

    used, faces = np.unique(mesh.faces, return_inverse=True)
    points, welded = np.unique(np.asarray(mesh.vertices, float)[used], axis=0, return_inverse=True)
    faces = welded.reshape(-1)[faces].reshape(-1, 3)
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat: all its points are corners, and it fills nothing
        return points, False
    a, b, c = (points[faces[:, k]] - points.mean(axis=0) for k in range(3))
    volume = abs(float(np.einsum("fi,fi->f", np.cross(a, b), c).sum())) / 6.0
    return points[hull.vertices], is_closed(faces) and volume >= (1.0 - _FILLED) * float(hull.volume)


def hull_table(hulls: list[Hull]) -> tuple[FloatArray, FloatArray, IntArray]:
    """Put hulls into a table for kernels.

    Returns points (n, 3); a row a hull of radius, disc and axis (hulls, 5); first point, end, solid (hulls, 3).
    """
    ends = np.cumsum([len(hull.points) for hull in hulls])
    whole = np.array([(end - len(hull.points), end, hull.solid) for hull, end in zip(hulls, ends)], np.int64)
    real = np.array([(hull.radius, hull.disc, *hull.axis) for hull in hulls])
    points = np.concatenate([np.zeros((0, 3)), *(hull.points for hull in hulls)])
    return points, real.reshape(-1, 5), whole.reshape(-1, 3)


@numba.njit(cache=True, nogil=True)
def _support(
    points: FloatArray, real: FloatArray, whole: IntArray, hull: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return the point of a hull (without its radius) furthest along (x, y, z)."""
    best, row = -1e300, 0
    for k in range(whole[hull, 0], whole[hull, 1]):
        along = points[k, 0] * x + points[k, 1] * y + points[k, 2] * z
        if along > best:
            best, row = along, k
    px, py, pz = points[row, 0], points[row, 1], points[row, 2]
    if real[hull, 1] > 0.0:
        ax, ay, az = real[hull, 2], real[hull, 3], real[hull, 4]
        along = x * ax + y * ay + z * az
        cx, cy, cz = x - along * ax, y - along * ay, z - along * az
        length = math.sqrt(cx * cx + cy * cy + cz * cz)
        if length > 1e-12:
            scale = real[hull, 1] / length
            px, py, pz = px + scale * cx, py + scale * cy, pz + scale * cz
    return px, py, pz


@numba.njit(cache=True, nogil=True)
def _nearest_of_segment(w: FloatArray, i: int, j: int, weight: FloatArray) -> None:
    """Write the weights (4,) of the point of the segment of corners i, j that is nearest to the origin."""
    along = square = 0.0
    for k in range(3):
        edge = w[j, k] - w[i, k]
        along -= w[i, k] * edge
        square += edge * edge
    t = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
    weight[:] = 0.0
    weight[i], weight[j] = 1.0 - t, t


@numba.njit(cache=True, nogil=True)
def _nearest_of_triangle(w: FloatArray, i: int, j: int, l: int, weight: FloatArray) -> None:  # noqa: E741
    """Write the weights (4,) of the point of triangle i, j, l nearest to the origin (Ericson 2005, 5.1.5)."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for k in range(3):
        ab, ac = w[j, k] - w[i, k], w[l, k] - w[i, k]
        d1 -= ab * w[i, k]
        d2 -= ac * w[i, k]
        d3 -= ab * w[j, k]
        d4 -= ac * w[j, k]
        d5 -= ab * w[l, k]
        d6 -= ac * w[l, k]
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if va > 0.0 and vb > 0.0 and vc > 0.0:
        total = va + vb + vc
        weight[:] = 0.0
        weight[i], weight[j], weight[l] = va / total, vb / total, vc / total
        return
    # on the border: the nearest of the three edges
    best = 1e300
    kept = np.zeros(4)
    for side in range(3):
        a, b = (i, j) if side == 0 else ((j, l) if side == 1 else (l, i))
        _nearest_of_segment(w, a, b, weight)
        square = 0.0
        for k in range(3):
            square += (weight[a] * w[a, k] + weight[b] * w[b, k]) ** 2
        if square < best:
            best = square
            kept[:] = weight
    weight[:] = kept


@numba.njit(cache=True, nogil=True)
def _nearest_of_simplex(w: FloatArray, n: int, weight: FloatArray) -> bool:
    """Write the weights (4,) of the point of a simplex of n corners nearest to the origin; True if it is inside."""
    weight[:] = 0.0
    if n == 1:
        weight[0] = 1.0
    elif n == 2:
        _nearest_of_segment(w, 0, 1, weight)
    elif n == 3:
        _nearest_of_triangle(w, 0, 1, 2, weight)
    else:
        best, outside = 1e300, False
        kept, trial = np.zeros(4), np.zeros(4)
        for apex in range(4):
            i, j, l = (apex + 1) % 4, (apex + 2) % 4, (apex + 3) % 4  # noqa: E741
            nx = (w[j, 1] - w[i, 1]) * (w[l, 2] - w[i, 2]) - (w[j, 2] - w[i, 2]) * (w[l, 1] - w[i, 1])
            ny = (w[j, 2] - w[i, 2]) * (w[l, 0] - w[i, 0]) - (w[j, 0] - w[i, 0]) * (w[l, 2] - w[i, 2])
            nz = (w[j, 0] - w[i, 0]) * (w[l, 1] - w[i, 1]) - (w[j, 1] - w[i, 1]) * (w[l, 0] - w[i, 0])
            origin = -(nx * w[i, 0] + ny * w[i, 1] + nz * w[i, 2])
            other = nx * (w[apex, 0] - w[i, 0]) + ny * (w[apex, 1] - w[i, 1]) + nz * (w[apex, 2] - w[i, 2])
            if origin * other > 0.0:
                continue
            outside = True
            _nearest_of_triangle(w, i, j, l, trial)
            square = 0.0
            for k in range(3):
                along = 0.0
                for corner in range(4):
                    along += trial[corner] * w[corner, k]
                square += along * along
            if square < best:
                best = square
                kept[:] = trial
        if not outside:
            return True
        weight[:] = kept
    return False


@numba.njit(cache=True, nogil=True)
def convex_gap(
    points: FloatArray,
    real: FloatArray,
    whole: IntArray,
    a: int,
    b: int,
    F: FloatArray,
    wanted: float,
    clearance: float,
    direction: FloatArray,
    simplex: FloatArray,
) -> tuple[float, float]:
    """Bound the distance in m between hulls ``a`` and ``b``, the latter's frame at ``F`` (4, 4) in that of the former.

    Stops as soon as the distance is at least ``wanted`` or less than ``clearance``. ``direction`` (3,), from ``b`` to
    ``a``, is where to start and receives the best one found; ``simplex`` (4, 3) is room to work. A negative upper
    bound means that the hulls overlap.
    """
    thick = real[a, 0] + real[b, 0]
    least, most = -1e300, 1e300
    dx, dy, dz = direction[0], direction[1], direction[2]
    n = 0
    weight = np.zeros(4)
    for _ in range(_ROUNDS):
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if not length > 1e-12:
            return least, min(most, -thick)
        dx, dy, dz = dx / length, dy / length, dz / length
        ax, ay, az = _support(points, real, whole, a, -dx, -dy, -dz)
        # the direction as b's frame sees it
        ex = F[0, 0] * dx + F[1, 0] * dy + F[2, 0] * dz
        ey = F[0, 1] * dx + F[1, 1] * dy + F[2, 1] * dz
        ez = F[0, 2] * dx + F[1, 2] * dy + F[2, 2] * dz
        bx, by, bz = _support(points, real, whole, b, ex, ey, ez)
        x = ax - (F[0, 0] * bx + F[0, 1] * by + F[0, 2] * bz + F[0, 3])
        y = ay - (F[1, 0] * bx + F[1, 1] * by + F[1, 2] * bz + F[1, 3])
        z = az - (F[2, 0] * bx + F[2, 1] * by + F[2, 2] * bz + F[2, 3])
        gap = x * dx + y * dy + z * dz - thick
        if gap > least:
            least = gap
            direction[0], direction[1], direction[2] = dx, dy, dz
        if least >= wanted or most - least < _CONVERGED:
            return least, most
        simplex[n, 0], simplex[n, 1], simplex[n, 2] = x, y, z
        n += 1
        if _nearest_of_simplex(simplex, n, weight):
            return least, min(most, -thick)
        kept = 0
        dx = dy = dz = 0.0
        for corner in range(n):
            if weight[corner] > 0.0:
                dx += weight[corner] * simplex[corner, 0]
                dy += weight[corner] * simplex[corner, 1]
                dz += weight[corner] * simplex[corner, 2]
                simplex[kept, 0] = simplex[corner, 0]
                simplex[kept, 1] = simplex[corner, 1]
                simplex[kept, 2] = simplex[corner, 2]
                kept += 1
        n = kept
        most = min(most, math.sqrt(dx * dx + dy * dy + dz * dz) - thick)
        if most < clearance or n == 4:
            break
    return least, most
