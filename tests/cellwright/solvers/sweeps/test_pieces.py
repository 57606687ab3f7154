from __future__ import annotations

import numpy as np
import pytest

from cellwright.causes import Cause
from cellwright.solvers.sweeps.pieces import evaluate_sweep, sweep_outcome

STATES = {"-": 0, "L": 1, "X": 2, "?": 3, ".": 4}
"""Unreached, beyond limits, colliding, undecided, clear."""


def outcome_of(
    *branches: str,
    broken: tuple[int, ...] = (),
    useful: tuple[int, int] | None = None,
    shortest: float = 0.05,
    body: int = 2,
) -> tuple[Cause, int]:
    """Return cause and body of a sweep in steps of 1 cm whose branches do not go on at the poses ``broken``."""
    status = np.array([[STATES[state] for state in branch] for branch in branches], np.int8)
    linked = np.ones(status.shape, np.bool_)
    linked[:, [0, *broken]] = False
    blocker = np.where((status == 2) | (status == 3), body, -1).astype(np.int32)
    n = status.shape[1]
    first, last = useful or (0, n - 1)
    travel = 0.01 * np.arange(first, last + 1)
    cause, found = sweep_outcome(status, blocker, linked, first, last, 0.0, 0.01, shortest, travel, 4)
    return Cause(cause), found


@pytest.mark.parametrize(
    ("branch", "expected"),
    [
        ("X.X.X", (Cause.COLLISION, 2)),
        ("?.?.?", (Cause.COLLISION, 2)),
        (".XXX", (Cause.COLLISION, 2)),
        ("-.-", (Cause.OUT_OF_REACH, -1)),
        ("L.L-", (Cause.JOINT_LIMIT, -1)),
        ("L.X-", (Cause.COLLISION, 2)),
        ("X..X", (Cause.TOO_SHORT, -1)),
        (".", (Cause.TOO_SHORT, -1)),
    ],
)
def test_a_clear_pose_that_is_alone_has_the_cause_of_its_neighbours(branch: str, expected: tuple[Cause, int]) -> None:
    assert outcome_of(branch) == expected


def test_only_clear_poses_that_are_not_linked_are_too_fast() -> None:
    assert outcome_of("X..X", broken=(2,)) == (Cause.JOINT_SPEED, -1)
    assert outcome_of("X.X.X", broken=(1, 2, 3)) == (Cause.COLLISION, 2)
    assert outcome_of("X...X", broken=(2,)) == (Cause.TOO_SHORT, -1)


@pytest.mark.parametrize("useful", [(1, 1), (1, 3), (3, 3)])
def test_neighbours_beyond_the_useful_interval_tell_too(useful: tuple[int, int]) -> None:
    assert outcome_of("X.-.X", useful=useful) == (Cause.COLLISION, 2)
    assert outcome_of("X.-.X", "-----", "LLLLL", useful=useful, body=3) == (Cause.COLLISION, 3)


def test_poses_beyond_the_useful_interval_do_not_count_otherwise() -> None:
    assert outcome_of("XLLLX", useful=(1, 3)) == (Cause.JOINT_LIMIT, -1)
    assert outcome_of("X...X", useful=(2, 2)) == (Cause.TOO_SHORT, -1)


def test_a_run_that_only_windings_break_is_stopped_by_joint_limits() -> None:
    # one joint turns from -0.3 to 0.3 rad; each half fits the limits, in different turns
    q = np.linspace(-0.3, 0.3, 7).reshape(7, 1, 1)
    status, linked = np.full((1, 7), STATES["."], np.int8), np.ones((1, 7), np.bool_)
    lower, upper = np.array([0.0]), np.array([2 * np.pi])

    def evaluated(shortest: float, travel: list[float]) -> tuple[Cause, int]:
        pieces = np.zeros((1, 3), np.int64)
        cause, _ = evaluate_sweep(
            *(q, linked, status, np.full((1, 7), -1, np.int32), lower, upper, np.zeros(1), 0.0, 0.01),
            *(np.array([0, 6]), shortest, np.array(travel), 1, pieces, pieces.copy(), np.zeros((1, 1))),
        )
        return Cause(cause), int(pieces[0, 2])

    assert evaluated(0.03, [0.01, 0.05]) == (Cause.NONE, 1)
    assert evaluated(0.05, [0.01, 0.05]) == (Cause.JOINT_LIMIT, 0)
    assert evaluated(0.05, []) == (Cause.TOO_SHORT, 0)
    assert evaluated(0.07, [0.01, 0.05]) == (Cause.TOO_SHORT, 0)
