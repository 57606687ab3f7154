from __future__ import annotations

import numpy as np
import pytest

from cellwright.solvers.hermite import position_extremes
from cellwright.solvers.optimal_control.checked_motion import SAMPLES, checked_curve
from cellwright.solvers.optimal_control.program import CostWeights
from cellwright.solvers.optimal_control.settled_motion import free_motion
from cellwright.solvers.path_timing import Limits, TimedMotion, time_straight
from tests.cellwright.solvers.optimal_control.planar_arm import dynamics_of, program_of

DYNAMICS = dynamics_of("ur10e")
WEIGHTS = CostWeights()
Q_A, Q_B = np.array([0.3, -1.2, 0.8, 0.2, 0.4, 0.1]), np.array([1.0, -0.6, 0.3, -0.4, 0.9, 0.5])


def straight(acceleration: float) -> TimedMotion:
    return time_straight(Q_A, Q_B, Limits(DYNAMICS.max_velocity, np.full(6, acceleration)), 0.05)


def test_a_slow_motion_passes_with_its_true_cost() -> None:
    motion = straight(1.0)
    curve = checked_curve(DYNAMICS, WEIGHTS, DYNAMICS.max_effort, motion)
    assert not curve.fault and curve.slowed == 1.0
    assert len(curve.motion.time) == SAMPLES * (len(motion.time) - 1) + 1 == len(curve.torque)
    # the integral once more, by the trapezoid rule on the states
    rate = WEIGHTS.rate(curve.motion.velocity, curve.torque)
    assert curve.cost == pytest.approx(float(np.trapezoid(rate, curve.motion.time)), rel=5e-3)


def test_a_hasty_motion_is_slowed_by_no_more_than_its_torques_ask_for() -> None:
    effort = 0.35 * DYNAMICS.max_effort
    curve = checked_curve(DYNAMICS, WEIGHTS, effort, straight(20.0))
    assert not curve.fault and curve.slowed > 1.05
    share = np.abs(curve.torque) / effort
    assert 0.98 < share.max() <= 1.0 + 1e-9
    again = checked_curve(DYNAMICS, WEIGHTS, effort, straight(20.0).slowed(curve.slowed))
    assert again.slowed == pytest.approx(1.0, abs=1e-6)
    assert again.cost == pytest.approx(curve.cost, rel=1e-6)


def test_what_no_slowing_mends_is_a_fault_with_its_numbers() -> None:
    weak = DYNAMICS.max_effort.copy()
    weak[1] = 40.0
    assert "'shoulder_lift_joint' needs" in checked_curve(DYNAMICS, WEIGHTS, weak, straight(1.0)).fault
    outside = TimedMotion(np.array([0.0, 5.0]), np.stack([Q_A, Q_A + 7.0]), np.zeros((2, 6)), np.zeros((2, 6)))
    assert "leaves its limits by" in checked_curve(DYNAMICS, WEIGHTS, DYNAMICS.max_effort, outside).fault
    moving = TimedMotion(np.array([0.0, 0.05]), np.stack([Q_A, Q_B]), np.ones((2, 6)), np.zeros((2, 6)))
    assert "not at rest is not slowed" in checked_curve(DYNAMICS, WEIGHTS, DYNAMICS.max_effort, moving).fault
    sudden = TimedMotion(np.array([0.0, 0.02]), np.stack([Q_A, Q_B]), np.zeros((2, 6)), np.zeros((2, 6)))
    assert "exceeded by a factor of" in checked_curve(DYNAMICS, WEIGHTS, DYNAMICS.max_effort, sudden).fault


def test_a_motion_that_begins_at_a_limit_does_not_swing_beyond_it() -> None:
    # the first step is slow and the second fast: the curve through them would first go back
    program = program_of("ur10e")
    q_a = np.array([0.5203732, -4.86804025, -0.58466421, -6.27940672, 3.07097878, 4.42180312])
    q_b = np.array([-4.53731834, 2.5608475, 2.01755021, 6.05483328, 4.32019962, -0.95370603])
    found = free_motion(program, q_a, q_b)
    low, high = position_extremes(found.discrete.time, found.discrete.q, found.discrete.node_velocity)
    assert (low < DYNAMICS.lower).any() or (high > DYNAMICS.upper).any()
    assert found.converged
    curve = found.curve.motion
    low, high = position_extremes(curve.time, curve.position, curve.velocity)
    assert (low >= DYNAMICS.lower - 1e-9).all() and (high <= DYNAMICS.upper + 1e-9).all()
