from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import CubicSpline

from cellwright.errors import SolverError
from cellwright.solvers import path_timing
from cellwright.solvers.hermite import shares_of_limits
from cellwright.solvers.path_timing import (
    LIMIT_TOLERANCE,
    Limits,
    TimedMotion,
    least_time,
    time_path,
    time_straight,
    trapezoid_time,
)

LIMITS = Limits(np.array([2.0, 2.5, 3.0]), np.array([10.0, 4.0, 20.0]))
CONFIGURATION = arrays(float, 3, elements=st.floats(-3.0, 3.0, allow_subnormal=False))


def keeps_limits(motion: TimedMotion, limits: Limits) -> bool:
    speed, acceleration = shares_of_limits(
        motion.time, motion.position, motion.velocity, limits.velocity, limits.acceleration
    )
    return bool(max(speed.max(), acceleration.max()) <= 1.0 + LIMIT_TOLERANCE + 1e-9)


def straight_time(q_a, q_b) -> float:
    """The least time of the straight motion, by the trapezoid of the parameter that all joints share."""
    length = np.maximum(np.abs(q_b - q_a), 1e-12)
    speed, acceleration = (LIMITS.velocity / length).min(), (LIMITS.acceleration / length).min()
    return float(trapezoid_time(np.array(1.0), speed, acceleration))


def line(q_a, q_b):
    return CubicSpline([0.0, 1.0], np.stack([q_a, q_b]), bc_type="natural")


@given(CONFIGURATION, CONFIGURATION)
@settings(max_examples=60, deadline=None)
def test_no_motion_undercuts_the_slowest_joint_alone(q_a, q_b):
    assert least_time(q_a, q_b, LIMITS) <= time_straight(q_a, q_b, LIMITS, 0.008).duration + 1e-6
    alone = trapezoid_time(q_b - q_a, LIMITS.velocity, LIMITS.acceleration)
    assert float(least_time(q_a, q_b, LIMITS)) == alone.max()


@given(CONFIGURATION, CONFIGURATION)
@settings(max_examples=60, deadline=None)
def test_a_straight_motion_keeps_its_limits_and_takes_its_closed_form_time(q_a, q_b):
    motion = time_straight(q_a, q_b, LIMITS, 0.008)
    if np.abs(q_b - q_a).max() > 1e-6:
        assert motion.duration == pytest.approx(straight_time(q_a, q_b), abs=1e-12)
        assert keeps_limits(motion, LIMITS)
    assert np.all(np.diff(motion.time) > 0)
    assert np.array_equal(motion.position[[0, -1]], [q_a, q_b])
    assert not motion.velocity[[0, -1]].any()


@pytest.mark.parametrize("seed", range(6))
def test_a_timed_straight_path_is_as_fast_as_its_trapezoid(seed):
    q_a, q_b = np.random.default_rng(seed).uniform(-3, 3, (2, 3))
    motion = time_path(line(q_a, q_b), np.array([0.0, 1.0]), LIMITS, 0.008)
    fastest = straight_time(q_a, q_b)
    assert fastest * (1 - 1e-9) <= motion.duration <= 1.01 * fastest
    assert keeps_limits(motion, LIMITS)


@pytest.mark.parametrize("seed", range(6))
def test_a_curved_path_keeps_all_limits_between_its_states_and_follows_the_path(seed):
    knots = np.linspace(0.0, 1.0, 6)
    path = CubicSpline(knots, np.random.default_rng(seed).uniform(-2, 2, (6, 3)))
    motion = time_path(path, knots, LIMITS, 0.008)
    assert keeps_limits(motion, LIMITS)
    assert motion.duration >= float(least_time(path(0.0), path(1.0), LIMITS))
    assert np.array_equal(motion.position[[0, -1]], path([0.0, 1.0]))
    assert not motion.velocity[[0, -1]].any()
    on_path = path(np.linspace(0, 1, 200_001))
    nearest = [np.abs(on_path - q).max(axis=1).min() for q in motion.position[:: len(motion.time) // 20]]
    assert max(nearest) < 1e-3


def test_a_travel_limits_the_speed_of_a_sweep():
    travel = np.linspace(0.0, 0.2, 101)
    path = CubicSpline(travel, np.column_stack([np.sin(travel), travel**2, travel]))
    limits = Limits(np.full(2, 3.0), np.full(2, 10.0)).with_travel(0.1, 1.0)
    motion = time_path(path, travel, limits, 0.008)
    assert motion.duration == pytest.approx(float(trapezoid_time(np.array(0.2), 0.1, 1.0)), rel=0.005)
    assert motion.velocity[:, -1].max() <= 0.1 * (1 + 1e-6)


def test_a_motion_run_backwards_keeps_the_limits():
    motion = time_straight(np.zeros(3), np.ones(3), LIMITS, 0.008).reversed()
    assert np.all(np.diff(motion.time) > 0) and motion.time[0] == 0.0
    assert keeps_limits(motion, LIMITS)
    assert np.array_equal(motion.position[0], np.ones(3))


def test_a_path_without_numbers_is_a_solver_error():
    def path(s, nu=0):
        return np.full((len(s), 3), np.nan)

    with pytest.raises(SolverError, match="no timing"):
        time_path(path, np.array([0.0, 1.0]), LIMITS, 0.008)


@given(
    time=st.lists(st.floats(0.0, 1.0), max_size=30),
    fixed=st.lists(st.floats(0.0, 1.0), min_size=2, max_size=10, unique=True),
)
def test_times_near_a_fixed_one_give_way_to_it(time, fixed):
    fixed = np.array(fixed)
    found = path_timing._merged(np.array(time), fixed)
    kept = [moment for moment in found if moment in fixed]
    far = [moment for moment in time if np.abs(moment - np.array(kept)).min() > path_timing.SHORTEST_INTERVAL]
    assert {fixed.min(), fixed.max()} <= set(kept)
    assert found.tolist() == sorted([*kept, *far])


def test_long_motions_with_many_switches_take_memory_for_their_states_alone():
    time = np.linspace(0.0, 2000.0, 200_000)
    tracemalloc.start()
    try:
        path_timing._merged(time, np.linspace(0.0, 2000.0, 500))
        assert tracemalloc.get_traced_memory()[1] < 20 * time.nbytes
    finally:
        tracemalloc.stop()
