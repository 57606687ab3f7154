"""What a mesh encloses, on a grid that is flooded from outside: which places are certainly outside, and the volume.

A node is near if the surface comes within half the diagonal of a grid cell. A cell without near nodes is not crossed
by the surface, however small or broken that is, so whatever the flood reaches through nodes that are not near is
outside for certain. What it does not reach counts as enclosed: cavities, bores narrower than two cells, the inside of
a mesh whose cracks are narrower than that. Orientation of faces, overlaps and shells in shells do not matter.

Cost: 20 to 80 ms for 60,000 nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.cell.bodies import Mesh
from cellwright.cell.containment import component_points, weld
from cellwright.cell.distance_field import grid_nodes
from cellwright.cell.mesh_topology import is_closed_and_oriented
from cellwright.cell.surface_distance import triangle_way

NODES = 60_000
"""Nodes of the grid: about 40 along the edge of a compact body."""
VOLUME_NODES = 250_000
_HALF_DIAGONAL = 0.5 * math.sqrt(3.0)
_ROUNDING = 1.0 + 1e-9
_THIN = 0.05
"""Extents count as at least this share of the longest one, so that flat meshes get a grid too."""


@dataclass(frozen=True, eq=False)
class SolidGrid:
    """A flooded grid about a mesh.

    Attributes:
        origin: The first node, (3,) in m.
        spacing: Distance of neighbouring nodes in m.
        outside: Whether a node is certainly outside: the flood has reached it, (nx, ny, nz).
        near: Whether the surface may cross a cell at the node, (nx, ny, nz).
        clearance: From each node to the nearest one that is not outside, in m, (nx, ny, nz).
    """

    origin: FloatArray
    spacing: float
    outside: BoolArray
    near: BoolArray
    clearance: FloatArray

    def core(self) -> FloatArray:
        """Return the nodes that are enclosed and not near the surface, (n, 3) in m."""
        inside = ~self.outside & ~self.near
        return grid_nodes(self.origin, self.spacing, inside.shape)[inside.ravel()]


def solid_grid(mesh: Mesh, n_nodes: int = NODES) -> SolidGrid:
    """Flood a grid of about ``n_nodes`` nodes about a mesh."""
    from scipy import ndimage

    origin, spacing, near = _near(mesh, n_nodes, _HALF_DIAGONAL)
    outside = _flooded(near)
    clearance = spacing * np.asarray(ndimage.distance_transform_edt(outside))
    return SolidGrid(origin, spacing, outside, near, clearance)


@dataclass(frozen=True)
class EnclosedVolume:
    """A reference volume in m^3; ``kind``: within the outer surface, or of the convex hull of an open mesh."""

    volume: float
    kind: Literal["enclosed", "convex"]


def is_one_closed_shell(mesh: Mesh) -> bool:
    """Tell whether a mesh is a single closed manifold: then inside and outside are what a ray's parity says."""
    _, faces = weld(mesh)
    return is_closed_and_oriented(faces) and len(component_points(mesh)) == 1


def enclosed_volume(mesh: Mesh) -> EnclosedVolume:
    """Return the volume within the outer surface of a mesh.

    A single closed shell has it exactly, by the divergence theorem. Several shells (overlapping or nested) and meshes
    with cracks get it from a flooded grid, where nodes within half a spacing of the surface count half: right to about
    1 % for bodies that are 30 nodes across. Closed meshes too thin for that get the sum over their shells. A mesh that
    encloses nothing gets the volume of its convex hull, or of its box where it is flat.
    """
    from scipy import ndimage

    vertices, faces = weld(mesh)
    used = vertices[np.unique(faces)]
    middle = 0.5 * (used.min(axis=0) + used.max(axis=0))
    a, b, c = ((vertices - middle)[faces[:, k]] for k in range(3))
    signed = abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6.0
    closed = is_closed_and_oriented(faces)
    hull, tiny = _convex_volume(used), 1e-9 * float(np.ptp(used, axis=0).max()) ** 3
    if closed and len(component_points(mesh)) == 1 and signed > tiny:
        return EnclosedVolume(signed, "enclosed")
    _, spacing, near = _near(mesh, VOLUME_NODES, 0.5)
    outside = _flooded(near)
    # walls inside the body count in full: only those with outside beside them are its surface
    rim = near & ndimage.binary_dilation(outside, np.ones((3, 3, 3), bool))
    n_rim, n_enclosed = int(np.count_nonzero(rim)), int(np.count_nonzero(~outside & ~rim))
    if np.count_nonzero(~outside & ~near) > 0.1 * n_rim:
        return EnclosedVolume(float(min((n_enclosed + 0.5 * n_rim) * spacing**3, hull)), "enclosed")
    if closed and signed > tiny:
        return EnclosedVolume(min(signed, hull), "enclosed")
    return EnclosedVolume(hull, "convex")


def _convex_volume(vertices: FloatArray) -> float:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(vertices).volume)
    except QhullError:
        # flat: a slab of a thousandth of its size, so that ratios to it stay finite
        extent = np.ptp(vertices, axis=0)
        return float(np.maximum(extent, 1e-3 * extent.max()).prod())


def _near(mesh: Mesh, n_nodes: int, reach: float) -> tuple[FloatArray, float, BoolArray]:
    """Return first node, spacing and which nodes the surface comes within ``reach`` spacings of."""
    vertices = np.asarray(mesh.vertices, np.float64)
    used = vertices[np.unique(mesh.faces)]
    lowest, highest = used.min(axis=0), used.max(axis=0)
    extent = highest - lowest
    spacing = float((np.maximum(extent, _THIN * extent.max()).prod() / n_nodes) ** (1.0 / 3.0))
    shape = np.ceil(extent / spacing).astype(np.int64) + 5
    origin = 0.5 * (lowest + highest) - 0.5 * spacing * (shape - 1)
    triangles = np.ascontiguousarray(vertices[mesh.faces].reshape(-1, 9))
    return origin, spacing, _near_nodes(triangles, origin, spacing, shape, reach * spacing * _ROUNDING)


def _flooded(near: BoolArray) -> BoolArray:
    from scipy import ndimage

    labels, _ = ndimage.label(~near)
    return np.asarray(labels == labels[0, 0, 0])


@numba.njit(cache=True, nogil=True)
def _near_nodes(triangles: FloatArray, origin: FloatArray, spacing: float, shape: IntArray, reach: float) -> BoolArray:
    near = np.zeros((shape[0], shape[1], shape[2]), np.bool_)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for face in range(len(triangles)):
        for k in range(3):
            least = min(triangles[face, k], triangles[face, 3 + k], triangles[face, 6 + k]) - reach - origin[k]
            most = max(triangles[face, k], triangles[face, 3 + k], triangles[face, 6 + k]) + reach - origin[k]
            low[k] = max(0, math.ceil(least / spacing))
            high[k] = min(shape[k] - 1, math.floor(most / spacing))
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    if not near[i, j, k]:
                        x, y, z = origin[0] + spacing * i, origin[1] + spacing * j, origin[2] + spacing * k
                        near[i, j, k] = triangle_way(triangles, face, x, y, z) <= reach * reach
    return near
