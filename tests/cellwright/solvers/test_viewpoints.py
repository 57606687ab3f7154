from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cellwright.solvers.viewpoints import TiltGrid, candidate_poses, tilt_rotations, untilted_frames

ANGLES = st.floats(-3.0, 3.0)


@given(st.lists(st.tuples(ANGLES, ANGLES, ANGLES), min_size=1, max_size=5))
def test_tilts_turn_about_the_own_z_then_x_then_y(tilts: list[tuple[float, float, float]]) -> None:
    expected = Rotation.from_euler("ZXY", tilts).as_matrix()
    np.testing.assert_allclose(tilt_rotations(np.array(tilts)), expected, atol=1e-14)


@given(st.integers(0, 1000))
def test_frames_are_right_handed_and_look_against_the_normal(seed: int) -> None:
    normals = np.random.default_rng(seed).normal(size=(20, 3))
    normals[:3] = np.eye(3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frames = untilted_frames(normals)
    np.testing.assert_allclose(frames @ np.swapaxes(frames, 1, 2), np.tile(np.eye(3), (20, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-14)
    np.testing.assert_array_equal(frames[:, :, 2], -normals)


def test_the_x_axis_follows_the_coordinate_axis_least_aligned_with_the_normal() -> None:
    frame = untilted_frames(np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(frame[0, :, 0], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(frame[1, :, 0], [0, 1, 0], atol=1e-15)


def test_every_pose_looks_at_its_sample_from_its_standoff() -> None:
    rng = np.random.default_rng(1)
    points, normals = rng.normal(size=(2, 6, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    poses = candidate_poses(points, normals, TiltGrid((0.15, 0.2), (0.0, 2.0), (-0.5, 0.0, 0.5), (0.0, 0.4)))
    assert len(poses.sample) == 6 * 24
    aim = poses.position + poses.tilt[:, :1] * poses.rotation[:, :, 2]
    np.testing.assert_allclose(aim, points[poses.sample], atol=1e-14)
    # a turn about z alone keeps the viewing direction; the tilts set the angle to the normal
    cosine = -np.einsum("ij,ij->i", poses.rotation[:, :, 2], normals[poses.sample])
    np.testing.assert_allclose(cosine, np.cos(poses.tilt[:, 2]) * np.cos(poses.tilt[:, 3]), atol=1e-14)


def test_without_tilts_each_sample_has_one_pose() -> None:
    poses = candidate_poses(np.zeros((3, 3)), np.eye(3), TiltGrid((0.182,), (0.0,), (0.0,), (0.0,)))
    assert poses.sample.tolist() == [0, 1, 2]
    np.testing.assert_allclose(poses.position, 0.182 * np.eye(3))
