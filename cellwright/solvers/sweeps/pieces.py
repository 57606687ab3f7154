"""Which pieces of a sweep an arm can execute, given its states: kernels of `cellwright.solvers.sweeps.following`.

A piece is a run of poses of one branch whose states are good and linked, and for which each joint has a number of
full turns that keeps it within its limits all along. All longest runs are looked at, so the answer is exact.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int8Array, Int32Array, IntArray
from cellwright.causes import Cause
from cellwright.solvers.joint_branches import TURN, greatest_changes, turns_within
from cellwright.solvers.state_tests import BEYOND_LIMITS, CLEAR, COLLIDING, UNDECIDED, FilterArrays
from cellwright.solvers.sweeps.states import classify_sweep

_OUT_OF_REACH, _JOINT_LIMIT, _COLLISION = int(Cause.OUT_OF_REACH), int(Cause.JOINT_LIMIT), int(Cause.COLLISION)
_JOINT_SPEED, _TOO_SHORT = int(Cause.JOINT_SPEED), int(Cause.TOO_SHORT)
ON_END = 1e-9
"""Metres by which rounding may put a sample beyond the end of a piece."""


@numba.njit(cache=True, nogil=True, _nrt=False)
def n_between(travel: FloatArray, start: float, end: float) -> int:
    """Count the sorted travels (m) from ``start`` to ``end``."""
    return int(
        np.searchsorted(travel, end + ON_END, side="right") - np.searchsorted(travel, start - ON_END, side="left")
    )


@numba.njit(cache=True, nogil=True, _nrt=False)
def _narrowed(q: FloatArray, lower: FloatArray, upper: FloatArray, least: FloatArray, most: FloatArray) -> bool:
    """Intersect the permitted turns (joints,) with those of one configuration; False if none is left."""
    possible = True
    for joint in range(len(q)):
        first, last = turns_within(q[joint], lower[joint], upper[joint])
        least[joint], most[joint] = max(least[joint], first), min(most[joint], last)
        possible = possible and least[joint] <= most[joint]
    return possible


@numba.njit(cache=True, nogil=True)
def longest_piece(
    q: FloatArray,
    linked: BoolArray,
    status: Int8Array,
    lowest_status: int,
    lower: FloatArray,
    upper: FloatArray,
    first_travel: float,
    step: float,
    shortest: float,
    sample_travel: FloatArray,
) -> tuple[int, int, int]:
    """Find the longest piece of one branch that measures a sample: first and last pose, number of samples.

    ``q`` (poses, joints) unwrapped; good are states of at least ``lowest_status``; ``sample_travel``: sorted
    travels of the samples in m. Ties go to the earlier piece; (0, -1, 0) if there is none.
    """
    n, n_joints = q.shape
    least, most = np.empty(n_joints), np.empty(n_joints)
    best_first, best_last, best_count = 0, -1, 0
    first = 0
    for k in range(n + 1):
        good = k < n and status[k] >= lowest_status
        goes_on = good and k > first and linked[k]
        if goes_on:
            goes_on = _narrowed(q[k], lower, upper, least, most)
        if goes_on:
            continue
        last = k - 1
        long_enough = (last - first) * step >= shortest - ON_END
        if long_enough and last - first > best_last - best_first:
            count = n_between(sample_travel, first_travel + first * step, first_travel + last * step)
            if count > 0:
                best_first, best_last, best_count = first, last, count
        if not good:
            first = k + 1
        else:
            # the next run begins as early as the turns permit
            begin = k
            least[:], most[:] = -math.inf, math.inf
            _narrowed(q[k], lower, upper, least, most)
            while begin > first and linked[begin]:
                if not _narrowed(q[begin - 1], lower, upper, least, most):
                    break
                begin -= 1
            first = begin
            least[:], most[:] = -math.inf, math.inf
            for pose in range(first, k + 1):
                _narrowed(q[pose], lower, upper, least, most)
    return best_first, best_last, best_count


@numba.njit(cache=True, nogil=True)
def wound_into(q: FloatArray, lower: FloatArray, upper: FloatArray, reference: FloatArray, out: FloatArray) -> bool:
    """Write the first configuration of a path (poses, joints), wound to be nearest to ``reference``, to ``out``.

    The same turns keep the whole path within the limits. Returns whether there are such turns.
    """
    n_joints = q.shape[1]
    least, most = np.full(n_joints, -math.inf), np.full(n_joints, math.inf)
    for k in range(len(q)):
        if not _narrowed(q[k], lower, upper, least, most):
            return False
    for joint in range(n_joints):
        turns = math.floor((reference[joint] - q[0, joint]) / TURN + 0.5)
        wound = q[0, joint] + TURN * min(max(turns, least[joint]), most[joint])
        out[joint] = min(max(wound, lower[joint]), upper[joint])
    return True


@numba.njit(cache=True, nogil=True, _nrt=False)
def _is_alone(status: Int8Array, k: int) -> bool:
    """Tell whether pose ``k`` of a branch is clear but no pose beside it is, although there is one."""
    before, after = k > 0 and status[k - 1] == CLEAR, k + 1 < len(status) and status[k + 1] == CLEAR
    return status[k] == CLEAR and len(status) > 1 and not (before or after)


@numba.njit(cache=True, nogil=True)
def _clear_cause(
    status: Int8Array,
    linked: BoolArray,
    k: int,
    first_travel: float,
    step: float,
    shortest: float,
    sample_travel: FloatArray,
) -> int:
    """Return what keeps the clear pose ``k`` of a branch out of a piece; of one that is alone its neighbours tell."""
    if _is_alone(status, k):
        return _OUT_OF_REACH
    n = len(status)
    begin = end = k
    while begin > 0 and linked[begin] and status[begin - 1] == CLEAR:
        begin -= 1
    while end + 1 < n and linked[end + 1] and status[end + 1] == CLEAR:
        end += 1
    if begin == end and n > 1:
        return _JOINT_SPEED
    # a run that is long enough and measures a sample lacks nothing but turns that fit all of it
    if (end - begin) * step >= shortest - ON_END and (
        n_between(sample_travel, first_travel + begin * step, first_travel + end * step) > 0
    ):
        return _JOINT_LIMIT
    return _TOO_SHORT


@numba.njit(cache=True, nogil=True)
def sweep_outcome(
    status: Int8Array,
    blocker: Int32Array,
    linked: BoolArray,
    first: int,
    last: int,
    first_travel: float,
    step: float,
    shortest: float,
    sample_travel: FloatArray,
    n_bodies: int,
) -> tuple[int, int]:
    """Return the furthest `Cause` over branches and the poses ``first`` to ``last`` of a sweep without a piece.

    With it goes the body (row) in the way of most of these states if the cause is a collision, else -1. What
    was left undecided counts as a collision.
    """
    cause = _OUT_OF_REACH
    n_blocked = np.zeros(n_bodies, np.int64)
    n_branches, n = status.shape
    for branch in range(n_branches):
        # the neighbours of a clear pose that is alone tell why, also where they lie beyond the ends
        begin = first - 1 if first > 0 and _is_alone(status[branch], first) else first
        end = last + 1 if last + 1 < n and _is_alone(status[branch], last) else last
        for k in range(begin, end + 1):
            state = status[branch, k]
            if state == BEYOND_LIMITS:
                cause = max(cause, _JOINT_LIMIT)
            elif state in (COLLIDING, UNDECIDED):
                cause = max(cause, _COLLISION)
                n_blocked[blocker[branch, k]] += 1
            elif state == CLEAR:
                if k > begin and linked[branch, k] and status[branch, k - 1] == CLEAR:
                    continue  # of the same run as the pose before
                found = _clear_cause(status[branch], linked[branch], k, first_travel, step, shortest, sample_travel)
                cause = max(cause, found)
    return cause, int(np.argmax(n_blocked)) if cause == _COLLISION else -1


@numba.njit(cache=True, nogil=True)
def evaluate_sweep(
    q: FloatArray,
    linked: BoolArray,
    status: Int8Array,
    blocker: Int32Array,
    lower: FloatArray,
    upper: FloatArray,
    reference: FloatArray,
    first_travel: float,
    step: float,
    useful: IntArray,
    shortest: float,
    sample_travel: FloatArray,
    n_bodies: int,
    pieces: IntArray,
    hopes: IntArray,
    q_start: FloatArray,
) -> tuple[int, int]:
    """Find the longest piece of every branch of one sweep; return its outcome (`Cause`) and the body in the way.

    ``pieces`` (branches, 3) receives first pose, last pose and number of samples with only clear states,
    ``hopes`` the same if all undecided states were clear; ``q_start`` (branches, joints) the wound start of each
    piece. ``useful`` (2,): first and last pose of the useful interval.
    """
    n_branches = q.shape[1]
    found = False
    for branch in range(n_branches):
        path = np.ascontiguousarray(q[:, branch])
        for lowest_status, out in ((CLEAR, pieces), (UNDECIDED, hopes)):
            if lowest_status == UNDECIDED and not (status[branch] == UNDECIDED).any():
                out[branch] = pieces[branch]
                continue
            out[branch, 0], out[branch, 1], out[branch, 2] = longest_piece(
                path,
                linked[branch],
                status[branch],
                lowest_status,
                lower,
                upper,
                first_travel,
                step,
                shortest,
                sample_travel,
            )
        if pieces[branch, 2] > 0:
            found = True
            wound_into(path[pieces[branch, 0] : pieces[branch, 1] + 1], lower, upper, reference, q_start[branch])
    if found:
        return 0, -1
    cause, body = sweep_outcome(
        status, blocker, linked, useful[0], useful[1], first_travel, step, shortest, sample_travel, n_bodies
    )
    return cause, body


@numba.njit(cache=True, nogil=True)
def follow_rows(
    f: FilterArrays,
    T_parent_joint: FloatArray,
    axis: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    max_velocity: FloatArray,
    reference: FloatArray,
    rows: IntArray,
    first: IntArray,
    T_base_last: FloatArray,
    q: FloatArray,
    places_kept: bool,
    step: FloatArray,
    first_travel: FloatArray,
    useful: IntArray,
    entry: IntArray,
    sample_travel: FloatArray,
    scan_speed: float,
    clearance: float,
    shortest: float,
    n_bodies: int,
    pieces: IntArray,
    hopes: IntArray,
    q_start: FloatArray,
    outcome: Int32Array,
) -> None:
    """Classify and evaluate many sweeps: ``rows`` of the tables; see `classify_sweep` and `evaluate_sweep`.

    Sweep ``rows[i]`` has the poses ``first[i]`` to ``first[i + 1]`` of ``T_base_last`` (poses, 4, 4) and ``q``
    (poses, branches, joints).
    """
    n_branches = q.shape[1]
    for place in range(len(rows)):
        row, a, b = rows[place], first[place], first[place + 1]
        linked = np.empty((n_branches, b - a), np.bool_)
        status = np.empty((n_branches, b - a), np.int8)
        blocker = np.empty((n_branches, b - a), np.int32)
        shift = np.empty((n_branches, b - a))
        greatest = greatest_changes(max_velocity, step[row], scan_speed)
        classify_sweep(
            f,
            T_parent_joint,
            axis,
            lower,
            upper,
            greatest,
            T_base_last[a:b],
            q[a:b],
            places_kept,
            step[row],
            clearance,
            shortest,
            linked,
            status,
            blocker,
            shift,
        )
        outcome[row, 0], outcome[row, 1] = evaluate_sweep(
            q[a:b],
            linked,
            status,
            blocker,
            lower,
            upper,
            reference,
            first_travel[row],
            step[row],
            useful[row],
            shortest,
            sample_travel[entry[row, 0] : entry[row, 1]],
            n_bodies,
            pieces[row],
            hopes[row],
            q_start[row],
        )
