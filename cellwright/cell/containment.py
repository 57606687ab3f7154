"""Is a point inside a closed mesh? Collision engines see a mesh as a skin, so this has to be asked apart.

Parity of crossings of a vertical ray with the triangles, which a grid in the xy plane narrows down to a few. The
crossing rule is half-open and every shared edge is evaluated from the same end, so no ray slips between two
triangles or is counted twice. Points on the surface may fall either way. Under 1 us a point, for most meshes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array, IntArray
from cellwright.cell.bodies import Mesh
from cellwright.cell.mesh_topology import is_closed

_MOST_CELLS = 512
"""Grid cells along an axis at most: memory for large meshes stays within a few megabytes."""


@dataclass(frozen=True, eq=False)
class ClosedMesh:
    """A closed mesh with its grid; make it by `closed_mesh`.

    Attributes:
        vertices: Welded vertices (n, 3) in m.
        faces: Triangles (m, 3), in the order of vertices that the crossing rule needs (any orientation).
        low: Smallest x and y of the grid, (2,).
        cell: Edge lengths of a grid cell, (2,).
        shape: Cells along x and y, (2,).
        first: Where each cell's triangles begin in ``listed``, (cells + 1,).
        listed: Triangles by cell.
    """

    vertices: FloatArray
    faces: IntArray
    low: FloatArray
    cell: FloatArray
    shape: IntArray
    first: IntArray
    listed: Int32Array

    def contains(self, point: FloatArray) -> bool:
        """Whether a point (3,) of the mesh's frame lies inside."""
        return bool(
            inside(
                np.ascontiguousarray(point, float),
                self.vertices,
                self.faces,
                self.low,
                self.cell,
                self.shape,
                self.first,
                self.listed,
            )
        )


def closed_mesh(mesh: Mesh) -> ClosedMesh | None:
    """Return the mesh prepared for containment tests, or None if it is open: then it is a shell without inside."""
    vertices, faces = weld(mesh)
    if not len(faces) or not is_closed(faces):
        return None
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    cells = min(_MOST_CELLS, max(1, math.ceil(math.sqrt(len(faces)))))
    shape = np.array([cells, cells], np.int64)
    cell = np.maximum((high - low) / cells, 1e-12)
    corners = vertices[faces][:, :, :2]  # (faces, 3, 2)
    first_cell = np.clip(np.floor((corners.min(axis=1) - low) / cell).astype(np.int64), 0, cells - 1)
    last_cell = np.clip(np.floor((corners.max(axis=1) - low) / cell).astype(np.int64), 0, cells - 1)
    first, listed = _bin(first_cell, last_cell, cells)
    return ClosedMesh(vertices, faces, low, cell, shape, first, listed)


def weld(mesh: Mesh) -> tuple[FloatArray, IntArray]:
    """Return vertices without doubles (equal coordinates) and faces without those that collapse."""
    vertices, row = np.unique(np.asarray(mesh.vertices, float), axis=0, return_inverse=True)
    faces = row.reshape(-1)[np.asarray(mesh.faces, np.int64)].reshape(-1, 3)
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return np.ascontiguousarray(vertices), np.ascontiguousarray(faces[proper], np.int64)


def component_points(mesh: Mesh) -> FloatArray:
    """Return one vertex (n, 3) of each connected piece of a mesh."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    vertices, faces = weld(mesh)
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(vertices), len(vertices)))
    _, label = connected_components(graph, directed=False)
    used = np.unique(faces)
    _, where = np.unique(label[used], return_index=True)
    return vertices[used[where]]


@numba.njit(cache=True, nogil=True)
def _bin(first_cell: IntArray, last_cell: IntArray, cells: int) -> tuple[IntArray, Int32Array]:
    first = np.zeros(cells * cells + 1, np.int64)
    for face in range(len(first_cell)):
        for i in range(first_cell[face, 0], last_cell[face, 0] + 1):
            for j in range(first_cell[face, 1], last_cell[face, 1] + 1):
                first[i * cells + j + 1] += 1
    for k in range(cells * cells):
        first[k + 1] += first[k]
    filled = first[:-1].copy()
    listed = np.empty(first[-1], np.int32)
    for face in range(len(first_cell)):
        for i in range(first_cell[face, 0], last_cell[face, 0] + 1):
            for j in range(first_cell[face, 1], last_cell[face, 1] + 1):
                listed[filled[i * cells + j]] = face
                filled[i * cells + j] += 1
    return first, listed


@numba.njit(cache=True, nogil=True)
def _crosses(vertices: FloatArray, one: int, other: int, x: float, y: float) -> bool:
    """Whether the ray from (x, y) along +x crosses the edge, evaluated from its lower vertex number."""
    a, b = min(one, other), max(one, other)
    ya, yb = vertices[a, 1], vertices[b, 1]
    if (ya > y) == (yb > y):
        return False
    return bool(x < vertices[a, 0] + (y - ya) * (vertices[b, 0] - vertices[a, 0]) / (yb - ya))


@numba.njit(cache=True, nogil=True)
def inside(
    point: FloatArray,
    vertices: FloatArray,
    faces: IntArray,
    low: FloatArray,
    cell: FloatArray,
    shape: IntArray,
    first: IntArray,
    listed: Int32Array,
) -> bool:
    """Whether a point lies inside; the arguments are the fields of `ClosedMesh`."""
    i, j = math.floor((point[0] - low[0]) / cell[0]), math.floor((point[1] - low[1]) / cell[1])
    # a point on the far rim belongs to the last cell
    i, j = (i - 1 if i == shape[0] else i), (j - 1 if j == shape[1] else j)
    if i < 0 or j < 0 or i >= shape[0] or j >= shape[1]:
        return False
    crossings = 0
    x, y, z = point[0], point[1], point[2]
    for k in range(first[i * shape[1] + j], first[i * shape[1] + j + 1]):
        a, b, c = faces[listed[k], 0], faces[listed[k], 1], faces[listed[k], 2]
        hit = _crosses(vertices, a, b, x, y) != _crosses(vertices, b, c, x, y)
        if hit == _crosses(vertices, c, a, x, y):
            continue
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        area = ux * vy - uy * vx
        if area == 0.0:
            continue
        dx, dy = x - vertices[a, 0], y - vertices[a, 1]
        s, t = (dx * vy - dy * vx) / area, (ux * dy - uy * dx) / area
        if vertices[a, 2] + s * uz + t * vz > z:
            crossings += 1
    return crossings % 2 == 1


def inside_all(points: FloatArray, mesh: ClosedMesh) -> BoolArray:
    """Return whether each of many points (n, 3) of the mesh's frame lies inside, (n,)."""
    found = np.empty(len(points), np.bool_)
    arrays = (mesh.vertices, mesh.faces, mesh.low, mesh.cell, mesh.shape, mesh.first, mesh.listed)
    _inside_all(np.ascontiguousarray(points, float), *arrays, found)
    return found


@numba.njit(cache=True, nogil=True)
def _inside_all(
    points: FloatArray,
    vertices: FloatArray,
    faces: IntArray,
    low: FloatArray,
    cell: FloatArray,
    shape: IntArray,
    first: IntArray,
    listed: Int32Array,
    found: BoolArray,
) -> None:
    for row in range(len(points)):
        found[row] = inside(points[row], vertices, faces, low, cell, shape, first, listed)
