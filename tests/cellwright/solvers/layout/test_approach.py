from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellwright.cell.built_in_robots import built_in_robot
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import pose
from cellwright.solvers.layout.approach import (
    approach_knots,
    follow_approach,
    newton_steps,
    poses_at,
    rotation_vectors,
    rotations,
    target_error,
)
from cellwright.solvers.layout.problem import Approach, TargetKind

UR = SerialArm.from_robot(built_in_robot("ur10e"))
Q = np.array([0.3, -1.3, 1.7, -1.9, -1.5, 0.4])


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.floats(0.01, np.pi))
def test_rotation_vectors_survive_the_way_there_and_back(axis: list[float], angle: float) -> None:
    length = float(np.linalg.norm(axis))
    if length < 1e-3:
        return
    vector = np.array(axis) / length * angle
    R = rotations(vector)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotations(rotation_vectors(R)), R, atol=1e-7)


def test_half_a_turn_has_an_axis() -> None:
    found = rotation_vectors(np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_allclose(np.abs(found), [np.pi, 0.0, 0.0], atol=1e-12)


def test_knots_are_dense_enough_and_keep_ends_and_times() -> None:
    poses = pose(np.array([[0, 0, 0.0], [0.5, 0, 0], [0.5, 0.1, 0]]), np.tile(np.eye(3), (3, 1, 1)))
    knots = approach_knots(Approach.along(poses, speed_m_s=0.2))
    assert np.linalg.norm(np.diff(knots.T_station_tool[:, :3, 3], axis=0), axis=1).max() <= 0.12
    np.testing.assert_array_equal(knots.T_station_tool[[0, -1]], poses[[0, -1]])
    assert knots.durations_s.sum() == pytest.approx(3.0)
    assert knots.timed
    assert not approach_knots(Approach(poses)).timed
    assert len(approach_knots(Approach(poses), most=3).place) == 3


def test_newton_finds_every_kind_of_target() -> None:
    goal = UR.flange_pose(Q)
    for kind in TargetKind:
        q, error = newton_steps(UR, np.eye(4), Q[None] + 0.2, goal[None], kind)
        assert np.abs(error).max() < 1e-9
        assert np.abs(target_error(UR.flange_pose(q[0]), goal, kind)).max() < 1e-9


def test_a_free_axis_does_not_count() -> None:
    turned = pose(np.zeros(3), rotations(np.array([0.0, 0.0, 1.0])))
    assert np.abs(target_error(turned, np.eye(4), TargetKind.AXIS)).max() < 1e-12
    assert target_error(turned, np.eye(4), TargetKind.POSE)[5] == pytest.approx(-1.0)
    opposite = pose(np.zeros(3), np.diag([1.0, -1.0, -1.0]))
    assert np.linalg.norm(target_error(opposite, np.eye(4), TargetKind.AXIS)) == pytest.approx(np.pi)


def test_an_approach_is_followed_between_its_knots() -> None:
    T = UR.flange_pose(Q)
    goals = np.stack([T, T, T])
    goals[1:, 2, 3] -= 0.2
    goals[2, 0, 3] += 0.1
    approach = Approach.along(goals, speed_m_s=0.1)
    knots = approach_knots(approach)
    knot_q = [Q]
    for goal in knots.T_station_tool[1:]:
        knot_q.append(newton_steps(UR, np.eye(4), knot_q[-1][None], goal[None], TargetKind.POSE)[0][0])
    followed = follow_approach(UR, np.eye(4), approach, np.eye(4), knots, np.array(knot_q))
    assert max(followed.error_m, followed.error_rad) < 1e-8
    np.testing.assert_allclose(UR.flange_pose(followed.q), goals, atol=1e-8)
    assert followed.dense_s.sum() == pytest.approx(approach.duration_s)
    assert np.abs(np.diff(followed.dense_q, axis=0)).max() < 0.1
    knot_q[1] = knot_q[1] + 0.3  # a knot off the path does not spoil the poses, only where Newton begins
    assert follow_approach(UR, np.eye(4), approach, np.eye(4), knots, np.array(knot_q)).error_m < 1e-8


def test_places_between_poses_are_straight_lines() -> None:
    poses = pose(np.array([[0, 0, 0.0], [1.0, 0, 0]]), np.stack([np.eye(3), rotations(np.array([0, 0, 1.0]))]))
    middle = poses_at(poses, np.array([0.5]))[0]
    np.testing.assert_allclose(middle, pose(np.array([0.5, 0, 0]), rotations(np.array([0, 0, 0.5]))), atol=1e-12)


def test_what_a_timed_approach_leaves_free_turns_as_evenly_as_its_knots_allow() -> None:
    # a line along the flange's axis, which the wrist may turn about: knots turn it at one speed, then back
    ends = np.stack([UR.flange_pose(Q)] * 2)
    ends[1, :3, 3] += 0.3 * ends[0, :3, 2]
    approach = Approach.along(ends, speed_m_s=0.1, target=TargetKind.AXIS)
    knots = approach_knots(approach)
    turns = 0.2 * np.concatenate([np.arange(3), [1.0]])[: len(knots.place)]
    goals = knots.T_station_tool @ pose(
        np.zeros((len(turns), 3)), rotations(turns[:, None] * np.array([0.0, 0.0, 1.0]))
    )
    knot_q = [Q]
    for goal in goals[1:]:
        knot_q.append(newton_steps(UR, np.eye(4), knot_q[-1][None], goal[None], TargetKind.POSE)[0][0])
    rough, smooth = (
        follow_approach(UR, np.eye(4), approach, np.eye(4), knots, np.array(knot_q), smooth=each)
        for each in (False, True)
    )
    assert max(smooth.error_m, smooth.error_rad) < 1e-8
    sharpest = []
    for followed in (rough, smooth):
        rate = np.diff(followed.dense_q[:, 5]) / followed.dense_s
        sharpest.append(np.abs(np.diff(rate) / followed.dense_s[1:]).max())
    between = np.diff(turns) / knots.durations_s
    assert sharpest[1] < 1.3 * np.abs(np.diff(between)).max() / knots.durations_s[0] < 0.2 * sharpest[0]
