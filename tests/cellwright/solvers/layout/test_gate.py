"""Every gate can fail: a solution that is right is spoilt in one way at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwright.solvers.layout.gate import GateTolerances, check_layout
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.mesh import build_mesh
from cellwright.solvers.layout.optimiser import solve_layout
from cellwright.solvers.layout.solution import GateReport, LayoutSolution, Transition
from tests.cellwright.solvers.small_layouts import two_stations

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
    assert "reach" in report.blocking


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
