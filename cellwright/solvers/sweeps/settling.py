"""Settle by the exact collision engine what the filter left undecided, where that can better a sweep's best piece.

A sweep's undecided states are asked about along the piece that there would be if all of them were clear, outward from
the piece that is certain (or from the middle), until one collides; then along the longest piece that is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int8Array, Int32Array
from cellwright.cell.robot import Chain
from cellwright.solvers.state_tests import BETWEEN_POSES, CLEAR, COLLIDING, UNDECIDED
from cellwright.solvers.sweeps.pieces import longest_piece

CollisionCheck = Callable[[FloatArray], bool]
"""Tells exactly whether the arm at a configuration (joints,) comes closer to something than the clearance."""

_MOST_BETWEEN = 10
"""Configurations checked between two poses; a state whose arm moves too far for that counts as colliding."""


@dataclass(frozen=True, eq=False)
class SweepStates:
    """All states of one sweep.

    Attributes:
        q: Solutions by pose, in continuous branches, (poses, branches, joints).
        linked: Whether a branch continues from the pose before, (branches, poses).
        status, blocker: State and the row of the body in the way, (branches, poses).
        shift: Furthest way of any point of the arm from the pose before in m, (branches, poses).
        first_travel, step: Travel of the first pose and distance of the poses in m.
        sample_travel: Sorted travels of the samples in m.
    """

    q: FloatArray
    linked: BoolArray
    status: Int8Array
    blocker: Int32Array
    shift: FloatArray
    first_travel: float
    step: float
    sample_travel: FloatArray

    def piece(self, chain: Chain, branch: int, lowest_status: int, shortest: float) -> tuple[int, int, int]:
        """Return first pose, last pose and number of samples of a branch's longest piece; (0, -1, 0) if none."""
        first, last, count = longest_piece(
            np.ascontiguousarray(self.q[:, branch]),
            self.linked[branch],
            self.status[branch],
            lowest_status,
            chain.lower,
            chain.upper,
            self.first_travel,
            self.step,
            shortest,
            self.sample_travel,
        )
        return int(first), int(last), int(count)


@dataclass
class Budget:
    """How many checks the exact engine may still be asked for."""

    left: int

    def spend(self, count: int) -> bool:
        """Take ``count`` checks off; False if there are not so many left."""
        if count > self.left:
            self.left = 0
            return False
        self.left -= count
        return True


def settle_sweep(
    states: SweepStates,
    chain: Chain,
    *,
    shortest: float,
    clearance: float,
    worthwhile_gain: float,
    exact: CollisionCheck,
    budget: Budget,
) -> bool:
    """Replace undecided states that matter by clear or colliding ones, in place; lengths in m.

    Branches are settled in the order of the samples they could measure, while that is more than the best certain
    piece measures by the share ``worthwhile_gain``. Returns False if the budget ran out first.
    """
    n_branches = len(states.status)
    hopes = [states.piece(chain, branch, UNDECIDED, shortest) for branch in range(n_branches)]
    best = max(states.piece(chain, branch, CLEAR, shortest)[2] for branch in range(n_branches))
    order = sorted(
        range(n_branches), key=lambda branch: (-hopes[branch][2], hopes[branch][0] - hopes[branch][1], branch)
    )
    for branch in order:
        if hopes[branch][2] <= best * (1.0 + worthwhile_gain):
            break
        while True:
            first, last, count = states.piece(chain, branch, UNDECIDED, shortest)
            if count <= best * (1.0 + worthwhile_gain):
                break
            pose = _next_pose(states, chain, branch, first, last, shortest)
            if pose < 0:
                best = max(best, count)
                break
            between = _configurations(states, branch, pose, clearance)
            if not budget.spend(len(between)):
                return False
            collides = not len(between) or any(exact(q) for q in between)
            states.status[branch, pose] = COLLIDING if collides else CLEAR
    return True


def _next_pose(states: SweepStates, chain: Chain, branch: int, first: int, last: int, shortest: float) -> int:
    """Return the undecided pose to ask about next, -1 if there is none: the nearest to what is certain."""
    undecided = first + np.flatnonzero(states.status[branch, first : last + 1] == UNDECIDED)
    if not len(undecided):
        return -1
    sure_first, sure_last, count = states.piece(chain, branch, CLEAR, shortest)
    inside = count > 0 and first <= sure_first and sure_last <= last
    middle = 0.5 * (sure_first + sure_last) if inside else 0.5 * (first + last)
    return int(undecided[np.argmin(np.abs(undecided - middle))])


def _configurations(states: SweepStates, branch: int, pose: int, clearance: float) -> FloatArray:
    """Return a state and as many configurations on both sides as the arm's way there asks for, (n, joints).

    Empty if that would be too many. Joints are interpolated: over one step that is as good as the straight line.
    """
    path = states.q[:, branch]
    found = [path[pose]]
    for other, arrives in ((pose - 1, pose), (pose + 1, pose + 1)):
        if not (0 <= other < len(path) and states.linked[branch, arrives]):
            continue
        if states.status[branch, other] < UNDECIDED:
            continue
        ways = BETWEEN_POSES * states.shift[branch, arrives] / max(clearance, 1e-6)
        n_between = math.ceil(ways - 1e-9) - 1
        if n_between > _MOST_BETWEEN and clearance > 0.0:
            return np.empty((0, path.shape[1]))
        shares = np.arange(1, min(n_between, _MOST_BETWEEN) + 1) / (n_between + 1)
        found.extend(path[pose] + share * (path[other] - path[pose]) for share in shares)
    return np.array(found)
