"""A second opinion on collisions: the planning scene's questions, answered by other code on another engine.

Nothing is shared with `cellwright.cell.scene` but the cell itself: kinematics come from pinocchio, the exact tests
from FCL (Pan, Chitta, Manocha 2012), closedness from trimesh, containment from winding numbers (van Oosterom and
Strackee 1983), so that one mistake cannot bless itself. Every mesh stays the triangles that it is. Some 100 us a
configuration; one scene a thread.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.cell.bodies import BASE, WORLD, Body, Box, Capsule, Cylinder, Mesh, Sphere
from cellwright.cell.cell import Cell


class VerificationScene:
    """Collision queries for one cell by FCL; configurations are (joints,) in rad.

    Attributes:
        cell: The cell.
        pairs: Pairs of rows of ``cell.bodies`` that are checked, (pairs, 2), lower row first: all that can move
            against each other and are not ignored, if left out.
        spheres: Centres (bodies, 3) in the bodies' frames and radii (bodies,) in m of spheres around them.
        engine: Name and version of the engine.
    """

    def __init__(self, cell: Cell, pairs: IntArray | None = None) -> None:
        import fcl
        import pinocchio

        self.cell = cell
        self.engine = f"FCL (python-fcl {fcl.__version__})"
        self._fcl, self._pinocchio = fcl, pinocchio
        self._model = cell.robot.model
        self._data = self._model.createData()
        self.skins = [Skin(body) for body in cell.bodies]
        self._objects = [fcl.CollisionObject(skin.geometry, fcl.Transform()) for skin in self.skins]
        self._parents = np.array([body.parent for body in cell.bodies], np.int64)
        self._T_parent_body = np.array([body.T_parent_body for body in cell.bodies], float).reshape(-1, 4, 4)
        self.pairs = self._checked_pairs() if pairs is None else pairs
        self._centre = np.array([skin.centre for skin in self.skins]).reshape(-1, 3)
        self._radius = np.array([skin.radius for skin in self.skins])
        self.spheres = self._centre, self._radius
        self._can_hold = self._nestable()

    def collides(self, q: FloatArray) -> bool:
        """Whether any checked pair touches or one body is inside another."""
        return self.collision(q) is not None

    def collision(self, q: FloatArray) -> tuple[str, str] | None:
        """Return the names of two bodies that collide at ``q``, None if none do."""
        self._pose(q)
        for pair in self._near():
            if self._pair_collides(pair):
                a, b = self.pairs[pair]
                return self.cell.bodies[a].name, self.cell.bodies[b].name
        return None

    def colliding_pairs(self, q: FloatArray) -> list[tuple[int, int]]:
        """Return all colliding pairs as rows of ``cell.bodies``, lower row first, sorted."""
        self._pose(q)
        found = [self.pairs[pair] for pair in self._near() if self._pair_collides(pair)]
        return sorted((int(a), int(b)) for a, b in found)

    def distance(self, q: FloatArray) -> float:
        """Return the smallest distance in m over all checked pairs; 0 if one collides; inf without pairs."""
        if self.collides(q):
            return 0.0
        fcl, smallest = self._fcl, math.inf
        apart = self._spheres_apart()
        for pair in np.argsort(apart, kind="stable").tolist():
            if apart[pair] >= smallest:
                break
            a, b = self.pairs[pair]
            found = fcl.distance(self._placed(a), self._placed(b), fcl.DistanceRequest(), fcl.DistanceResult())
            smallest = min(smallest, max(0.0, float(found)))
        return smallest

    def pair_distance(self, pair: int, q: FloatArray) -> float:
        """Return the distance in m of the bodies of one of ``pairs``; 0 if their surfaces touch.

        Of a body inside another it is the distance of their surfaces.
        """
        self._pinocchio.forwardKinematics(self._model, self._data, np.asarray(q, float))
        placed = []
        for row in self.pairs[pair].tolist():
            parent = int(self._parents[row])
            T = self._T_parent_body[row]
            if parent >= BASE:  # pinocchio's joint 0 is the universe, here the base
                T = self.cell.T_world_base @ self._data.oMi[parent].homogeneous @ T
            self._objects[row].setTransform(self._fcl.Transform(T[:3, :3], T[:3, 3]))
            placed.append(self._objects[row])
        fcl = self._fcl
        return max(0.0, float(fcl.distance(*placed, fcl.DistanceRequest(), fcl.DistanceResult())))

    def _checked_pairs(self) -> IntArray:
        """All pairs of bodies that can move against each other, less the ignored ones.

        Pairs that the planner ignores only because no sample brought them near each other are checked.
        """
        n = len(self.cell.bodies)
        one, other = self._parents[:, None], self._parents[None, :]
        checked = np.triu(np.ones((n, n), bool), 1) & (one != other) & (np.maximum(one, other) > BASE)
        unproven = {(min(a, b), max(a, b)) for a, b in self.cell.never_touching.tolist()}
        for a, b in np.asarray(self.cell.ignored_pairs).tolist():
            checked[min(a, b), max(a, b)] = (min(a, b), max(a, b)) in unproven
        return np.argwhere(checked)

    def _nestable(self) -> BoolArray:
        """Whether in a pair (pairs, 2) the first can hold the second, and the other way about, by their sizes."""
        extent = np.array([skin.extent for skin in self.skins])
        closed = np.array([skin.closed is not None for skin in self.skins], bool)
        a, b = self.pairs[:, 0], self.pairs[:, 1]
        first = closed[a] & (extent[b] <= 2.0 * self._radius[a])
        second = closed[b] & (extent[a] <= 2.0 * self._radius[b])
        return np.stack([first, second], axis=1)

    def _pose(self, q: FloatArray) -> None:
        """Put all bodies where they are at ``q``."""
        self._pinocchio.forwardKinematics(self._model, self._data, np.asarray(q, float))
        T_world_base = self.cell.T_world_base
        carriers = np.array([np.eye(4), *(T_world_base @ placement.homogeneous for placement in self._data.oMi)])
        carriers[1] = T_world_base  # pinocchio's joint 0 is the universe, here the base
        self._poses = carriers[np.where(self._parents == WORLD, 0, self._parents + 1)] @ self._T_parent_body
        self._centres = (self._poses[:, :3, :3] @ self._centre[:, :, None])[:, :, 0] + self._poses[:, :3, 3]
        self._is_placed = [False] * len(self._objects)

    def _placed(self, row: int) -> Any:
        """Return the engine's body where it is; most bodies are never asked for, so it moves no sooner."""
        if not self._is_placed[row]:
            T = self._poses[row]
            self._objects[row].setTransform(self._fcl.Transform(T[:3, :3], T[:3, 3]))
            self._is_placed[row] = True
        return self._objects[row]

    def _spheres_apart(self) -> FloatArray:
        a, b = self.pairs[:, 0], self.pairs[:, 1]
        between = np.linalg.norm(self._centres[a] - self._centres[b], axis=1)
        return np.asarray(between - self._radius[a] - self._radius[b])

    def _near(self) -> list[int]:
        near: list[int] = np.flatnonzero(self._spheres_apart() <= 1e-9).tolist()
        return near

    def _pair_collides(self, pair: int) -> bool:
        a, b = self.pairs[pair]
        fcl = self._fcl
        if fcl.collide(self._placed(a), self._placed(b), fcl.CollisionRequest(), fcl.CollisionResult()):
            return True
        first, second = self._can_hold[pair]
        return (first and self._holds(a, b)) or (second and self._holds(b, a))

    def _holds(self, outer: int, inner: int) -> bool:
        """Whether closed mesh ``outer`` has a piece of ``inner`` inside, given that their surfaces do not touch."""
        T_outer, T_inner = self._poses[outer], self._poses[inner]
        p_world = self.skins[inner].witnesses @ T_inner[:3, :3].T + T_inner[:3, 3]
        points = (p_world - T_outer[:3, 3]) @ T_outer[:3, :3]
        return any(self.skins[outer].contains(point) for point in points)


class Skin:
    """A body as FCL sees it, and what winding numbers and bounds need of it."""

    def __init__(self, body: Body) -> None:
        import fcl

        self.extent = 0.0  # longest edge of the bounding box, of the smallest piece
        self.corners: FloatArray | None = None  # of the triangles (faces, 3, 3) of a mesh, as the engine numbers them
        self.closed: FloatArray | None = None  # the same of a closed mesh, consistently wound
        self.centre = np.zeros(3)
        self.witnesses = np.zeros((1, 3))
        match body.shape:
            case Box(size):
                self.geometry: Any = fcl.Box(*size)
                self.radius, self.extent = math.dist(size, (0, 0, 0)) / 2.0, max(size)
            case Sphere(radius):
                self.geometry = fcl.Sphere(radius)
                self.radius, self.extent = radius, 2.0 * radius
            case Cylinder(radius, length):
                self.geometry = fcl.Cylinder(radius, length)
                self.radius, self.extent = math.hypot(radius, length / 2.0), max(2.0 * radius, length)
            case Capsule(radius, length):
                self.geometry = fcl.Capsule(radius, length)
                self.radius, self.extent = radius + length / 2.0, length + 2.0 * radius
            case Mesh():
                self._take_mesh(body.shape)

    def _take_mesh(self, mesh: Mesh) -> None:
        import fcl
        import trimesh

        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=True)
        self.geometry = fcl.BVHModel()
        self.geometry.beginModel(len(solid.vertices), len(solid.faces))
        self.geometry.addSubModel(np.asarray(solid.vertices), np.asarray(solid.faces))
        self.geometry.endModel()
        self.corners = np.array(solid.triangles)
        low, high = np.asarray(solid.bounds)
        self.centre = (low + high) / 2.0
        self.radius = float(np.linalg.norm(np.asarray(solid.vertices) - self.centre, axis=1).max())
        pieces = trimesh.graph.connected_component_labels(solid.face_adjacency, node_count=len(solid.faces))
        first_faces = np.unique(pieces, return_index=True)[1]
        self.extent = min(float(np.ptp(solid.triangles[pieces == k].reshape(-1, 3), axis=0).max()) for k in set(pieces))
        self.witnesses = np.asarray(solid.vertices)[np.asarray(solid.faces)[first_faces, 0]]
        if (np.bincount(solid.edges_unique_inverse) % 2 == 0).all():
            trimesh.repair.fix_winding(solid)
            self.closed = np.asarray(solid.triangles)
            self._low, self._high = low, high

    def contains(self, point: FloatArray) -> bool:
        """Whether the closed mesh winds an odd number of times about a point of its frame."""
        if self.closed is None or (point < self._low).any() or (point > self._high).any():
            return False
        corners = self.closed - point
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.einsum("fi,fi->f", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("fi,fi->f", one, other) for one, other in ((a, b), (b, c), (c, a)))
        angles = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        return round(abs(float(angles.sum())) / (4.0 * math.pi)) % 2 == 1
