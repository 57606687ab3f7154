"""Cut a motion into steps so small that no point of the robot moves further than a bound in any of them.

A rigid body moves from one pose to the next by an affine map of its points, and the length of an affine map is
convex: the point of a box that moves furthest is one of its corners. So the displacement of a body between two
states is at most that of the eight corners of a box around it, which is a bound for every point of the body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.cell import Cell
from cellwright.cell.robot import Chain
from cellwright.cell.transforms import apply
from cellwright.errors import SolverError
from cellwright.solvers.hermite import states_at, subdivide

ROUNDS = 8
"""Cuts after the first one; a smooth motion needs one or two, as its intervals are cut in equal times."""

ROUNDING = 1e-9
"""Share by which steps stay below their bounds, so that rounding never takes one beyond."""


class Motion(Protocol):
    """States that the cubic Hermite curve joins: time (states,) in s, the others (states, joints)."""

    @property
    def time(self) -> FloatArray: ...
    @property
    def position(self) -> FloatArray: ...
    @property
    def velocity(self) -> FloatArray: ...


@dataclass(frozen=True, eq=False)
class MovingCorners:
    """Corners of boxes around all bodies that the joints move.

    Attributes:
        chain: The arm's kinematics.
        link: What carries each corner: the link behind joint ``link``, (corners,).
        p_link: The corners in their links' frames, (corners, 3) in m.
    """

    chain: Chain
    link: FloatArray
    p_link: FloatArray

    @classmethod
    def of(cls, cell: Cell) -> MovingCorners:
        """Collect the corners of a cell's moving bodies."""
        moving = [body for body in cell.bodies if body.parent > 0]
        corners = [apply(body.T_parent_body, corners_of(body.shape)) for body in moving]
        link = np.repeat([body.parent for body in moving], 8) if moving else np.empty(0)
        return cls(cell.robot.chain, link, np.concatenate([np.empty((0, 3)), *corners]))

    def displacement(self, position: FloatArray) -> FloatArray:
        """Bound how far any point of the robot moves from each state to the next, (states - 1,) in m."""
        furthest = np.zeros(len(position) - 1)
        poses = link_poses_of(self.chain, position)
        for number in np.unique(self.link):
            np.maximum(
                furthest,
                chords(np.ascontiguousarray(poses[:, int(number)]), self.p_link[self.link == number]),
                out=furthest,
            )
        return furthest


@numba.njit(cache=True, nogil=True)
def chords(T: FloatArray, points: FloatArray) -> FloatArray:
    """Return how far the furthest of points (k, 3) moves from each pose (n, 4, 4) to the next, (n - 1,) in m."""
    furthest = np.zeros(len(T) - 1)
    for row in range(len(T) - 1):
        most = 0.0
        for k in range(len(points)):
            square = 0.0
            for i in range(3):
                way = T[row + 1, i, 3] - T[row, i, 3]
                for j in range(3):
                    way += (T[row + 1, i, j] - T[row, i, j]) * points[k, j]
                square += way * way
            most = max(most, square)
        furthest[row] = math.sqrt(most)
    return furthest


def link_poses_of(chain: Chain, position: FloatArray) -> FloatArray:
    """Return the poses of base and links (states, joints + 1, 4, 4) at many configurations (states, joints)."""
    n_states, n_joints = position.shape
    poses = np.tile(np.eye(4), (n_states, n_joints + 1, 1, 1))
    for joint in range(n_joints):
        c, s = np.cos(position[:, joint]), np.sin(position[:, joint])
        a = chain.axis[joint]
        cross = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
        turn = np.tile(np.eye(4), (n_states, 1, 1))
        turn[:, :3, :3] = (
            c[:, None, None] * np.eye(3) + s[:, None, None] * cross + (1.0 - c)[:, None, None] * np.outer(a, a)
        )
        poses[:, joint + 1] = poses[:, joint] @ (chain.T_parent_joint[joint] @ turn)
    return poses


def dense_times(motion: Motion, corners: MovingCorners, *, step: float, step_angle: float) -> FloatArray:
    """Return times (n,) of which each step moves no point further than ``step`` m, no joint by ``step_angle`` rad.

    All times of the motion are among them.

    Raises:
        SolverError: If cutting does not get there: the motion is not finite.
    """
    time = np.asarray(motion.time)
    for _ in range(ROUNDS):
        position, _ = states_at(motion.time, motion.position, motion.velocity, time)
        turned = np.abs(np.diff(position, axis=0)).max(axis=1)
        share = np.maximum(corners.displacement(position) / step, turned / step_angle)
        if not np.all(np.isfinite(share)):
            break
        parts = np.maximum(np.ceil(share * (1.0 + ROUNDING)), 1.0).astype(np.int64)
        if np.all(parts == 1):
            return time
        time = subdivide(time, parts)
    raise SolverError(f"a motion of {len(motion.time)} states cannot be cut into steps of {step * 1e3:.3g} mm")


def corners_of(shape: Shape) -> FloatArray:
    """Return the corners (8, 3) in m of the box around a shape, in the body's frame."""
    match shape:
        case Box():
            half = np.array(shape.size) / 2.0
            low, high = -half, half
        case Cylinder() | Capsule():
            reach = shape.length / 2.0 + (shape.radius if isinstance(shape, Capsule) else 0.0)
            high = np.array([shape.radius, shape.radius, reach])
            low = -high
        case Sphere():
            high = np.full(3, shape.radius)
            low = -high
        case Mesh():
            low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    choice = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], bool)
    return np.where(choice, high, low)
