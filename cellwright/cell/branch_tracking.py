"""All inverse kinematics branches along paths, solved at a few poses and followed between them.

For solvers that take long. Poses some steps apart are solved; between two of them every branch is followed by Newton's
method. If each branch of the one arrives at another branch of the other and none is left over, the stretch is done;
else a branch begins or ends in between, or two come too close, and the pose in the middle is solved too, down to
neighbours. So a stretch costs what it is worth: little where branches run side by side.

Every configuration meets its pose within 1e-9 m and rad. A branch that begins and ends between two solved poses without
any other one changing is not seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.cell.chain_kinematics import track_pose
from cellwright.cell.robot import Chain

_APART = 8
"""Largest distance of the poses that are solved at first, in steps."""
_ARRIVED = 1e-9
_MOST_STEPS = 8
_FURTHEST_TURN = 0.5
"""Joint change a step (rad) beyond which Newton's method may have gone to another branch."""
_SAME = 1e-4
"""Configurations whose joints all differ by less than this are one branch, rad."""


def solve_paths(
    solve: Callable[[FloatArray], FloatArray], chain: Chain, T_base_flange: FloatArray, first: IntArray
) -> FloatArray:
    """Return the branches (n, branches, joints) in rad of all poses (n, 4, 4) of paths; NaN rows where there are fewer.

    Args:
        solve: Poses (m, 4, 4) to all their branches (m, branches, joints).
        chain: The arm.
        T_base_flange: Poses of all paths, one path after the other.
        first: First pose of each path, and the end, (paths + 1,).
    """
    ends = [_spread(a, b) for a, b in zip(first[:-1].tolist(), (first[1:] - 1).tolist()) if b >= a]
    seeds = np.concatenate([np.empty(0, np.int64), *ends])
    solved = solve(T_base_flange[seeds])
    q = np.full((len(T_base_flange), *solved.shape[1:]), math.nan)
    q[seeds] = solved
    stretches = np.concatenate([np.empty((0, 2), np.int64), *(np.stack([e[:-1], e[1:]], -1) for e in ends)])
    while len(stretches):
        stretches = np.ascontiguousarray(stretches[stretches[:, 1] > stretches[:, 0] + 1])
        done = np.zeros(len(stretches), bool)
        _follow_stretches(chain.T_parent_joint, chain.axis, chain.T_last_flange, T_base_flange, stretches, q, done)
        begin, end = stretches[~done].T
        middle = (begin + end) // 2
        if len(middle):
            q[middle] = solve(T_base_flange[middle])
        stretches = np.concatenate([np.stack([begin, middle], -1), np.stack([middle, end], -1)])
    return q


def _spread(begin: int, end: int) -> IntArray:
    """Return rows from ``begin`` to ``end`` at most `_APART` apart."""
    count = max(1, math.ceil((end - begin) / _APART))
    return np.unique(np.linspace(begin, end, count + 1).round().astype(np.int64))


@numba.njit(cache=True, nogil=True)
def _follow_stretches(
    T_parent_joint: FloatArray,
    axis: FloatArray,
    T_last_flange: FloatArray,
    T_base_flange: FloatArray,
    stretches: IntArray,
    q: FloatArray,
    done: BoolArray,
) -> None:
    """Follow all branches of each stretch (first and last pose, both solved) in place; tell which were followed."""
    n_branches, n_joints = q.shape[1:]
    taken = np.empty(n_branches, np.bool_)
    for row in range(len(stretches)):
        begin, end = stretches[row]
        taken[:] = False
        followed = True
        for branch in range(n_branches):
            if math.isnan(q[begin, branch, 0]):
                continue
            for k in range(begin + 1, end + 1):
                found, arrived = track_pose(
                    T_parent_joint, axis, T_last_flange, q[k - 1, branch], T_base_flange[k], _ARRIVED, _MOST_STEPS
                )
                followed = arrived and _apart(found, q[k - 1, branch]) <= _FURTHEST_TURN
                if not followed or k == end:
                    break
                for joint in range(n_joints):
                    wrapped = found[joint] - 2.0 * math.pi * math.ceil(found[joint] / (2.0 * math.pi) - 0.5)
                    q[k, branch, joint] = wrapped if wrapped > -math.pi else math.pi
            if followed:
                followed = False
                for other in range(n_branches):
                    if not taken[other] and _apart(found, q[end, other]) < _SAME:
                        taken[other] = followed = True
                        break
            if not followed:
                break
        for other in range(n_branches):
            followed = followed and (taken[other] or math.isnan(q[end, other, 0]))
        done[row] = followed
        if not followed:
            q[begin + 1 : end] = math.nan


@numba.njit(cache=True, nogil=True)
def _apart(q: FloatArray, other: FloatArray) -> float:
    """Return the largest difference of two configurations in rad, full turns aside; NaN if one is NaN."""
    greatest = 0.0
    for joint in range(len(q)):
        if math.isnan(other[joint]):
            return math.nan
        difference = abs(q[joint] - other[joint])
        greatest = max(greatest, abs(difference - 2.0 * math.pi * math.floor(difference / (2.0 * math.pi) + 0.5)))
    return greatest
