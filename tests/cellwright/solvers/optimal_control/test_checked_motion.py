from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.solvers.hermite import position_extremes
from cellwright.solvers.optimal_control.checked_motion import SAMPLES, checked_curve
from cellwright.solvers.optimal_control.program import CostWeights, MotionProgram
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


def test_an_arm_thrown_through_a_pose_that_it_cannot_hold_is_a_fault_once_it_is_too_slow() -> None:
    # at 80 N m the stretched arm cannot be held; slowing the swing, which its speeds ask for, takes it there
    effort = DYNAMICS.max_effort.copy()
    effort[1] = 80.0
    program = MotionProgram(DYNAMICS, CostWeights(1.0, 1e-6, 0.0), n_steps=20, max_effort=effort)
    q_a, q_b = np.zeros(6), np.zeros(6)
    q_a[1], q_b[1] = -1.57, 1.57
    found = free_motion(program, q_a, q_b)
    assert found.discrete.converged
    assert np.abs(DYNAMICS.holding_torque(found.curve.motion.position)[:, 1]).max() > 1.2 * effort[1]
    assert "to hold the arm on the way" in found.fault


@settings(max_examples=60, deadline=None)
@given(
    duration=st.floats(0.3, 3.0),
    share=st.floats(0.15, 1.0),
    turn=st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6),
    back=st.floats(-1.0, 1.0),
)
def test_a_motion_without_fault_keeps_all_torque_limits(
    duration: float, share: float, turn: list[float], back: float
) -> None:
    q = np.stack([Q_A, Q_A + back * np.array(turn), Q_A + np.array(turn)])
    velocity = np.zeros((3, 6))
    velocity[1] = (q[2] - q[0]) / duration
    motion = TimedMotion(np.array([0.0, 0.4, 1.0]) * duration, q, velocity, np.zeros((3, 6)))
    effort = share * DYNAMICS.max_effort
    curve = checked_curve(DYNAMICS, WEIGHTS, effort, motion)
    if not curve.fault:
        assert np.all(np.abs(curve.torque) <= effort * (1.0 + 1e-6))
