"""A mesh made ready for fitting spheres: centred, scaled to a diagonal of 1, sampled, and asked for its inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray
from cellwright.cell.bodies import Mesh
from cellwright.cell.bounding_volumes import TriangleTree, build_tree
from cellwright.cell.containment import ClosedMesh, closed_mesh, inside_all
from cellwright.cell.distance_field import grid_nodes
from cellwright.cell.solid_grid import SolidGrid, enclosed_volume, is_one_closed_shell, solid_grid
from cellwright.cell.surface_distance import distances
from cellwright.cell.surface_sampling import sample_randomly
from cellwright.errors import InvalidInputError

_MOST_CORNERS = 3000
_MOST_INNER = 2000
_MOST_PIECES = 16
"""Meshes of more pieces are taken as they are: each piece is asked for on its own."""
_FARTHEST = 1e6
"""A mesh further from its origin than so many times its size has lost its shape to rounding."""
_MARGIN, _MOST_MARGIN = 1e-6, 1e-3
"""Share of the diagonal, or of the furthest coordinate if that is more; single precision rounds at 6e-8 of it. Bodies
more than a thousand diagonals from their origin lose more than hulls can be grown by for nothing."""


@dataclass(frozen=True, eq=False)
class SphereBody:
    """A mesh in units of its own diagonal, about its middle.

    Attributes:
        middle: Middle of the mesh's box, (3,) in m.
        unit: Its diagonal in m.
        triangles: Corners, (faces, 3, 3).
        tree: For distances, without pieces that lie well inside of others.
        grid: For what is outside.
        shell: The surface if it is one closed shell, else ``None``.
        core: Grid nodes well inside, (n, 3).
        volume: That the hull is measured by.
        volume_kind: What it is of: ``enclosed`` or ``convex``.
        margin: Spheres hold the body with radii smaller by this: more than single precision rounds by.
    """

    middle: FloatArray
    unit: float
    triangles: FloatArray
    tree: TriangleTree
    grid: SolidGrid
    shell: ClosedMesh | None
    core: FloatArray
    volume: float
    volume_kind: str
    margin: float

    @property
    def encloses(self) -> bool:
        """Whether there is an inside to cover."""
        return self.shell is not None or len(self.core) > 0

    def contains(self, points: FloatArray) -> BoolArray:
        """Tell which points (n, 3) are inside; near a surface that is not one closed shell, ``False``."""
        if self.shell is not None:
            return inside_all(np.ascontiguousarray(points), self.shell)
        grid = self.grid
        node = np.rint((points - grid.origin) / grid.spacing).astype(np.int64)
        within = ((node >= 0) & (node < grid.outside.shape)).all(axis=1)
        i, j, k = np.clip(node, 0, np.array(grid.outside.shape) - 1).T
        # the surface stays further from such a node than the point is
        return np.asarray(within & ~grid.outside[i, j, k] & ~grid.near[i, j, k])

    def surface_points(self, n_points: int, generator: np.random.Generator) -> FloatArray:
        """Draw points on the surface, beside its corners, (n, 3)."""
        corners = _some(np.unique(self.triangles.reshape(-1, 3), axis=0), _MOST_CORNERS, generator)
        return np.concatenate([sample_randomly(self.triangles, n_points, generator).points, corners])

    def inner_points(self, generator: np.random.Generator) -> FloatArray:
        """Draw from the nodes well inside, (n, 3); a body without any gives none."""
        return _some(self.core, _MOST_INNER, generator)


def sphere_body(mesh: Mesh) -> SphereBody:
    """Make a mesh ready.

    Raises:
        InvalidInputError: If it has no triangles, no extent, numbers that are not finite, or lies so far from its
            origin that rounding has eaten its shape.
    """
    faces = np.asarray(mesh.faces, np.int64)
    if not len(faces):
        raise InvalidInputError("the mesh has no triangles: no spheres can be fitted to it")
    points = np.asarray(mesh.vertices, np.float64)[np.unique(faces)]
    if not np.isfinite(points).all():
        raise InvalidInputError(
            f"{np.count_nonzero(~np.isfinite(points).all(axis=1))} of {len(points)} vertices of the mesh are not "
            "finite: export it again"
        )
    lowest, highest = points.min(axis=0), points.max(axis=0)
    middle, unit = 0.5 * (lowest + highest), float(np.linalg.norm(highest - lowest))
    if unit == 0.0:
        raise InvalidInputError("all vertices of the mesh are one point: it has no extent that spheres could cover")
    if np.abs(middle).max() > _FARTHEST * unit:
        raise InvalidInputError(
            f"the mesh is {unit:.3g} m across but lies {np.abs(middle).max():.3g} m from its origin, too far for "
            "double precision: move it to its origin"
        )
    scaled = Mesh((np.asarray(mesh.vertices, np.float64) - middle) / unit, np.ascontiguousarray(faces, np.int32))
    grid = solid_grid(scaled)
    shell = closed_mesh(scaled) if is_one_closed_shell(scaled) else None
    enclosed = enclosed_volume(scaled)
    return SphereBody(
        middle,
        unit,
        np.ascontiguousarray(scaled.vertices[faces]),
        build_tree(scaled.vertices, scaled.faces[_outer_faces(scaled, grid)]),
        grid,
        shell,
        grid.core(),
        enclosed.volume,
        enclosed.kind,
        min(_MARGIN * max(1.0, float(np.abs([lowest, highest]).max()) / unit), _MOST_MARGIN),
    )


def _outer_faces(mesh: Mesh, grid: SolidGrid) -> BoolArray:
    """Tell which faces (m,) belong to pieces that come near the rim of what the flood has reached.

    The way out from inside crosses the surface near a rim node, so it crosses no piece that is near none of them.
    """
    from scipy import ndimage
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    _, row = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corners = row.reshape(-1)[mesh.faces]
    ends = np.concatenate([corners[:, :2], corners[:, 1:]])
    graph = coo_array((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(row.max() + 1,) * 2)
    piece = connected_components(graph, directed=False)[1][corners[:, 0]]
    outer = np.ones(len(corners), bool)
    pieces = np.unique(piece)
    if not 1 < len(pieces) <= _MOST_PIECES:
        return outer
    rim = grid.near & ndimage.binary_dilation(grid.outside, np.ones((3, 3, 3), bool))
    nodes = grid_nodes(grid.origin, grid.spacing, rim.shape)[rim.ravel()]
    for number in pieces:
        own = piece == number
        away = distances(build_tree(mesh.vertices, mesh.faces[own]), nodes)
        outer[own] = away.min() <= grid.spacing
    return outer if outer.any() else np.ones(len(corners), bool)


def _some(points: FloatArray, most: int, generator: np.random.Generator) -> FloatArray:
    if len(points) <= most:
        return points
    return points[np.sort(generator.choice(len(points), most, replace=False))]
