"""Bounds that no plan undercuts: kernels against brute force, and whole scenes against stitched plans."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.transforms import pose
from cellwright.solvers.joint_branches import TURN
from cellwright.solvers.path_timing import Limits, least_time
from cellwright.solvers.placement.cycles import HopefulSweep, estimated_cycle, least_cycle
from cellwright.solvers.placement.judge import PlacementJudge
from cellwright.solvers.placement.kernels import holding_runs, least_connections
from cellwright.solvers.placement.problem import PlacementProblem
from cellwright.solvers.placement.trial import Promise, TrialSettings, try_design
from cellwright.solvers.state_tests import CLEAR, COLLIDING, UNDECIDED
from tests.cellwright.solvers import scanning_cell
from tests.cellwright.solvers.placement.placed_sweeps import HALF, problem

SEEDS = st.integers(0, 2**32 - 1)
LIMITS = Limits(np.array([1.0, 2.0]), np.array([3.0, 1.5]))


def paths(rng: np.random.Generator, n: int, greatest: FloatArray) -> FloatArray:
    """Two smooth ways of two joints over ``n`` poses, no step larger than ``greatest``, (2, n, 2)."""
    pulls = rng.uniform(-1.0, 1.0, (2, 1, 2)) + 0.3 * rng.uniform(-1.0, 1.0, (2, n, 2))
    return rng.uniform(-2.0, 2.0, (2, 1, 2)) + np.cumsum(np.clip(pulls, -1.0, 1.0) * greatest, axis=1)


@settings(deadline=None, max_examples=60)
@given(SEEDS, st.floats(0.5, 2.0))
def test_no_connection_undercuts_its_bound_wherever_the_sweeps_end(seed: int, share: float) -> None:
    """Brute force over how far either sweep goes on beyond what is needed, and over full turns."""
    rng = np.random.default_rng(seed)
    step, followed = 0.01, 0.2
    executed = followed / share
    one, other = paths(rng, 12, LIMITS.velocity * step / followed)
    a, b = int(rng.integers(12)), int(rng.integers(12))
    turns = np.sort(rng.integers(-1, 2, (2, 2, 2)), axis=1).astype(float)  # option, least and most, joint
    reach = np.abs(one[a:] - one[a]).max(axis=0), np.abs(other[: b + 1] - other[b]).max(axis=0)
    q = np.stack([np.stack([one[a], one[a]]), np.stack([other[b], other[b]])])
    ways = np.stack([np.stack([0.0 * reach[0], reach[0]]), np.stack([reach[1], 0.0 * reach[1]])])
    bound = least_connections(q, ways, turns, LIMITS.velocity, LIMITS.acceleration, share)[0, 1]
    least = np.inf
    differences = np.stack(np.meshgrid(*(range(-2, 3),) * 2), axis=-1).reshape(-1, 2)
    low, high = turns[1, 0] - turns[0, 1], turns[1, 1] - turns[0, 0]
    differences = differences[((differences >= low) & (differences <= high)).all(axis=1)]
    for end in range(a, 12):
        for begin in range(b + 1):
            longer = ((end - a) + (b - begin)) * step / executed
            times = least_time(one[end], other[begin] + TURN * differences, LIMITS)
            least = min(least, longer + float(times.min()))
    assert bound <= least + 1e-9


def test_where_nothing_more_can_be_executed_the_bound_is_the_time_of_the_slowest_joint() -> None:
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 2, 2))
    still = np.zeros((3, 2, 2))
    bound = least_connections(q, still, still, LIMITS.velocity, LIMITS.acceleration, 1.0)
    np.testing.assert_allclose(bound, least_time(q[:, None, 1], q[None, :, 0], LIMITS), atol=1e-12)


@settings(deadline=None, max_examples=100)
@given(SEEDS)
def test_every_piece_that_holds_what_is_needed_lies_within_the_run(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, lower, upper = 8, np.full(2, -2.0), np.full(2, 2.0)
    q = np.stack(list(paths(rng, n, np.array([0.2, 0.2]))), axis=1)
    status = rng.choice([COLLIDING, UNDECIDED, CLEAR], (2, n), p=[0.1, 0.3, 0.6]).astype(np.int8)
    linked = rng.random((2, n)) < 0.9
    first, last = np.sort(rng.integers(0, n, 2)).tolist()
    runs = holding_runs(q, linked, status, lower, upper, first, last)
    for branch in range(2):
        holding = [
            (i, j)
            for i in range(first + 1)
            for j in range(last, n)
            if (status[branch, i : j + 1] >= UNDECIDED).all() and linked[branch, i + 1 : j + 1].all()
        ]
        inside = (np.abs(q[first : last + 1, branch]) <= 2.0).all()
        if holding and inside:
            begin, end = min(i for i, _ in holding), max(j for _, j in holding)
            assert runs[branch].tolist() == [begin, end, 1]
        elif not holding:
            assert runs[branch].tolist() == [0, 0, 0]


def test_where_the_best_piece_misses_what_is_needed_another_branch_is_taken() -> None:
    """The first branch hopes for more samples, elsewhere: that refuses nothing, and costs what the other one takes."""
    task = problem(1)
    at, n = np.array(task.cell.start), 13
    q = np.tile(at, (n, 2, 1)) + np.linspace(0.0, 0.1, n)[:, None, None]
    pieces = np.array([[6, 12, 3], [0, 4, 1]])
    sweep = HopefulSweep(q, pieces, (0, 3), np.array([[0, 0, 0], [0, 4, 1]]), 0.01)
    assert sweep.span == (0, 3)
    assert 0.0 < least_cycle(task, [sweep]) <= estimated_cycle(task, [sweep]) < np.inf


@cache
def settings_of_trials() -> TrialSettings:
    return TrialSettings(scanning_cell.SETTINGS, "best", 0)


def random_scene(seed: int) -> tuple[PlacementProblem, FloatArray]:
    """Few sweeps of which only a part must be executed, a post near the part, and a design near the present one."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    middle, half = rng.uniform(-0.03, 0.03, (n, 1)), rng.uniform(0.0, 0.03, (n, 1))
    required = np.clip(middle + half * [[-1.0, 1.0]], -HALF, HALF)
    angle, height = rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 0.3)
    at = scanning_cell.PART_AT + np.array([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.5 * height])
    post = Body("post", Box((0.04, 0.04, height)), WORLD, pose(at, np.eye(3)))
    cell = scanning_cell.cell()
    bodies = (*cell.bodies[:-1], post, cell.bodies[-1])
    changes: dict[str, Any] = {"cell": replace(cell, bodies=bodies), "required": required, "carried": ("post",)}
    return problem(n, returns=bool(rng.integers(2)), **changes), rng.uniform(-1.0, 1.0, 3) * [0.05, 0.05, 0.4]


@pytest.mark.parametrize("seed", [0, 4, 6, 7, 9])  # all can be executed in full
def test_no_stitched_cycle_undercuts_its_bound(seed: int) -> None:
    task, values = random_scene(seed)
    given = settings_of_trials()
    stitching = replace(given, stitch=replace(given.stitch, returns=task.returns))
    bound = PlacementJudge(task).bound(values)
    true = try_design(task, Promise(values, bound, bound), stitching, {}).cycle
    assert 0.0 < bound <= true < np.inf
