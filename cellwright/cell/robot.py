"""A serial arm: its URDF as a pinocchio model, its limits, and its chain as plain arrays for kernels."""

from __future__ import annotations

from dataclasses import dataclass

from cellwright.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Chain:
    """A serial chain of revolute joints as plain arrays, for numba kernels and inverse kinematics.

    The pose of link ``i`` (behind joint ``i``, ``i`` from 1) in the base is the product over joints of
    ``T_parent_joint[k] @ rotation(axis[k], q[k])``; the flange is ``link_n @ T_last_flange``.

    Attributes:
        T_parent_joint: Fixed pose of each joint frame on the link before it, (joints, 4, 4).
        axis: Unit rotation axes in the joint frames, (joints, 3).
        T_last_flange: Pose of the flange on the last link, (4, 4).
        lower, upper: Joint limits in rad, (joints,).
        max_velocity: Joint speed limits in rad/s, (joints,).
        max_acceleration: Joint acceleration limits in rad/s^2, (joints,).
    """

    T_parent_joint: FloatArray
    axis: FloatArray
    T_last_flange: FloatArray
    lower: FloatArray
    upper: FloatArray
    max_velocity: FloatArray
    max_acceleration: FloatArray


class Robot:
    """To be completed by the cell-model work: see docs/architecture.md for its interface."""

    chain: Chain
