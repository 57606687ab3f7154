"""How far joints may move before anything can touch: trust regions from the clearance, Bjorkenstam 2014, section 2.4.

With phi(q) the distance between two bodies and w_i(q) the 1-norm of the fastest motion of any point of the outer one a
unit of joint i, moving each of the n joints between them by at most (phi(q) - d_c) / (n w_i(q)) leaves a clearance of
d_c to first order: sum_i w_i abs(dq_i) bounds how far a point moves. The paper takes arm and surroundings as one pair;
here each pair of bodies counts for itself, so that links that are always near each other bind only the joints between
them. What comes out is a box about each node's positions, whatever the geometry.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.solvers.motion_steps import MovingCorners, link_poses_of
from cellwright.solvers.roadmap import CollisionChecker

SMALLEST_WEIGHT = 1e-6
"""m per rad below which a joint moves nothing: its box would be endless."""
WIDEST = 1.0
"""rad; wider boxes say nothing: the bound is of first order."""
EXACT_WITHIN = 0.3
"""m; pairs further apart count with the gap between their bounding balls, which is cheap."""


class ClearanceScene(CollisionChecker, Protocol):
    """What collision avoidance asks of a scene; `cellwright.cell.scene.Scene` is one."""

    clearance_m: float

    @property
    def pair_links(self) -> Int32Array:
        """Inner and outer link of each pair of bodies, (pairs, 2)."""
        ...

    def pair_distances(self, q: FloatArray, within: float, /) -> FloatArray:
        """Return what separates each pair at least, (pairs,) in m, exact below ``within`` m."""
        ...

    def distance(self, q: FloatArray, /) -> float:
        """Return the smallest distance in m between bodies at ``q`` (joints,); 0 if they collide."""
        ...

    def colliding_pair(self, q: FloatArray, /) -> tuple[str, str] | None:
        """Return the names of a colliding pair, or None."""
        ...


def joint_weights(corners: MovingCorners, q: FloatArray) -> FloatArray:
    """Return w_i(q) in m per rad of the bodies on each link: (links, states, joints) for ``q`` (states, joints).

    The 1-norm is convex and the motion of points affine in them, so corners of boxes about the bodies bound it. Row 0
    is the base.
    """
    poses = link_poses_of(corners.chain, q)
    weights = np.zeros((corners.chain.n_joints + 1, *q.shape))
    for number in np.unique(corners.link).astype(int).tolist():
        T = poses[:, number]
        points = np.einsum("sij,kj->ski", T[:, :3, :3], corners.p_link[corners.link == number]) + T[:, None, :3, 3]
        for joint in range(number):
            # a joint's own motion leaves its axis where it is, so the frame behind it serves as well
            frame = poses[:, joint + 1]
            axis = frame[:, :3, :3] @ corners.chain.axis[joint]
            moved = np.cross(axis[:, None], points - frame[:, None, :3, 3])
            weights[number, :, joint] = np.abs(moved).sum(axis=2).max(axis=1)
    return weights


def clearance_boxes(
    scene: ClearanceScene, corners: MovingCorners, q: FloatArray, share: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper positions (nodes, joints) about nodes ``q``.

    ``share`` shrinks the boxes. Where a pair has no more than the scene's clearance, the joints between stay put.
    """
    inner, outer = scene.pair_links.T
    joints = np.arange(q.shape[1])
    between = (joints >= inner[:, None]) & (joints < outer[:, None])  # (pairs, joints)
    weights = np.maximum(joint_weights(corners, q), SMALLEST_WEIGHT)
    half = np.full(q.shape, WIDEST)
    for row, node in enumerate(q):
        room = np.maximum(scene.pair_distances(node, EXACT_WITHIN) - scene.clearance_m, 0.0)
        reach = (room / (outer - inner))[:, None] / weights[outer, row]
        np.minimum(half[row], np.min(np.where(between, reach, WIDEST), axis=0, initial=WIDEST), out=half[row])
    return q - share * half, q + share * half
