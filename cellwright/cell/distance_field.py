"""Bounds on the signed distance from points to bodies: analytic for simple shapes, by a grid for meshes.

A `DistanceField` holds, at the nodes of a grid around one mesh, a lower and an upper bound of the signed distance
(negative inside). A signed distance changes by at most the way gone, so each of the eight nodes about a point bounds
the distance there; the tightest of them is taken. No interpolation error can make a bound wrong.

The sign comes from flooding the grid from outside: two neighbouring nodes that are both further from the surface than
half the spacing cannot have it between them. Rays, which may slip through shared edges, are not used. What the flood
does not reach counts as inside in the lower bound; the upper bound says so only where the mesh is closed, so an open
shell never claims a solid it does not have.

Cost: one exact point-to-mesh distance a node (Open3D, about 3 us), 20 to 30 ns a query.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import BoolArray, Float32Array, FloatArray, Int32Array, IntArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.mesh_topology import is_closed_and_oriented
from cellwright.cell.transforms import inverse

BOX, CYLINDER, SPHERE, CAPSULE, FIELD, UNTABLED = range(6)
"""Codes of the shapes in kernels: ``FIELD`` is a mesh behind its distance field, ``UNTABLED`` one without."""

_ROUNDING = 2e-6
"""Distances are computed in single precision: metres by which the bounds are widened for it."""


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Bounds of the signed distance to one mesh at the nodes of a regular grid.

    Attributes:
        origin: The first node, (3,) in m in the body's frame.
        spacing: Distance of neighbouring nodes in m.
        lower, upper: Bounds of the signed distance at the nodes in m, (nx, ny, nz).
        lowest, highest: Corners of the mesh's bounding box, (3,) in m.
        closed: Whether the mesh encloses a solid.
    """

    origin: FloatArray
    spacing: float
    lower: Float32Array
    upper: Float32Array
    lowest: FloatArray
    highest: FloatArray
    closed: bool


def grid_nodes(origin: FloatArray, spacing: float, shape: tuple[int, ...]) -> FloatArray:
    """Return the nodes of a grid in C order, (n, 3) in m."""
    axes = [origin[axis] + spacing * np.arange(shape[axis]) for axis in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def mesh_field(mesh: Mesh, *, spacing: float, padding: float, most_nodes: int = 250_000) -> DistanceField:
    """Sample the distance to a mesh on a grid that reaches ``padding`` m beyond its bounding box.

    The spacing in m grows beyond ``spacing`` where the grid would have more than ``most_nodes`` nodes.
    """
    vertices = np.asarray(mesh.vertices, np.float64)
    used = vertices[np.unique(mesh.faces)]
    lowest, highest = used.min(axis=0), used.max(axis=0)
    extent = highest - lowest + 2.0 * padding
    spacing = max(spacing, float((extent.prod() / most_nodes) ** (1.0 / 3.0)))
    shape = tuple(int(n) for n in np.ceil(extent / spacing).astype(int) + 1)
    origin = 0.5 * (lowest + highest) - 0.5 * spacing * (np.array(shape) - 1)
    distance = _unsigned_distances(vertices, mesh.faces, grid_nodes(origin, spacing, shape)).reshape(shape)
    # welded, because STL files give each triangle its own vertices
    _, welded = np.unique(vertices, axis=0, return_inverse=True)
    closed = is_closed_and_oriented(welded.reshape(-1)[mesh.faces])
    clear = distance > 0.5 * spacing + 2.0 * _ROUNDING
    lower, upper = distance.copy(), distance.copy()
    lower[~clear] *= -1.0
    enclosed = clear & ~_flooded(clear)
    lower[enclosed] *= -1.0
    if closed:
        upper[enclosed] *= -1.0
    return DistanceField(origin, spacing, lower - _ROUNDING, upper + _ROUNDING, lowest, highest, closed)


def _unsigned_distances(vertices: FloatArray, faces: Int32Array | IntArray, points: FloatArray) -> Float32Array:
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    # about the middle of the mesh, so that single precision is spent on the mesh and not on where it lies
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    scene.add_triangles(np.asarray(vertices - middle, np.float32), np.asarray(faces, np.uint32))
    return np.asarray(scene.compute_distance(np.asarray(points - middle, np.float32)).numpy())


def _flooded(clear: BoolArray) -> BoolArray:
    """Return which clear nodes are joined to the border of the grid through clear neighbours."""
    from scipy import ndimage

    padded = np.pad(clear, 1, constant_values=True)
    labels, _ = ndimage.label(padded)
    return np.asarray((labels == labels[0, 0, 0])[1:-1, 1:-1, 1:-1])


@dataclass(frozen=True, eq=False)
class DistanceTable:
    """Several bodies' distances as flat arrays for kernels; make it by `distance_table`.

    Attributes:
        real: A row a body, lengths in m: size (box: half edge lengths; cylinder, capsule: radius, half length;
            sphere: radius; 3 numbers), rows of the transform from the common frame to the body (12), first node
            (3), spacing, corners of the mesh's bounding box (6); (bodies, 25).
        whole: Shape code, nodes along each axis (3), place of the first node in the bounds; (bodies, 5).
        lower, upper: Bounds at the nodes of all fields one after the other, in m.
    """

    real: FloatArray
    whole: IntArray
    lower: Float32Array
    upper: Float32Array


def distance_table(
    shapes: list[Shape],
    T_frame_body: list[FloatArray],
    tabled: list[bool],
    *,
    spacing: float,
    padding: float,
    most_nodes: int = 250_000,
) -> DistanceTable:
    """Put bodies that stand still in one frame each into a table for kernels.

    ``T_frame_body``: pose (4, 4) of each body; ``tabled``: whether a mesh gets a field, without which only its
    bounding box bounds the distance; ``spacing``, ``padding`` (m) and ``most_nodes``: see `mesh_field`.
    """
    real, whole = np.zeros((len(shapes), 25)), np.zeros((len(shapes), 5), np.int64)
    lower: list[Float32Array] = [np.zeros(0, np.float32)]
    upper: list[Float32Array] = [np.zeros(0, np.float32)]
    for row, (shape, T) in enumerate(zip(shapes, T_frame_body)):
        real[row, 3:15] = inverse(T)[:3].ravel()
        if isinstance(shape, Mesh) and not tabled[row]:
            used = np.asarray(shape.vertices, float)[np.unique(shape.faces)]
            whole[row, 0] = UNTABLED
            real[row, 19:] = (*used.min(axis=0), *used.max(axis=0))
        elif isinstance(shape, Mesh):
            field = mesh_field(shape, spacing=spacing, padding=padding, most_nodes=most_nodes)
            real[row, 15:] = (*field.origin, field.spacing, *field.lowest, *field.highest)
            whole[row] = (FIELD, *field.lower.shape, sum(map(len, lower)))
            lower.append(field.lower.ravel())
            upper.append(field.upper.ravel())
        else:
            whole[row, 0], real[row, :3] = primitive_code(shape)
    return DistanceTable(real, whole, np.concatenate(lower), np.concatenate(upper))


def primitive_code(shape: Box | Cylinder | Sphere | Capsule) -> tuple[int, tuple[float, float, float]]:
    """Return the code of a simple shape and its size as kernels take it."""
    match shape:
        case Box(size):
            return BOX, (0.5 * size[0], 0.5 * size[1], 0.5 * size[2])
        case Cylinder(radius, length):
            return CYLINDER, (radius, 0.5 * length, 0.0)
        case Sphere(radius):
            return SPHERE, (radius, 0.0, 0.0)
        case Capsule(radius, length):
            return CAPSULE, (radius, 0.5 * length, 0.0)


@numba.njit(cache=True, nogil=True, _nrt=False)
def primitive_distance(kind: int, a: float, b: float, c: float, x: float, y: float, z: float) -> float:
    """Return the exact signed distance in m of the point (x, y, z) in the body's frame to a simple shape."""
    if kind == SPHERE:
        return math.sqrt(x * x + y * y + z * z) - a
    if kind == CAPSULE:
        along = max(abs(z) - b, 0.0)
        return math.sqrt(x * x + y * y + along * along) - a
    if kind == CYLINDER:
        u, v, w = math.sqrt(x * x + y * y) - a, abs(z) - b, -1e300
    else:
        u, v, w = abs(x) - a, abs(y) - b, abs(z) - c
    out_u, out_v, out_w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
    return math.sqrt(out_u * out_u + out_v * out_v + out_w * out_w) + min(max(u, v, w), 0.0)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _in_body(real: FloatArray, body: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    # element by element: slices of arrays would be counted and uncounted, which costs more than the arithmetic
    return (
        real[body, 3] * x + real[body, 4] * y + real[body, 5] * z + real[body, 6],
        real[body, 7] * x + real[body, 8] * y + real[body, 9] * z + real[body, 10],
        real[body, 11] * x + real[body, 12] * y + real[body, 13] * z + real[body, 14],
    )


@numba.njit(cache=True, nogil=True, _nrt=False)
def _box_distance(real: FloatArray, body: int, x: float, y: float, z: float) -> float:
    """Return the distance in m of a point of the body's frame to the bounding box of a mesh, 0 inside."""
    out_x = max(real[body, 19] - x, x - real[body, 22], 0.0)
    out_y = max(real[body, 20] - y, y - real[body, 23], 0.0)
    out_z = max(real[body, 21] - z, z - real[body, 24], 0.0)
    return math.sqrt(out_x * out_x + out_y * out_y + out_z * out_z)


@numba.njit(cache=True, nogil=True, _nrt=False)
def outer_distance(real: FloatArray, whole: IntArray, body: int, x: float, y: float, z: float) -> float:
    """Return a quick lower bound in m of the signed distance to a body: exact, or that to a mesh's bounding box.

    Inside the box it is not known. The point is in the common frame; arrays of a `DistanceTable`.
    """
    x, y, z = _in_body(real, body, x, y, z)
    if whole[body, 0] >= FIELD:
        least = _box_distance(real, body, x, y, z)
        return least - _ROUNDING if least > 0.0 else -1e300
    return float(primitive_distance(whole[body, 0], real[body, 0], real[body, 1], real[body, 2], x, y, z))


@numba.njit(cache=True, nogil=True, _nrt=False)
def distance_bounds(
    real: FloatArray,
    whole: IntArray,
    lower: Float32Array,
    upper: Float32Array,
    body: int,
    x: float,
    y: float,
    z: float,
) -> tuple[float, float]:
    """Return a lower and an upper bound in m of the signed distance of a point (common frame) to one body.

    The first four arguments are those of a `DistanceTable`.
    """
    x, y, z = _in_body(real, body, x, y, z)
    if whole[body, 0] < FIELD:
        exact = primitive_distance(whole[body, 0], real[body, 0], real[body, 1], real[body, 2], x, y, z)
        return exact, exact
    # far outside, the bounding box of the mesh says more than the border of the grid
    outside = _box_distance(real, body, x, y, z)
    least, most = outside - _ROUNDING if outside > 0.0 else -1e300, 1e300
    if whole[body, 0] == FIELD:
        spacing = real[body, 18]
        u, v, w = (x - real[body, 15]) / spacing, (y - real[body, 16]) / spacing, (z - real[body, 17]) / spacing
        ny, nz = whole[body, 2], whole[body, 3]
        i = int(min(max(math.floor(u), 0), whole[body, 1] - 2))
        j = int(min(max(math.floor(v), 0), ny - 2))
        k = int(min(max(math.floor(w), 0), nz - 2))
        for corner in range(8):
            a, b, c = corner >> 2, (corner >> 1) & 1, corner & 1
            way = spacing * math.sqrt((u - i - a) ** 2 + (v - j - b) ** 2 + (w - k - c) ** 2)
            node = whole[body, 4] + ((i + a) * ny + j + b) * nz + k + c
            least = max(least, lower[node] - way)
            most = min(most, upper[node] + way)
    return least, most


@numba.njit(cache=True, nogil=True)
def primitive_distances(kind: int, size: FloatArray, points: FloatArray) -> FloatArray:
    """Return the signed distances (n,) in m of points (n, 3) in the body's frame to a simple shape."""
    out = np.empty(len(points))
    for row in range(len(points)):
        x, y, z = points[row]
        out[row] = primitive_distance(kind, size[0], size[1], size[2], x, y, z)
    return out
