"""How short could the cycle of given sweeps be with the workpiece, or the robot's base, standing elsewhere?

A *design* is a state of the harness's joints; zero is the present placement. Moving the part by a motion of the world,
or the base by its inverse, is one and the same seen from the base: sweeps and whatever moves with them shift rigidly
there, everything else stays. So balls, hulls and distance fields are prepared once (`cellwright.cell.sphere_filter`)
and only shifted for a design, which is then tried in the order of the costs of the tests:

1. standing bodies do not certainly overlap (`cellwright.solvers.placement.overlap_filter`);
2. the start configuration is not certainly blocked;
3. each sweep is followed: on some branch no state of what must be executed is certainly blocked;
4. the cycle is estimated (`cellwright.solvers.placement.cycles`), which ranks designs and refuses none.

A design that is refused could not be executed. `PlacementJudge.bound` says what no plan at a design undercuts.
Cost: some milliseconds for eight sweeps, nearly all of it outside the interpreter lock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.causes import Cause
from cellwright.cell import parallel_axes
from cellwright.cell.branch_tracking import solve_paths
from cellwright.cell.chain_kinematics import link_poses
from cellwright.cell.inverse_kinematics import PARALLEL_AXES, inverse_kinematics_for
from cellwright.cell.sphere_filter import SphereFilter, sphere_filter
from cellwright.cell.transforms import apply, inverse
from cellwright.solvers.joint_branches import greatest_changes
from cellwright.solvers.placement.cycles import HopefulSweep, estimated_cycle, least_cycle
from cellwright.solvers.placement.kernels import holding_runs
from cellwright.solvers.placement.overlap_filter import moving_pairs
from cellwright.solvers.placement.problem import PlacementProblem
from cellwright.solvers.state_tests import COLLIDING
from cellwright.solvers.sweeps.pieces import evaluate_sweep
from cellwright.solvers.sweeps.poses import spread_poses, sweep_poses
from cellwright.solvers.sweeps.states import classify_sweep

FIELD_PADDING = 0.1
"""Metres around a mesh in which its distance is tabulated."""
SAME_TRAVEL = 1e-6
"""Metres by which a piece may miss the end of what must be executed: rounding of poses."""


class Refusal(Enum):
    """Why a design is out of the question."""

    OVERLAP = "overlap"
    START = "start collision"
    SWEEP = "sweep"


@dataclass(frozen=True)
class Verdict:
    """What a design comes to.

    Attributes:
        estimate: What its cycle is estimated to be, s; infinite if it is refused.
        refusal: Which test refused it, ``None`` if none did.
        what: The bodies that overlap, the body that the start configuration meets, or the sweep.
        cause: Furthest test that the sweep reached, `Cause`.
        n_untested: Tests that were left when it was refused: how far it is from being executable.
    """

    estimate: float
    refusal: Refusal | None = None
    what: str = ""
    cause: int = 0
    n_untested: int = 0


class PlacementJudge:
    """Judges designs of one problem; safe to use from several threads at once.

    Attributes:
        problem: The problem.
    """

    def __init__(self, problem: PlacementProblem) -> None:
        self.problem = problem
        cell, follow = problem.cell, problem.follow
        self._chain = cell.robot.chain
        self._start = np.array(cell.start, float)
        self._ik = inverse_kinematics_for(self._chain)
        self._T_flange_last = inverse(self._chain.T_last_flange)
        self._filter = sphere_filter(
            cell,
            link_overshoot=follow.link_overshoot,
            tool_overshoot=follow.tool_overshoot,
            field_spacing=follow.field_spacing,
            field_padding=FIELD_PADDING,
        )
        standing = [row for row, body in enumerate(cell.bodies) if body.parent <= 0]
        self._shifted = [place for place, row in enumerate(standing) if problem.is_shifted(row)]
        self._standing = moving_pairs(problem, self._filter, standing)
        self._poses = sweep_poses(cell, problem.sweeps, follow)
        self._sample_travel = np.array(problem.sweeps.sample_travel, float)

    def judge(self, values: FloatArray) -> Verdict:
        """Return what a design (joints,) comes to."""
        refusal, sweeps = self._tested(values)
        return refusal or Verdict(estimated_cycle(self.problem, sweeps))

    def bound(self, values: FloatArray) -> float:
        """Return a cycle in s that no plan at a design (joints,) undercuts; infinite if it is refused.

        It takes some ten milliseconds: for those designs that a search has found.
        """
        refusal, sweeps = self._tested(values)
        return np.inf if refusal else least_cycle(self.problem, sweeps)

    def _tested(self, values: FloatArray) -> tuple[Verdict | None, list[HopefulSweep]]:
        """Return the verdict on a design that is refused, or else what can be hoped of its sweeps."""
        M, n_sweeps = self.problem.shift(values), len(self._poses.sweep)
        overlap = self._overlap(M)
        if overlap:
            return Verdict(np.inf, Refusal.OVERLAP, overlap, n_untested=n_sweeps + 1), []
        arrays = self._shifted_filter(M).arrays()
        blocker = self._blocking_start(arrays)
        if blocker:
            return Verdict(np.inf, Refusal.START, blocker, n_untested=n_sweeps), []
        T_first = np.ascontiguousarray(M @ self._poses.T_base_flange)
        direction = np.ascontiguousarray(self._poses.direction @ M[:3, :3].T)
        sweeps = []
        for row in range(n_sweeps):
            sweep, cause = self._hopeful(arrays, row, T_first, direction)
            if sweep is None:
                name = self.problem.names[self._poses.sweep[row]]
                return Verdict(np.inf, Refusal.SWEEP, name, cause, n_sweeps - 1 - row), []
            sweeps.append(sweep)
        return None, sweeps

    def _overlap(self, M: FloatArray) -> str:
        """Return the first two standing bodies that certainly overlap, empty if none do."""
        return next((pair.names for pair in self._standing if pair.overlaps(self._filter, M)), "")

    def _shifted_filter(self, M: FloatArray) -> SphereFilter:
        """Return the filter with hulls and distances of the shifted bodies where they stand then."""
        f = self._filter
        points, hull, real = f.hull_points.copy(), f.hull_real.copy(), f.distance.real.copy()
        back = inverse(M)
        for place in self._shifted:
            own = slice(f.hull_whole[place, 0], f.hull_whole[place, 1])
            points[own] = apply(M, points[own])
            hull[place, 2:5] = M[:3, :3] @ hull[place, 2:5]
            real[place, 3:15] = (np.vstack([real[place, 3:15].reshape(3, 4), [0.0, 0.0, 0.0, 1.0]]) @ back)[:3].ravel()
        return replace(f, hull_points=points, hull_real=hull, distance=replace(f.distance, real=real))

    def _blocking_start(self, arrays: tuple[FloatArray | IntArray, ...]) -> str:
        """Return the body that certainly blocks the start configuration, empty if none does."""
        chain, clearance = self._chain, self.problem.follow.clearance
        T_last = link_poses(chain.T_parent_joint, chain.axis, self._start)[-1:]
        linked, status = np.empty((1, 1), np.bool_), np.empty((1, 1), np.int8)
        blocker, shift = np.empty((1, 1), np.int32), np.empty((1, 1))
        classify_sweep(
            *(arrays, chain.T_parent_joint, chain.axis, chain.lower, chain.upper, np.ones(len(self._start)), T_last),
            *(self._start[None, None].copy(), True, 0.0, clearance, 0.0, linked, status, blocker, shift),
        )
        return self.problem.cell.bodies[int(blocker[0, 0])].name if status[0, 0] == COLLIDING else ""

    def _solutions(self, T_base_flange: FloatArray, first: IntArray) -> FloatArray:
        if self._ik.family == PARALLEL_AXES:
            found: FloatArray = parallel_axes.branches(self._ik.parallel_axes_geometry, T_base_flange)
            return found
        if self._ik.slow:
            return solve_paths(self._ik.solve, self._chain, T_base_flange, first)
        return self._ik.solve(T_base_flange)

    def _hopeful(
        self, arrays: tuple[FloatArray | IntArray, ...], row: int, T_first: FloatArray, direction: FloatArray
    ) -> tuple[HopefulSweep | None, int]:
        """Return what can be hoped of one sweep, and its `Cause` if that is nothing."""
        problem, poses, chain, follow = self.problem, self._poses, self._chain, self.problem.follow
        n, step = int(poses.n_poses[row]), float(poses.step[row])
        first_travel, needed = float(poses.first_travel[row]), self._needed(row)
        if needed is None:
            return None, int(Cause.TOO_SHORT)
        T, first = np.empty((n, 4, 4)), np.array([0, n])
        spread_poses(T_first, direction, poses.step, np.array([row]), first, T)
        q = self._solutions(T, first)
        n_branches = q.shape[1]
        linked, status = np.empty((n_branches, n), np.bool_), np.empty((n_branches, n), np.int8)
        blocker, shift = np.empty((n_branches, n), np.int32), np.empty((n_branches, n))
        classify_sweep(
            *(arrays, chain.T_parent_joint, chain.axis, chain.lower, chain.upper),
            greatest_changes(chain.max_velocity, step, follow.scan_speed),
            *(T @ self._T_flange_last, q, self._ik.family == PARALLEL_AXES, step, follow.clearance, follow.shortest),
            *(linked, status, blocker, shift),
        )
        runs = holding_runs(q, linked, status, chain.lower, chain.upper, *needed)
        pieces = np.zeros((n_branches, 3), np.int64)
        hopes, q_start = pieces.copy(), np.empty((n_branches, chain.n_joints))
        cause, _ = evaluate_sweep(
            *(q, linked, status, blocker, chain.lower, chain.upper, self._start, first_travel, step),
            *(poses.useful[row], follow.shortest, self._sample_travel[poses.entry[row, 0] : poses.entry[row, 1]]),
            *(len(problem.cell.bodies), pieces, hopes, q_start),
        )
        if not runs[:, 2].any():
            return None, int(Cause.TOO_SHORT) if hopes[:, 2].any() else int(cause)
        return HopefulSweep(q, hopes, needed, runs, step), 0

    def _needed(self, row: int) -> tuple[int, int] | None:
        """Return the first and the last pose of a sweep that every plan executes, ``None`` if it does not go so far."""
        poses, required = self._poses, self.problem.required[self._poses.sweep[row]]
        step, first_travel, n = float(poses.step[row]), float(poses.first_travel[row]), int(poses.n_poses[row])
        first = math.floor((required[0] + SAME_TRAVEL - first_travel) / step)
        last = max(first, math.ceil((required[1] - SAME_TRAVEL - first_travel) / step))
        return (min(first, n - 1), last) if first >= 0 and last < n else None
