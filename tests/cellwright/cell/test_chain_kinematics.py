from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.built_in_robots import built_in_robot
from cellwright.cell.chain_kinematics import flange_poses, pose_error_into, solve_in_place, track_pose
from cellwright.cell.transforms import pose, rotation_from_rpy


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_tracking_reaches_a_nearby_pose(seed: int) -> None:
    generator = np.random.default_rng(seed)
    chain = built_in_robot("ur10e").chain
    q = generator.uniform(-3, 3, 6)
    q[4] = math.copysign(max(abs(q[4]), 0.3), q[4])  # away from the wrist's singular line
    target = flange_poses(chain.T_parent_joint, chain.axis, chain.T_last_flange, (q + 0.01)[None])[0]
    found, reached = track_pose(chain.T_parent_joint, chain.axis, chain.T_last_flange, q, target, 1e-10, 50)
    again = flange_poses(chain.T_parent_joint, chain.axis, chain.T_last_flange, found[None])[0]
    assert reached == (np.abs(again - target).max() < 1e-9)
    if reached:
        assert np.abs(again - target).max() < 1e-9


def test_tracking_says_when_a_pose_is_out_of_reach() -> None:
    chain = built_in_robot("ur10e").chain
    q = np.array([0.0, -1.5, 1.5, 0.1, 1.0, 0.0])
    _, reached = track_pose(
        chain.T_parent_joint, chain.axis, chain.T_last_flange, q, pose(np.array([3.0, 0, 0]), np.eye(3)), 1e-9, 50
    )
    assert not reached


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), angle=st.one_of(st.floats(0.0, math.pi), st.sampled_from([0.0, 1e-12, math.pi])))
def test_the_pose_error_is_the_twist_between_poses(seed: int, angle: float) -> None:
    from scipy.spatial.transform import Rotation

    generator = np.random.default_rng(seed)
    axis = generator.normal(size=3)
    axis /= np.linalg.norm(axis)
    T = pose(generator.normal(size=3), rotation_from_rpy(*generator.uniform(-3, 3, 3)))
    target = pose(generator.normal(size=3), Rotation.from_rotvec(angle * axis).as_matrix() @ T[:3, :3])
    error = np.empty(6)
    pose_error_into(T, target, error)
    assert np.allclose(error[:3], target[:3, 3] - T[:3, 3], atol=1e-14)
    turned = Rotation.from_rotvec(error[3:]).as_matrix() @ T[:3, :3]
    assert np.abs(turned - target[:3, :3]).max() < 1e-7
    assert abs(np.linalg.norm(error[3:]) - angle) < 1e-7


def test_small_systems_are_solved_and_singular_ones_refused() -> None:
    generator = np.random.default_rng(0)
    A, x = generator.normal(size=(6, 6)), generator.normal(size=6)
    b = A @ x
    assert solve_in_place(A.copy(), b)
    assert np.allclose(b, x)
    assert not solve_in_place(np.zeros((3, 3)), np.ones(3))
