"""Distances in a layout as plain numbers: robot against stations, walls and itself, and stations against each other.

Every distance is a gap: centre distance less both radii less the clearance, negative inside. Two things that both
stand still are not measured against each other (obstacles may overlap), except a workstation against a wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.solvers.layout.problem import LayoutProblem


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

    def layout_gaps(self, design: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return gaps in m of `layout_pairs`, `base_pairs` and `wall_pairs`, each (..., pairs), of (..., n_design)."""
        problem = self.problem
        hull = self.hull_world(design)
        one, other = self.layout_pairs.T
        apart = np.linalg.norm(hull[..., one, :] - hull[..., other, :], axis=-1)
        stations = apart - self.hull_radii[one] - self.hull_radii[other] - problem.clearance_m
        sphere, body = self.base_pairs.T
        T_base = problem.base_pose(design)
        centres = problem.robot_spheres.centres @ np.swapaxes(T_base[..., :3, :3], -1, -2) + T_base[..., None, :3, 3]
        apart = np.linalg.norm(centres[..., sphere, :] - hull[..., body, :], axis=-1)
        base = apart - problem.robot_spheres.radii[sphere] - self.hull_radii[body] - problem.clearance_m
        wall, body = self.wall_pairs.T
        normals = np.array([each.normal for each in problem.walls]).reshape(-1, 3)
        offsets = np.array([each.offset_m for each in problem.walls])
        walls = np.einsum("...ij,ij->...i", hull[..., body, :], normals[wall]) - offsets[wall] - self.hull_radii[body]
        return stations, base, walls

    def layout_violation(self, design: FloatArray) -> FloatArray:
        """Return the sum of all penetrations in the layout in m, (...,), of designs (..., n_design); 0 is feasible."""
        total = np.zeros(np.shape(design)[:-1])
        for gaps in self.layout_gaps(design):
            total = total + np.maximum(-gaps, 0.0).sum(axis=-1)
        return np.asarray(total)

    def worst_layout_gaps(self, design: FloatArray) -> list[LayoutGap]:
        """Return the smallest gap of each pair of bodies (stations, base, walls), smallest first."""
        names = [station.name for station in self.problem.stations]
        owner = [names[station] for station in self.hull_station]
        worst: dict[tuple[str, str], float] = {}
        firsts = (owner, ["robot base"] * len(self.problem.robot_spheres), [w.name for w in self.problem.walls])
        pairs = (self.layout_pairs, self.base_pairs, self.wall_pairs)
        for first, rows, gaps in zip(firsts, pairs, self.layout_gaps(design)):
            for (one, other), gap in zip(rows.tolist(), gaps.tolist()):
                key = (first[one], owner[other])
                worst[key] = min(gap, worst.get(key, np.inf))
        return sorted((LayoutGap(*key, gap) for key, gap in worst.items()), key=lambda each: each.gap_m)

    def hull_gaps(self, robot_world: FloatArray, hull_world: FloatArray) -> FloatArray:
        """Return gaps (n, moving robot spheres, hull spheres) in m of (n, robot spheres, 3) to (hull spheres, 3)."""
        moving = self.moving_spheres
        # |a - b|^2 as a product of matrices, about the middle so that it loses nothing: no array of differences
        middle = hull_world.mean(axis=0) if len(hull_world) else np.zeros(3)
        robot, hull = robot_world[:, moving] - middle, hull_world - middle
        square = (robot**2).sum(axis=-1)[..., None] + (hull**2).sum(axis=-1) - 2.0 * (robot @ hull.T)
        radii = self.problem.robot_spheres.radii[moving][:, None] + self.hull_radii
        return np.asarray(np.sqrt(np.maximum(square, 0.0)) - (radii + self.problem.clearance_m))

    def wall_gaps(self, robot_world: FloatArray) -> FloatArray:
        """Return gaps (n, moving robot spheres, walls) in m; infinite for walls that do not hold the robot."""
        moving = self.moving_spheres
        gaps = np.full((len(robot_world), len(moving), len(self.problem.walls)), np.inf)
        for column, wall in enumerate(self.problem.walls):
            if wall.holds_robot:
                reach = robot_world[:, moving] @ wall.normal - wall.offset_m
                gaps[:, :, column] = reach - self.problem.robot_spheres.radii[moving]
        return gaps

    def self_gaps(self, robot_world: FloatArray) -> FloatArray:
        """Return gaps (n, self pairs) in m."""
        one, other = self.problem.robot_spheres.self_pairs.T
        radii = self.problem.robot_spheres.radii
        apart = np.linalg.norm(robot_world[:, one] - robot_world[:, other], axis=-1)
        return np.asarray(apart - radii[one] - radii[other])

    def motion_gap(self, design: FloatArray, q: FloatArray, own_station: int = -1) -> FloatArray:
        """Return the smallest gap (n,) in m of the robot at configurations ``q`` (n, joints) to everything.

        Hulls of ``own_station`` are left out: an approach is free of collisions with its own station by definition.
        """
        robot = self.robot_world(self.problem.base_pose(design), q)
        gaps = np.full(len(q), np.inf)
        others = self.hull_station != own_station
        families = (self.hull_gaps(robot, self.hull_world(design))[:, :, others], self.wall_gaps(robot))
        for family in families:
            if family.size:
                gaps = np.minimum(gaps, family.reshape(len(q), -1).min(axis=1))
        if len(self.problem.robot_spheres.self_pairs):
            gaps = np.minimum(gaps, self.self_gaps(robot).min(axis=1))
        return gaps
