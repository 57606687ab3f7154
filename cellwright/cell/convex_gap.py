"""Bounds on the gap between two convex bodies, by the algorithm of Gilbert, Johnson and Keerthi (1988).

The bounds are certificates, whatever the iteration does: a direction whose supports lie apart proves a gap of at
least that much, and a point of the Minkowski difference proves one of at most its length. So the search may stop as
soon as either bound decides the question, and started from the direction of the last answer it mostly does at once.

A body is the hull of points, thickened by a radius (sphere, capsule) or by a disc about an axis (cylinder). The support
of a body with many corners is found by climbing along the hull's edges from the last one, which takes some 20 ns;
on a convex body no other peak can stop the climb.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.mesh_topology import is_closed_and_oriented

_CONVERGED = 1e-7
"""Metres between the two bounds at which the search ends."""
_ROUNDS = 32
_FEW = 12
"""Corners up to which looking at all of them is faster than to climb."""
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
        edges: Pairs of corners that an edge of the hull joins, each both ways, sorted, (m, 2); none: not known.
    """

    points: FloatArray
    radius: float
    disc: float
    axis: FloatArray
    solid: bool
    edges: IntArray


def hull_of(shape: Shape, T_frame_body: FloatArray) -> Hull:
    """Return the hull of a shape at a pose (4, 4) in the frame that carries it."""
    radius = disc = 0.0
    solid, edges = True, np.empty((0, 2), np.int64)
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
            points, solid, edges = _mesh_hull(shape)
    R = T_frame_body[:3, :3]
    return Hull(points @ R.T + T_frame_body[:3, 3], float(radius), float(disc), R[:, 2].copy(), solid, edges)


def _mesh_hull(mesh: Mesh) -> tuple[FloatArray, bool, IntArray]:
    """Return the corners of a mesh's hull, whether the mesh fills it, and the hull's edges."""
    from scipy.spatial import ConvexHull, QhullError

    used, faces = np.unique(mesh.faces, return_inverse=True)
    points, welded = np.unique(np.asarray(mesh.vertices, float)[used], axis=0, return_inverse=True)
    faces = welded.reshape(-1)[faces].reshape(-1, 3)
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat: all its points are corners, and it fills nothing
        return points, False, np.empty((0, 2), np.int64)
    a, b, c = (points[faces[:, k]] - points.mean(axis=0) for k in range(3))
    volume = abs(float(np.einsum("fi,fi->f", np.cross(a, b), c).sum())) / 6.0
    sides = np.concatenate([hull.simplices[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    corner = np.full(len(points), -1, np.int64)
    corner[hull.vertices] = np.arange(len(hull.vertices))
    edges = np.unique(corner[np.concatenate([sides, sides[:, ::-1]])], axis=0)
    filled = is_closed_and_oriented(faces) and volume >= (1.0 - _FILLED) * float(hull.volume)
    return points[hull.vertices], filled, edges


def hull_table(hulls: list[Hull]) -> tuple[FloatArray, IntArray, FloatArray, IntArray]:
    """Put hulls into a table for kernels.

    Returns points (n, 3); where the neighbours of each point begin in this same array, the end, and the neighbours
    (n + 1 + edges,); a row a hull of radius, disc and axis (hulls, 5); first point, end, solid (hulls, 3).
    """
    ends = np.cumsum([len(hull.points) for hull in hulls])
    whole = np.array([(end - len(hull.points), end, hull.solid) for hull, end in zip(hulls, ends)], np.int64)
    real = np.array([(hull.radius, hull.disc, *hull.axis) for hull in hulls])
    points = np.concatenate([np.zeros((0, 3)), *(hull.points for hull in hulls)])
    begins = ends - [len(hull.points) for hull in hulls]
    edges = np.concatenate([np.empty((0, 2), np.int64), *(hull.edges + begin for hull, begin in zip(hulls, begins))])
    place = len(points) + 1 + np.searchsorted(edges[:, 0], np.arange(len(points) + 1))
    return points, np.concatenate([place, edges[:, 1]]), real.reshape(-1, 5), whole.reshape(-1, 3)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _support(
    points: FloatArray,
    edge: IntArray,
    real: FloatArray,
    whole: IntArray,
    hull: int,
    row: int,
    x: float,
    y: float,
    z: float,
) -> tuple[float, float, float, int]:
    """Return the point of a hull (without its radius) furthest along (x, y, z), and its corner; ``row``: a guess."""
    begin, end = whole[hull, 0], whole[hull, 1]
    if end - begin <= _FEW or edge[begin] == edge[end]:
        best, row = -1e300, begin
        for k in range(begin, end):
            along = points[k, 0] * x + points[k, 1] * y + points[k, 2] * z
            if along > best:
                best, row = along, k
    else:
        row = min(max(row, begin), end - 1)
        best, climbs = points[row, 0] * x + points[row, 1] * y + points[row, 2] * z, True
        while climbs:
            climbs = False
            for place in range(edge[row], edge[row + 1]):
                k = edge[place]
                along = points[k, 0] * x + points[k, 1] * y + points[k, 2] * z
                if along > best:
                    best, row, climbs = along, k, True
    px, py, pz = points[row, 0], points[row, 1], points[row, 2]
    if real[hull, 1] > 0.0:
        ax, ay, az = real[hull, 2], real[hull, 3], real[hull, 4]
        along = x * ax + y * ay + z * az
        cx, cy, cz = x - along * ax, y - along * ay, z - along * az
        length = math.sqrt(cx * cx + cy * cy + cz * cz)
        if length > 1e-12:
            scale = real[hull, 1] / length
            px, py, pz = px + scale * cx, py + scale * cy, pz + scale * cz
    return px, py, pz, row


@numba.njit(cache=True, nogil=True, _nrt=False)
def _nearest_of_segment(room: FloatArray, i: int, j: int, to: int) -> None:
    """Write the weights of the point of the segment of corners i, j nearest to the origin to row ``to``.

    ``room`` (7, 4) has the corners in its first four rows.
    """
    along = square = 0.0
    for k in range(3):
        edge = room[j, k] - room[i, k]
        along -= room[i, k] * edge
        square += edge * edge
    t = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
    for k in range(4):
        room[to, k] = 0.0
    room[to, i], room[to, j] = 1.0 - t, t


@numba.njit(cache=True, nogil=True, _nrt=False)
def _nearest_of_triangle(room: FloatArray, i: int, j: int, l: int, to: int) -> None:  # noqa: E741
    """Write the weights of the point of triangle i, j, l nearest to the origin to row ``to`` (Ericson 2005, 5.1.5)."""
    d1 = d2 = d3 = d4 = d5 = d6 = 0.0
    for k in range(3):
        ab, ac = room[j, k] - room[i, k], room[l, k] - room[i, k]
        d1 -= ab * room[i, k]
        d2 -= ac * room[i, k]
        d3 -= ab * room[j, k]
        d4 -= ac * room[j, k]
        d5 -= ab * room[l, k]
        d6 -= ac * room[l, k]
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if va > 0.0 and vb > 0.0 and vc > 0.0:
        total = va + vb + vc
        for k in range(4):
            room[to, k] = 0.0
        room[to, i], room[to, j], room[to, l] = va / total, vb / total, vc / total
        return
    # on the border: the nearest of the three edges
    best, nearest = 1e300, 0
    for side in range(3):
        a, b = (i, j) if side == 0 else ((j, l) if side == 1 else (l, i))
        _nearest_of_segment(room, a, b, to)
        square = 0.0
        for k in range(3):
            square += (room[to, a] * room[a, k] + room[to, b] * room[b, k]) ** 2
        if square < best:
            best, nearest = square, side
    a, b = (i, j) if nearest == 0 else ((j, l) if nearest == 1 else (l, i))
    _nearest_of_segment(room, a, b, to)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _nearest_of_simplex(room: FloatArray, n: int) -> bool:
    """Write the weights of the point of a simplex of n corners nearest to the origin to row 4; True if it is inside."""
    for k in range(4):
        room[4, k] = 0.0
    if n == 1:
        room[4, 0] = 1.0
    elif n == 2:
        _nearest_of_segment(room, 0, 1, 4)
    elif n == 3:
        _nearest_of_triangle(room, 0, 1, 2, 4)
    else:
        best, outside = 1e300, False
        for apex in range(4):
            i, j, l = (apex + 1) % 4, (apex + 2) % 4, (apex + 3) % 4  # noqa: E741
            ux, uy, uz = room[j, 0] - room[i, 0], room[j, 1] - room[i, 1], room[j, 2] - room[i, 2]
            vx, vy, vz = room[l, 0] - room[i, 0], room[l, 1] - room[i, 1], room[l, 2] - room[i, 2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            origin = -(nx * room[i, 0] + ny * room[i, 1] + nz * room[i, 2])
            wx, wy, wz = room[apex, 0] - room[i, 0], room[apex, 1] - room[i, 1], room[apex, 2] - room[i, 2]
            if origin * (nx * wx + ny * wy + nz * wz) > 0.0:
                continue
            outside = True
            _nearest_of_triangle(room, i, j, l, 5)
            square = 0.0
            for k in range(3):
                along = 0.0
                for corner in range(4):
                    along += room[5, corner] * room[corner, k]
                square += along * along
            if square < best:
                best = square
                for k in range(4):
                    room[6, k] = room[5, k]
        if not outside:
            return True
        for k in range(4):
            room[4, k] = room[6, k]
    return False


@numba.njit(cache=True, nogil=True, _nrt=False)
def convex_gap(
    points: FloatArray,
    edge: IntArray,
    real: FloatArray,
    whole: IntArray,
    a: int,
    b: int,
    F: FloatArray,
    wanted: float,
    clearance: float,
    start: FloatArray,
    room: FloatArray,
) -> tuple[float, float]:
    """Bound the distance in m between hulls ``a`` and ``b``, the latter's frame at ``F`` (4, 4) in that of the former.

    Stops as soon as the distance is at least ``wanted`` or less than ``clearance``. ``start`` (5,) is where to start: a
    direction from ``b`` to ``a``, which becomes the best one found, and the corners seen last; ``room`` (7, 4) is
    room to work. A negative upper bound means that the hulls overlap.
    """
    thick = real[a, 0] + real[b, 0]
    least, most = -1e300, 1e300
    dx, dy, dz = start[0], start[1], start[2]
    row_a, row_b = int(start[3]), int(start[4])
    n = 0
    for _ in range(_ROUNDS):
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if not length > 1e-12:
            return least, min(most, -thick)
        dx, dy, dz = dx / length, dy / length, dz / length
        ax, ay, az, row_a = _support(points, edge, real, whole, a, row_a, -dx, -dy, -dz)
        # the direction as b's frame sees it
        ex = F[0, 0] * dx + F[1, 0] * dy + F[2, 0] * dz
        ey = F[0, 1] * dx + F[1, 1] * dy + F[2, 1] * dz
        ez = F[0, 2] * dx + F[1, 2] * dy + F[2, 2] * dz
        bx, by, bz, row_b = _support(points, edge, real, whole, b, row_b, ex, ey, ez)
        start[3], start[4] = row_a, row_b
        x = ax - (F[0, 0] * bx + F[0, 1] * by + F[0, 2] * bz + F[0, 3])
        y = ay - (F[1, 0] * bx + F[1, 1] * by + F[1, 2] * bz + F[1, 3])
        z = az - (F[2, 0] * bx + F[2, 1] * by + F[2, 2] * bz + F[2, 3])
        gap = x * dx + y * dy + z * dz - thick
        if gap > least:
            least = gap
            start[0], start[1], start[2] = dx, dy, dz
        if least >= wanted or most - least < _CONVERGED:
            return least, most
        room[n, 0], room[n, 1], room[n, 2] = x, y, z
        n += 1
        if _nearest_of_simplex(room, n):
            return least, min(most, -thick)
        kept = 0
        dx = dy = dz = 0.0
        for corner in range(n):
            if room[4, corner] > 0.0:
                dx += room[4, corner] * room[corner, 0]
                dy += room[4, corner] * room[corner, 1]
                dz += room[4, corner] * room[corner, 2]
                room[kept, 0] = room[corner, 0]
                room[kept, 1] = room[corner, 1]
                room[kept, 2] = room[corner, 2]
                kept += 1
        n = kept
        most = min(most, math.sqrt(dx * dx + dy * dy + dz * dz) - thick)
        if most < clearance or n == 4:
            break
    return least, most
