"""Every gate can fail: a solution that is right is spoilt in one way at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwright.cell.built_in_robots import built_in_arm
from cellwright.cell.harness import fixed
from cellwright.cell.transforms import pose
from cellwright.errors import InvalidInputError
from cellwright.solvers.layout.approach import newton_steps, rotations
from cellwright.solvers.layout.gate import GateTolerances, check_layout
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.mesh import build_mesh
from cellwright.solvers.layout.optimiser import solve_layout
from cellwright.solvers.layout.problem import (
    HOME,
    Approach,
    LayoutProblem,
    Spheres,
    Station,
    TargetKind,
    Visit,
)
from cellwright.solvers.layout.solution import GateReport, LayoutSolution, Transition
from tests.cellwright.solvers.small_layouts import polar_arm, two_stations

PROBLEM = two_stations(obstacle=0.15)
MESH = build_mesh(PROBLEM, 1)


@pytest.fixture(scope="module")
def solution() -> LayoutSolution:
    # the post is in the way, so the stations stay on both sides of it
    return solve_layout(PROBLEM.with_design(np.array([-0.6, 1.0, 0.6, 1.0])))


DESIGN = np.array([-0.6, 1.0, 0.6, 1.0])


def gated(solution: LayoutSolution, design: np.ndarray = DESIGN, **spoilt: object) -> GateReport:
    transitions = [replace(transition, **spoilt) for transition in solution.transitions]  # type: ignore[arg-type]
    visits = list(solution.approach_q)
    return check_layout(LayoutGeometry(PROBLEM), MESH, design, visits, transitions, GateTolerances())[0]


def test_what_is_right_passes(solution: LayoutSolution) -> None:
    report = gated(solution)
    assert report.passed, report.blocking
    assert report.blocking == ""
    assert report.n_samples > 1000


def straight(transition: Transition) -> Transition:
    return replace(transition, times_s=transition.times_s[[0, -1]], q=transition.q[[0, -1]])


def test_a_straight_way_through_the_post_is_found(solution: LayoutSolution) -> None:
    spoilt = replace(solution, transitions=tuple(straight(each) for each in solution.transitions))
    report = gated(spoilt)
    assert not report.passed
    assert report.path_violation_m == pytest.approx(0.17, abs=0.01)
    assert "post" in report.blocking
    assert "link 'beam' enters post" in report.blocking


def test_speeds_above_the_limit_are_found(solution: LayoutSolution) -> None:
    hasty = replace(
        solution, transitions=tuple(replace(each, times_s=0.8 * each.times_s) for each in solution.transitions)
    )
    report = gated(hasty)
    assert report.speed_ratio == pytest.approx(1.25, abs=0.01)
    assert "too fast" in report.blocking


def test_ends_off_their_stations_are_found(solution: LayoutSolution) -> None:
    shifted = DESIGN + np.array([0.0, 0.003, 0.0, 0.0])
    report = gated(solution, np.minimum(shifted, [9, 1.003, 9, 9]))
    assert report.endpoint_m == pytest.approx(0.003, abs=1e-5)
    assert any("station 1" in str(finding) for finding in report.findings)
    assert report.design_excess == pytest.approx(0.003)
    assert any("station 1.out leaves its range" in str(finding) for finding in report.findings)


def test_a_jump_between_approach_and_transition_is_found(solution: LayoutSolution) -> None:
    moved = replace(solution, approach_q=tuple(q + 1e-3 for q in solution.approach_q))
    assert any("jump" in str(finding) for finding in gated(moved).findings)


def test_joints_beyond_their_limits_are_found(solution: LayoutSolution) -> None:
    away = np.array([6.0, 0.0])
    far = replace(solution, transitions=tuple(replace(each, q=each.q + away) for each in solution.transitions))
    report = gated(far)
    assert report.position_excess > 0.5
    assert any("swivel" in str(finding) for finding in report.findings)


def test_overlapping_stations_are_found(solution: LayoutSolution) -> None:
    report = gated(solution, np.array([-0.05, 1.0, 0.05, 1.0]))
    assert report.layout_violation_m == pytest.approx(0.2 - 2.0 * np.sin(0.05), abs=1e-6)
    assert any(
        "station 1 and station 2 overlap" in str(f) or "station 2 and station 1" in str(f) for f in report.findings
    )


def test_accelerations_above_the_limit_are_found() -> None:
    still = two_stations().with_design(DESIGN)
    smooth = solve_layout(still, "second_order")
    assert smooth.converged, smooth.report.blocking
    hasty = [
        replace(each, times_s=0.9 * each.times_s, velocity=each.velocity / 0.9)
        for each in smooth.transitions
        if each.velocity is not None
    ]
    geometry = LayoutGeometry(still)
    report, _ = check_layout(
        geometry, build_mesh(still, 1), np.zeros(0), list(smooth.approach_q), hasty, GateTolerances()
    )
    assert report.acceleration_ratio == pytest.approx(1.0 / 0.81, abs=1e-3)
    assert any("accelerates" in str(finding) for finding in report.findings)


def test_velocities_that_do_not_belong_to_the_positions_are_found() -> None:
    still = two_stations().with_design(DESIGN)
    smooth = solve_layout(still, "second_order")
    lying = [replace(each, velocity=0.5 * each.velocity) for each in smooth.transitions if each.velocity is not None]
    report, _ = check_layout(
        LayoutGeometry(still), build_mesh(still, 1), np.zeros(0), list(smooth.approach_q), lying, GateTolerances()
    )
    assert not report.passed


def report_of(problem: LayoutProblem, visit_q: list[np.ndarray], transitions: list[Transition]) -> GateReport:
    geometry = LayoutGeometry(problem)
    return check_layout(geometry, build_mesh(problem, 1), np.zeros(0), visit_q, transitions, GateTolerances())[0]


def at_full_speed(start: int, end: int, q: np.ndarray, goal: np.ndarray, speed: np.ndarray) -> Transition:
    """A straight motion as fast as the joints are, or a short wait."""
    duration = max(float((np.abs(goal - q) / speed).max()), 1e-3)
    return Transition(start, end, np.array([0.0, duration]), np.stack([q, goal]))


UR = built_in_arm("ur10e")
BENT = np.array([0.3, -1.3, 1.7, -1.9, -1.5, 0.4])


def ur_line(length: float, *, flipped: bool) -> GateReport:
    """A UR10e that works along a line and returns; it ends on the branch where it began, or on any other."""
    ends = np.stack([UR.flange_pose(BENT)] * 2)
    ends[1, 1, 3] += length
    problem = LayoutProblem(
        UR, (Station("bench", fixed(np.eye(4)), Spheres(), (Approach(ends),)),), visits=(HOME, Visit(0)), home_q=BENT
    )
    starts = np.concatenate([BENT[None], np.random.default_rng(1).uniform(-2.0, 2.0, (200, 6))])
    found, error = newton_steps(UR, np.eye(4), starts, np.repeat(ends[1:], len(starts), axis=0), TargetKind.POSE)
    other = np.flatnonzero((np.abs(error).max(axis=1) < 1e-9) & (np.abs(found - found[0]).max(axis=1) > 0.8))[0]
    last = found[other if flipped else 0]
    assert (np.abs(last) < 2.0 * np.pi).all()
    transitions = [
        at_full_speed(0, 1, BENT, BENT + 0.0, UR.max_velocity),
        at_full_speed(1, 0, last, BENT, UR.max_velocity),
    ]
    return report_of(problem, [BENT[None], np.stack([BENT, last])], transitions)


def test_a_jump_to_another_branch_along_an_approach_is_found() -> None:
    good, jumping = ur_line(0.1, flipped=False), ur_line(0.1, flipped=True)
    assert good.passed, good.blocking
    assert good.approach_jump < 0.05
    assert jumping.approach_m < 1e-6  # every pose is met
    assert jumping.approach_jump > 0.5
    assert "the arm jumps on the approach of bench" in jumping.blocking


def test_an_arm_that_turns_fast_near_its_axis_does_not_jump() -> None:
    # past the column at 2 mm the swivel turns by nearly half a turn within millimetres: fast, but without a jump
    places = np.array([[0.302, -0.05, 0.0], [0.302, 0.05, 0.0]]) - np.array([0.3, 0.0, 0.0])
    arm = replace(polar_arm(), lower=np.array([-6.0, 0.001]))
    approach = Approach(pose(places, np.tile(np.eye(3), (2, 1, 1))), TargetKind.POSITION)
    stations = (Station("bench", fixed(np.eye(4)), Spheres(), (approach,)),)
    home = np.array([-np.arctan2(0.05, 0.002), np.hypot(0.05, 0.002)])
    end = home * np.array([-1.0, 1.0])
    problem = LayoutProblem(arm, stations, visits=(HOME, Visit(0)), home_q=home)
    transitions = [
        at_full_speed(0, 1, home, home + 0.0, arm.max_velocity),
        at_full_speed(1, 0, end, home, arm.max_velocity),
    ]
    report = report_of(problem, [home[None], np.stack([home, end])], transitions)
    assert report.passed, report.blocking
    assert report.approach_jump <= GateTolerances().jump


def at_rest_only(velocity: float) -> GateReport:
    """Two single-pose visits between which the swivel turns to and fro at a constant speed."""
    at = np.array([[-0.5, 0.8], [0.5, 0.8]])
    arm = polar_arm()
    target = Approach(np.eye(4)[None], TargetKind.POSITION)
    stations = tuple(Station(name, fixed(arm.flange_pose(q)), Spheres(), (target,)) for name, q in zip("ab", at))
    pace = np.array([velocity, 0.0])
    times = np.array([0.0, 1.0 / velocity])
    transitions = [
        Transition(0, 1, times, at, np.tile(pace, (2, 1))),
        Transition(1, 0, times, at[::-1], np.tile(-pace, (2, 1))),
    ]
    return report_of(LayoutProblem(arm, stations), [at[:1], at[1:]], transitions)


def test_an_arm_that_does_not_stop_at_a_visit_is_found() -> None:
    report = at_rest_only(1.5)
    assert report.acceleration_ratio == 0.0  # within each transition all is well
    assert report.rest_ratio == pytest.approx(1.0)
    assert not report.passed
    assert any("does not stand still" in str(finding) for finding in report.findings)


def pieces(start: int, end: int, q: float, velocity: float, *parts: tuple[float, float]) -> Transition:
    """The reach under one constant acceleration after the other: acceleration and time of each."""
    times, rows, rates = [0.0], [q], [velocity]
    for acceleration, lasting in parts:
        times.append(times[-1] + lasting)
        rows.append(rows[-1] + rates[-1] * lasting + 0.5 * acceleration * lasting**2)
        rates.append(rates[-1] + acceleration * lasting)
    still = np.zeros(len(times))
    return Transition(
        start,
        end,
        np.array(times),
        np.stack([still, np.array(rows)], axis=1),
        np.stack([still, np.array(rates)], axis=1),
    )


def timed_line(*, back: bool = False, speed: float = 0.3, entered_at_rest: bool = False) -> GateReport:
    """The reach moves out along a line, and perhaps back, from a home 0.1 m before it."""
    x = np.array([0.6, 0.9, 0.6] if back else [0.6, 0.9])
    poses = pose(np.stack([x, 0.0 * x, 0.0 * x], axis=1), np.tile(np.eye(3), (len(x), 1, 1)))
    line = Approach.along(poses, speed_m_s=speed, target=TargetKind.POSITION)
    home = np.array([0.0, 0.5])
    stations = (Station("bench", fixed(np.eye(4)), Spheres(), (line,)),)
    problem = LayoutProblem(polar_arm(), stations, visits=(HOME, Visit(0)), home_q=home)
    slow = speed**2 / 0.2  # 0.1 m from rest to the line's speed
    half = np.sqrt(0.1 / 2.0)
    first = pieces(0, 1, 0.5, 0.0, (2.0, half), (-2.0, half)) if entered_at_rest else None
    first = first or pieces(0, 1, 0.5, 0.0, (slow, 0.2 / speed))
    if back:
        last = pieces(1, 0, 0.6, -speed, (slow, 0.2 / speed))
    else:
        turning = np.sqrt(0.5 * (0.4 + 0.25 * speed**2))
        last = pieces(1, 0, 0.9, speed, (-2.0, turning + speed / 2.0), (2.0, turning))
    knots = build_mesh(problem, 1).knots[1]
    assert knots is not None
    along = np.interp(knots.place, np.arange(len(x)), x)
    return report_of(problem, [home[None], np.stack([0.0 * along, along], axis=1)], [first, last])


def test_a_timed_line_that_is_entered_and_left_at_its_speed_passes() -> None:
    report = timed_line()
    assert report.passed, report.blocking
    assert report.handover_s < 1e-6


def test_an_arm_that_does_not_have_the_speed_of_a_timed_line_is_found() -> None:
    report = timed_line(entered_at_rest=True)
    assert report.handover_s == pytest.approx(0.3 / 4.0, rel=1e-6)  # at 4 m/s^2
    assert any("speed of the approach of bench" in str(finding) for finding in report.findings)


def test_a_line_that_turns_back_at_speed_accelerates_too_much() -> None:
    report = timed_line(back=True)
    assert report.acceleration_ratio == pytest.approx(2.0 * 0.3 / GateTolerances().blend_s / 4.0, rel=1e-3)
    assert any("accelerates too much on the approach of bench" in str(finding) for finding in report.findings)
    slowly = timed_line(back=True, speed=0.02)
    assert slowly.passed, slowly.blocking


def test_a_wrong_orientation_has_the_name_of_its_own_visit() -> None:
    ends = np.stack([UR.flange_pose(BENT)] * 2)
    ends[0, :3, 3] += 0.01
    ends[1] = ends[1] @ pose(np.zeros(3), rotations(np.array([0.0, 0.0, 0.02])))
    stations = tuple(Station(n, fixed(T), Spheres(), (Approach(np.eye(4)[None]),)) for n, T in zip(("a", "b"), ends))
    standing = [at_full_speed(*pair, BENT, BENT + 0.0, UR.max_velocity) for pair in ((0, 1), (1, 0))]
    report = report_of(LayoutProblem(UR, stations), [BENT[None], BENT[None]], standing)
    assert [str(finding) for finding in report.findings[:2]] == [
        "a is not met by 0.01732 m",
        "the orientation at b is not met by 0.02 rad",
    ]


def test_a_home_that_is_missed_is_told_in_the_unit_of_its_joint() -> None:
    home = np.array([0.0, 0.5])
    target = Approach(polar_arm().flange_pose(home)[None], TargetKind.POSITION)
    stations = (Station("bench", fixed(np.eye(4)), Spheres(), (target,)),)
    problem = LayoutProblem(polar_arm(), stations, visits=(HOME, Visit(0)), home_q=home)
    turned = home + np.array([0.01, 0.0])
    transitions = [
        at_full_speed(0, 1, turned, home, problem.arm.max_velocity),
        at_full_speed(1, 0, home, turned, problem.arm.max_velocity),
    ]
    report = report_of(problem, [turned[None], home[None]], transitions)
    assert report.endpoint_m < 1e-9
    assert str(report.findings[0]) == "home is not met by 0.01 rad"


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        ({"times_s": np.array([0.0, 0.0])}, "do not rise"),
        ({"times_s": np.array([0.1, 1.0])}, "begins at 0.1 s"),
        ({"times_s": np.array([0.0])}, r"shape \(1,\)"),
        ({"q": np.array([[0.0, 0.5], [np.nan, 0.5]])}, "not finite"),
        ({"velocity": np.zeros((2, 3))}, "velocities"),
    ],
)
def test_a_transition_that_is_none_is_refused(spoilt: dict[str, np.ndarray], said: str) -> None:
    right = Transition(0, 1, np.array([0.0, 1.0]), np.array([[0.0, 0.5], [1.0, 0.5]]))
    with pytest.raises(InvalidInputError, match=said):
        replace(right, **spoilt)  # type: ignore[arg-type]
