"""Continuous branches of joint solutions along a path: matching, unwrapping, full turns within the limits."""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray

TURN = 2.0 * math.pi
ON_LIMIT = 1e-9
"""Radians by which rounding may put a joint beyond its limit."""
_SURELY_NEAR = 3.14
"""Angles closer than this are less than half a turn apart, whatever the rounding."""
GREATEST_TURN = 0.5
"""Largest joint change a step in rad, however slow the scan: beyond it nearest solutions are no proof of continuity."""


@numba.njit(cache=True, nogil=True)
def greatest_changes(max_velocity: FloatArray, step: float, scan_speed: float) -> FloatArray:
    """Return how far each joint may turn from pose to pose, (joints,) in rad."""
    return np.minimum(max_velocity * (step / scan_speed), GREATEST_TURN)


@numba.njit(cache=True, nogil=True, _nrt=False)
def unwrapped(angle: float, near: float) -> float:
    """Return ``angle`` plus the full turns that bring it closest to ``near``."""
    if abs(near - angle) < _SURELY_NEAR:  # saves the division on most poses
        return angle
    return angle + TURN * math.floor((near - angle) / TURN + 0.5)


@numba.njit(cache=True, nogil=True, _nrt=False)
def turns_within(q: float, lower: float, upper: float) -> tuple[int, int]:
    """Return the least and the most full turns that bring ``q`` into its limits; least > most if none does."""
    return math.ceil((lower - q - ON_LIMIT) / TURN), math.floor((upper - q + ON_LIMIT) / TURN)


@numba.njit(cache=True, nogil=True, _nrt=False)
def within_limits(q: float, lower: float, upper: float) -> bool:
    """Tell whether some number of full turns brings ``q`` into its limits."""
    if lower <= q <= upper:  # saves the divisions on most states
        return True
    least, most = turns_within(q, lower, upper)
    return bool(least <= most)


@numba.njit(cache=True, nogil=True, _nrt=False)
def _change(before: FloatArray, after: FloatArray, greatest: FloatArray) -> float:
    """Return the largest joint change between two solutions as a share of the greatest one permitted."""
    share = 0.0
    for joint in range(len(before)):
        share = max(share, abs(unwrapped(after[joint], before[joint]) - before[joint]) / greatest[joint])
    return share


@numba.njit(cache=True, nogil=True)
def _matches_into(before: FloatArray, after: FloatArray, greatest: FloatArray, source: IntArray) -> None:
    """Match the branches (rows, NaN if missing) of two poses, closest first: ``source[new] = old``, or -1."""
    n = len(before)
    cost = np.full((n, n), math.inf)
    for old in range(n):
        for new in range(n):
            if not (math.isnan(before[old, 0]) or math.isnan(after[new, 0])):
                cost[old, new] = _change(before[old], after[new], greatest)
    source[:] = -1
    while True:
        best = int(np.argmin(cost))
        old, new = best // n, best % n
        if not cost[old, new] <= 1.0:
            return
        source[new] = old
        cost[old, :] = math.inf
        cost[:, new] = math.inf


@numba.njit(cache=True, nogil=True)
def order_branches(q: FloatArray, places_kept: bool, greatest: FloatArray, linked: BoolArray) -> None:
    """Order solutions ``q`` (poses, branches, joints) in place so that branches continue in their row, unwrapped.

    ``linked`` (poses, branches) tells where a branch continues from the pose before. ``places_kept``: the solver
    keeps each branch in its row already. ``greatest`` (joints,): the largest change a step, in rad.
    """
    n, n_branches, n_joints = q.shape
    linked[0, :] = False
    source, target = np.empty(n_branches, np.int64), np.empty(n_branches, np.int64)
    moved = np.empty((n_branches, n_joints))
    for k in range(1, n):
        if not places_kept:
            _matches_into(q[k - 1], q[k], greatest, source)
            target[:] = -1
            for new in range(n_branches):
                if source[new] >= 0:
                    target[source[new]] = new
            free = 0
            for new in range(n_branches):
                if source[new] < 0:
                    while target[free] >= 0:
                        free += 1
                    target[free] = new
            for row in range(n_branches):
                moved[row] = q[k, target[row]]
            q[k] = moved
        for branch in range(n_branches):
            linked[k, branch] = False
            if math.isnan(q[k, branch, 0]) or math.isnan(q[k - 1, branch, 0]):
                continue
            goes_on = True
            for joint in range(n_joints):
                q[k, branch, joint] = unwrapped(q[k, branch, joint], q[k - 1, branch, joint])
                goes_on = goes_on and abs(q[k, branch, joint] - q[k - 1, branch, joint]) <= greatest[joint]
            linked[k, branch] = goes_on
