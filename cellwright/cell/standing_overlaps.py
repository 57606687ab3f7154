"""Which bodies that stand still stand in one another, and how deep? Scenes check only pairs that can move.

Whether two bodies meet says the engine of verification. How deep is bounded from below by what would have to give way:

- a point that both bodies hold and that lies ``d`` under the surface of one keeps them from coming apart by any move
  shorter than ``d``. Points tried: those of both surfaces and a grid in the region that both could fill, refined about
  the deepest;
- two triangles that cross come apart by no move shorter than their own penetration, which their separating axes give
  exactly. That speaks for meshes without an inside.

So a depth is proven but may be larger, notably where two finely meshed open shells cross. Some 20 ms a pair that meets.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.cell.bodies import BASE, WORLD, Body, Mesh
from cellwright.cell.cell import Cell
from cellwright.cell.containment import closed_mesh, inside_all
from cellwright.cell.distance_field import primitive_code, primitive_distances
from cellwright.cell.tessellation import triangles_of
from cellwright.cell.transforms import apply, inverse
from cellwright.cell.verification_scene import Skin, VerificationScene

RESTING = 1e-3
"""Bodies that stand this deep in one another (m) rest on each other: models and placements are no better."""
_GRID = 12
"""Points along each edge of the region that both bodies could fill."""
_EDGES = 24
"""Surfaces are cut into triangles with edges of at most this part of the body's size."""
_MOST_POINTS = 4000
_MOST_MEASURED = 200
_MOST_CONTACTS = 2000
_ROUNDS = 5


@dataclass(frozen=True)
class Overlap:
    """Two bodies that stand in one another; they come apart by no move shorter than ``depth`` m."""

    body: str
    other: str
    depth: float


def standing_pairs(cell: Cell, permitted: Collection[tuple[int, int]] = ()) -> IntArray:
    """Return pairs of rows of bodies that stand still in the world or on the robot's base, (pairs, 2).

    Pairs on the base are the robot's own affair; ``permitted`` pairs are left out too.
    """
    harmless = {(min(a, b), max(a, b)) for a, b in permitted}
    stands = [row for row, body in enumerate(cell.bodies) if body.parent <= BASE]
    pairs = [
        (a, b)
        for a in stands
        for b in stands
        if a < b and WORLD in (cell.bodies[a].parent, cell.bodies[b].parent) and (a, b) not in harmless
    ]
    return np.array(pairs, np.int64).reshape(-1, 2)


def standing_overlaps(
    cell: Cell, *, resting: float = RESTING, permitted: Collection[tuple[int, int]] = ()
) -> tuple[list[Overlap], str]:
    """Return the standing bodies that are more than ``resting`` m in one another, and the engine that says so.

    They come in the order of the bodies, the later body of each pair first: the part before what it stands in.
    ``permitted``: pairs of rows that may be.
    """
    scene = VerificationScene(cell, standing_pairs(cell, permitted))
    found: list[Overlap] = []
    for a, b in scene.colliding_pairs(cell.start):
        one, other = (_Standing(cell.bodies[row], scene.skins[row], cell.T_world_base) for row in (a, b))
        depth = _common_depth(one, other)
        if depth <= resting:
            depth = max(depth, _crossing_depth(one, other))
        if depth > resting:
            found.append(Overlap(cell.bodies[b].name, cell.bodies[a].name, depth))
    return found, scene.engine


class _Standing:
    """A body where it stands, with what the depth of points in it needs."""

    def __init__(self, body: Body, skin: Skin, T_world_base: FloatArray) -> None:
        import fcl
        import trimesh

        self.shape, self.skin = body.shape, skin
        self.T_world_body = body.T_parent_body if body.parent == WORLD else T_world_base @ body.T_parent_body
        self.T_body_world = inverse(self.T_world_body)
        self.closed = closed_mesh(body.shape) if isinstance(body.shape, Mesh) else None
        self.has_inside = self.closed is not None or not isinstance(body.shape, Mesh)
        vertices, faces = triangles_of(body.shape)
        longest = max(float(np.linalg.norm(np.ptp(vertices[faces].reshape(-1, 3), axis=0))) / _EDGES, 1e-9)
        corners, _ = trimesh.remesh.subdivide_to_size(vertices, faces, longest, max_iter=40)
        self.p_body = np.unique(corners, axis=0)  # points of the surface
        self.p_world = apply(self.T_world_body, self.p_body)
        self.low, self.high = self.p_world.min(axis=0), self.p_world.max(axis=0)
        self.placed = fcl.CollisionObject(skin.geometry, fcl.Transform())

    def holds(self, p_world: FloatArray) -> BoolArray:
        """Whether each point (n, 3) lies inside, (n,)."""
        points = apply(self.T_body_world, p_world)
        if self.closed is not None:
            return inside_all(points, self.closed)
        return self.has_inside & (self._distances(points) <= 0.0) if self.has_inside else np.zeros(len(points), bool)

    def deepest(self, p_world: FloatArray) -> tuple[float, FloatArray]:
        """Return how far under the surface the deepest of some points (n, 3) lies, all of them inside, and the point.

        In a mesh the exact distance of the most promising ones is measured, so that a deeper one may be overlooked.
        """
        points = apply(self.T_body_world, p_world)
        if self.closed is None:
            depth = -self._distances(points)
            row = int(np.argmax(depth))
            return float(depth[row]), p_world[row]
        from scipy.spatial import KDTree

        at_most, _ = KDTree(self.p_body).query(points)
        best, best_row = -1.0, 0
        for row in np.argsort(-at_most, kind="stable")[:_MOST_MEASURED].tolist():
            if at_most[row] <= best:
                break
            depth_here = self._from_surface(points[row])
            if depth_here > best:
                best, best_row = depth_here, row
        return best, p_world[best_row]

    def _distances(self, points: FloatArray) -> FloatArray:
        """Return signed distances to a simple shape."""
        if isinstance(self.shape, Mesh):
            raise TypeError("a mesh is no simple shape")
        kind, size = primitive_code(self.shape)
        return np.asarray(primitive_distances(kind, np.array(size), np.ascontiguousarray(points)))

    def _from_surface(self, point: FloatArray) -> float:
        import fcl

        dot = fcl.CollisionObject(fcl.Sphere(1e-9), fcl.Transform(point))
        return max(0.0, float(fcl.distance(self.placed, dot, fcl.DistanceRequest(), fcl.DistanceResult())))


def _common_depth(one: _Standing, other: _Standing) -> float:
    """Return how deep the deepest point found that both bodies hold lies under the surface of one of them."""
    low, high = np.maximum(one.low, other.low), np.minimum(one.high, other.high)
    if (low > high).any():
        return 0.0
    step = (high - low) / _GRID
    grid = low + step * (np.stack(np.meshgrid(*3 * [np.arange(_GRID)], indexing="ij"), axis=-1).reshape(-1, 3) + 0.5)
    pool = [grid[one.holds(grid) & other.holds(grid)]]
    for body, peer in ((one, other), (other, one)):
        within = body.p_world[((body.p_world >= low - 1e-9) & (body.p_world <= high + 1e-9)).all(axis=1)]
        within = within[:: max(1, -(-len(within) // _MOST_POINTS))]
        pool.append(within[peer.holds(within)])
    best, point = _deepest(one, other, np.concatenate(pool))
    if not (one.has_inside and other.has_inside):
        return best
    around = np.stack(np.meshgrid(*3 * [np.linspace(-1.0, 1.0, 5)], indexing="ij"), axis=-1).reshape(-1, 3)
    for _ in range(_ROUNDS):
        near = point + step * around
        near = near[one.holds(near) & other.holds(near)]
        deeper, candidate = _deepest(one, other, near)
        if deeper > best:
            best, point = deeper, candidate
        step = step / 2.0
    return best


def _deepest(one: _Standing, other: _Standing, points: FloatArray) -> tuple[float, FloatArray]:
    found = [body.deepest(points) for body in (one, other) if body.has_inside and len(points)]
    return max(found, key=lambda item: item[0], default=(0.0, np.zeros(3)))


def _crossing_depth(one: _Standing, other: _Standing) -> float:
    """Return the deepest penetration of two triangles of two meshes; 0 for other shapes."""
    import fcl

    if one.skin.corners is None or other.skin.corners is None:
        return 0.0
    T = one.T_body_world @ other.T_world_body
    placed = fcl.CollisionObject(other.skin.geometry, fcl.Transform(T[:3, :3], T[:3, 3]))
    result: Any = fcl.CollisionResult()
    fcl.collide(one.placed, placed, fcl.CollisionRequest(num_max_contacts=_MOST_CONTACTS, enable_contact=True), result)
    if not result.contacts:
        return 0.0
    rows = np.array([(contact.b1, contact.b2) for contact in result.contacts])
    return float(triangle_penetration(one.skin.corners[rows[:, 0]], apply(T, other.skin.corners[rows[:, 1]])).max())


def triangle_penetration(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return by how little pairs of triangles (n, 3, 3) must be moved to come apart, (n,) in m; 0 if they are.

    The Minkowski difference of two triangles is a polytope whose faces stand on the triangles' normals or on the
    products of their edges: the least overlap along these directions is the distance of the origin to its surface.
    """
    edges, others = np.roll(one, -1, axis=1) - one, np.roll(other, -1, axis=1) - other
    axes = np.concatenate(
        [
            np.cross(edges[:, :1], edges[:, 1:2]),
            np.cross(others[:, :1], others[:, 1:2]),
            np.cross(edges[:, :, None], others[:, None]).reshape(len(one), 9, 3),
        ],
        axis=1,
    )  # (n, 11, 3)
    length = np.linalg.norm(axes, axis=2)
    scale = np.linalg.norm(edges, axis=2).max(axis=1) * np.linalg.norm(others, axis=2).max(axis=1)
    usable = length > 1e-9 * np.maximum(scale, 1e-300)[:, None]
    unit = axes / np.where(usable, length, 1.0)[:, :, None]
    p, q = np.einsum("nij,nkj->nik", one, unit), np.einsum("nij,nkj->nik", other, unit)
    apart = np.minimum(p.max(axis=1) - q.min(axis=1), q.max(axis=1) - p.min(axis=1))
    return np.asarray(np.maximum(np.where(usable, apart, np.inf).min(axis=1), 0.0))
