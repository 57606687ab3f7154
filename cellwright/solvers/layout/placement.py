"""How short could the cycle of given sweeps be with the workpiece, or the robot's base, standing elsewhere?

A *design* is a state of the harness's joints; zero is the present placement. Moving the part by a motion of the world,
or the base by its inverse, is one and the same seen from the base: sweeps and whatever moves with them shift rigidly
there, everything else stays. So balls, hulls and distance fields are prepared once (`cellwright.cell.sphere_filter`)
and only shifted for a design, which is then tried in the order of the costs of the tests:

1. standing bodies do not certainly overlap (`cellwright.solvers.layout.placement_overlaps`);
2. the start configuration is not certainly blocked;
3. each sweep is followed in full: some branch executes all of what must be executed. States that the filter leaves
   undecided count as free;
4. the cycle: the best order of sweeps, directions, branches and windings, exact up to `EXACT_UP_TO` sweeps, with sweeps
   that only the scanner's speed and acceleration limit and straight joint motions between them, whatever is in the way.

So the cycle is a bound from below but for the choice of windings, and a design that is refused could not be executed.
Cost: some milliseconds for eight sweeps, nearly all of it outside the interpreter lock.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from cellwright.arrays import FloatArray, Int32Array, IntArray
from cellwright.causes import Cause
from cellwright.cell import parallel_axes
from cellwright.cell.bodies import WORLD
from cellwright.cell.branch_tracking import solve_paths
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import link_poses
from cellwright.cell.harness import Harness
from cellwright.cell.inverse_kinematics import PARALLEL_AXES, inverse_kinematics_for
from cellwright.cell.sphere_filter import SphereFilter, sphere_filter
from cellwright.cell.transforms import apply, inverse
from cellwright.solvers.layout.placement_kernels import alternatives_into, best_piece, straight_times
from cellwright.solvers.layout.placement_overlaps import moving_pairs
from cellwright.solvers.path_timing import trapezoid_time
from cellwright.solvers.state_tests import COLLIDING
from cellwright.solvers.sweeps.order_kernels import held_karp, improve_sequence
from cellwright.solvers.sweeps.pieces import follow_rows
from cellwright.solvers.sweeps.poses import CandidateSweeps, FollowSettings, spread_poses, sweep_poses
from cellwright.solvers.sweeps.states import classify_sweep

FIELD_PADDING = 0.1
"""Metres around a mesh in which its distance is tabulated."""
EXACT_UP_TO = 9
"""Sweeps up to which the order is exact: milliseconds; beyond, local search from the nearest next."""
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
        cycle: Its optimistic cycle in s; infinite if it is refused.
        refusal: Which test refused it, ``None`` if none did.
        what: The bodies that overlap, the body that the start configuration meets, or the sweep.
        cause: Furthest test that the sweep reached, `Cause`.
        n_untested: Tests that were left when it was refused: how far it is from being executable.
    """

    cycle: float
    refusal: Refusal | None = None
    what: str = ""
    cause: int = 0
    n_untested: int = 0


@dataclass(frozen=True, eq=False)
class PlacementProblem:
    """What may move, and what must be executed wherever it stands.

    Attributes:
        cell: The cell in its present placement, with the part.
        harness: Motion of the part, or of the robot's base, in the world; the identity at zero.
        moves_base: Whether the base moves; else the part.
        carried: Names of the bodies that move along with the part; the part itself is always one.
        sweeps: The sweeps as they are looked at now, in the world.
        required: First and last travel of each that must be executed, (sweeps, 2) in m.
        names: What to call each sweep.
        follow: How they are followed.
        tool_acceleration: Acceleration of the scanner on a sweep, m/s^2.
        returns: Whether the cycle ends in the start configuration.
        most_alternatives: Branches and windings of each sweep.
    """

    cell: Cell
    harness: Harness
    moves_base: bool
    carried: tuple[str, ...]
    sweeps: CandidateSweeps
    required: FloatArray
    names: tuple[str, ...]
    follow: FollowSettings
    tool_acceleration: float
    returns: bool
    most_alternatives: int = 8

    def motion(self, values: FloatArray) -> FloatArray:
        """Return the motion (4, 4) in the world of what moves, at design joints ``values`` (joints,)."""
        return self.harness.poses(np.asarray(values, float))

    def shift(self, values: FloatArray) -> FloatArray:
        """Return how the sweeps shift as seen from the base, (4, 4)."""
        D, T = self.motion(values), self.cell.T_world_base
        return inverse(D @ T) @ T if self.moves_base else inverse(T) @ D @ T

    def is_shifted(self, row: int) -> bool:
        """Whether a body of the cell shifts, as seen from the base, with the sweeps."""
        body = self.cell.bodies[row]
        return body.parent == WORLD and (self.moves_base or body.name in self.carried or self.is_part(row))

    def is_part(self, row: int) -> bool:
        """Whether a body is the workpiece: always the last one of a cell."""
        return row == len(self.cell.bodies) - 1

    def moved_cell(self, values: FloatArray) -> Cell:
        """Return the cell at a design."""
        D = self.motion(values)
        if self.moves_base:
            return replace(self.cell, T_world_base=D @ self.cell.T_world_base)
        bodies = tuple(
            replace(body, T_parent_body=D @ body.T_parent_body) if self.is_shifted(row) else body
            for row, body in enumerate(self.cell.bodies)
        )
        return replace(self.cell, bodies=bodies)

    def moved_sweeps(self, values: FloatArray) -> CandidateSweeps:
        """Return the sweeps in the world at a design."""
        if self.moves_base:
            return self.sweeps
        return replace(self.sweeps, T_world_scanner=self.motion(values) @ self.sweeps.T_world_scanner)


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
        self._standing = moving_pairs(cell, self._filter, standing, problem.is_shifted)
        self._poses = sweep_poses(cell, problem.sweeps, follow)
        self._sample_travel = np.array(problem.sweeps.sample_travel, float)

    def judge(self, values: FloatArray) -> Verdict:
        """Return what a design (joints,) comes to."""
        M, n_sweeps = self.problem.shift(values), len(self._poses.sweep)
        overlap = self._overlap(M)
        if overlap:
            return Verdict(np.inf, Refusal.OVERLAP, overlap, n_untested=n_sweeps + 1)
        arrays = self._shifted_filter(M).arrays()
        blocker = self._blocking_start(arrays)
        if blocker:
            return Verdict(np.inf, Refusal.START, blocker, n_untested=n_sweeps)
        return self._cycle(M, arrays)

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

    def _cycle(self, M: FloatArray, arrays: tuple[FloatArray | IntArray, ...]) -> Verdict:
        problem, poses, chain = self.problem, self._poses, self._chain
        n_joints, most = chain.n_joints, problem.most_alternatives
        T_first = np.ascontiguousarray(M @ poses.T_base_flange)
        direction = np.ascontiguousarray(poses.direction @ M[:3, :3].T)
        entries, exits, durations, counts = [], [], [], []

        def refused(row: int, cause: int) -> Verdict:
            left = len(poses.sweep) - 1 - row
            return Verdict(np.inf, Refusal.SWEEP, problem.names[poses.sweep[row]], cause, left)

        for row in range(len(poses.sweep)):
            n = int(poses.n_poses[row])
            T, first = np.empty((n, 4, 4)), np.array([0, n])
            spread_poses(T_first, direction, poses.step, np.array([row]), first, T)
            q = self._solutions(T, first)
            pieces, outcome = self._followed(arrays, row, T, q)
            best = best_piece(pieces)
            begin, end = (int(pieces[best, 0]), int(pieces[best, 1])) if best >= 0 else (0, -1)
            at = poses.first_travel[row] + poses.step[row] * np.array([begin, end])
            needed = problem.required[poses.sweep[row]]
            if best < 0 or at[0] > needed[0] + SAME_TRAVEL or at[1] < needed[1] - SAME_TRAVEL:
                return refused(row, outcome if best < 0 else int(Cause.TOO_SHORT))
            entry, exit_ = np.empty((most, n_joints)), np.empty((most, n_joints))
            count = alternatives_into(
                *(q, pieces, begin, end, chain.lower, chain.upper, chain.max_velocity, self._start, entry, exit_)
            )
            if count == 0:
                return refused(row, int(Cause.JOINT_LIMIT))
            # forwards and backwards
            entries.append(np.stack([entry[:count], exit_[:count]], 1).reshape(-1, n_joints))
            exits.append(np.stack([exit_[:count], entry[:count]], 1).reshape(-1, n_joints))
            length = np.array(at[1] - at[0])
            duration = float(trapezoid_time(length, problem.follow.scan_speed, problem.tool_acceleration))
            durations.append(np.full(2 * count, duration))
            counts.append(2 * count)
        return Verdict(self._best_order(entries, exits, np.concatenate(durations), counts))

    def _followed(
        self, arrays: tuple[FloatArray | IntArray, ...], row: int, T: FloatArray, q: FloatArray
    ) -> tuple[IntArray, int]:
        """Return the pieces of one sweep if undecided states were free, (branches, 3), and its `Cause` without any."""
        problem, poses, chain, m = self.problem, self._poses, self._chain, len(self._poses.sweep)
        pieces = np.zeros((m, q.shape[1], 3), np.int64)
        hopes, q_start = pieces.copy(), np.empty((m, q.shape[1], chain.n_joints))
        outcome = np.zeros((m, 2), np.int32)
        follow = problem.follow
        follow_rows(
            *(arrays, chain.T_parent_joint, chain.axis, chain.lower, chain.upper, chain.max_velocity, self._start),
            *(np.array([row]), np.array([0, len(T)]), T @ self._T_flange_last, q, self._ik.family == PARALLEL_AXES),
            *(poses.step, poses.first_travel, poses.useful, poses.entry, self._sample_travel),
            *(follow.scan_speed, follow.clearance, follow.shortest, len(problem.cell.bodies)),
            *(pieces, hopes, q_start, outcome),
        )
        return hopes[row], int(outcome[row, 0])

    def _best_order(
        self, entries: Sequence[FloatArray], exits: Sequence[FloatArray], duration: FloatArray, counts: list[int]
    ) -> float:
        """Return the duration of the best order of all sweeps, with the way from the start and perhaps back."""
        chain = self._chain
        first = np.array([0, *itertools.accumulate(counts)], np.int32)
        cost = straight_times(
            np.concatenate([*exits, self._start[None]]),
            np.concatenate([*entries, self._start[None]]),
            chain.max_velocity,
            chain.max_acceleration,
        )
        if not self.problem.returns:
            cost[:, -1] = 0.0
        if len(counts) <= EXACT_UP_TO:
            totals, _, _ = held_karp(cost, duration, first, np.inf)
            return float(totals.min())
        total, _ = improve_sequence(_nearest_next(cost, first), cost, duration, first)
        return float(total)


def _nearest_next(cost: FloatArray, first: Int32Array) -> Int32Array:
    """Return sweeps in the order in which the nearest option comes next."""
    n = len(first) - 1
    sweep_of, left = np.repeat(np.arange(n), np.diff(first)), np.ones(len(cost) - 1, bool)
    at, sequence = len(cost) - 1, np.empty(n, np.int32)
    for place in range(n):
        at = int(np.argmin(np.where(left, cost[at, :-1], np.inf)))
        sequence[place] = sweep_of[at]
        left &= sweep_of != sweep_of[at]
    return sequence
