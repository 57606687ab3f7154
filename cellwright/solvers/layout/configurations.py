"""Every joint configuration that serves the visits of many layouts at once, and which of them collide there.

Six-axis arms with full poses get all branches of the certified inverse kinematics, with a free turn about the tool's
axis all branches at evenly spread turns. Other arms (prismatic joints, fewer or more than six, targets by position
alone) get Newton's solutions from the nearest configurations of a cloud sampled once. Branches come shifted by whole
turns into the joint limits.

Cost: 10 us a full pose of a six-axis arm; about 0.1 ms a pose by Newton's method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from cellwright.arrays import BoolArray, FloatArray
from cellwright.cell.inverse_kinematics import InverseKinematics, inverse_kinematics_for
from cellwright.cell.robot import Chain
from cellwright.cell.serial_arm import motions
from cellwright.cell.transforms import inverse
from cellwright.solvers.layout.approach import approach_knots, newton_steps
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.problem import LayoutProblem, TargetKind

REACHED = 1e-5
"""Largest residual in m and in rad of a configuration that counts as reaching a pose."""
_TOUCHING_M = 1e-6
_CLOUD = 20_000
_TURN_LENGTH_M = 0.4
"""A radian counts as so many metres when the nearest configurations of the cloud are looked up."""
_NEWTON_STEPS = 12
_CHUNK = 4_000_000
"""Sphere pairs measured at once."""


@dataclass(frozen=True, eq=False)
class VisitConfigurations:
    """Configurations of the visits of n layouts; rows that do not reach, break limits or collide are NaN.

    Attributes:
        first, last: At the first and last pose of each visit's approach, on one branch,
            (n, visits, candidates, joints).
        reached: Whether a visit was reached in the joint limits at all, collisions aside, (n, visits).
    """

    first: FloatArray
    last: FloatArray
    reached: BoolArray

    @property
    def usable(self) -> BoolArray:
        """Which candidates stand, (n, visits, candidates)."""
        return np.asarray(np.isfinite(self.first[..., 0]))

    @property
    def unserved(self) -> BoolArray:
        """Which visits have no candidate left, (n, visits)."""
        return np.asarray(~self.usable.any(axis=2))


@dataclass(frozen=True, eq=False)
class ConfigurationFinder:
    """Finds the configurations of a problem's visits.

    Attributes:
        problem: The problem.
        rng: Samples the cloud, for arms without closed form.
        n_turns: Turns about the tool's axis that are tried where it is free.
        n_near: Configurations of the cloud that Newton's method starts from.
    """

    problem: LayoutProblem
    rng: np.random.Generator
    n_turns: int = 8
    n_near: int = 8
    geometry: LayoutGeometry = field(init=False)

    def __post_init__(self) -> None:
        """Prepare the spheres."""
        object.__setattr__(self, "geometry", LayoutGeometry(self.problem))

    def find(self, designs: FloatArray) -> VisitConfigurations:
        """Return the configurations of all visits of designs (n, n_design)."""
        problem = self.problem
        designs = np.asarray(designs, float)
        T_base_world = inverse(problem.base_pose(designs))
        T_world_station = problem.station_poses(designs) if problem.stations else np.zeros((len(designs), 0, 4, 4))
        found = [self._of_visit(visit, T_base_world, T_world_station) for visit in range(len(problem.visits))]
        most = max(first.shape[1] for first, _ in found)
        first = np.stack([_padded(each, most) for each, _ in found], axis=1)
        last = np.stack([_padded(each, most) for _, each in found], axis=1)
        reached = np.asarray(np.isfinite(first[..., 0]).any(axis=2))
        begun = {start for start, _ in problem.transitions}
        ended = {end for _, end in problem.transitions}
        blocked = self._blocked(designs, first, ended) | self._blocked(designs, last, begun)
        first[blocked], last[blocked] = np.nan, np.nan
        return VisitConfigurations(first, last, reached)

    def _of_visit(
        self, visit: int, T_base_world: FloatArray, T_world_station: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return configurations (n, candidates, joints) at the first and the last pose of a visit's approach."""
        problem, approach = self.problem, self.problem.approach_of(visit)
        n, arm = len(T_base_world), problem.arm
        if approach is None:
            home = np.array(np.broadcast_to(np.asarray(problem.home_q, float), (n, 1, arm.n_joints)))
            return home, home.copy()
        T_base_station = T_base_world @ T_world_station[:, problem.visits[visit].station]
        first = self._at(T_base_station @ approach.T_station_tool[0], approach.target)
        last = first.copy()
        if approach.n_poses > 1:
            n_candidates = first.shape[1]
            rows = last.reshape(-1, arm.n_joints)
            alive = np.flatnonzero(np.isfinite(rows[:, 0]))
            for T_station_tool in approach_knots(approach).T_station_tool[1:]:
                goals = np.repeat(T_base_station @ T_station_tool, n_candidates, axis=0)[alive]
                q, error = newton_steps(arm, problem.T_flange_tool, rows[alive], goals, approach.target, steps=8)
                kept = (np.abs(error).max(axis=1) < REACHED) & self._within(q)
                rows[alive[~kept]] = np.nan
                rows[alive[kept]] = q[kept]
                alive = alive[kept]
            first[np.isnan(last[..., 0])] = np.nan
        return first, last

    def _at(self, T_base_tool: FloatArray, target: TargetKind) -> FloatArray:
        """Return configurations (n, candidates, joints) that reach tool poses (n, 4, 4)."""
        solver = self._closed_form
        if solver is None or target is TargetKind.POSITION:
            return self._by_newton(T_base_tool, target)
        goals = T_base_tool[:, None]
        if target is TargetKind.AXIS:
            turns = motions(True, np.array([0.0, 0.0, 1.0]), np.arange(self.n_turns) * 2.0 * math.pi / self.n_turns)
            goals = goals @ turns
        flange = goals @ inverse(self.problem.T_flange_tool)
        found = solver.solve(flange.reshape(-1, 4, 4)).reshape(len(goals), -1, 6)
        return self._shifted(found)

    @cached_property
    def _closed_form(self) -> InverseKinematics | None:
        arm = self.problem.arm
        if arm.n_joints != 6 or not arm.revolute.all():
            return None
        return inverse_kinematics_for(
            Chain(
                arm.T_parent_joint,
                arm.axis,
                arm.T_last_flange,
                arm.lower,
                arm.upper,
                arm.max_velocity,
                arm.max_acceleration,
            )
        )

    def _shifted(self, q: FloatArray) -> FloatArray:
        """Shift turning joints (..., joints) by whole turns towards the middle of their limits; NaN if outside."""
        arm = self.problem.arm
        middle = 0.5 * (arm.lower + arm.upper)
        turns = np.round((middle - q) / (2.0 * math.pi))
        moved = np.where(arm.revolute, q + 2.0 * math.pi * turns, q)
        return np.where(self._within(moved)[..., None], moved, np.nan)

    def _within(self, q: FloatArray) -> BoolArray:
        arm = self.problem.arm
        with np.errstate(invalid="ignore"):
            return np.asarray(((q >= arm.lower - 1e-9) & (q <= arm.upper + 1e-9)).all(axis=-1))

    @cached_property
    def _cloud(self) -> tuple[FloatArray, FloatArray]:
        """Random configurations (samples, joints) and their tool poses (samples, 4, 4)."""
        arm = self.problem.arm
        q = self.rng.uniform(arm.lower, arm.upper, (_CLOUD, arm.n_joints))
        return q, arm.flange_pose(q) @ self.problem.T_flange_tool

    @cached_property
    def _trees(self) -> dict[TargetKind, Any]:
        from scipy.spatial import cKDTree

        return {target: cKDTree(_features(self._cloud[1], target)) for target in TargetKind}

    def _by_newton(self, T_base_tool: FloatArray, target: TargetKind) -> FloatArray:
        arm = self.problem.arm
        _, near = self._trees[target].query(_features(T_base_tool, target), k=self.n_near)
        start = self._cloud[0][near].reshape(-1, arm.n_joints)
        goals = np.repeat(T_base_tool, self.n_near, axis=0)
        q, error = newton_steps(
            arm, self.problem.T_flange_tool, start, goals, target, steps=_NEWTON_STEPS, within_limits=True
        )
        q[np.abs(error).max(axis=1) > REACHED] = np.nan
        return q.reshape(len(T_base_tool), self.n_near, arm.n_joints)

    def _blocked(self, designs: FloatArray, q: FloatArray, at_transition: set[int]) -> BoolArray:
        """Tell which candidates (n, visits, candidates, joints) collide where they stand.

        At the end of a transition (visits ``at_transition``) the station that is visited counts too; inside an
        approach it is clear by definition.
        """
        blocked = np.zeros(q.shape[:3], bool)
        per_layout = q.shape[1] * q.shape[2] * max(self._n_pairs, 1)
        if not self._n_pairs:
            return blocked
        size = max(1, _CHUNK // per_layout)
        for begin in range(0, len(designs), size):
            part = slice(begin, begin + size)
            blocked[part] = self._gaps(designs[part], q[part], at_transition) < -_TOUCHING_M
        return blocked

    @cached_property
    def _n_pairs(self) -> int:
        moving = len(self.geometry.moving_spheres)
        walls = sum(wall.holds_robot for wall in self.problem.walls)
        return moving * (len(self.geometry.hull_radii) + walls) + len(self.problem.robot_spheres.self_pairs)

    def _gaps(self, designs: FloatArray, q: FloatArray, at_transition: set[int]) -> FloatArray:
        """Return the smallest gap (n, visits, candidates) in m; NaN for candidates that are none."""
        gaps = np.full(q.shape[:3], np.inf)
        for visit, where in enumerate(self.problem.visits):
            own = -1 if visit in at_transition else where.station
            gaps[:, visit] = self.geometry.motion_gap(designs, q[:, visit], own)
        return gaps


def _padded(q: FloatArray, n_candidates: int) -> FloatArray:
    """Add NaN rows to (n, candidates, joints)."""
    missing = np.full((len(q), n_candidates - q.shape[1], q.shape[2]), np.nan)
    return np.concatenate([q, missing], axis=1)


def _features(T: FloatArray, target: TargetKind) -> FloatArray:
    """Return rows (n, k) whose distances compare tool poses (n, 4, 4) as far as ``target`` asks."""
    parts = [T[:, :3, 3]]
    if target is not TargetKind.POSITION:
        parts.append(_TURN_LENGTH_M * T[:, :3, 2])
    if target is TargetKind.POSE:
        parts.append(_TURN_LENGTH_M * T[:, :3, 0])
    return np.concatenate(parts, axis=1)
