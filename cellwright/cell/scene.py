"""Does the cell collide at a configuration? The planning scene: our kinematics and filter, coal's exact tests.

Real geometry is checked: primitives and convex meshes as solids, other meshes as triangle hierarchies. A body
inside a closed mesh counts as colliding with it, in either direction; an open mesh is a shell without inside.
A closed mesh whose faces all lie on its convex hull is taken as that hull.
The broad phase (`cellwright.cell.broad_phase`) leaves the engine a few pairs: about 10 us a check for the UR10e.

Verification has its own scene on another engine: `cellwright.cell.verification_scene`. A `Scene` keeps scratch
arrays and the engine's caches: use one a thread.
"""

from __future__ import annotations

import copy
import math
from functools import cached_property
from typing import Any

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.cell.bodies import BASE, WORLD, Body, Box, Capsule, Cylinder, Mesh, Sphere
from cellwright.cell.broad_phase import body_poses_into, bounds_of, near_pairs_at
from cellwright.cell.cell import Cell
from cellwright.cell.containment import ClosedMesh, closed_mesh, component_points

_ON_HULL = 1e-5
"""A mesh is convex if its faces lie no deeper than this (m) under its hull, which then stands for it."""
_TOUCHING = 1e-6
"""Bodies this close (m) touch. Asked for exactly 0 and no contacts, coal 3.0 overlooked overlaps of up to 0.4 mm
(its GJK stops early); with this margin and contacts none of 10^5 compared with FCL was missed."""
_MOST_HULL_FACES = 10_000
"""Larger meshes are not tried for convexity: they are scans or castings, and the trial takes long."""


class Scene:
    """Collision queries for one cell; configurations are (joints,) in rad.

    Attributes:
        cell: The cell.
        clearance_m: Bodies closer than this count as colliding.
        pairs: Pairs of rows of ``cell.bodies`` that are checked, (pairs, 2).
    """

    def __init__(self, cell: Cell, clearance_m: float = 0.0) -> None:
        import coal

        self.cell = cell
        self.clearance_m = float(clearance_m)
        self._margin = max(_TOUCHING, self.clearance_m)
        self._chain = cell.robot.chain
        bodies = cell.bodies
        n = len(bodies)
        self._parent = np.array([body.parent for body in bodies], np.int32)
        self._T_parent_body = np.array([body.T_parent_body for body in bodies], float).reshape(-1, 4, 4)
        self._T_world_base = np.ascontiguousarray(cell.T_world_base, float)
        self._bounds = bounds_of(bodies)
        self._solids = [_Solid(body) for body in bodies]
        self.pairs = checked_pairs(cell)
        self._links = np.empty((cell.robot.n_joints + 1, 4, 4))
        self._poses = np.empty((n, 4, 4))
        self._centres = np.empty((n, 3))
        self._near = np.empty(len(self.pairs), np.int32)
        self._queries: dict[int, Any] = {}
        self._request = coal.CollisionRequest()
        self._request.enable_contact = True
        self._result = coal.CollisionResult()
        self._Ta, self._Tb = coal.Transform3s(), coal.Transform3s()
        self._coal = coal

    def with_clearance(self, clearance_m: float) -> Scene:
        """Return a scene of the same cell with another clearance; the bodies are prepared once."""
        other = copy.copy(self)
        other.clearance_m = float(clearance_m)
        other._margin = max(_TOUCHING, other.clearance_m)
        other._links, other._poses = self._links.copy(), self._poses.copy()
        other._centres, other._near = self._centres.copy(), self._near.copy()
        other._queries = {}
        other._request, other._result = self._coal.CollisionRequest(), self._coal.CollisionResult()
        other._request.enable_contact = True
        other._Ta, other._Tb = self._coal.Transform3s(), self._coal.Transform3s()
        return other

    def collides(self, q: FloatArray) -> bool:
        """Whether any checked pair touches, or comes closer than the clearance."""
        return self._first_colliding(q) >= 0

    def colliding_pair(self, q: FloatArray) -> tuple[str, str] | None:
        """Return the names of a colliding pair, the first in the order of ``pairs``, or None."""
        pair = self._first_colliding(q)
        if pair < 0:
            return None
        a, b = self.pairs[pair]
        return self.cell.bodies[a].name, self.cell.bodies[b].name

    def colliding_pairs(self, q: FloatArray) -> list[tuple[int, int]]:
        """Return all colliding pairs as rows of ``cell.bodies``."""
        near = self._near_pairs(q, self._margin)
        return [(int(self.pairs[k, 0]), int(self.pairs[k, 1])) for k in near if self._pair_collides(k)]

    def collide_all(self, q: FloatArray) -> BoolArray:
        """Return whether each of many configurations (n, joints) collides, (n,)."""
        return np.array([self._first_colliding(row) >= 0 for row in np.ascontiguousarray(q, float)], bool)

    def first_colliding(self, q: FloatArray) -> int:
        """Return the first of many configurations (n, joints) that collides, -1 if none does."""
        rows = np.ascontiguousarray(q, float)
        return next((number for number, row in enumerate(rows) if self._first_colliding(row) >= 0), -1)

    def motion_collides(self, q_a: FloatArray, q_b: FloatArray, step: float) -> bool:
        """Whether the straight joint motion collides, tried every ``step`` rad of the fastest joint.

        Both ends are tried first, then halves, quarters and so on: a colliding motion is found early.
        """
        q_a, q_b = np.asarray(q_a, float), np.asarray(q_b, float)
        if self.collides(q_a) or self.collides(q_b):
            return True
        n_steps = max(1, math.ceil(float(np.abs(q_b - q_a).max()) / step - 1e-9))
        return any(self.collides(q_a + (k / n_steps) * (q_b - q_a)) for k in halving_order(n_steps))

    def distance(self, q: FloatArray) -> float:
        """Return the smallest distance in m over all checked pairs; 0 if one collides; inf without pairs.

        The clearance plays no part. Some 100 us: for reports and rough maps, not for inner loops.
        """
        coal = self._coal
        if not len(self.pairs):
            return math.inf
        for k in self._near_pairs(q, _TOUCHING):
            if self._pair_collides(k, _TOUCHING):
                return 0.0
        self._update_poses(q)
        at_least = self._gaps_between_balls()
        smallest = math.inf
        request = coal.DistanceRequest()
        for pair in np.argsort(at_least, kind="stable"):
            if at_least[pair] >= smallest:
                break
            result = coal.DistanceResult()
            one, other = self._place(int(pair))
            found = coal.distance(one.geometry, self._Ta, other.geometry, self._Tb, request, result)
            smallest = min(smallest, max(0.0, float(found)))
        return smallest

    @cached_property
    def pair_links(self) -> Int32Array:
        """Inner and outer link of each pair, (pairs, 2): joints ``inner`` to ``outer - 1`` move one against the other.

        What stands in the world counts as fixed to the base, link 0.
        """
        return np.sort(np.maximum(self._parent[self.pairs], BASE), axis=1).astype(np.int32)

    def pair_distances(self, q: FloatArray, within: float) -> FloatArray:
        """Return what separates each pair at least, (pairs,) in m; exact below ``within`` m, 0 where they collide.

        Above it the gap between the bounding balls, where that is already as large.
        """
        coal = self._coal
        near = set(self._near_pairs(q, _TOUCHING))
        self._update_poses(q)
        gaps = self._gaps_between_balls()
        request = coal.DistanceRequest()
        for pair in np.flatnonzero(gaps < within).tolist():
            one, other = self._place(pair)
            found = coal.distance(one.geometry, self._Ta, other.geometry, self._Tb, request, coal.DistanceResult())
            gaps[pair] = max(0.0, float(found))
            if pair in near and self._pair_collides(pair, _TOUCHING):
                gaps[pair] = 0.0
        return gaps

    def _update_poses(self, q: FloatArray) -> None:
        body_poses_into(
            self._chain.T_parent_joint,
            self._chain.axis,
            self._T_world_base,
            self._parent,
            self._T_parent_body,
            np.ascontiguousarray(q, float),
            self._links,
            self._poses,
        )

    def _gaps_between_balls(self) -> FloatArray:
        """Return by how much the bounding balls of each pair are apart at the poses of now, (pairs,)."""
        a, b = self.pairs[:, 0], self.pairs[:, 1]
        centres = np.einsum("nij,nj->ni", self._poses[:, :3, :3], self._bounds.centre) + self._poses[:, :3, 3]
        radius = self._bounds.radius
        return np.asarray(np.linalg.norm(centres[a] - centres[b], axis=1) - radius[a] - radius[b])

    def _near_pairs(self, q: FloatArray, margin: float) -> list[int]:
        count = near_pairs_at(
            self._chain.T_parent_joint,
            self._chain.axis,
            self._T_world_base,
            self._parent,
            self._T_parent_body,
            np.ascontiguousarray(q, float),
            self._links,
            self._poses,
            self._bounds.centre,
            self._bounds.half,
            self._bounds.radius,
            self.pairs,
            margin,
            self._centres,
            self._near,
        )
        near: list[int] = self._near[:count].tolist()
        return near

    def _first_colliding(self, q: FloatArray) -> int:
        for pair in self._near_pairs(q, self._margin):
            if self._pair_collides(pair):
                return pair
        return -1

    def _place(self, pair: int) -> tuple[_Solid, _Solid]:
        a, b = self.pairs[pair]
        T_a, T_b = self._poses[a], self._poses[b]
        self._Ta.setRotation(T_a[:3, :3])
        self._Ta.setTranslation(T_a[:3, 3])
        self._Tb.setRotation(T_b[:3, :3])
        self._Tb.setTranslation(T_b[:3, 3])
        return self._solids[a], self._solids[b]

    def _pair_collides(self, pair: int, margin: float | None = None) -> bool:
        one, other = self._place(pair)
        query = self._queries.get(pair)
        if query is None:
            query = self._queries[pair] = self._coal.ComputeCollision(one.geometry, other.geometry)
        self._request.security_margin = self._margin if margin is None else margin
        self._result.clear()
        if query(self._Ta, self._Tb, self._request, self._result):
            return True
        a, b = self.pairs[pair]
        return one.holds(other, self._poses[a], self._poses[b]) or other.holds(one, self._poses[b], self._poses[a])


def checked_pairs(cell: Cell) -> Int32Array:
    """Return the pairs of rows of ``cell.bodies`` to check, (pairs, 2).

    All but the ignored ones and pairs that never move against each other: on one parent, or both standing still, be
    it on the robot's base or in the world. What stands in one another is found by `cellwright.cell.standing_overlaps`.
    """
    ignored = {(min(a, b), max(a, b)) for a, b in np.asarray(cell.ignored_pairs).tolist()}
    parents = [body.parent for body in cell.bodies]
    pairs = [
        (a, b)
        for a in range(len(parents))
        for b in range(a + 1, len(parents))
        if parents[a] != parents[b] and max(parents[a], parents[b]) > BASE and (a, b) not in ignored
    ]
    # moving pairs that decide most often come first: arm against world, then the arm against itself
    pairs.sort(key=lambda pair: (WORLD not in (parents[pair[0]], parents[pair[1]]), -max(parents[k] for k in pair)))
    return np.array(pairs, np.int32).reshape(-1, 2)


def halving_order(n: int) -> list[int]:
    """Return 1 .. n-1 with halves first, then quarters, and so on.

    >>> halving_order(8)
    [4, 2, 6, 1, 3, 5, 7]
    """
    order: list[int] = []
    spans = [(0, n)]
    while spans:
        following: list[tuple[int, int]] = []
        for low, high in spans:
            if high - low > 1:
                middle = (low + high) // 2
                order.append(middle)
                following += [(low, middle), (middle, high)]
        spans = following
    return order


class _Solid:
    """A body as coal sees it, with what the containment test needs."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self._hull: tuple[FloatArray, Int32Array] | None = None
        self._closed: ClosedMesh | None = None
        if isinstance(body.shape, Mesh):
            self._closed = closed_mesh(body.shape)
            if self._closed is not None:
                self._hull = _convex_hull_of(self._closed)
        self.geometry = self._geometry()

    @cached_property
    def _points(self) -> FloatArray:
        """One point (n, 3) of each connected piece, in the body frame."""
        if isinstance(self.body.shape, Mesh):
            return component_points(self.body.shape)
        return np.zeros((1, 3))

    def holds(self, other: _Solid, T_world_self: FloatArray, T_world_other: FloatArray) -> bool:
        """Whether the other body, whose surface does not touch this one's, has a piece inside this closed mesh.

        Convex solids need no such test: the engine itself sees what is inside them.
        """
        if self._closed is None or self._hull is not None:
            return False
        R = T_world_self[:3, :3]
        for point in other._points:
            p_world = T_world_other[:3, :3] @ point + T_world_other[:3, 3]
            if self._closed.contains((p_world - T_world_self[:3, 3]) @ R):
                return True
        return False

    def _geometry(self) -> Any:
        import coal

        match self.body.shape:
            case Box(size):
                return coal.Box(*size)
            case Cylinder(radius, length):
                return coal.Cylinder(radius, length)
            case Sphere(radius):
                return coal.Sphere(radius)
            case Capsule(radius, length):
                return coal.Capsule(radius, length)
            case Mesh(vertices, faces):
                if self._hull is not None:
                    corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
                    corners.extend(list(self._hull[0]))
                    triangles.extend([coal.Triangle(*row) for row in self._hull[1].tolist()])
                    return coal.Convex(corners, triangles)
                model = coal.BVHModelOBBRSS()
                model.beginModel(len(faces), len(vertices))
                model.addVertices(np.ascontiguousarray(vertices, float))
                model.addTriangles(np.ascontiguousarray(faces, np.int64))
                model.endModel()
                return model


def _convex_hull_of(mesh: ClosedMesh) -> tuple[FloatArray, Int32Array] | None:
    """Return the mesh's convex hull, outward triangles, if all its faces lie on it; else None."""
    from scipy.spatial import ConvexHull, QhullError

    if len(mesh.faces) > _MOST_HULL_FACES:
        return None
    try:
        hull = ConvexHull(mesh.vertices)
    except QhullError:  # flat
        return None
    planes = np.unique(hull.equations.round(9), axis=0)
    for rows in np.array_split(mesh.vertices[mesh.faces].mean(axis=1), 1 + len(mesh.faces) // 200):
        depth = -(rows @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        if depth.max() > _ON_HULL:
            return None
    used, row = np.unique(hull.simplices, return_inverse=True)
    points, triangles = mesh.vertices[used], row.reshape(-1, 3).astype(np.int32)
    normals = np.cross(
        points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    )
    inward = np.einsum("fi,fi->f", normals, hull.equations[:, :3]) < 0.0
    triangles[inward] = triangles[inward, ::-1]
    return points, triangles
