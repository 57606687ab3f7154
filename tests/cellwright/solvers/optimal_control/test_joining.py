from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.built_in_robots import built_in_arm
from cellwright.cell.scene import Scene
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_dynamics import symbolic_dynamics
from cellwright.solvers.hermite import shares_of_limits
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.optimal_control.collision_free import AvoidanceParams
from cellwright.solvers.optimal_control.joining import (
    JoiningMotions,
    JoiningScene,
    MovingState,
    least_joining_time,
)
from cellwright.solvers.optimal_control.measures import measure
from cellwright.solvers.optimal_control.program import CostWeights, MotionProgram
from cellwright.solvers.optimal_control.settled_motion import settle
from cellwright.solvers.optimal_control.starts import straight_start
from cellwright.solvers.path_timing import Limits, least_time
from tests.cellwright.solvers.optimal_control.planar_arm import GOAL, START, planar_cell, planar_path

SPEED, ACCELERATION = np.array([3.0, 4.0]), np.array([12.0, 20.0])
LIMITS = Limits(SPEED, ACCELERATION)
rates = st.floats(-1.0, 1.0)


@cache
def joining(clear: bool = True) -> JoiningMotions:
    """Motions of the planar arm, far from its posts or among them."""
    cell = planar_cell()
    scene = Scene(cell, 0.005)
    program = MotionProgram(
        symbolic_dynamics(SerialArm.from_robot(cell.robot)),
        CostWeights(1.0, 1e-4, 0.05),
        n_steps=12,
        max_acceleration=ACCELERATION,
        reserve=(0.005, 0.1),
    )

    def path(q_a, q_b):
        return None if clear else planar_path(scene, q_a, q_b)

    around = JoiningScene(scene, scene, MovingCorners.of(cell), path, AvoidanceParams(most_rounds=4), 0.005, 0.05)
    return JoiningMotions(program, LIMITS, around)


def state(q, v) -> MovingState:
    return MovingState(np.array(q, float), np.array(v, float))


A, B = state([-1.5, 0.5], [0.4, -0.3]), state([-2.4, 1.2], [-0.2, 0.5])


def test_joints_that_do_not_decide_the_duration_move_smoothly():
    dynamics = symbolic_dynamics(built_in_arm("ur10e"))
    program = MotionProgram(
        dynamics, CostWeights(1.0, 1e-6, 0.01), n_steps=16, max_acceleration=np.full(6, 10.0), reserve=(0.005, 0.05)
    )
    a, b = np.radians([0.0, -110.0, 80.0, -60.0, -90.0, 0.0]), np.radians([-90.0, -112.0, 110.0, -20.0, -40.0, -60.0])
    found = settle(program, straight_start(program, a, b))
    assert found.converged
    speeds = found.curve.motion.velocity / dynamics.max_velocity
    once = 2.0 * (speeds.max(axis=0) - speeds.min(axis=0))  # up and down again
    assert np.all(np.abs(np.diff(speeds, axis=0)).sum(axis=0) <= once + 0.1)
    free = MotionProgram(dynamics, CostWeights(1.0, 1e-6, 0.01), n_steps=16)
    assert found.curve.cost == pytest.approx(
        measure(dynamics, free.weights, free.max_effort, found.curve.motion).cost, rel=1e-3
    ), "smoothness is no part of what a motion is said to cost"


def test_a_motion_begins_and_ends_with_the_velocities_that_it_joins():
    found = joining().direct(A, B)
    assert found is not None and found.via == "optimal control"
    motion = found.motion
    np.testing.assert_allclose(motion.position[[0, -1]], [A.q, B.q], atol=1e-12)
    np.testing.assert_allclose(motion.velocity[[0, -1]], [A.v, B.v], atol=1e-9)


def test_the_curve_keeps_speed_acceleration_and_torque_limits():
    found = joining().direct(A, B)
    assert found is not None and found.torque is not None
    motion = found.motion
    shares = shares_of_limits(motion.time, motion.position, motion.velocity, SPEED, ACCELERATION)
    assert max(float(share.max()) for share in shares) <= 1.005
    assert np.all(np.abs(found.torque) <= [60.0, 30.0])


def test_backwards_it_is_the_same_motion():
    there, back = joining().direct(A, B), joining().direct(B.reversed(), A.reversed())
    assert there is not None and back is not None and there.cost == back.cost
    np.testing.assert_allclose(back.motion.position, there.motion.position[::-1])
    np.testing.assert_allclose(back.motion.velocity, -there.motion.velocity[::-1])


def test_its_cost_is_what_measuring_says_and_no_less_than_its_bound():
    motions = joining()
    found = motions.direct(A, B)
    assert found is not None
    program = motions._program
    taken = measure(program.dynamics, motions.weights, program.max_effort, found.motion)
    assert found.cost == pytest.approx(taken.cost, rel=1e-4)
    assert found.cost >= float(motions.bound(A, B)) * 0.99
    assert found.motion.duration >= float(least_joining_time(A, B, LIMITS)) * 0.99


def test_what_stands_in_the_way_is_gone_around_without_a_stop():
    a, b = state(START, [0.1, 0.0]), state(GOAL, [0.2, 0.1])
    motions = joining(clear=False)
    assert motions.direct(a, b) is None
    found = motions.around(a, b)
    assert found is not None
    np.testing.assert_allclose(found.motion.velocity[[0, -1]], [a.v, b.v], atol=1e-9)
    scene = Scene(planar_cell(), 0.0)
    assert not scene.collide_all(found.motion.position).any()


def test_without_a_path_there_is_no_way_around():
    assert joining().around(state(START, [0.0, 0.0]), state(GOAL, [0.0, 0.0])) is None


@given(st.floats(-3.0, 3.0), rates, rates)
@settings(max_examples=200)
def test_the_least_time_of_one_joint_is_that_of_two_ramps_and_a_cruise(way, begin, end):
    """Against a search over the turning speed."""
    one = Limits(np.array([1.2]), np.array([2.0]))
    found = float(least_joining_time(state([0.0], [begin]), state([way], [end]), one))
    V = np.append(np.linspace(-1.2, 1.2, 4001), [begin, end])
    covered = (V**2 - begin**2) * np.sign(V - begin) / 4.0 + (end**2 - V**2) * np.sign(end - V) / 4.0
    with np.errstate(all="ignore"):
        cruise = np.where(np.abs(way - covered) < 1e-9, 0.0, (way - covered) / V)
    took = np.abs(V - begin) / 2.0 + np.abs(end - V) / 2.0 + cruise
    best = float(np.min(took[np.isfinite(cruise) & (cruise >= 0.0)], initial=np.inf))
    assert found <= best + 1e-3
    turned = 0.5 * (begin + end) * abs(end - begin) / 2.0
    if way == turned or abs(way - turned) > 1e-4:  # about it, a little too far takes long
        assert found == pytest.approx(best, abs=1e-2)


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_between_states_at_rest_the_least_time_is_the_trapezoids(one, other):
    a, b = state([0.0, 0.0], [0.0, 0.0]), state([one, other], [0.0, 0.0])
    assert float(least_joining_time(a, b, LIMITS)) == pytest.approx(float(least_time(a.q, b.q, LIMITS)), abs=1e-4)
