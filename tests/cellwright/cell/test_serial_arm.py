from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.built_in_robots import built_in_robot
from cellwright.cell.serial_arm import SerialArm
from cellwright.errors import InvalidInputError
from tests.cellwright.cell.random_arms import random_urdf


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_kinematics_of_any_serial_chain_equal_pinocchio(seed: int) -> None:
    arm = SerialArm.from_urdf(random_urdf(seed))
    model = arm.model
    data = model.createData()
    frame = model.getFrameId(arm.flange_link)
    for q in np.random.default_rng(seed).uniform(arm.lower, arm.upper, (3, arm.n_joints)):
        pinocchio.framesForwardKinematics(model, data, q)
        J = pinocchio.computeFrameJacobian(model, data, q, frame, pinocchio.LOCAL_WORLD_ALIGNED).reshape(6, -1)
        np.testing.assert_allclose(arm.flange_pose(q), data.oMf[frame].homogeneous, atol=1e-12)
        np.testing.assert_allclose(arm.jacobian(q), J, atol=1e-12)


def test_many_configurations_at_once_are_the_same_as_one_by_one() -> None:
    arm = SerialArm.from_urdf(random_urdf(3))
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper, (2, 4, arm.n_joints))
    poses, J = arm.link_poses(q), arm.jacobian(q)
    for index in np.ndindex(2, 4):
        np.testing.assert_array_equal(poses[index], arm.link_poses(q[index]))
        np.testing.assert_allclose(J[index], arm.jacobian(q[index]), atol=1e-15)


def test_a_robot_and_its_serial_arm_agree() -> None:
    robot = built_in_robot("ur10e")
    arm = SerialArm.from_robot(robot)
    q = np.array([0.3, -1.2, 1.4, -0.7, -1.5, 0.2])
    np.testing.assert_allclose(arm.flange_pose(q), robot.flange_pose(q), atol=1e-14)
    np.testing.assert_allclose(arm.jacobian(q), robot.jacobian(q), atol=1e-14)
    assert arm.max_effort[0] == 330.0


def test_limits_are_read_and_continuous_joints_get_full_turns() -> None:
    arm = SerialArm.from_urdf(
        '<robot name="two"><link name="a"/><link name="b"/><link name="c"/>'
        '<joint name="turn" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
        '<limit velocity="2" effort="3"/></joint>'
        '<joint name="slide" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="2 0 0"/>'
        '<limit lower="0.1" upper="0.5" velocity="0.3"/></joint></robot>'
    )
    np.testing.assert_allclose(arm.lower, [-2 * np.pi, 0.1])
    np.testing.assert_allclose(arm.max_velocity, [2.0, 0.3])
    np.testing.assert_allclose(arm.max_acceleration, [2.0 / 0.15, 2.0])
    assert list(arm.revolute) == [True, False]
    assert arm.max_effort[0] == 3.0
    assert np.isnan(arm.max_effort[1])
    np.testing.assert_allclose(arm.flange_pose(np.array([np.pi / 2, 0.4]))[:3, 3], [0.0, 0.4, 0.0], atol=1e-15)


def test_several_tips_need_a_name() -> None:
    urdf = random_urdf(1).replace(
        "</robot>",
        '<link name="side"/><joint name="s" type="fixed"><parent link="link1"/><child link="side"/></joint></robot>',
    )
    with pytest.raises(InvalidInputError, match="2 tips"):
        SerialArm.from_urdf(urdf)
    assert SerialArm.from_urdf(urdf, flange_link="link5").flange_link == "link5"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('lower="-1.5" upper="2.5"', 'lower="2" upper="1"', "lower must be less"),
        ('velocity="1.5"', 'velocity="0"', "positive"),
        ('type="revolute"', 'type="floating"', "is floating"),
        ('effort="7"', 'effort="much"', "write a number"),
    ],
)
def test_a_joint_that_makes_no_sense_is_named(old: str, new: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message) as caught:
        SerialArm.from_urdf(random_urdf(2).replace(old, new))
    assert "joint" in str(caught.value)
