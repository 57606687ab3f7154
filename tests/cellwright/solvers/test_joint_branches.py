from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.solvers.joint_branches import TURN, greatest_changes, order_branches, turns_within, unwrapped

angles = st.floats(-50, 50)


@settings(deadline=None)
@given(angles, angles)
def test_unwrapping_adds_full_turns_and_lands_within_half_a_turn(angle, near):
    found = unwrapped(angle, near)
    assert abs(found - near) <= math.pi + 1e-9
    turns = (found - angle) / TURN
    assert abs(turns - round(turns)) < 1e-9


@settings(deadline=None)
@given(angles, st.floats(-10, 10), st.floats(0.01, 20))
def test_the_turns_within_limits_are_all_and_only_those_that_fit(q, lower, width):
    least, most = turns_within(q, lower, lower + width)
    fitting = [k for k in range(-30, 31) if lower - 1e-9 <= q + TURN * k <= lower + width + 1e-9]
    assert list(range(least, most + 1)) == fitting


def shuffled_paths(seed: int, n: int = 40, n_branches: int = 5):
    """Smooth joint paths, wrapped, their rows shuffled at every pose; some are missing here and there."""
    rng = np.random.default_rng(seed)
    begin, slope = rng.uniform(-3, 3, (n_branches, 6)), rng.uniform(-0.05, 0.05, (n_branches, 6))
    paths = begin + np.arange(n)[:, None, None] * slope
    missing = rng.random((n, n_branches)) < 0.02
    seen = np.where(missing[..., None], np.nan, np.remainder(paths + math.pi, TURN) - math.pi)
    rows = np.array([rng.permutation(n_branches) for _ in range(n)])
    return paths, missing, np.take_along_axis(seen, rows[..., None], axis=1)


def test_branches_that_solvers_shuffle_are_put_together_again_and_unwrapped():
    for seed in range(20):
        _, missing, q = shuffled_paths(seed)
        linked = np.empty(q.shape[:2], bool)
        order_branches(q, False, np.full(6, 0.06), linked)
        # every pose still has the same solutions
        assert np.isnan(q[..., 0]).sum() == missing.sum()
        assert not linked[0].any()
        steps = np.abs(np.diff(q, axis=0)).max(axis=2)
        assert (steps[linked[1:]] <= 0.06).all()
        assert linked.sum() >= (~(missing[1:] | missing[:-1])).sum()


def test_a_solver_that_keeps_places_is_not_reordered():
    paths, missing, _ = shuffled_paths(1)
    q = np.where(missing[..., None], np.nan, np.remainder(paths + math.pi, TURN) - math.pi)
    before, linked = q.copy(), np.empty(q.shape[:2], bool)
    order_branches(q, True, np.full(6, 0.06), linked)
    turns = (q - before) / TURN
    assert np.allclose(turns, np.round(turns), equal_nan=True)
    assert (linked[1:] == ~(missing[1:] | missing[:-1])).all()


def test_the_faster_the_scan_the_less_a_joint_may_turn_between_poses():
    speed = np.array([1.0, 2.0])
    assert np.allclose(greatest_changes(speed, 0.005, 0.1), [0.05, 0.1])
    assert np.allclose(greatest_changes(speed, 0.005, 0.2), [0.025, 0.05])
    assert greatest_changes(speed, 0.005, 1e-6).max() == 0.5
