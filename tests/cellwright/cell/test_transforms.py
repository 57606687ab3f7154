"""Poses against SciPy's rotations, an independent implementation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cellwright.arrays import FloatArray
from cellwright.cell.transforms import (
    apply,
    inverse,
    pose,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_rpy,
)

seeds = st.integers(0, 2**32 - 1)
near_half_turns = st.floats(-1e-9, 1e-9)
axes = st.sampled_from([*np.eye(3), *-np.eye(3), np.ones(3) / np.sqrt(3), np.array([1.0, -1.0, 0.0]) / np.sqrt(2)])


def rotations(seed: int, n: int = 5) -> Rotation:
    return Rotation.random(n, random_state=seed)


def wxyz(rotation: Rotation) -> FloatArray:
    return np.roll(rotation.as_quat(canonical=True), 1, axis=-1)


@given(seeds)
def test_quaternions_and_matrices_agree_with_scipy(seed: int) -> None:
    rotation = rotations(seed)
    np.testing.assert_allclose(rotation_from_quaternion(wxyz(rotation)), rotation.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(quaternion_from_rotation(rotation.as_matrix()), wxyz(rotation), atol=1e-13)


@given(axes, near_half_turns)
def test_half_turns_lose_no_digits(axis: FloatArray, off: float) -> None:
    # the textbook formula divides by sqrt(1 + trace), which vanishes here
    R = Rotation.from_rotvec((np.pi + off) * axis).as_matrix()
    q = quaternion_from_rotation(R)
    assert q[0] >= 0
    np.testing.assert_allclose(np.linalg.norm(q), 1, atol=1e-15)
    np.testing.assert_allclose(rotation_from_quaternion(q), R, atol=1e-14)


@given(seeds, st.floats(1e-3, 1e3))
def test_a_quaternion_of_any_length_is_normalised_first(seed: int, length: float) -> None:
    q = wxyz(rotations(seed))
    np.testing.assert_allclose(rotation_from_quaternion(-length * q), rotation_from_quaternion(q), atol=1e-14)


@given(st.tuples(*[st.floats(-np.pi, np.pi)] * 3))
def test_roll_pitch_yaw_is_the_convention_of_urdf(rpy: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(rotation_from_rpy(*rpy), Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-14)


@given(seeds)
def test_an_inverse_undoes_its_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = pose(rng.normal(size=(2, 5, 3)), Rotation.random(10, random_state=seed).as_matrix().reshape(2, 5, 3, 3))
    np.testing.assert_allclose(inverse(T) @ T, np.broadcast_to(np.eye(4), T.shape), atol=1e-14)
    np.testing.assert_allclose(inverse(T), np.linalg.inv(T), atol=1e-12)


@given(seeds)
def test_applying_two_poses_is_applying_their_product(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_a_b, T_b_c = pose(rng.normal(size=(2, 3)), rotations(seed, 2).as_matrix())
    points = rng.normal(size=(7, 3))
    np.testing.assert_allclose(apply(T_a_b, apply(T_b_c, points)), apply(T_a_b @ T_b_c, points), atol=1e-13)


def test_one_position_serves_many_rotations_and_the_other_way_round() -> None:
    R = rotations(1, 4).as_matrix()
    assert pose(np.array([1.0, 2.0, 3.0]), R).shape == (4, 4, 4)
    T = pose(np.arange(12.0).reshape(4, 3), np.eye(3))
    np.testing.assert_array_equal(T[:, :3, 3], np.arange(12.0).reshape(4, 3))
    np.testing.assert_array_equal(T[:, 3], np.tile([0, 0, 0, 1], (4, 1)))


@pytest.mark.parametrize("empty", [np.zeros((0, 4))])
def test_no_quaternions_make_no_rotations(empty: FloatArray) -> None:
    assert rotation_from_quaternion(empty).shape == (0, 3, 3)
    assert quaternion_from_rotation(np.zeros((0, 3, 3))).shape == (0, 4)
