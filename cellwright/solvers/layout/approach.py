"""Approaches as the robot follows them: knots for the optimisers, and tracking of every pose for the gate.

An approach leads in straight lines through its poses: positions linearly, orientations by the shortest turn. The
optimisers constrain some knots of it; afterwards every pose is found by Newton's method from those knots on, so that
what lies between them is known too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import inverse
from cellwright.solvers.layout.problem import Approach, TargetKind

_KNOT_M = 0.12
_KNOT_RAD = 0.5
MOST_KNOTS = 9
_NEWTON_STEPS = 30
_DAMPING = 1e-8
JUMP = 0.1
"""Step of a joint, rad or m, between two samples of an approach from which on samples are taken between them, and a
jump if it is still there when they lie `_HALVINGS` times half as far apart."""
_HALVINGS = 7


@dataclass(frozen=True, eq=False)
class Knots:
    """Some poses of an approach.

    Attributes:
        T_station_tool: (k, 4, 4); first and last are those of the approach.
        durations_s: Time from each to the next, (k - 1,); NaN where the approach is untimed.
        place: Where each lies: number of the piece plus share of it, (k,).
    """

    T_station_tool: FloatArray
    durations_s: FloatArray
    place: FloatArray

    @property
    def timed(self) -> bool:
        """Whether there are several knots with times between them."""
        return len(self.durations_s) > 0 and bool(np.isfinite(self.durations_s).all())


def approach_knots(approach: Approach, most: int = MOST_KNOTS) -> Knots:
    """Return knots at most 0.12 m and 0.5 rad apart, or ``most`` ones if that asks for more."""
    n = approach.n_poses
    if n == 1:
        return Knots(approach.T_station_tool, np.zeros(0), np.zeros(1))
    lengths, angles = piece_sizes(approach.T_station_tool)
    effort = np.maximum(lengths / _KNOT_M, angles / _KNOT_RAD)
    count = min(max(math.ceil(effort.sum()), 1), most - 1)
    along = np.concatenate([[0.0], np.cumsum(np.maximum(effort, 1e-9))])
    place = np.interp(np.linspace(0.0, along[-1], count + 1), along, np.arange(n))
    if approach.durations_s is None:
        durations = np.full(count, np.nan)
    else:
        clock = np.concatenate([[0.0], np.cumsum(approach.durations_s)])
        durations = np.diff(np.interp(place, np.arange(n), clock))
    return Knots(poses_at(approach.T_station_tool, place), durations, place)


def piece_sizes(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lengths in m and angles in rad, (n - 1,) each, between poses (n, 4, 4)."""
    lengths = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    angles = np.linalg.norm(rotation_vectors(np.swapaxes(poses[:-1, :3, :3], 1, 2) @ poses[1:, :3, :3]), axis=1)
    return lengths, angles


def rotation_vectors(R: FloatArray) -> FloatArray:
    """Return axis times angle (..., 3) in rad of rotations (..., 3, 3)."""
    vector = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    sine = 0.5 * np.linalg.norm(vector, axis=-1)
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    scale = np.where(sine > 1e-9, angle / np.maximum(2.0 * sine, 1e-12), 0.5)
    found = vector * scale[..., None]
    half_turn = (sine <= 1e-9) & (cosine < 0.0)
    if np.any(half_turn):
        # the skew part vanishes at a half turn: the axis is the largest column of R + 1
        columns = R + np.eye(3)
        largest = np.argmax(np.linalg.norm(columns, axis=-2), axis=-1)
        axis = np.take_along_axis(columns, largest[..., None, None], axis=-1)[..., 0]
        axis = axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
        found = np.where(half_turn[..., None], np.pi * axis, found)
    return np.asarray(found)


def rotations(vectors: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) of axis times angle (..., 3) in rad (Rodrigues)."""
    v = np.asarray(vectors, float)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    K = np.zeros((*v.shape[:-1], 3, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    K = K - np.swapaxes(K, -1, -2)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * K + second * (K @ K))


def poses_at(poses: FloatArray, place: FloatArray) -> FloatArray:
    """Return the poses (m, 4, 4) at places (m,) along poses (n, 4, 4): piece plus share of it."""
    if len(poses) == 1:
        return np.repeat(poses, len(place), axis=0)
    piece = np.clip(np.floor(place).astype(int), 0, len(poses) - 2)
    share = (place - piece)[:, None]
    T = poses[piece].copy()
    T[:, :3, 3] += share * (poses[piece + 1, :3, 3] - poses[piece, :3, 3])
    turn = rotation_vectors(np.swapaxes(poses[piece, :3, :3], 1, 2) @ poses[piece + 1, :3, :3])
    T[:, :3, :3] = T[:, :3, :3] @ rotations(share * turn)
    return np.asarray(T)


def target_error(T_actual: FloatArray, T_goal: FloatArray, target: TargetKind) -> FloatArray:
    """Return position (m) and rotation error (rad) as rows (..., 6), in the base's axes; what is free counts zero."""
    error = np.zeros((*np.broadcast_shapes(T_actual.shape[:-2], T_goal.shape[:-2]), 6))
    error[..., :3] = T_goal[..., :3, 3] - T_actual[..., :3, 3]
    if target is TargetKind.POSE:
        error[..., 3:] = rotation_vectors(T_goal[..., :3, :3] @ np.swapaxes(T_actual[..., :3, :3], -1, -2))
    elif target is TargetKind.AXIS:
        now, goal = T_actual[..., :3, 2], T_goal[..., :3, 2]
        across = np.cross(now, goal)
        sine = np.linalg.norm(across, axis=-1, keepdims=True)
        angle = np.arctan2(sine, np.sum(now * goal, axis=-1, keepdims=True))
        # opposite axes have no cross product: any turn leads towards the goal
        away = np.where(sine > 1e-9, across / np.maximum(sine, 1e-12), T_actual[..., :3, 0])
        error[..., 3:] = angle * away
    return error


def newton_steps(
    arm: SerialArm,
    T_flange_tool: FloatArray,
    q: FloatArray,
    T_base_goal: FloatArray,
    target: TargetKind,
    *,
    steps: int = _NEWTON_STEPS,
    damping: float = _DAMPING,
    largest: float = 0.4,
    within_limits: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Return configurations (n, joints) brought towards goals (n, 4, 4) from ``q`` (n, joints), and errors (n, 6).

    Damped least squares, all rows at once; a step turns no joint farther than ``largest``.
    """
    q = np.array(q, float)
    for _ in range(steps):
        links = arm.link_poses(q)
        T_base_tool = links[..., -1, :, :] @ arm.T_last_flange @ T_flange_tool
        error = target_error(T_base_tool, T_base_goal, target)
        size = np.abs(error).max(axis=1)
        if size.max(initial=0.0) < 1e-12:
            break
        J = arm.jacobian(q, T_flange_tool, links)
        if target is TargetKind.POSITION:
            J[:, 3:] = 0.0
        elif target is TargetKind.AXIS:
            z = T_base_tool[:, :3, 2]
            J[:, 3:] -= z[:, :, None] * np.einsum("ni,nij->nj", z, J[:, 3:])[:, None, :]
        damped = np.swapaxes(J, 1, 2) @ J
        damped[:, range(arm.n_joints), range(arm.n_joints)] += damping + 0.1 * np.minimum(size, 1.0)[:, None] ** 2
        step = np.linalg.solve(damped, (np.swapaxes(J, 1, 2) @ error[:, :, None]))[:, :, 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        q += step * np.minimum(1.0, largest / np.maximum(longest, 1e-12))
        if within_limits:
            q = np.clip(q, arm.lower, arm.upper)
    return q, target_error(arm.flange_pose(q) @ T_flange_tool, T_base_goal, target)


@dataclass(frozen=True, eq=False)
class Followed:
    """An approach followed pose by pose.

    Attributes:
        q: Configurations at the approach's poses, (n, joints).
        dense_q: The same with poses in between, closer where the arm turns fast, (m, joints).
        dense_s: Time from each dense configuration to the next, (m - 1,); NaN where untimed.
        error_m, error_rad: Largest residual over all of them.
    """

    q: FloatArray
    dense_q: FloatArray
    dense_s: FloatArray
    error_m: float
    error_rad: float

    @property
    def timed(self) -> bool:
        """Whether there are several configurations with times between them."""
        return len(self.dense_s) > 0 and bool(np.isfinite(self.dense_s).all())

    @property
    def jump(self) -> float:
        """The largest step of a joint between two neighbouring configurations, rad or m."""
        return float(np.abs(np.diff(self.dense_q, axis=0)).max(initial=0.0))


def follow_approach(
    arm: SerialArm,
    T_flange_tool: FloatArray,
    approach: Approach,
    T_base_station: FloatArray,
    knots: Knots,
    knot_q: FloatArray,
    *,
    step_m: float = 0.005,
    step_rad: float = 0.05,
    smooth: bool = False,
) -> Followed:
    """Follow an approach through its given knots ``knot_q`` (knots, joints); the first and last stay as they are.

    What poses leave free goes in straight lines between knots, or ``smooth`` along a timed approach: with the constant
    accelerations that a program on these knots reckons with.
    """
    n = approach.n_poses
    if n == 1:
        T = T_base_station @ approach.T_station_tool[0]
        error = target_error(arm.flange_pose(knot_q[0]) @ T_flange_tool, T, approach.target)
        return Followed(knot_q, knot_q, np.zeros(0), *_sizes(error[None]))
    lengths, angles = piece_sizes(approach.T_station_tool)
    parts = np.maximum(np.ceil(np.maximum(lengths / step_m, angles / step_rad)), 1).astype(int)
    place = np.concatenate([np.linspace(i, i + 1, c, endpoint=False) for i, c in enumerate(parts.tolist())] + [[n - 1]])
    guess = _at_knots(approach, knots, knot_q, place, smooth)

    def met(place: FloatArray, guess: FloatArray) -> FloatArray:
        goals = T_base_station @ poses_at(approach.T_station_tool, place)
        return newton_steps(arm, T_flange_tool, guess, goals, approach.target)[0]

    q = np.concatenate([knot_q[:1], met(place[1:-1], guess[1:-1]), knot_q[-1:]])
    for _ in range(_HALVINGS):
        wide = np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) > JUMP)
        if not len(wide):
            break
        between = 0.5 * (place[wide] + place[wide + 1])
        q = np.insert(q, wide + 1, met(between, 0.5 * (q[wide] + q[wide + 1])), axis=0)
        place = np.insert(place, wide + 1, between)
    goals = T_base_station @ poses_at(approach.T_station_tool, place)
    error = target_error(arm.flange_pose(q) @ T_flange_tool, goals, approach.target)
    if approach.durations_s is None:
        times = np.full(len(place) - 1, np.nan)
    else:
        times = approach.durations_s[np.floor(place[:-1]).astype(int)] * np.diff(place)
    return Followed(q[np.searchsorted(place, np.arange(n))], q, times, *_sizes(error))


def _at_knots(approach: Approach, knots: Knots, knot_q: FloatArray, place: FloatArray, smooth: bool) -> FloatArray:
    """Return configurations (m, joints) at places (m,) between knots: straight lines, if ``smooth`` with round corners.

    Round are means over the shortest time between two knots: so a speed changes evenly from one piece to the next.
    """
    if not (smooth and knots.timed and approach.durations_s is not None):
        return np.stack([np.interp(place, knots.place, column) for column in knot_q.T], axis=1)
    clock = np.concatenate([[0.0], np.cumsum(approach.durations_s)])
    t, corner = (np.interp(each, np.arange(approach.n_poses), clock) for each in (place, knots.place))
    pace = np.diff(knot_q, axis=0) / np.diff(corner)[:, None]
    area = np.diff(corner)[:, None] * 0.5 * (knot_q[1:] + knot_q[:-1])
    before = np.concatenate([np.zeros((1, knot_q.shape[1])), np.cumsum(area, axis=0)])

    def integral(t: FloatArray) -> FloatArray:
        # the first and the last piece go on beyond their ends
        piece = np.clip(np.searchsorted(corner, t, side="right") - 1, 0, len(pace) - 1)
        since = (t - corner[piece])[:, None]
        return np.asarray(before[piece] + since * (knot_q[piece] + 0.5 * since * pace[piece]))

    width = float(np.diff(corner).min())
    return (integral(t + 0.5 * width) - integral(t - 0.5 * width)) / width


def _sizes(error: FloatArray) -> tuple[float, float]:
    return float(np.linalg.norm(error[:, :3], axis=1).max()), float(np.linalg.norm(error[:, 3:], axis=1).max())


def base_goals(T_world_base: FloatArray, T_world_station: FloatArray, poses: FloatArray) -> FloatArray:
    """Return tool goals (n, 4, 4) in the robot's base of poses (n, 4, 4) relative to a station."""
    return np.asarray(inverse(T_world_base) @ T_world_station @ poses)
