from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.causes import Cause
from cellwright.cell.bodies import Box
from cellwright.cell.cell import Cell
from cellwright.cell.harness import fixed
from cellwright.cell.sphere_filter import sphere_filter
from cellwright.cell.transforms import inverse
from cellwright.solvers.joint_branches import TURN
from cellwright.solvers.path_timing import Limits, time_straight
from cellwright.solvers.placement.judge import FIELD_PADDING, PlacementJudge, Refusal
from cellwright.solvers.placement.kernels import alternatives_into, best_piece, straight_times
from cellwright.solvers.sweeps.order_kernels import improve_sequence
from tests.cellwright.solvers import scanning_cell
from tests.cellwright.solvers.placement.placed_sweeps import FOLLOW, POST, harness, judge, problem

DESIGN = np.array([0.03, -0.05, 0.4])
STILL = np.zeros(3)
JOINTS = st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=2)


def with_post() -> Cell:
    bare = scanning_cell.cell_without_part()
    cell = scanning_cell.cell()
    return replace(cell, bodies=(*bare.bodies, POST, cell.bodies[-1]))


def test_the_identity_changes_nothing() -> None:
    task = problem()
    assert np.allclose(task.shift(STILL), np.eye(4), atol=1e-15)
    for one, other in zip(task.moved_cell(STILL).bodies, task.cell.bodies):
        assert np.allclose(one.T_parent_body, other.T_parent_body, atol=1e-15)
    verdict = judge().judge(STILL)
    assert verdict.refusal is None


def test_the_estimate_is_near_the_true_cycle() -> None:
    true = sum(segment.motion.duration for segment in scanning_cell.plan().segments)
    assert 0.8 * true < judge().judge(STILL).estimate <= true


def test_only_the_part_and_what_it_carries_are_moved() -> None:
    task = problem(carried=("post",), cell=with_post())
    D = task.motion(DESIGN)
    for row, (moved, before) in enumerate(zip(task.moved_cell(DESIGN).bodies, task.cell.bodies)):
        expected = D @ before.T_parent_body if before.name in ("part", "post") else before.T_parent_body
        assert np.array_equal(moved.T_parent_body, expected), task.cell.bodies[row].name


def test_moving_all_that_stands_is_moving_the_base_the_other_way() -> None:
    """Seen from the base both are one problem."""
    back = fixed(inverse(problem().motion(DESIGN)))
    of_world = PlacementJudge(problem(carried=("table",))).judge(DESIGN)
    base = PlacementJudge(problem(moves_base=True, harness=back)).judge(np.zeros(0))
    assert (of_world.refusal, of_world.what) == (base.refusal, base.what)
    assert of_world.estimate == pytest.approx(base.estimate, abs=1e-9)


def test_shifting_the_filter_is_making_it_of_the_moved_cell() -> None:
    task = problem(carried=("post",), cell=with_post())
    judged = PlacementJudge(task)
    shifted = judged._shifted_filter(task.shift(DESIGN))
    how = {"link_overshoot": FOLLOW.link_overshoot, "tool_overshoot": FOLLOW.tool_overshoot}
    made = sphere_filter(
        task.moved_cell(DESIGN), field_spacing=FOLLOW.field_spacing, field_padding=FIELD_PADDING, **how
    )
    np.testing.assert_allclose(shifted.hull_points, made.hull_points, atol=1e-12)
    np.testing.assert_allclose(shifted.hull_real, made.hull_real, atol=1e-12)
    np.testing.assert_allclose(shifted.distance.real, made.distance.real, atol=1e-12)
    np.testing.assert_array_equal(shifted.pair, made.pair)


def test_what_stands_in_one_another_is_refused_by_its_names() -> None:
    verdict = PlacementJudge(problem(cell=with_post(), harness=harness(0.5))).judge(np.array([0.0, 0.4, 0.0]))
    assert (verdict.refusal, verdict.what) == (Refusal.OVERLAP, "part and post")
    assert verdict.estimate == np.inf


def test_a_start_that_meets_a_carried_body_is_refused() -> None:
    flange = scanning_cell.cell_without_part().robot.flange_pose(scanning_cell.START)
    values = np.append(flange[:2, 3] - POST.T_parent_body[:2, 3], 0.0)
    tall = replace(POST, shape=Box((0.1, 0.1, 3.0)))
    cell = with_post()
    among = replace(cell, bodies=tuple(tall if body is POST else body for body in cell.bodies))
    verdict = PlacementJudge(problem(cell=among, carried=("post",), harness=harness(2.0))).judge(values)
    assert (verdict.refusal, verdict.what) == (Refusal.START, "post")


def test_out_of_reach_is_refused_with_the_sweep_and_its_cause() -> None:
    verdict = PlacementJudge(problem(harness=harness(3.0))).judge(np.array([2.5, 0.0, 0.0]))
    assert (verdict.refusal, verdict.what, verdict.cause) == (Refusal.SWEEP, "view 0", int(Cause.OUT_OF_REACH))
    assert verdict.n_untested == 4


def test_a_sweep_that_would_be_shorter_is_refused() -> None:
    longer = problem(required=np.tile([-0.06, 0.07], (5, 1)))
    verdict = PlacementJudge(longer).judge(STILL)
    assert (verdict.refusal, verdict.what, verdict.cause) == (Refusal.SWEEP, "view 0", int(Cause.TOO_SHORT))


def test_more_sweeps_than_the_exact_order_takes_are_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = judge().judge(STILL).estimate
    monkeypatch.setattr("cellwright.solvers.placement.cycles.EXACT_UP_TO", 0)
    searched = judge().judge(STILL).estimate
    assert exact - 1e-9 <= searched <= 1.1 * exact


def test_the_way_back_counts_if_it_is_asked_for() -> None:
    there = judge().judge(STILL).estimate
    assert PlacementJudge(problem(returns=True)).judge(STILL).estimate > there


def test_the_exact_order_is_no_longer_than_any(rng_seed: int = 0) -> None:
    """Brute force over all orders of three sweeps, on one option each and both directions."""
    rng = np.random.default_rng(rng_seed)
    cost, duration = rng.random((7, 7)), rng.random(6)
    first = np.array([0, 2, 4, 6], np.int32)
    least = min(
        cost[6, a] + cost[a, b] + cost[b, c] + cost[c, 6] + duration[[a, b, c]].sum()
        for order in itertools.permutations(range(3))
        for a, b, c in itertools.product(*((2 * sweep, 2 * sweep + 1) for sweep in order))
    )
    total, _ = improve_sequence(np.arange(3, dtype=np.int32), cost, duration, first)
    assert total >= least - 1e-12


@settings(deadline=None, max_examples=50)
@given(JOINTS, JOINTS)
def test_straight_times_are_those_of_timed_motions(a: list[float], b: list[float]) -> None:
    limits = Limits(np.array([1.0, 2.0]), np.array([3.0, 1.5]))
    times = straight_times(np.array([a, b]), np.array([a, b]), limits.velocity, limits.acceleration)
    assert times[0, 0] == times[1, 1] == 0.0
    if np.abs(np.subtract(a, b)).max() > 1e-6:
        duration = time_straight(np.array(a), np.array(b), limits, 0.008).duration
        assert times[0, 1] == times[1, 0] == pytest.approx(duration, rel=1e-9)


def test_the_best_piece_has_most_samples_then_is_longest_then_first() -> None:
    pieces = np.array([[0, 9, 2], [0, 5, 3], [1, 8, 3], [2, 9, 3], [0, 9, 0]])
    assert best_piece(pieces) == 2
    assert best_piece(np.zeros((3, 3), np.int64)) == -1


def test_alternatives_are_all_windings_within_the_limits_the_nearest_first() -> None:
    path = np.linspace([0.1, -0.2], [0.3, 0.2], 5)
    q = np.stack([path, path + 0.5], axis=1)  # two branches
    pieces = np.array([[0, 4, 3], [1, 4, 3]])
    lower, upper = np.full(2, -1.2 * TURN), np.full(2, 1.2 * TURN)
    entries, exits = np.empty((20, 2)), np.empty((20, 2))
    args = (q, pieces, 0, 4, lower, upper, np.ones(2), np.zeros(2))
    count = alternatives_into(*args, entries, exits)
    turns = {tuple(np.round((entry - path[0]) / TURN).astype(int)) for entry in entries[:count]}
    assert turns == set(itertools.product((-1, 0, 1), repeat=2)), "the second branch misses the first pose"
    np.testing.assert_allclose(exits[:count] - entries[:count], np.tile(path[4] - path[0], (count, 1)), atol=1e-12)
    away = np.abs((entries + exits)[:count] / 2).max(axis=1)
    assert away.tolist() == sorted(away.tolist())
    few = np.empty((3, 2))
    assert alternatives_into(*args, few, np.empty((3, 2))) == 3
    np.testing.assert_allclose(few, entries[:3])
