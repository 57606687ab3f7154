"""Forward kinematics, geometric Jacobian and Newton tracking of a `Chain`, as numba kernels on plain arrays.

All poses are in the base frame; the Jacobian has linear rows first and is taken at the flange origin (pinocchio:
LOCAL_WORLD_ALIGNED). Functions named ``*_into`` write to given arrays and allocate nothing, for use in other
kernels. Under 1 us a call for six joints.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import FloatArray

_DAMPING = 1e-9
"""Squared damping of the Newton step: vanishes against a regular Jacobian, keeps a singular one solvable."""
_MAX_STEP = 0.5
"""Longest Newton step of any joint in rad: longer ones leave the range in which the linearisation holds."""


@numba.njit(cache=True, nogil=True, _nrt=False)
def multiply_into(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Write the product of two poses (4, 4) to ``out``, which must be neither of them."""
    for row in range(3):
        for column in range(4):
            total = A[row, 0] * B[0, column] + A[row, 1] * B[1, column] + A[row, 2] * B[2, column]
            out[row, column] = total + A[row, 3] if column == 3 else total
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0


@numba.njit(cache=True, nogil=True, _nrt=False)
def link_poses_into(T_parent_joint: FloatArray, axis: FloatArray, q: FloatArray, out: FloatArray) -> None:
    """Write the poses of base (identity) and links to ``out`` (joints + 1, 4, 4); Rodrigues' formula a joint."""
    for row in range(4):
        for column in range(4):
            out[0, row, column] = 1.0 if row == column else 0.0
    # element by element: slices of arrays are counted and uncounted, which takes as long as the arithmetic
    for k in range(len(q)):
        c, s = math.cos(q[k]), math.sin(q[k])
        x, y, z = axis[k, 0], axis[k, 1], axis[k, 2]
        t = 1.0 - c
        r00, r01, r02 = t * x * x + c, t * x * y - s * z, t * x * z + s * y
        r10, r11, r12 = t * x * y + s * z, t * y * y + c, t * y * z - s * x
        r20, r21, r22 = t * x * z - s * y, t * y * z + s * x, t * z * z + c
        for row in range(3):
            b0, b1, b2, b3 = out[k, row, 0], out[k, row, 1], out[k, row, 2], out[k, row, 3]
            f0 = b0 * T_parent_joint[k, 0, 0] + b1 * T_parent_joint[k, 1, 0] + b2 * T_parent_joint[k, 2, 0]
            f1 = b0 * T_parent_joint[k, 0, 1] + b1 * T_parent_joint[k, 1, 1] + b2 * T_parent_joint[k, 2, 1]
            f2 = b0 * T_parent_joint[k, 0, 2] + b1 * T_parent_joint[k, 1, 2] + b2 * T_parent_joint[k, 2, 2]
            f3 = b0 * T_parent_joint[k, 0, 3] + b1 * T_parent_joint[k, 1, 3] + b2 * T_parent_joint[k, 2, 3]
            out[k + 1, row, 0] = f0 * r00 + f1 * r10 + f2 * r20
            out[k + 1, row, 1] = f0 * r01 + f1 * r11 + f2 * r21
            out[k + 1, row, 2] = f0 * r02 + f1 * r12 + f2 * r22
            out[k + 1, row, 3] = f3 + b3
        out[k + 1, 3, 0] = out[k + 1, 3, 1] = out[k + 1, 3, 2] = 0.0
        out[k + 1, 3, 3] = 1.0


@numba.njit(cache=True, nogil=True)
def link_poses(T_parent_joint: FloatArray, axis: FloatArray, q: FloatArray) -> FloatArray:
    """Return the poses of base (row 0, identity) and of the link behind each joint, (joints + 1, 4, 4)."""
    out = np.empty((len(q) + 1, 4, 4))
    link_poses_into(T_parent_joint, axis, q, out)
    return out


@numba.njit(cache=True, nogil=True)
def flange_pose(T_parent_joint: FloatArray, axis: FloatArray, T_last_flange: FloatArray, q: FloatArray) -> FloatArray:
    """Return ``T_base_flange`` (4, 4) at ``q`` (joints,)."""
    out = np.empty((4, 4))
    multiply_into(link_poses(T_parent_joint, axis, q)[-1], T_last_flange, out)
    return out


@numba.njit(cache=True, nogil=True)
def flange_poses(T_parent_joint: FloatArray, axis: FloatArray, T_last_flange: FloatArray, q: FloatArray) -> FloatArray:
    """Return ``T_base_flange`` (n, 4, 4) at many configurations ``q`` (n, joints)."""
    out = np.empty((len(q), 4, 4))
    links = np.empty((q.shape[1] + 1, 4, 4))
    for row in range(len(q)):
        link_poses_into(T_parent_joint, axis, q[row], links)
        multiply_into(links[-1], T_last_flange, out[row])
    return out


@numba.njit(cache=True, nogil=True, _nrt=False)
def jacobian_into(links: FloatArray, axis: FloatArray, p_flange: FloatArray, out: FloatArray) -> None:
    """Write the geometric Jacobian (6, joints) of the point ``p_flange`` (3,) from link poses to ``out``."""
    for joint in range(len(axis)):
        link = links[joint + 1]
        # the axis is fixed in the joint frame and the rotation leaves it in place, so the link's pose serves
        wx = link[0, 0] * axis[joint, 0] + link[0, 1] * axis[joint, 1] + link[0, 2] * axis[joint, 2]
        wy = link[1, 0] * axis[joint, 0] + link[1, 1] * axis[joint, 1] + link[1, 2] * axis[joint, 2]
        wz = link[2, 0] * axis[joint, 0] + link[2, 1] * axis[joint, 1] + link[2, 2] * axis[joint, 2]
        dx, dy, dz = p_flange[0] - link[0, 3], p_flange[1] - link[1, 3], p_flange[2] - link[2, 3]
        out[0, joint], out[1, joint], out[2, joint] = wy * dz - wz * dy, wz * dx - wx * dz, wx * dy - wy * dx
        out[3, joint], out[4, joint], out[5, joint] = wx, wy, wz


@numba.njit(cache=True, nogil=True)
def jacobian(T_parent_joint: FloatArray, axis: FloatArray, T_last_flange: FloatArray, q: FloatArray) -> FloatArray:
    """Return the geometric Jacobian (6, joints) of the flange in the base frame, linear rows first."""
    links = link_poses(T_parent_joint, axis, q)
    T = np.empty((4, 4))
    multiply_into(links[-1], T_last_flange, T)
    out = np.empty((6, len(q)))
    jacobian_into(links, axis, T[:3, 3], out)
    return out


@numba.njit(cache=True, nogil=True)
def pose_error_into(T: FloatArray, T_target: FloatArray, out: FloatArray) -> None:
    """Write the twist (6,) that takes ``T`` to ``T_target`` to ``out``: metres, then the rotation vector in rad."""
    for row in range(3):
        out[row] = T_target[row, 3] - T[row, 3]
    R = np.empty((3, 3))
    for row in range(3):
        for column in range(3):
            R[row, column] = (
                T_target[row, 0] * T[column, 0] + T_target[row, 1] * T[column, 1] + T_target[row, 2] * T[column, 2]
            )
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    sine = 0.5 * math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))
    if sine < 1e-9 and angle > 1.0:
        # half a turn: the axis is the column of R + I with the largest diagonal
        largest = 0
        for row in range(1, 3):
            if R[row, row] > R[largest, largest]:
                largest = row
        norm = math.sqrt(2.0 * (1.0 + R[largest, largest]))
        for row in range(3):
            out[3 + row] = angle * (R[row, largest] + (1.0 if row == largest else 0.0)) / norm
        return
    scale = 0.5 if sine < 1e-9 else 0.5 * angle / sine
    out[3], out[4], out[5] = scale * x, scale * y, scale * z


@numba.njit(cache=True, nogil=True, _nrt=False)
def solve_in_place(A: FloatArray, b: FloatArray) -> bool:
    """Solve ``A x = b`` by Gaussian elimination with partial pivoting; ``b`` becomes x. False if singular."""
    n = len(b)
    for column in range(n):
        pivot = column
        for row in range(column + 1, n):
            if abs(A[row, column]) > abs(A[pivot, column]):
                pivot = row
        if abs(A[pivot, column]) < 1e-300:
            return False
        if pivot != column:
            for k in range(column, n):
                A[column, k], A[pivot, k] = A[pivot, k], A[column, k]
            b[column], b[pivot] = b[pivot], b[column]
        for row in range(column + 1, n):
            factor = A[row, column] / A[column, column]
            for k in range(column, n):
                A[row, k] -= factor * A[column, k]
            b[row] -= factor * b[column]
    for row in range(n - 1, -1, -1):
        for k in range(row + 1, n):
            b[row] -= A[row, k] * b[k]
        b[row] /= A[row, row]
    return True


@numba.njit(cache=True, nogil=True)
def track_pose(
    T_parent_joint: FloatArray,
    axis: FloatArray,
    T_last_flange: FloatArray,
    q_start: FloatArray,
    T_target: FloatArray,
    tolerance: float,
    max_steps: int,
) -> tuple[FloatArray, bool]:
    """Move ``q_start`` (joints,) to the nearby configuration whose flange pose is ``T_target`` (4, 4).

    Newton's method with the damped least-squares step ``J' (J J' + damping)^-1 error``; each step's largest
    joint change is at most 0.5 rad. Returns the configuration and whether position (m) and rotation (rad)
    errors are both at most ``tolerance``. Limits are not looked at.
    """
    n = len(q_start)
    q = q_start.copy()
    links, T = np.empty((n + 1, 4, 4)), np.empty((4, 4))
    J, error, step = np.empty((6, n)), np.empty(6), np.empty(6)
    A = np.empty((6, 6))
    for iteration in range(max_steps + 1):
        link_poses_into(T_parent_joint, axis, q, links)
        multiply_into(links[n], T_last_flange, T)
        pose_error_into(T, T_target, error)
        distance = math.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
        angle = math.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)
        if distance <= tolerance and angle <= tolerance:
            return q, True
        if iteration == max_steps:
            break
        jacobian_into(links, axis, T[:3, 3], J)
        for row in range(6):
            step[row] = error[row]
            for column in range(6):
                total = _DAMPING if row == column else 0.0
                for joint in range(n):
                    total += J[row, joint] * J[column, joint]
                A[row, column] = total
        if not solve_in_place(A, step):
            break
        largest = 0.0
        for joint in range(n):
            change = 0.0
            for row in range(6):
                change += J[row, joint] * step[row]
            largest = max(largest, abs(change))
        scale = 1.0 if largest <= _MAX_STEP else _MAX_STEP / largest
        for joint in range(n):
            change = 0.0
            for row in range(6):
                change += J[row, joint] * step[row]
            q[joint] += scale * change
    return q, False
