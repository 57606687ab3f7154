"""Distances in a layout as plain numbers: robot against stations, walls and itself, and stations against each other.

Every distance is a gap: centre distance less both radii, negative inside. Between bodies, and between the moving robot
and a wall, it is less the clearance too; what stands may touch a wall, and the robot's links each other. Two things
that both stand still are not measured against each other (obstacles may overlap), except a workstation against a wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.harness import Harness
from cellwright.cell.serial_arm import chain_poses
from cellwright.solvers.layout.problem import LayoutProblem

ROBOT_BASE = "robot base"
"""What people call the spheres on link 0."""
_PARALLEL = 1e-9
"""Largest cosine of a right angle, and sine of none, between a base's joint and a wall."""


@dataclass(frozen=True)
class LayoutGap:
    """The gap between two bodies of the layout, or a body and a wall: their names and metres."""

    first: str
    second: str
    gap_m: float


@dataclass(frozen=True, eq=False)
class LayoutGeometry:
    """The spheres of a problem, flattened.

    Attributes:
        problem: What they belong to.
    """

    problem: LayoutProblem

    @cached_property
    def hull_station(self) -> IntArray:
        """The station of each hull sphere, (spheres,)."""
        counts = [len(station.hull) for station in self.problem.stations]
        return np.repeat(np.arange(len(counts)), counts)

    @cached_property
    def hull_centres(self) -> FloatArray:
        """Centres in the station's frame, (spheres, 3)."""
        return np.concatenate([station.hull.centres for station in self.problem.stations])

    @cached_property
    def hull_radii(self) -> FloatArray:
        """Radii in m, (spheres,)."""
        return np.concatenate([station.hull.radii for station in self.problem.stations])

    @cached_property
    def layout_pairs(self) -> IntArray:
        """Pairs of hull spheres of two stations of which at least one moves, (pairs, 2)."""
        moves = np.array([station.harness.n_joints > 0 for station in self.problem.stations])[self.hull_station]
        first, second = np.triu_indices(len(self.hull_station), 1)
        wanted = (self.hull_station[first] != self.hull_station[second]) & (moves[first] | moves[second])
        return np.stack([first[wanted], second[wanted]], axis=1)

    @cached_property
    def base_pairs(self) -> IntArray:
        """Pairs (robot sphere on link 0, hull sphere) of which at least one moves, (pairs, 2)."""
        spheres = np.flatnonzero(self.problem.robot_spheres.link == 0)
        base_moves = self.problem.base.n_joints > 0
        moves = [base_moves or station.harness.n_joints > 0 for station in self.problem.stations]
        hull = np.flatnonzero(np.array(moves, bool)[self.hull_station])
        return np.stack(np.meshgrid(spheres, hull, indexing="ij"), axis=-1).reshape(-1, 2)

    @cached_property
    def wall_pairs(self) -> IntArray:
        """Pairs (wall, hull sphere) of stations that move or are worked at, (pairs, 2)."""
        held = [station.harness.n_joints > 0 or bool(station.approaches) for station in self.problem.stations]
        hull = np.flatnonzero(np.array(held, bool)[self.hull_station])
        walls = np.arange(len(self.problem.walls))
        return np.stack(np.meshgrid(walls, hull, indexing="ij"), axis=-1).reshape(-1, 2)

    @cached_property
    def base_wall_pairs(self) -> IntArray:
        """Pairs (wall, robot sphere on link 0) of walls that hold the robot and its base moves against, (pairs, 2).

        A base that only slides and turns along a wall, as on a floor, keeps its distance: no design changes it.
        """
        base = self.problem.base
        axes = _axes_in_world(base)
        walls = [
            number
            for number, wall in enumerate(self.problem.walls)
            if wall.holds_robot
            and any(
                np.linalg.norm(np.cross(axis, wall.normal)) > _PARALLEL
                if turns
                else abs(axis @ wall.normal) > _PARALLEL
                for axis, turns, span in zip(axes, base.revolute, base.upper - base.lower)
                if span > 0.0
            )
        ]
        spheres = np.flatnonzero(self.problem.robot_spheres.link == 0)
        pairs = np.stack(np.meshgrid(np.array(walls, np.int64), spheres, indexing="ij"), axis=-1)
        return pairs.reshape(-1, 2)

    @property
    def pair_families(self) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """`layout_pairs`, `base_pairs`, `wall_pairs` and `base_wall_pairs`, in the order of `layout_gaps`."""
        return self.layout_pairs, self.base_pairs, self.wall_pairs, self.base_wall_pairs

    @cached_property
    def pair_names(self) -> tuple[tuple[list[str], list[str]], ...]:
        """The names behind both columns of each of `pair_families`, by the number that stands there."""
        hull = [self.problem.stations[station].name for station in self.hull_station.tolist()]
        base = [ROBOT_BASE] * len(self.problem.robot_spheres)
        walls = [wall.name for wall in self.problem.walls]
        return (hull, hull), (base, hull), (walls, hull), (walls, base)

    @cached_property
    def moving_spheres(self) -> IntArray:
        """The robot spheres on links that move against the base."""
        return np.flatnonzero(self.problem.robot_spheres.link > 0)

    def sample_step(self, sagitta_m: float, least_m: float) -> float:
        """Return how far apart in m samples of a sphere's way may lie so that it dips no deeper than ``sagitta_m``.

        That is between two samples, into any hull or any other part of the robot; at least ``least_m``, and infinite
        where nothing is to be hit: walls are flat.
        """
        return max(least_m, float(np.sqrt(8.0 * sagitta_m * self.smallest_radii_m)))

    @cached_property
    def smallest_radii_m(self) -> float:
        """The smallest sum of two radii, of the robot's moving spheres and what they may hit; infinite if nothing."""
        radii = self.problem.robot_spheres.radii
        pairs = self.problem.robot_spheres.self_pairs
        smallest = float(radii[pairs].sum(axis=1).min()) if len(pairs) else np.inf
        if len(self.hull_radii) and len(self.moving_spheres):
            smallest = min(smallest, float(radii[self.moving_spheres].min() + self.hull_radii.min()))
        return smallest

    def hull_world(self, design: FloatArray) -> FloatArray:
        """Return the hull centres (..., spheres, 3) in the world at designs (..., n_design)."""
        poses = self.problem.station_poses(design)[..., self.hull_station, :, :]
        return np.asarray((poses[..., :3, :3] @ self.hull_centres[:, :, None])[..., 0] + poses[..., :3, 3])

    def robot_world(self, T_world_base: FloatArray, q: FloatArray) -> FloatArray:
        """Return the robot's sphere centres (..., spheres, 3) in the world at ``q`` (..., joints)."""
        spheres = self.problem.robot_spheres
        links = (T_world_base[..., None, :, :] @ self.problem.arm.link_poses(q))[..., spheres.link, :, :]
        return np.asarray((links[..., :3, :3] @ spheres.centres[:, :, None])[..., 0] + links[..., :3, 3])

    def layout_gaps(self, design: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return gaps in m of all `pair_families`, each (..., pairs), at designs (..., n_design)."""
        problem, spheres = self.problem, self.problem.robot_spheres
        hull = self.hull_world(design)
        one, other = self.layout_pairs.T
        apart = np.linalg.norm(hull[..., one, :] - hull[..., other, :], axis=-1)
        stations = apart - self.hull_radii[one] - self.hull_radii[other] - problem.clearance_m
        T_base = problem.base_pose(design)
        centres = spheres.centres @ np.swapaxes(T_base[..., :3, :3], -1, -2) + T_base[..., None, :3, 3]
        sphere, body = self.base_pairs.T
        apart = np.linalg.norm(centres[..., sphere, :] - hull[..., body, :], axis=-1)
        base = apart - spheres.radii[sphere] - self.hull_radii[body] - problem.clearance_m
        walls = self._from_walls(self.wall_pairs, hull, self.hull_radii)
        return stations, base, walls, self._from_walls(self.base_wall_pairs, centres, spheres.radii)

    def _from_walls(self, pairs: IntArray, centres: FloatArray, radii: FloatArray) -> FloatArray:
        """Return how far spheres (..., spheres, 3) are inside walls in m, (..., pairs), of pairs (wall, sphere)."""
        normals = np.array([each.normal for each in self.problem.walls]).reshape(-1, 3)
        offsets = np.array([each.offset_m for each in self.problem.walls])
        wall, sphere = pairs.T
        reach = np.einsum("...ij,ij->...i", centres[..., sphere, :], normals[wall])
        return np.asarray(reach - offsets[wall] - radii[sphere])

    def layout_violation(self, design: FloatArray) -> FloatArray:
        """Return the sum of all penetrations in the layout in m, (...,), of designs (..., n_design); 0 is feasible."""
        total = np.zeros(np.shape(design)[:-1])
        for gaps in self.layout_gaps(design):
            total = total + np.maximum(-gaps, 0.0).sum(axis=-1)
        return np.asarray(total)

    def worst_layout_gaps(self, design: FloatArray) -> list[LayoutGap]:
        """Return the smallest gap of each pair of bodies (stations, base, walls), smallest first."""
        worst: dict[tuple[str, str], float] = {}
        for (first, second), rows, gaps in zip(self.pair_names, self.pair_families, self.layout_gaps(design)):
            for (one, other), gap in zip(rows.tolist(), gaps.tolist()):
                key = (first[one], second[other])
                worst[key] = min(gap, worst.get(key, np.inf))
        return sorted((LayoutGap(*key, gap) for key, gap in worst.items()), key=lambda each: each.gap_m)

    def hull_gaps(self, robot_world: FloatArray, hull_world: FloatArray) -> FloatArray:
        """Return gaps (..., moving robot spheres, hull spheres) in m of all robot spheres to hull spheres.

        ``robot_world`` (..., robot spheres, 3) and ``hull_world`` (..., hull spheres, 3) broadcast.
        """
        moving = self.moving_spheres
        # |a - b|^2 as a product of matrices, about the middle so that it loses nothing: no array of differences
        middle = hull_world.mean(axis=-2, keepdims=True) if hull_world.shape[-2] else np.zeros((1, 3))
        robot, hull = robot_world[..., moving, :] - middle, hull_world - middle
        square = (robot**2).sum(axis=-1)[..., None] + (hull**2).sum(axis=-1)[..., None, :]
        square = square - 2.0 * (robot @ np.swapaxes(hull, -1, -2))
        radii = self.problem.robot_spheres.radii[moving][:, None] + self.hull_radii
        return np.asarray(np.sqrt(np.maximum(square, 0.0)) - (radii + self.problem.clearance_m))

    def wall_gaps(self, robot_world: FloatArray) -> FloatArray:
        """Return gaps (..., moving robot spheres, walls) in m; infinite for walls that do not hold the robot."""
        moving = self.moving_spheres
        gaps = np.full((*robot_world.shape[:-2], len(moving), len(self.problem.walls)), np.inf)
        for column, wall in enumerate(self.problem.walls):
            if wall.holds_robot:
                reach = robot_world[..., moving, :] @ wall.normal - wall.offset_m - self.problem.clearance_m
                gaps[..., column] = reach - self.problem.robot_spheres.radii[moving]
        return gaps

    def self_gaps(self, robot_world: FloatArray) -> FloatArray:
        """Return gaps (..., self pairs) in m of robot spheres (..., spheres, 3)."""
        one, other = self.problem.robot_spheres.self_pairs.T
        radii = self.problem.robot_spheres.radii
        apart = np.linalg.norm(robot_world[..., one, :] - robot_world[..., other, :], axis=-1)
        return np.asarray(apart - radii[one] - radii[other])

    def motion_gap(self, design: FloatArray, q: FloatArray, own_station: int = -1) -> FloatArray:
        """Return the smallest gap (..., n) in m of the robot at configurations ``q`` (..., n, joints) to everything.

        Of one design (n_design,), or of one for each row of ``q`` (..., n_design). Hulls of ``own_station`` are left
        out: an approach is free of collisions with its own station by definition.
        """
        robot = self.robot_world(self.problem.base_pose(design)[..., None, :, :], q)
        gaps = np.full(q.shape[:-1], np.inf)
        others = self.hull_station != own_station
        if len(self.moving_spheres) and others.any():
            between = self.hull_gaps(robot, self.hull_world(design)[..., None, :, :])
            gaps = np.minimum(gaps, between[..., others].min(axis=(-2, -1)))
        if len(self.moving_spheres) and len(self.problem.walls):
            gaps = np.minimum(gaps, self.wall_gaps(robot).min(axis=(-2, -1)))
        if len(self.problem.robot_spheres.self_pairs):
            gaps = np.minimum(gaps, self.self_gaps(robot).min(axis=-1))
        return gaps


def _axes_in_world(harness: Harness) -> FloatArray:
    """Return the axes (joints, 3) of a harness in the world with its joints at their lower limits."""
    if not harness.n_joints:
        return np.zeros((0, 3))
    links = chain_poses(harness.T_parent_joint, harness.axis, harness.revolute, harness.lower)[-harness.n_joints :]
    return np.asarray((links[:, :3, :3] @ harness.axis[:, :, None])[..., 0])
