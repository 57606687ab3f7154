"""How quickly can followed sweeps be executed one after the other, if nothing is in the way? Kernels of `cycles`.

Of each followed sweep: its alternatives, which are branches and windings (whole turns of joints that their limits have
room for), the nearest to the start configuration first, as in `cellwright.solvers.sweeps.alternatives`. Between any
two ends: the time of the straight joint motion from rest to rest in closed form, and a time that none undercuts.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int8Array, IntArray
from cellwright.solvers.joint_branches import TURN, turns_within
from cellwright.solvers.state_tests import UNDECIDED

_STILL = 1e-12
"""Rad; a joint that turns less holds still."""


@numba.njit(cache=True, nogil=True)
def best_piece(pieces: IntArray) -> int:
    """Return the branch of the best of the pieces (branches, 3), -1 if there is none.

    Pieces are first pose, last pose, samples. Most samples win, then the longest, then the lowest branch.
    """
    best, most, longest = -1, 0, 0
    for branch in range(len(pieces)):
        samples, length = pieces[branch, 2], pieces[branch, 1] - pieces[branch, 0]
        if samples > most or (samples == most > 0 and length > longest):
            best, most, longest = branch, samples, length
    return best


@numba.njit(cache=True, nogil=True)
def holding_runs(
    q: FloatArray,
    linked: BoolArray,
    status: Int8Array,
    lower: FloatArray,
    upper: FloatArray,
    first: int,
    last: int,
) -> IntArray:
    """Return each branch's longest run of linked states, none certainly blocked, that holds two poses, (branches, 3).

    First and last pose of the run and 1; zeros where there is none, or where no number of turns keeps the poses from
    ``first`` to ``last`` within the limits. Every executable piece that holds these poses lies within such a run.

    Args:
        q: Solutions, (poses, branches, joints).
        linked, status: Whether a state continues the one before, and its state, (branches, poses).
        lower, upper: Limits of the joints, (joints,).
        first, last: Poses that must be executed.
    """
    n, n_branches, _ = q.shape
    runs = np.zeros((n_branches, 3), np.int64)
    for branch in range(n_branches):
        holds = status[branch, first] >= UNDECIDED
        for k in range(first + 1, last + 1):
            holds = holds and linked[branch, k] and status[branch, k] >= UNDECIDED
        if not holds:
            continue
        turns = turns_along(q[first : last + 1, branch], lower, upper)
        if (turns[0] > turns[1]).any():
            continue
        begin, end = first, last
        while begin > 0 and linked[branch, begin] and status[branch, begin - 1] >= UNDECIDED:
            begin -= 1
        while end + 1 < n and linked[branch, end + 1] and status[branch, end + 1] >= UNDECIDED:
            end += 1
        runs[branch] = begin, end, 1
    return runs


@numba.njit(cache=True, nogil=True)
def turns_along(path: FloatArray, lower: FloatArray, upper: FloatArray) -> IntArray:
    """Return the least and the most full turns that keep a path (poses, joints) within its limits, (2, joints)."""
    n_joints = path.shape[1]
    turns = np.empty((2, n_joints), np.int64)
    for joint in range(n_joints):
        low, high = math.inf, -math.inf
        for k in range(len(path)):
            low, high = min(low, path[k, joint]), max(high, path[k, joint])
        turns[0, joint], _ = turns_within(low, lower[joint], upper[joint])
        _, turns[1, joint] = turns_within(high, lower[joint], upper[joint])
    return turns


@numba.njit(cache=True, nogil=True)
def alternatives_into(
    q: FloatArray,
    pieces: IntArray,
    first: int,
    last: int,
    lower: FloatArray,
    upper: FloatArray,
    velocity: FloatArray,
    start: FloatArray,
    entries: FloatArray,
    exits: FloatArray,
) -> int:
    """Write where the alternatives of one sweep begin and end, (most, joints) in rad; return how many there are.

    Args:
        q: Solutions, a branch continuous along its piece, (poses, branches, joints).
        pieces: First pose, last pose, samples of each branch's piece, (branches, 3).
        first, last: Poses between which the sweep is executed.
        lower, upper, velocity: Limits of the joints, (joints,).
        start: What the nearest alternatives are near to, (joints,).
        entries, exits: Room for the alternatives; only the nearest are kept.
    """
    n_joints, most = q.shape[2], len(entries)
    away = np.full(most, math.inf)
    least, span, turns = np.empty(n_joints, np.int64), np.empty(n_joints, np.int64), np.empty(n_joints)
    count = 0
    for branch in range(q.shape[1]):
        if pieces[branch, 2] <= 0 or pieces[branch, 0] > first or pieces[branch, 1] < last:
            continue
        n_ways = 1
        within = turns_along(q[first : last + 1, branch], lower, upper)
        for joint in range(n_joints):
            least[joint], span[joint] = within[0, joint], within[1, joint] - within[0, joint] + 1
            n_ways *= max(span[joint], 0)
        middle = (first + last) // 2
        for way in range(n_ways):
            rest, slowest = way, 0.0
            for joint in range(n_joints):
                turns[joint] = TURN * (least[joint] + rest % span[joint])
                rest //= span[joint]
                slowest = max(slowest, abs(q[middle, branch, joint] + turns[joint] - start[joint]) / velocity[joint])
            place = count if count < most else most
            while place > 0 and away[place - 1] > slowest:
                if place < most:
                    away[place] = away[place - 1]
                    entries[place], exits[place] = entries[place - 1], exits[place - 1]
                place -= 1
            if place < most:
                away[place] = slowest
                for joint in range(n_joints):
                    entries[place, joint] = q[first, branch, joint] + turns[joint]
                    exits[place, joint] = q[last, branch, joint] + turns[joint]
                count = min(count + 1, most)
    return count


@numba.njit(cache=True, nogil=True)
def straight_times(
    exits: FloatArray, entries: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Return the times of straight joint motions from rest to rest, from each exit (n, joints) to each entry."""
    n = len(exits)
    times = np.zeros((n, n))
    for a in range(n):
        for b in range(n):
            speed, gain = math.inf, math.inf
            for joint in range(exits.shape[1]):
                way = abs(entries[b, joint] - exits[a, joint])
                if way > _STILL:
                    speed, gain = min(speed, velocity[joint] / way), min(gain, acceleration[joint] / way)
            if gain < math.inf:
                reaches_speed = gain >= speed * speed
                times[a, b] = 1.0 / speed + speed / gain if reaches_speed else 2.0 / math.sqrt(gain)
    return times


@numba.njit(cache=True, nogil=True)
def least_connections(
    q: FloatArray,
    reach: FloatArray,
    turns: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    share: float,
) -> FloatArray:
    """Return times that no motion from one option's exit to another's entry undercuts, (options, options).

    Each joint alone needs its trapezoid over the way that is left, whole turns apart. A plan may shorten the way by up
    to the two ends' reach if it executes more of the sweeps; at scanning speed no joint turns faster than its limit, so
    that takes ``share`` of the time that the joint needs at full speed, which is counted here. Between nothing and all
    of it the sum is concave: one of these is least.

    Args:
        q: Where options begin and end, (options, 2, joints) in rad.
        reach: Ways by which each joint may begin or end elsewhere, (options, 2, joints).
        turns: Least and most full turns of each option, (options, 2, joints).
        velocity, acceleration: Limits of the joints, (joints,).
        share: Scanning speed at which sweeps were followed as a share of that at which they are executed.
    """
    n = len(q)
    times = np.zeros((n, n))
    for a in range(n):
        for b in range(n):
            for joint in range(q.shape[2]):
                way = q[b, 0, joint] - q[a, 1, joint]
                fewest, most = turns[b, 0, joint] - turns[a, 1, joint], turns[b, 1, joint] - turns[a, 0, joint]
                way = abs(way + TURN * min(max(math.floor(0.5 - way / TURN), fewest), most))
                saved = min(way, reach[a, 1, joint] + reach[b, 0, joint])
                whole = _rest_to_rest(way, velocity[joint], acceleration[joint])
                nearer = _rest_to_rest(way - saved, velocity[joint], acceleration[joint])
                least = min(whole, nearer + share * saved / velocity[joint])
                times[a, b] = max(times[a, b], least)
    return times


@numba.njit(cache=True, nogil=True)
def _rest_to_rest(way: float, velocity: float, acceleration: float) -> float:
    """Return the time of the trapezoid over a way of one joint."""
    if way * acceleration >= velocity * velocity:
        return way / velocity + velocity / acceleration
    return 2.0 * math.sqrt(way / acceleration)
