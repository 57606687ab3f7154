from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwright.cell.scene import Scene
from cellwright.errors import SolverError
from cellwright.solvers.hermite import shares_of_limits, states_at
from cellwright.solvers.roadmap import RoadmapSize
from cellwright.solvers.stitching import stitch
from tests.cellwright.solvers import scanning_cell
from tests.cellwright.solvers.scanning_cell import SETTINGS


def run(checker=None, method="best", settings=SETTINGS, seed=0):
    cell = scanning_cell.cell()
    return stitch(
        cell,
        checker or Scene(cell, 0.005),
        scanning_cell.sweeps(),
        settings=settings,
        method=method,
        rng=np.random.default_rng(seed),
    )


class Barred:
    """A scene in which other states collide as well."""

    def __init__(self, extra):
        self.scene, self.extra = Scene(scanning_cell.cell(), 0.005), extra

    def collides(self, q):
        return bool(self.extra(q)) or self.scene.collides(q)

    def first_colliding(self, states):
        return next((row for row, q in enumerate(states) if self.collides(q)), -1)

    def motion_collides(self, q_a, q_b, step):
        n = max(2, int(np.abs(q_b - q_a).max() / step) + 1)
        return any(self.collides(q) for q in np.linspace(q_a, q_b, n))

    def colliding_pair(self, q):
        return ("scanner", "ghost") if self.extra(q) else self.scene.colliding_pair(q)


def test_every_sweep_is_executed_once_between_connections_that_meet_it():
    plan = scanning_cell.plan()
    assert sorted(s.sweep for s in plan.segments if s.sweep >= 0) == [0, 1, 2, 3, 4]
    assert [s.sweep >= 0 for s in plan.segments] == [False, True] * 5
    current = scanning_cell.START
    for segment in plan.segments:
        n = 6
        assert segment.motion.position[0, :n] == pytest.approx(current, abs=1e-12)
        current = segment.motion.position[-1, :n]
        assert not segment.motion.velocity[[0, -1]].any()


def test_sweeps_cover_their_intervals_in_the_stated_direction():
    for segment in scanning_cell.plan().segments:
        if segment.sweep >= 0:
            interval = scanning_cell.sweeps()[segment.sweep].interval
            ends = interval if segment.direction == 1 else interval[::-1]
            assert segment.motion.position[[0, -1], -1] == pytest.approx(ends, abs=1e-12)


def test_the_plan_keeps_limits_and_clearance_everywhere():
    cell, trajectory = scanning_cell.cell(), scanning_cell.trajectory()
    motion = (trajectory.time_s, trajectory.position_rad, trajectory.velocity_rad_s)
    speed, acceleration = shares_of_limits(*motion, cell.robot.chain.max_velocity, cell.robot.chain.max_acceleration)
    assert max(speed.max(), acceleration.max()) < 1.006
    dense, _ = states_at(*motion, np.linspace(0, trajectory.time_s[-1], 4000))
    assert not Scene(cell, 0.0045).collide_all(dense).any()


def test_the_best_order_is_not_longer_than_the_greedy_one_and_both_are_reported():
    durations = scanning_cell.plan().durations
    assert scanning_cell.plan().chosen == "exact"
    assert durations["exact"] <= durations["greedy"]
    total = sum(segment.motion.duration for segment in scanning_cell.plan().segments)
    assert total == pytest.approx(durations["exact"], abs=1e-6)
    greedy = run(method="greedy")
    assert greedy.chosen == "greedy"
    assert sum(s.motion.duration for s in greedy.segments) == pytest.approx(greedy.durations["greedy"], abs=1e-6)


def test_a_plan_can_end_where_it_starts():
    plan = run(settings=replace(SETTINGS, returns=True))
    assert plan.segments[-1].motion.position[-1] == pytest.approx(scanning_cell.START, abs=1e-12)


def test_a_seed_gives_one_plan():
    a, b = run(seed=3), run(seed=3)
    assert [s.motion.position.tobytes() for s in a.segments] == [s.motion.position.tobytes() for s in b.segments]
    assert [s.motion.time.tobytes() for s in a.segments] == [s.motion.time.tobytes() for s in b.segments]


def test_a_sweep_that_collides_on_every_branch_is_left_out_with_the_bodies():
    robot = scanning_cell.cell().robot
    middle = scanning_cell.sweeps()[2].T_world_scanner[:3, 3]

    def over_the_middle(q):
        scanner = robot.flange_pose(q) @ scanning_cell.cell_without_part().T_flange_scanner
        return np.linalg.norm(scanner[:3, 3] - middle) < 0.003

    plan = run(Barred(over_the_middle))
    assert executed(plan) == {0, 1, 3, 4}
    assert [left.sweep for left in plan.left_out] == [2]
    assert plan.left_out[0].reason.startswith("bodies collide between the poses at which it was followed, on ")
    assert "scanner and ghost after" in plan.left_out[0].reason


def executed(plan):
    return {segment.sweep for segment in plan.segments if segment.sweep >= 0}


def test_a_sweep_whose_ends_cannot_be_reached_is_left_out_with_the_reason():
    robot = scanning_cell.cell().robot
    centre = scanning_cell.sweeps()[3].T_world_scanner[:3, 3]

    def in_a_shell_around_the_sweep(q):
        scanner = robot.flange_pose(q) @ scanning_cell.cell_without_part().T_flange_scanner
        return 0.08 < np.linalg.norm(scanner[:3, 3] - centre) < 0.13

    settings = replace(SETTINGS, roadmap=RoadmapSize(30, 15, 60), max_alternatives=1)
    plan = run(Barred(in_a_shell_around_the_sweep), settings=settings)
    assert executed(plan) == {0, 1, 2, 4}
    (left,) = plan.left_out
    assert left.sweep == 3
    assert "no collision-free connection was found from the start configuration to" in left.reason
    assert [segment.sweep >= 0 for segment in plan.segments] == [False, True] * 4


def test_what_the_roadmap_does_not_connect_random_trees_do():
    """Without a single random node the roadmap has straight ways only; every sweep is executed all the same."""
    plan = run(settings=replace(SETTINGS, roadmap=RoadmapSize(0, 0, 0), max_alternatives=2))
    assert executed(plan) == {0, 1, 2, 3, 4}
    assert not plan.left_out


def test_a_plan_without_any_sweep_has_no_segment_and_says_why():
    plan = run(Barred(lambda q: np.abs(q - scanning_cell.START).max() > 0.3))
    assert plan.segments == ()
    assert [left.sweep for left in plan.left_out] == [0, 1, 2, 3, 4]
    assert all(left.reason for left in plan.left_out)


def test_an_exact_order_that_is_not_proven_is_an_error_with_gap_and_mend():
    with pytest.raises(SolverError, match=r"gap \d+\.\d%, .* raise max_connections"):
        run(method="exact", settings=replace(SETTINGS, exact_up_to=0))


def test_the_plan_says_whether_its_order_is_proven():
    assert scanning_cell.plan().proven
    assert scanning_cell.plan().lower_bound == pytest.approx(scanning_cell.plan().durations["exact"], abs=1e-6)
    searched = run(settings=replace(SETTINGS, exact_up_to=0))
    assert not searched.proven
    assert 0.0 < searched.lower_bound <= scanning_cell.plan().durations["exact"]
