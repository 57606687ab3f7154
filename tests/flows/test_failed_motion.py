"""Where a plan fails is told as the motion that the robot makes at that moment."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from cellwright.errors import UnsafePlanError
from flows.failed_motion import failed_motion, motion_at, state_at
from schemas.motion import Trajectory
from tests.tasks import plan_artefacts as plan


def trajectory(*kinds: str) -> Trajectory:
    n = len(kinds)
    view = np.array([7 + row if kind == "sweep" else -1 for row, kind in enumerate(kinds)], np.int32)
    return plan.changed(  # type: ignore[no-any-return]
        plan.trajectory(), kind=kinds, view=view, start_s=np.arange(n, dtype=float), end_s=np.arange(1.0, n + 1.0),
        branch=np.zeros(n, np.int8), direction=np.ones(n, np.int8), via=("",) * n,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("time_s", "words"),
    [
        (0.5, "on the way from the start to sweep 1"),
        (1.5, "on sweep 1 of 2 (view 8)"),
        (2.5, "on the way from sweep 1 to sweep 2"),
        (3.0, "on the way from sweep 1 to sweep 2"),
        (3.5, "on sweep 2 of 2 (view 10)"),
        (4.5, "on the way from sweep 2 back to the start"),
        (5.1, "on the way from sweep 2 back to the start"),
    ],
)
def test_the_motion_at_a_moment_is_a_sweep_or_the_way_between_two(time_s: float, words: str) -> None:
    kinds = ("connection", "sweep", "connection", "sweep", "connection")
    assert motion_at(trajectory(*kinds), time_s) == words


def test_the_state_at_a_moment_lies_between_its_neighbours() -> None:
    moved = plan.trajectory()
    for row in range(len(moved.time_s) - 1):
        middle = (moved.time_s[row] + moved.time_s[row + 1]) / 2
        expected = (moved.position_rad[row] + moved.position_rad[row + 1]) / 2
        np.testing.assert_allclose(state_at(moved, middle), expected, atol=1e-12)


def test_a_check_without_a_moment_is_shown_nowhere() -> None:
    assert failed_motion(UnsafePlanError("sweeps not executed"), None, plan.trajectory()) is None  # type: ignore[arg-type]


def test_the_moment_survives_pickling() -> None:
    again = pickle.loads(pickle.dumps(UnsafePlanError("it touches", 1.5)))
    assert (str(again), again.time_s) == ("it touches", 1.5)
