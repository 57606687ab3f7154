"""Torques at the states of a motion are those of rigid-body dynamics, and of holding still where the arm does."""

from __future__ import annotations

import numpy as np
import pytest

from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_dynamics import Payload, SymbolicDynamics, symbolic_dynamics
from cellwright.solvers.motion_torques import stands_still, state_torques
from cellwright.solvers.path_timing import TimedMotion

SLIDE_AND_SWING = """\
<robot name="crane">
  <link name="world"/>
  <link name="cart"><inertial><mass value="3"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
  <joint name="slide" type="prismatic"><parent link="world"/><child link="cart"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="500" velocity="1"/></joint>
  <joint name="swing" type="revolute"><parent link="cart"/><child link="rod"/><axis xyz="0 -1 0"/>
    <limit lower="-3" upper="3" effort="100" velocity="1"/></joint>
</robot>
"""
G = 9.81


def crane(payload: Payload | None = None) -> SymbolicDynamics:
    return symbolic_dynamics(SerialArm.from_urdf(SLIDE_AND_SWING), payload=payload)


def stopping(dwell: float = 1.0) -> TimedMotion:
    """The slide slows down to rest, stands, and sets off again; its states have the accelerations of before a jump."""
    time = np.array([0.0, 0.5, 0.5 + dwell / 2, 0.5 + dwell, 1.0 + dwell])
    at = np.array([0.0, 0.25, 0.25, 0.25, 0.5])
    speed = np.array([1.0, 0.0, 0.0, 0.0, 1.0])
    rate = np.array([-2.0, -2.0, 0.0, 2.0, 2.0])
    return TimedMotion(time, *(np.stack([each, 0.0 * each], axis=1) for each in (at, speed, rate)))


def test_a_slide_is_asked_for_newtons_and_a_turning_joint_for_newton_metres() -> None:
    torque = state_torques(crane(Payload.point(1.0, (1.0, 0.0, 0.0))), stopping())
    mass, moment = 3.0 + 2.0 + 1.0, 2.0 * 0.5 + 1.0 * 1.0
    np.testing.assert_allclose(torque[:, 0], mass * (G + np.array([-2.0, 0.0, 0.0, 0.0, 2.0])), rtol=1e-12)
    np.testing.assert_allclose(torque[:, 1], moment * (G + np.array([-2.0, 0.0, 0.0, 0.0, 2.0])), rtol=1e-12)


def test_the_arm_stands_still_from_the_first_state_of_a_dwell_to_its_last() -> None:
    assert stands_still(stopping()).tolist() == [False, True, True, True, False]


def test_a_stop_without_a_dwell_is_no_standstill() -> None:
    motion = stopping()
    kept = [0, 1, 4]
    moving = TimedMotion(motion.time[[0, 1, 2]], *(each[kept] for each in (motion.position, motion.velocity)),
                         motion.acceleration[kept])  # fmt: skip
    assert not stands_still(moving).any()
    np.testing.assert_allclose(state_torques(crane(), moving)[1, 0], 5.0 * (G - 2.0), rtol=1e-12)


@pytest.mark.parametrize("left", [1e-17, 1e-12])
def test_what_rounding_leaves_of_a_speed_is_still(left: float) -> None:
    motion = stopping()
    velocity = motion.velocity.copy()
    velocity[1] = left
    almost = TimedMotion(motion.time, motion.position + left, velocity, motion.acceleration)
    assert stands_still(almost).tolist() == stands_still(motion).tolist()


def test_coordinates_beyond_the_joints_are_left_out() -> None:
    motion = stopping()
    wide = TimedMotion(motion.time, *(np.pad(each, ((0, 0), (0, 1))) for each in (
        motion.position, motion.velocity, motion.acceleration)))  # fmt: skip
    np.testing.assert_array_equal(state_torques(crane(), wide), state_torques(crane(), motion))
