"""How quickly can followed sweeps be executed one after the other, if nothing is in the way? Kernels of `placement`.

Of each followed sweep: its alternatives, which are branches and windings (whole turns of joints that their limits have
room for), the nearest to the start configuration first, as in `cellwright.solvers.sweeps.alternatives`. Between any
two ends: the time of the straight joint motion from rest to rest, in closed form.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.solvers.joint_branches import TURN, turns_within

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
        for joint in range(n_joints):
            low, high = math.inf, -math.inf
            for k in range(first, last + 1):
                low, high = min(low, q[k, branch, joint]), max(high, q[k, branch, joint])
            fewest, _ = turns_within(low, lower[joint], upper[joint])
            _, greatest = turns_within(high, lower[joint], upper[joint])
            least[joint], span[joint] = fewest, greatest - fewest + 1
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
