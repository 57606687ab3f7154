"""Poses as 4x4 matrices: `T_a_b` is the pose of b in a. Quaternions are (w, x, y, z)."""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray


def pose(position: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return poses (..., 4, 4) from positions (..., 3) in m and rotation matrices (..., 3, 3)."""
    position, rotation = np.asarray(position, float), np.asarray(rotation, float)
    T = np.zeros((*np.broadcast_shapes(position.shape[:-1], rotation.shape[:-2]), 4, 4))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = position
    T[..., 3, 3] = 1.0
    return T


def inverse(T: FloatArray) -> FloatArray:
    """Return the inverse poses of (..., 4, 4) rigid transforms."""
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    return pose(-(R_t @ T[..., :3, 3:])[..., 0], R_t)


def apply(T: FloatArray, points: FloatArray) -> FloatArray:
    """Map points (n, 3) by one pose (4, 4)."""
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def rotation_from_quaternion(quaternion: FloatArray) -> FloatArray:
    """Return rotation matrices (..., 3, 3) of quaternions (..., 4) in (w, x, y, z), normalised first."""
    q = np.asarray(quaternion, float)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )


def quaternion_from_rotation(rotation: FloatArray) -> FloatArray:
    """Return quaternions (..., 4) in (w, x, y, z) with w >= 0 of rotation matrices (..., 3, 3).

    The largest of the four components is computed first (Shepperd 1978), so no division is ill-conditioned.
    """
    R = np.asarray(rotation, float)
    d0, d1, d2 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    squares = np.stack([1 + d0 + d1 + d2, 1 + d0 - d1 - d2, 1 - d0 + d1 - d2, 1 - d0 - d1 + d2], -1)
    largest = np.argmax(squares, axis=-1)
    a, b, c = R[..., 2, 1], R[..., 0, 2], R[..., 1, 0]
    e, f, g = R[..., 1, 2], R[..., 2, 0], R[..., 0, 1]
    rows = np.stack(
        [
            np.stack([squares[..., 0], a - e, b - f, c - g], -1),
            np.stack([a - e, squares[..., 1], c + g, b + f], -1),
            np.stack([b - f, c + g, squares[..., 2], a + e], -1),
            np.stack([c - g, b + f, a + e, squares[..., 3]], -1),
        ],
        -2,
    )
    picked = np.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :]
    picked = picked / np.linalg.norm(picked, axis=-1, keepdims=True)
    return np.asarray(np.where(picked[..., :1] < 0, -picked, picked))


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return Rz(yaw) Ry(pitch) Rx(roll), the URDF convention, angles in rad, (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
