from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.built_in_robots import built_in_arm
from cellwright.cell.harness import fixed
from cellwright.cell.transforms import pose
from cellwright.solvers.layout.optimiser import solve_layout
from cellwright.solvers.layout.problem import Approach, LayoutProblem, RobotSpheres, Spheres, Station, TargetKind
from cellwright.solvers.layout.second_order import SecondOrderSettings, least_times, trapezoids
from tests.cellwright.solvers.small_layouts import polar_arm, two_stations

FREE = replace(two_stations(), robot_spheres=RobotSpheres())


def bound(q: np.ndarray, goal: np.ndarray) -> float:
    arm = polar_arm()
    return float(least_times(goal - q, arm.max_velocity, arm.max_acceleration).max())


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.3, 1.2), st.floats(0.3, 1.2))
@settings(max_examples=60, deadline=None)
def test_trapezoids_arrive_in_the_least_time_within_every_limit(a: float, b: float, c: float, d: float) -> None:
    q, goal = np.array([a, c]), np.array([b, d])
    motion = trapezoids(0, 1, q, goal, FREE, 50)
    arm = polar_arm()
    assert motion.duration_s == pytest.approx(max(bound(q, goal), 1e-4), abs=1e-9)
    assert motion.velocity is not None
    np.testing.assert_allclose(motion.q[[0, -1]], [q, goal], atol=1e-9)
    np.testing.assert_allclose(motion.velocity[[0, -1]], 0.0, atol=1e-9)
    steps = np.diff(motion.times_s)[:, None]
    assert (np.abs(motion.velocity) <= arm.max_velocity + 1e-9).all()
    assert (np.abs(np.diff(motion.velocity, axis=0)) <= arm.max_acceleration * steps + 1e-9).all()
    # the velocities are those of the positions
    moved = 0.5 * steps * (motion.velocity[1:] + motion.velocity[:-1])
    np.testing.assert_allclose(np.diff(motion.q, axis=0), moved, atol=1e-9)


def test_the_least_time_is_a_triangle_or_a_trapezoid() -> None:
    times = least_times(np.array([0.5, 4.0]), np.array([2.0, 2.0]), np.array([2.0, 2.0]))
    np.testing.assert_allclose(times, [1.0, 3.0])


def test_the_program_meets_the_trapezoid_bound_within_a_millisecond() -> None:
    still = FREE.with_design(np.array([-0.6, 1.0, 0.5, 0.7]))
    program = solve_layout(still, "second_order", settings=SecondOrderSettings(trapezoids=False))
    assert program.converged, program.report.blocking
    assert len(program.transitions[0].times_s) == 51
    least = sum(bound(motion.q[0], motion.q[-1]) for motion in program.transitions)
    assert program.cycle_time_s == pytest.approx(least, abs=1e-3 * len(program.transitions))
    exact = solve_layout(still, "second_order")
    assert exact.converged
    assert exact.cycle_time_s == pytest.approx(least, abs=1e-6)
    assert exact.report.acceleration_ratio == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("robot", ["ur10e", "ur5", "crx10ia_l", "kr180_r2500_extra", "nj290", "scara", "pr_robot"])
def test_every_robot_without_obstacles_meets_its_trapezoid_bound_within_a_millisecond(robot: str) -> None:
    arm = built_in_arm(robot)
    rng = np.random.default_rng(3)
    low, high = np.maximum(arm.lower, -1.5), np.minimum(arm.upper, 1.5)
    places = arm.flange_pose(rng.uniform(0.8 * low + 0.2 * high, 0.2 * low + 0.8 * high, (2, arm.n_joints)))
    target = TargetKind.POSE if arm.n_joints == 6 else TargetKind.POSITION
    at = Approach(np.eye(4)[None], target)
    stations = tuple(Station(name, fixed(place), Spheres(), (at,)) for name, place in zip("ab", places))
    problem = LayoutProblem(arm, stations)
    exact = solve_layout(problem, "second_order")
    program = solve_layout(problem, "second_order", settings=SecondOrderSettings(trapezoids=False))
    for solution in (exact, program):
        assert solution.converged, solution.report.blocking
        least = sum(
            float(least_times(t.q[-1] - t.q[0], arm.max_velocity, arm.max_acceleration).max())
            for t in solution.transitions
        )
        assert solution.cycle_time_s == pytest.approx(least, abs=1e-3)


def test_stations_are_placed_for_accelerations() -> None:
    solution = solve_layout(FREE, "second_order", start=np.array([-1.2, 0.8, 1.2, 0.8]))
    assert solution.converged, solution.report.blocking
    still = solve_layout(FREE.with_design(np.array([-0.11, 1.0, 0.11, 1.0])), "second_order")
    assert solution.cycle_time_s < still.cycle_time_s


def test_accelerations_hold_round_an_obstacle() -> None:
    held = two_stations(obstacle=0.43).with_design(np.array([-0.6, 1.0, 0.6, 1.0]))
    first, second = solve_layout(held), solve_layout(held, "second_order")
    assert second.converged, second.report.blocking
    assert second.cycle_time_s > first.cycle_time_s
    assert 0.9 < second.report.acceleration_ratio <= 1.0 + 1e-5
    assert second.report.speed_ratio <= 1.0 + 1e-5


def test_a_timed_approach_is_entered_and_left_at_its_own_speed() -> None:
    line = pose(np.array([[-0.3, 0.0, 0.0], [-0.15, 0.0, 0.0]]), np.tile(np.eye(3), (2, 1, 1)))
    moving = Approach.along(line, speed_m_s=0.3, target=TargetKind.POSITION)
    stations = tuple(replace(station, approaches=(moving,)) for station in FREE.stations)
    still = replace(FREE, stations=stations).with_design(np.array([-0.6, 1.0, 0.5, 0.9]))
    solution = solve_layout(still, "second_order")
    assert solution.converged, solution.report.blocking
    velocity = solution.transitions[0].velocity
    assert velocity is not None
    np.testing.assert_allclose(velocity[0], [0.0, 0.3], atol=1e-6)
    np.testing.assert_allclose(velocity[-1], [0.0, 0.3], atol=1e-6)
