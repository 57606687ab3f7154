from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from cellwright.cell.harness import DesignJoint as Joint
from cellwright.cell.harness import Harness, X, fixed
from cellwright.cell.transforms import pose
from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.layout.costs import extra_costs
from cellwright.solvers.layout.direct import DirectSettings
from cellwright.solvers.layout.examples import thin_wall_problem
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.optimiser import solve_layout, solve_layout_from_starts, start_overlaps
from cellwright.solvers.layout.problem import (
    HOME,
    Approach,
    LayoutCost,
    LayoutProblem,
    RobotSpheres,
    Spheres,
    Station,
    TargetKind,
    Visit,
    Wall,
)
from cellwright.solvers.layout.relaxation import nearest_clear_design
from cellwright.solvers.layout.solution import LayoutSolution
from cellwright.solvers.layout.staged import StagedSettings
from cellwright.solvers.layout.symbols import LayoutSymbols
from tests.cellwright.solvers.small_layouts import polar_arm, polar_spheres, ring_harness, two_stations

START = np.array([-1.2, 0.8, 1.2, 0.8])


@pytest.mark.parametrize("method", ["staged", "direct"])
def test_stations_move_together_until_their_hulls_touch(method: str) -> None:
    solution = solve_layout(two_stations(), method, start=START, rng=np.random.default_rng(0))
    assert solution.converged, solution.report.blocking
    assert solution.method == method
    assert solution.report.layout_violation_m < 1e-4

    # both joints share the way: the outer hull as far out as it may, the other nearer by T and turned by 1.5 T
    def apart(T: float) -> float:
        return float(np.hypot(1.0 - (1.0 - T) * np.cos(1.5 * T), (1.0 - T) * np.sin(1.5 * T)))

    T = brentq(lambda T: apart(T) - 0.2, 0.01, 0.3)
    assert solution.cycle_time_s > 2.0 * T - 2e-3
    # the paper's form may stay where both are equally far out, a local minimum
    assert solution.cycle_time_s < 2.0 * T * (1.02 if method == "staged" else 1.2)


def test_equal_inputs_give_equal_solutions() -> None:
    one, other = (
        solve_layout(two_stations(obstacle=0.15), rng=np.random.default_rng(3), start=START) for _ in range(2)
    )
    np.testing.assert_array_equal(one.design, other.design)
    for first, second in zip(one.transitions, other.transitions):
        np.testing.assert_array_equal(first.q, second.q)
        np.testing.assert_array_equal(first.times_s, second.times_s)


def held_apart() -> LayoutProblem:
    """Two stations that stand still on both sides of a post, so wide that the beam has to draw back."""
    return two_stations(obstacle=0.43).with_design(np.array([-0.6, 1.0, 0.6, 1.0]))


def test_the_beam_draws_back_from_a_post_and_every_sample_is_clear() -> None:
    solution = solve_layout(held_apart(), rng=np.random.default_rng(0))
    assert solution.converged, solution.report.blocking
    # along the post's edge, swept by the tip: each piece as long as its slower joint, there and back
    turn = np.linspace(np.arcsin(0.45 / 0.8), 0.0, 20_001)
    edge = 0.8 * np.cos(turn) - np.sqrt(np.maximum(0.45**2 - (0.8 * np.sin(turn)) ** 2, 0.0))
    half = np.maximum(-np.diff(turn) / 1.5, -np.diff(edge)).sum() + 0.8 - edge[0]
    for transition in solution.transitions:
        assert transition.at(np.linspace(0.0, transition.duration_s, 400))[:, 1].min() < 0.36
        assert 2.0 * half - 5e-3 <= transition.duration_s <= 1.15 * 2.0 * half
        assert len(transition.times_s) > 100
    assert solution.report.path_violation_m < 5e-4


def test_the_polish_runs_by_default_and_keeps_a_clear_motion_clear() -> None:
    polished = solve_layout(held_apart(), rng=np.random.default_rng(0))
    plain = solve_layout(held_apart(), rng=np.random.default_rng(0), settings=StagedSettings(polish=False))
    assert polished.converged
    assert polished.cycle_time_s <= plain.cycle_time_s + 1e-9
    assert any(phase.name == "polish" for phase in polished.phases)


def test_a_cycle_from_home_begins_and_ends_there() -> None:
    problem = replace(two_stations(), visits=(HOME, Visit(0), Visit(1)), home_q=np.array([0.0, 0.3]))
    solution = solve_layout(problem, start=START)
    assert solution.converged, solution.report.blocking
    np.testing.assert_allclose(solution.transitions[0].q[0], [0.0, 0.3])
    np.testing.assert_allclose(solution.transitions[-1].q[-1], [0.0, 0.3])


def test_the_robot_base_can_be_what_moves() -> None:
    problem = two_stations().with_design(np.array([-0.5, 1.0, 0.5, 1.0]))
    free = replace(problem, base=Harness((Joint("slide", False, X, -0.6, 0.1),)))
    still, moved = solve_layout(problem), solve_layout(free)
    assert still.converged
    assert moved.converged
    # farther back the same stations take less turning
    assert moved.cycle_time_s < still.cycle_time_s - 0.05
    assert moved.design[0] < -0.05


def test_a_timed_approach_counts_in_the_cycle_and_is_followed() -> None:
    line = pose(np.array([[-0.3, 0.0, 0.0], [-0.15, 0.0, 0.0]]), np.tile(np.eye(3), (2, 1, 1)))
    there_and_back = np.concatenate([line, line[:1]])
    slow = Approach.along(there_and_back, speed_m_s=0.3, target=TargetKind.POSITION)
    problem = two_stations()
    stations = tuple(replace(station, approaches=(slow,)) for station in problem.stations)
    solution = solve_layout(replace(problem, stations=stations), start=START)
    assert solution.converged, solution.report.blocking
    assert solution.approach_s == pytest.approx(2.0)
    assert solution.cycle_time_s == pytest.approx(solution.transition_s + 2.0)
    assert solution.report.approach_m < 1e-6
    assert solution.approach_q[0].shape == (3, 2)


def test_an_approach_too_fast_for_a_joint_does_not_converge() -> None:
    line = pose(np.array([[-0.3, 0.0, 0.0], [-0.15, 0.0, 0.0]]), np.tile(np.eye(3), (2, 1, 1)))
    fast = Approach.along(line, speed_m_s=5.0, target=TargetKind.POSITION)
    problem = two_stations()
    stations = tuple(
        replace(station, approaches=(fast,), harness=fixed(station.harness.poses(np.array([a, 0.9]))))
        for station, a in zip(problem.stations, (-0.5, 0.5))
    )
    solution = solve_layout(replace(problem, stations=stations))
    assert not solution.converged
    assert solution.report.blocking


def test_manipulability_is_maximised() -> None:
    # of a polar arm it grows with the reach, so the stations move outwards though nothing else asks for it
    alone = replace(two_stations(radius=0.01), cost=LayoutCost(manipulability=-50.0))
    inner = solve_layout(alone, start=START)
    outer = solve_layout(replace(alone, cost=LayoutCost(manipulability=50.0)), start=START)
    assert inner.converged
    assert outer.converged
    assert outer.transitions[0].q[0, 1] > inner.transitions[0].q[0, 1] + 0.2


@pytest.mark.parametrize("along_path", [False, True])
@pytest.mark.parametrize("which", ["manipulability", "repeatability"])
def test_a_higher_weight_improves_the_measure_it_weighs(which: str, along_path: bool) -> None:
    problem = two_stations(radius=0.01)
    measured = []
    for weight in (0.0, 0.2, 20.0):
        # what a metre of error costs is that much more than what a unit of manipulability is worth
        factor = weight * (1e3 if which == "repeatability" else 1.0)
        cost = LayoutCost(joint_deviation=(1e-3, 1e-4), along_path=along_path, **{which: factor})
        solution = solve_layout(replace(problem, cost=cost), start=START)
        assert solution.converged, solution.report.blocking
        q = np.concatenate(solution.approach_q)
        if along_path:
            q = np.concatenate([t.at(np.linspace(0.0, t.duration_s, 50)) for t in solution.transitions])
        unit = replace(cost, **{which: 1.0})
        measured.append(float(extra_costs(problem.arm, q, unit).mean()))
        assert solution.extra_cost == pytest.approx(factor * measured[-1], rel=0.05, abs=1e-9)
    # both count as costs, so manipulability enters with a minus sign
    assert measured[2] < measured[0]
    assert measured[2] <= measured[1] + 1e-6 <= measured[0] + 2e-6


def mean_over_time(problem: LayoutProblem, solution: LayoutSolution) -> float:
    """Return the mean of the extra cost over the cycle, by the trapezoidal rule on a grid of its own."""
    area = seconds = 0.0
    for motion in solution.transitions:
        grid = np.linspace(0.0, motion.duration_s, 3001)
        area += float(np.trapezoid(extra_costs(problem.arm, motion.at(grid), problem.cost), grid))
        seconds += motion.duration_s
    poses = problem.station_poses(solution.design)
    for visit, where in enumerate(problem.visits):
        approach = problem.approach_of(visit)
        if approach is not None and approach.durations_s is not None:
            clock = np.concatenate([[0.0], np.cumsum(approach.durations_s)])
            grid = np.linspace(0.0, clock[-1], 3001)
            points = np.stack([np.interp(grid, clock, each) for each in approach.T_station_tool[:, :3, 3].T], axis=1)
            x, y, _ = (points @ poses[where.station, :3, :3].T + poses[where.station, :3, 3]).T
            # the polar arm swivels to a point and reaches out to it
            q = np.stack([np.arctan2(y, x), np.hypot(x, y)], axis=1)
            area += float(np.trapezoid(extra_costs(problem.arm, q, problem.cost), grid))
            seconds += approach.duration_s
    return area / seconds


def reach_beyond_ends(solution: LayoutSolution) -> float:
    """Return how much farther than at the ends of its transitions the beam reaches on the way."""
    return max(float((motion.q[:, 1] - motion.q[[0, -1], 1].max()).max()) for motion in solution.transitions)


@pytest.mark.parametrize("method", ["staged", "direct", "second_order"])
def test_a_cost_along_the_path_bends_motions_and_is_its_mean_over_the_time(method: str) -> None:
    # of a polar arm manipulability grows with the reach, so the beam moves out and in again on its way
    still = two_stations(radius=0.01).with_design(np.array([-1.0, 0.8, 1.0, 0.8]))
    found = {}
    for weight, along_path in ((0.2, True), (5.0, True), (5.0, False)):
        cost = LayoutCost(manipulability=weight, along_path=along_path)
        problem = replace(still, cost=cost)
        # soft ends give way to a cost by as much as their price lets them
        exact = DirectSettings(tracking=1e5) if method == "direct" else None
        found[weight, along_path] = solution = solve_layout(problem, method, settings=exact)
        assert solution.converged, solution.report.blocking
        if along_path:
            assert solution.extra_cost == pytest.approx(mean_over_time(problem, solution), rel=2e-4)
    straight, bent = found[5.0, False], found[5.0, True]
    if method != "direct":
        # what a joint with time to spare does on its way is nobody's concern in the direct form
        assert reach_beyond_ends(straight) < 1e-6
    assert reach_beyond_ends(bent) > 0.1
    along = replace(still, cost=LayoutCost(manipulability=5.0, along_path=True))
    assert bent.cycle_time_s + bent.extra_cost < straight.cycle_time_s + mean_over_time(along, straight) - 0.05


def test_timed_approaches_count_in_the_mean_over_the_time() -> None:
    line = pose(np.array([[-0.3, 0.0, 0.0], [-0.15, 0.0, 0.0]]), np.tile(np.eye(3), (2, 1, 1)))
    slow = Approach.along(np.concatenate([line, line[:1]]), speed_m_s=0.3, target=TargetKind.POSITION)
    still = two_stations().with_design(np.array([-1.0, 0.9, 1.0, 0.9]))
    stations = tuple(replace(station, approaches=(slow,)) for station in still.stations)
    problem = replace(still, stations=stations, cost=LayoutCost(manipulability=1.0, along_path=True))
    solution = solve_layout(problem)
    assert solution.converged, solution.report.blocking
    assert solution.extra_cost == pytest.approx(mean_over_time(problem, solution), rel=2e-3)


def test_a_wall_holds_stations_and_beam() -> None:
    problem = replace(two_stations(), walls=(Wall("wall", np.array([-1.0, 0.0, 0.0]), -0.8),))
    solution = solve_layout(problem, start=START)
    assert solution.converged, solution.report.blocking
    hulls = problem.station_poses(solution.design)[:, 0, 3] + 0.1
    assert hulls.max() <= 0.8 + 1e-4


def test_a_wall_holds_the_base_that_moves() -> None:
    problem = two_stations().with_design(np.array([-0.5, 1.0, 0.5, 1.0]))
    slide = Harness((Joint("slide", False, X, -0.6, 0.1),))
    wall = Wall("wall", X, -0.35)
    for start in (None, np.array([-0.5])):
        held = solve_layout(replace(problem, base=slide, walls=(wall,)), start=start)
        assert held.converged, held.report.blocking
        # the column of 0.15 m radius as near to the wall as it gets, which takes less turning
        assert held.design[0] == pytest.approx(-0.2, abs=1e-3)
        assert held.design[0] >= -0.2 - 1e-4
    assert "wall" in solve_layout(replace(problem, base=slide, walls=(wall,)), start=np.array([-0.5])).notes[0]


def test_a_base_in_a_wall_is_named_with_its_depth() -> None:
    problem = replace(two_stations(), base=Harness((Joint("slide", False, X, -0.6, -0.5),)))
    with pytest.raises(InfeasibleError, match=r"wall and robot base overlap: relax it by 0\.35"):
        solve_layout_from_starts(replace(problem, walls=(Wall("wall", X, -0.3),)), n_starts=1)


def test_a_station_out_of_reach_is_named_with_its_distance() -> None:
    problem = two_stations()
    far = replace(problem.stations[1], harness=fixed(pose(np.array([0.0, 2.0, 0.0]), np.eye(3))))
    target = far.approaches[0].T_station_tool[0] @ np.eye(4)
    assert target[0, 3] == -0.2
    with pytest.raises(InfeasibleError, match=r"station 2 is out of reach: relax it by 0\.8"):
        solve_layout_from_starts(replace(problem, stations=(problem.stations[0], far)), n_starts=1)


def test_a_station_in_a_wall_is_named_with_its_depth() -> None:
    problem = two_stations().with_design(np.array([-0.5, 1.0, 0.5, 1.0]))
    depth = np.sin(0.5) + 0.1 - 0.5
    walled = replace(problem, walls=(Wall("north wall", np.array([0.0, -1.0, 0.0]), -0.5, False),))
    with pytest.raises(InfeasibleError, match="north wall and station 2 overlap") as caught:
        solve_layout_from_starts(walled, n_starts=1)
    assert f"{depth:.3g}" in str(caught.value)


def test_stations_that_cannot_part_are_named() -> None:
    problem = two_stations(radius=0.5, ranges=((0.0, 0.2), (0.1, 0.3)))
    with pytest.raises(InfeasibleError, match="station 1 and station 2 overlap"):
        solve_layout_from_starts(problem, n_starts=1)


def test_a_start_that_does_not_fit_is_refused_and_overlaps_are_told() -> None:
    problem = two_stations()
    with pytest.raises(InvalidInputError, match=r"station 1.around by 0.5"):
        solve_layout(problem, start=START + np.array([1.7, 0, 0, 0]))
    with pytest.raises(InvalidInputError, match="4 finite design joints"):
        solve_layout(problem, start=np.zeros(3))
    with pytest.raises(InvalidInputError, match="choose one of"):
        solve_layout(problem, "by hand")
    with pytest.raises(InvalidInputError, match="StagedSettings"):
        solve_layout(problem, "staged", settings=3)
    with pytest.raises(InvalidInputError, match="at least one"):
        solve_layout_from_starts(problem, n_starts=0)
    assert start_overlaps(problem, START) == []
    assert "overlap by 0.1" in start_overlaps(problem, np.array([-0.05, 1.0, 0.05, 1.0]))[0]


def test_an_overlapping_start_is_pushed_apart_and_told_with_the_smallest_change() -> None:
    start = np.array([-0.05, 0.7, 0.05, 0.7])
    problem = two_stations()
    solution = solve_layout(problem, start=start)
    assert solution.converged, solution.report.blocking
    (note,) = solution.notes
    assert "station 1 and station 2 overlap by 0.13" in note
    # turning about the column takes the least: 0.2 m apart at 0.7 m
    least = 2.0 * np.arcsin(0.1 / 0.7) - 0.1
    symbols = LayoutSymbols(problem)
    clear = nearest_clear_design(symbols, start)
    assert clear is not None
    assert symbols.geometry.layout_violation(clear) == 0.0
    assert np.abs(clear - start).sum() <= least + 1e-3
    assert "the smallest change found that clears it: station" in note
    assert solve_layout(problem, start=START).notes == ()
    assert solve_layout_from_starts(problem, n_starts=1, start=start).notes == (note,)


def test_an_overlapping_start_that_cannot_be_separated_is_an_error_with_the_smallest_relaxation() -> None:
    problem = replace(two_stations(radius=0.5, ranges=((0.0, 0.2), (0.1, 0.3))), robot_spheres=RobotSpheres())
    start = np.array([0.1, 0.8, 0.2, 0.8])
    assert nearest_clear_design(LayoutSymbols(problem), start) is None
    with pytest.raises(InfeasibleError, match="station 1 and station 2 overlap") as caught:
        solve_layout(problem, start=start)
    # no place on a fine grid of the harnesses overlaps less in all than what is told
    grid = np.stack(np.meshgrid(*[np.linspace(a, b, 9) for a, b in zip(problem.lower, problem.upper)]), -1)
    gaps = LayoutGeometry(problem).layout_gaps(grid.reshape(-1, 4))
    least = sum(np.maximum(-each, 0.0).sum(axis=-1) for each in gaps).min()
    told = float(re.findall(r"smallest relaxation found is ([\d.]+)", str(caught.value))[0])
    assert told <= 1.02 * least


def test_the_direct_solver_goes_round_a_post_that_is_in_the_straight_way() -> None:
    problem = two_stations(obstacle=0.15).with_design(np.array([-0.6, 1.0, 0.6, 1.0]))
    direct = solve_layout(problem, "direct", settings=DirectSettings(n_segments=40))
    assert direct.converged, direct.report.blocking
    for transition in direct.transitions:
        q = transition.at(np.linspace(0.0, transition.duration_s, 500))
        passing = q[np.argmin(np.abs(q[:, 0])), 1]
        # before the post or behind it
        assert abs(passing - 0.8) > 0.168
    # there is time to draw back while the arm turns; soft targets gain it a little
    ours = solve_layout(problem)
    assert ours.cycle_time_s == pytest.approx(2.0 * 1.2 / 1.5, abs=1e-3)
    assert direct.cycle_time_s == pytest.approx(ours.cycle_time_s, abs=5e-3)


def test_the_direct_solver_does_not_find_its_way_round_a_wide_post_and_its_gate_says_so() -> None:
    direct = solve_layout(held_apart(), "direct", settings=DirectSettings(n_segments=10))
    assert not direct.converged
    assert direct.report.path_violation_m > 0.01
    assert "enters post" in direct.report.blocking


def test_the_direct_solver_steps_through_a_thin_wall_between_few_points_and_is_caught() -> None:
    problem = thin_wall_problem()
    coarse = solve_layout(problem, "direct", settings=DirectSettings(n_segments=10))
    assert not coarse.converged
    assert coarse.report.path_violation_m > 0.02
    assert "enters wall" in coarse.report.blocking
    ours = solve_layout(problem, settings=StagedSettings(n_segments=10))
    assert ours.converged, ours.report.blocking
    # the tip has to draw back from the wall
    assert all(t.q[:, 1].min() < t.q[0, 1] - 0.2 for t in ours.transitions)


def test_the_best_of_several_starts_is_never_worse_than_the_first() -> None:
    problem = two_stations(obstacle=0.15)
    first = solve_layout_from_starts(problem, n_starts=1, start=START)
    best = solve_layout_from_starts(problem, n_starts=2, start=START)
    assert best.cycle_time_s <= first.cycle_time_s
    assert isinstance(best, LayoutSolution)


def test_beams_that_would_touch_the_column_keep_clear_of_it() -> None:
    arm = polar_arm()
    spheres = polar_spheres()
    own = replace(spheres, self_pairs=np.array([[0, 1]]), radii=np.array([0.02, 0.4]))
    target = Approach(pose(np.zeros((1, 3)), np.eye(3)[None]), TargetKind.POSITION)
    stations = tuple(
        Station(name, ring_harness(*span, 0.35, 0.6), Spheres(), (target,))
        for name, span in (("a", (-1.0, -0.5)), ("b", (0.5, 1.0)))
    )
    solution = solve_layout(LayoutProblem(arm, stations, robot_spheres=own), start=np.array([-0.8, 0.4, 0.8, 0.4]))
    assert solution.converged, solution.report.blocking
    assert min(q[0, 1] for q in solution.approach_q) >= 0.42 - 1e-3
