"""Follow straight scanner sweeps with an arm: which pieces can it execute, in which branch, and if none, why.

Kaiser 2021, section 4.2, step 4: each sweep, trimmed to its useful interval plus a margin, is cut into poses a step
apart; every inverse kinematics branch at every pose is tested for joint limits, collisions, and continuity at the
scanning speed. Kept is the longest executable piece of each branch.

Collisions are decided by balls and distance bounds (`cellwright.cell.sphere_filter`) that never call a colliding
state free. What they leave undecided counts as blocked at first. Then the exact engine is asked, only where its
answer can change a sweep's best piece, in a fixed order: first sweeps without any piece, then those that would gain
most samples, until ``max_exact_checks`` states were tested. The result depends on nothing but the inputs: neither on
time nor on the number of threads.

Cost: about 1 us a pose for the closed-form inverse kinematics and 0.7 us a state for the tests; 20,000 sweeps take
seconds on two cores. Arms without a quick solver are solved at some poses only and followed between them.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray, Int8Array, Int32Array, IntArray
from cellwright.cell import parallel_axes
from cellwright.cell.branch_tracking import solve_paths
from cellwright.cell.cell import Cell
from cellwright.cell.inverse_kinematics import PARALLEL_AXES, InverseKinematics, inverse_kinematics_for
from cellwright.cell.sphere_filter import SphereFilter, sphere_filter
from cellwright.cell.transforms import inverse
from cellwright.solvers.joint_branches import greatest_changes
from cellwright.solvers.sweeps.pieces import evaluate_sweep, follow_rows
from cellwright.solvers.sweeps.poses import CandidateSweeps, FollowSettings, SweepPoses, spread_poses, sweep_poses
from cellwright.solvers.sweeps.settling import Budget, CollisionCheck, SweepStates, settle_sweep
from cellwright.solvers.sweeps.states import classify_sweep

_POSES_PER_CHUNK = 8_192
"""Poses that one thread works on at a time; bounds the memory for solutions to a few megabytes a thread."""
_FIELD_PADDING = 0.1
"""Metres around a standing mesh in which its distance is tabulated: as far as the largest ball is thick."""

_SETTLED_AT_ONCE = 64
"""Sweeps whose states are found again together before the exact engine is asked about them."""


@dataclass(frozen=True, eq=False)
class FollowedSweeps:
    """The executable pieces, by sweep and within a sweep the best first, and why sweeps have none.

    Attributes:
        sweep, branch: (pieces,).
        start, end: Travel in m, (pieces,).
        n_samples: Samples measured within the piece, (pieces,).
        q_start: Joint configuration at the start, (pieces, joints) in rad.
        outcome: `Cause` of each sweep, 0 if it has a piece, (sweeps,).
        blocked_by: Row of the body in the way of most states where the outcome is a collision, else -1.
        n_exact_checks: States that the exact engine was asked about.
        n_unsettled: Sweeps whose best piece might be better if undecided states had been asked about too.
    """

    sweep: Int32Array
    branch: Int8Array
    start: FloatArray
    end: FloatArray
    n_samples: IntArray
    q_start: FloatArray
    outcome: Int8Array
    blocked_by: Int32Array
    n_exact_checks: int
    n_unsettled: int


def follow_sweeps(
    cell: Cell,
    sweeps: CandidateSweeps,
    *,
    settings: FollowSettings,
    exact: CollisionCheck | None = None,
    n_threads: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> FollowedSweeps:
    """Find the executable pieces of all sweeps.

    Without ``exact`` undecided states stay blocked. ``cell`` has the part in it if the sweeps go around one.
    ``n_threads``: as many as cores if left out; the result does not depend on it.

    Raises:
        InvalidInputError: If the arm has no inverse kinematics or a sweep's interval is malformed.
    """
    poses = sweep_poses(cell, sweeps, settings)
    follower = _Follower(cell, settings, sweeps)
    table = _Table.empty(len(poses.sweep), follower.ik.n_branches, cell.robot.chain.n_joints)
    n_checks = n_unsettled = 0
    with ThreadPoolExecutor(n_threads or len(os.sched_getaffinity(0))) as pool:
        jobs = [(pool.submit(follower.follow, poses, rows, table), len(rows)) for rows in _chunks(poses.n_poses)]
        done = 0
        for job, count in jobs:
            job.result()
            done += count
            progress((0.9 if exact else 1.0) * done / len(poses.sweep))
        if exact is not None:
            n_checks, n_unsettled = _settle(follower, poses, table, exact, pool, progress)
    progress(1.0)
    return _gathered(sweeps, poses, table, n_checks, n_unsettled)


def _chunks(n_poses: IntArray) -> Iterator[IntArray]:
    """Yield rows of sweeps, as many as make up a chunk of poses; the same whatever the number of threads."""
    chunk = np.cumsum(n_poses) // _POSES_PER_CHUNK
    for number in np.unique(chunk):
        yield np.flatnonzero(chunk == number)


@dataclass(frozen=True, eq=False)
class _Table:
    """What following found, by sweep and branch."""

    pieces: IntArray  # (m, branches, 3)
    hopes: IntArray
    q_start: FloatArray
    outcome: Int32Array  # (m, 2)

    @classmethod
    def empty(cls, m: int, n_branches: int, n_joints: int) -> _Table:
        pieces = np.zeros((m, n_branches, 3), np.int64)
        return cls(pieces, pieces.copy(), np.full((m, n_branches, n_joints), np.nan), np.zeros((m, 2), np.int32))


class _Follower:
    """The cell in the form that kernels take."""

    def __init__(self, cell: Cell, settings: FollowSettings, sweeps: CandidateSweeps) -> None:
        self.chain = cell.robot.chain
        self.reference = np.array(cell.start, float)
        self.settings = settings
        self.sample_travel = np.array(sweeps.sample_travel, float)
        self.n_bodies = len(cell.bodies)
        self.ik: InverseKinematics = inverse_kinematics_for(self.chain)
        self.filter: SphereFilter = sphere_filter(
            cell,
            link_overshoot=settings.link_overshoot,
            tool_overshoot=settings.tool_overshoot,
            field_spacing=settings.field_spacing,
            field_padding=_FIELD_PADDING,
        )
        self.T_flange_last = inverse(self.chain.T_last_flange)

    def solutions(self, T_base_flange: FloatArray, first: IntArray) -> FloatArray:
        """Return all branches (n, branches, joints) of flange poses (n, 4, 4); ``first``: see `solve_paths`."""
        if self.ik.family == PARALLEL_AXES:
            found: FloatArray = parallel_axes.branches(self.ik.parallel_axes_geometry, T_base_flange)
            return found
        if self.ik.slow:
            return solve_paths(self.ik.solve, self.chain, T_base_flange, first)
        return self.ik.solve(T_base_flange)

    def classify(self, poses: SweepPoses, row: int, T: FloatArray, q: FloatArray) -> SweepStates:
        """Test every state of one sweep; ``T`` (n, 4, 4) flange poses, ``q`` (n, branches, joints) is overwritten."""
        n, n_branches, _ = q.shape
        states = SweepStates(
            q,
            np.empty((n_branches, n), np.bool_),
            np.empty((n_branches, n), np.int8),
            np.empty((n_branches, n), np.int32),
            np.empty((n_branches, n)),
            float(poses.first_travel[row]),
            float(poses.step[row]),
            self.sample_travel[poses.entry[row, 0] : poses.entry[row, 1]],
        )
        classify_sweep(
            self.filter.arrays(),
            self.chain.T_parent_joint,
            self.chain.axis,
            self.chain.lower,
            self.chain.upper,
            greatest_changes(self.chain.max_velocity, states.step, self.settings.scan_speed),
            T @ self.T_flange_last,
            q,
            self.ik.family == PARALLEL_AXES,
            states.step,
            self.settings.clearance,
            self.settings.shortest,
            *(states.linked, states.status, states.blocker, states.shift),
        )
        return states

    def evaluate(self, poses: SweepPoses, row: int, states: SweepStates, table: _Table) -> None:
        """Write the pieces of one sweep to its row of the table."""
        table.outcome[row] = evaluate_sweep(
            *(states.q, states.linked, states.status, states.blocker),
            self.chain.lower,
            self.chain.upper,
            self.reference,
            states.first_travel,
            states.step,
            poses.useful[row],
            self.settings.shortest,
            states.sample_travel,
            self.n_bodies,
            *(table.pieces[row], table.hopes[row], table.q_start[row]),
        )

    def poses_and_solutions(self, poses: SweepPoses, rows: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the first pose of each sweep and the end, all flange poses (n, 4, 4), all their solutions."""
        first = np.concatenate([[0], np.cumsum(poses.n_poses[rows])])
        T = np.empty((first[-1], 4, 4))
        spread_poses(poses.T_base_flange, poses.direction, poses.step, rows, first, T)
        return first, T, self.solutions(T, first)

    def states(self, poses: SweepPoses, rows: IntArray) -> list[SweepStates]:
        """Test all states of some sweeps."""
        first, T, q = self.poses_and_solutions(poses, rows)
        parts = [slice(a, b) for a, b in itertools.pairwise(first.tolist())]
        return [self.classify(poses, int(row), T[part], q[part]) for row, part in zip(rows, parts)]

    def follow(self, poses: SweepPoses, rows: IntArray, table: _Table) -> None:
        """Fill the rows of the table for some sweeps."""
        first, T, q = self.poses_and_solutions(poses, rows)
        follow_rows(
            self.filter.arrays(),
            self.chain.T_parent_joint,
            self.chain.axis,
            self.chain.lower,
            self.chain.upper,
            self.chain.max_velocity,
            self.reference,
            rows,
            first,
            T @ self.T_flange_last,
            q,
            self.ik.family == PARALLEL_AXES,
            poses.step,
            poses.first_travel,
            poses.useful,
            poses.entry,
            self.sample_travel,
            self.settings.scan_speed,
            self.settings.clearance,
            self.settings.shortest,
            self.n_bodies,
            *(table.pieces, table.hopes, table.q_start, table.outcome),
        )


def _settle(
    follower: _Follower,
    poses: SweepPoses,
    table: _Table,
    exact: CollisionCheck,
    pool: ThreadPoolExecutor,
    progress: Callable[[float], None],
) -> tuple[int, int]:
    """Ask the exact engine where it can change a best piece; return the checks made and the sweeps left out."""
    settings = follower.settings
    n_asked = 0

    def counted(q: FloatArray) -> bool:
        nonlocal n_asked
        n_asked += 1
        return exact(q)

    has, hoped = table.pieces[:, :, 2].max(axis=1), table.hopes[:, :, 2].max(axis=1)
    gain = hoped - has
    worth = np.flatnonzero(gain > settings.worthwhile_gain * has)
    order = worth[np.lexsort((worth, -gain[worth], has[worth] > 0))]
    budget = Budget(settings.max_exact_checks)
    for begin in range(0, len(order), _SETTLED_AT_ONCE):
        rows = order[begin : begin + _SETTLED_AT_ONCE]
        halves = pool.map(lambda half: follower.states(poses, half), np.array_split(rows, 2))
        for place, (row, states) in enumerate(zip(rows.tolist(), [states for half in halves for states in half])):
            settled = settle_sweep(
                states,
                follower.chain,
                shortest=settings.shortest,
                clearance=settings.clearance,
                worthwhile_gain=settings.worthwhile_gain,
                exact=counted,
                budget=budget,
            )
            follower.evaluate(poses, row, states, table)
            if not settled:
                return n_asked, len(order) - begin - place
        progress(0.9 + 0.1 * (begin + len(rows)) / len(order))
    return n_asked, 0


def _gathered(
    sweeps: CandidateSweeps, poses: SweepPoses, table: _Table, n_checks: int, n_unsettled: int
) -> FollowedSweeps:
    """Put the pieces in order: by sweep, then most samples, then longest, then lowest branch."""
    row, branch = np.nonzero(table.pieces[:, :, 2])
    first, last, count = table.pieces[row, branch].T
    start = poses.first_travel[row] + first * poses.step[row]
    end = poses.first_travel[row] + last * poses.step[row]
    order = np.lexsort((branch, first - last, -count, row))
    outcome = np.zeros(len(sweeps.start), np.int8)
    blocked_by = np.full(len(sweeps.start), -1, np.int32)
    outcome[poses.sweep], blocked_by[poses.sweep] = table.outcome.T
    return FollowedSweeps(
        poses.sweep[row][order].astype(np.int32),
        branch[order].astype(np.int8),
        start[order],
        end[order],
        count[order],
        table.q_start[row, branch][order],
        outcome,
        blocked_by,
        n_checks,
        n_unsettled,
    )
