"""The joint axes of a chain as lines in space, and the frames that Denavit and Hartenberg's rule puts on them.

Recognising a kinematic family and solving it must not depend on the frames that a URDF happens to have.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import FloatArray

if TYPE_CHECKING:
    from cellwright.cell.robot import Chain

ALIGNED = 1e-8
"""Largest angle (rad) or distance (m) by which axes may miss being parallel, perpendicular or intersecting.

Rounded right angles in URDFs are off by some 1e-10; calibrated arms by 1e-3 and they are another family.
"""


def axes_at_zero(chain: Chain) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return directions (joints, 3) and points (joints, 3) of all axes, and the flange (4, 4), at q = 0 in the base."""
    from cellwright.cell.chain_kinematics import flange_pose, link_poses

    zero = np.zeros(chain.n_joints)
    links = link_poses(chain.T_parent_joint, chain.axis, zero)[1:]
    directions = np.einsum("jab,jb->ja", links[:, :3, :3], chain.axis)
    T_base_flange = flange_pose(chain.T_parent_joint, chain.axis, chain.T_last_flange, zero)
    return directions, links[:, :3, 3].copy(), T_base_flange


def parallel(h: FloatArray, h_other: FloatArray) -> bool:
    """Whether two directions are parallel or opposite."""
    return float(np.linalg.norm(np.cross(h, h_other))) <= ALIGNED


def perpendicular(h: FloatArray, h_other: FloatArray) -> bool:
    """Whether two directions are perpendicular."""
    return abs(float(h @ h_other)) <= ALIGNED


def meeting_point(p: FloatArray, h: FloatArray, p_other: FloatArray, h_other: FloatArray) -> tuple[FloatArray, float]:
    """Return the point of line (p, h) next to another line perpendicular to it, and the lines' distance in m."""
    between = p_other - p
    point = p + (between @ h) * h
    on_other = p_other - (between @ h_other) * h_other
    return point, float(np.linalg.norm(on_other - point))


def frame(x: FloatArray, z: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the pose (4, 4) of a frame by its x and z axes and origin."""
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = x, np.cross(z, x), z, origin
    return T


def turn(x_from: FloatArray, x_to: FloatArray, about: FloatArray) -> float:
    """Return the angle in rad that turns one direction to another about an axis perpendicular to both."""
    return math.atan2(float(about @ np.cross(x_from, x_to)), float(x_from @ x_to))
