"""Which pairs of bodies may be closer than a margin? Forward kinematics, spheres and boxes in one numba kernel.

Every body has a bounding sphere and an oriented bounding box in its own frame. A pair survives if the spheres,
then the boxes (separating axes; Gottschalk 1996) cannot rule it out; survivors go to the exact engine. A pair that
is ruled out is truly farther apart than the margin. About 2 us for the UR10e among a handful of bodies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.cell.bodies import WORLD, Body, Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.chain_kinematics import link_poses_into, multiply_into

_PARALLEL = 1e-9
"""Added to the rotation's absolute values: nearly parallel edges give no separating axis."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounding volumes of bodies: box centre in the body frame (n, 3), half extents (n, 3), sphere radius (n,)."""

    centre: FloatArray
    half: FloatArray
    radius: FloatArray


def bounds_of(bodies: tuple[Body, ...]) -> Bounds:
    """Return the bounding volumes of bodies."""
    boxes = [_box_of(body.shape) for body in bodies]
    centre = np.array([box[0] for box in boxes]).reshape(-1, 3)
    half = np.array([box[1] for box in boxes]).reshape(-1, 3)
    radius = np.array([_radius_of(body.shape, box[0], box[1]) for body, box in zip(bodies, boxes)]).reshape(-1)
    return Bounds(centre, half, radius)


def _box_of(shape: Shape) -> tuple[FloatArray, FloatArray]:
    match shape:
        case Box(size):
            return np.zeros(3), np.array(size) / 2.0
        case Cylinder(radius, length):
            return np.zeros(3), np.array([radius, radius, length / 2.0])
        case Capsule(radius, length):
            return np.zeros(3), np.array([radius, radius, length / 2.0 + radius])
        case Sphere(radius):
            return np.zeros(3), np.full(3, radius)
        case Mesh(vertices, _):
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            return (low + high) / 2.0, (high - low) / 2.0


def _radius_of(shape: Shape, centre: FloatArray, half: FloatArray) -> float:
    match shape:
        case Sphere(radius):
            return radius
        case Capsule(radius, length):
            return radius + length / 2.0
        case Cylinder(radius, length):
            return math.hypot(radius, length / 2.0)
        case Mesh(vertices, _):
            return float(np.linalg.norm(vertices - centre, axis=1).max())
        case Box():
            return float(np.linalg.norm(half))


@numba.njit(cache=True, nogil=True)
def body_poses_into(
    T_parent_joint: FloatArray,
    axis: FloatArray,
    T_world_base: FloatArray,
    parent: Int32Array,
    T_parent_body: FloatArray,
    q: FloatArray,
    links: FloatArray,
    T_world_body: FloatArray,
) -> None:
    """Write the world poses of all bodies at ``q`` to ``T_world_body`` (bodies, 4, 4); ``links`` is work space."""
    link_poses_into(T_parent_joint, axis, q, links)
    carrier = np.empty((4, 4))
    last = -2
    for body in range(len(parent)):
        if parent[body] == WORLD:
            T_world_body[body] = T_parent_body[body]
            continue
        if parent[body] != last:
            last = parent[body]
            multiply_into(T_world_base, links[last], carrier)
        multiply_into(carrier, T_parent_body[body], T_world_body[body])


@numba.njit(cache=True, nogil=True)
def _boxes_apart(
    A: FloatArray,
    half_a: FloatArray,
    B: FloatArray,
    half_b: FloatArray,
    t: FloatArray,
    margin: float,
    work: FloatArray,
) -> bool:
    """Whether two oriented boxes, centres ``t`` apart in the world, are provably more than ``margin`` apart.

    ``work`` is work space (8, 3): allocating it here would cost more than the test.
    """
    R, Q, d, a = work[0:3], work[3:6], work[6], work[7]
    for i in range(3):
        a[i] = half_a[i] + margin
        d[i] = t[0] * A[0, i] + t[1] * A[1, i] + t[2] * A[2, i]
        for j in range(3):
            R[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]
            Q[i, j] = abs(R[i, j]) + _PARALLEL
    for i in range(3):
        if abs(d[i]) > a[i] + half_b[0] * Q[i, 0] + half_b[1] * Q[i, 1] + half_b[2] * Q[i, 2]:
            return True
    for j in range(3):
        along = abs(d[0] * R[0, j] + d[1] * R[1, j] + d[2] * R[2, j])
        if along > a[0] * Q[0, j] + a[1] * Q[1, j] + a[2] * Q[2, j] + half_b[j]:
            return True
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            reach = a[i1] * Q[i2, j] + a[i2] * Q[i1, j] + half_b[j1] * Q[i, j2] + half_b[j2] * Q[i, j1]
            if abs(d[i2] * R[i1, j] - d[i1] * R[i2, j]) > reach:
                return True
    return False


@numba.njit(cache=True, nogil=True)
def _world_centre_into(T: FloatArray, centre: FloatArray, out: FloatArray) -> None:
    for row in range(3):
        out[row] = T[row, 0] * centre[0] + T[row, 1] * centre[1] + T[row, 2] * centre[2] + T[row, 3]


@numba.njit(cache=True, nogil=True)
def near_pairs_into(
    T_world_body: FloatArray,
    centre: FloatArray,
    half: FloatArray,
    radius: FloatArray,
    pairs: Int32Array,
    margin: float,
    centres: FloatArray,
    near: Int32Array,
) -> int:
    """Write the rows of ``pairs`` (pairs, 2) that may be within ``margin`` to ``near`` and return their number."""
    for body in range(len(radius)):
        _world_centre_into(T_world_body[body], centre[body], centres[body])
    count = 0
    t, work = np.empty(3), np.empty((8, 3))
    for pair in range(len(pairs)):
        a, b = pairs[pair, 0], pairs[pair, 1]
        reach = radius[a] + radius[b] + margin
        t[0] = centres[b, 0] - centres[a, 0]
        t[1] = centres[b, 1] - centres[a, 1]
        t[2] = centres[b, 2] - centres[a, 2]
        if t[0] * t[0] + t[1] * t[1] + t[2] * t[2] > reach * reach:
            continue
        if _boxes_apart(T_world_body[a], half[a], T_world_body[b], half[b], t, margin, work):
            continue
        near[count] = pair
        count += 1
    return count


@numba.njit(cache=True, nogil=True)
def near_pairs_at(
    T_parent_joint: FloatArray,
    axis: FloatArray,
    T_world_base: FloatArray,
    parent: Int32Array,
    T_parent_body: FloatArray,
    q: FloatArray,
    links: FloatArray,
    T_world_body: FloatArray,
    centre: FloatArray,
    half: FloatArray,
    radius: FloatArray,
    pairs: Int32Array,
    margin: float,
    centres: FloatArray,
    near: Int32Array,
) -> int:
    """`body_poses_into`, then `near_pairs_into`, in one call."""
    body_poses_into(T_parent_joint, axis, T_world_base, parent, T_parent_body, q, links, T_world_body)
    return int(near_pairs_into(T_world_body, centre, half, radius, pairs, margin, centres, near))
