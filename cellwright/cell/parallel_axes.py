"""Closed-form inverse kinematics of six-axis arms with three parallel inner axes: every Universal Robots arm.

The family: axes 2, 3, 4 parallel; axes 1 and 2, 4 and 5, 5 and 6 perpendicular and intersecting. Frames are put on
the axes by Denavit and Hartenberg's rule (alpha = 90, 0, 0, 90, -90, 0 degrees), whatever frames the URDF has, so the
textbook solution (Hawkins 2013, "Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms") applies to
all of them. Angles come from two-argument arctangents, so nothing is lost near 0 and 180 degrees.

All eight branches, about 1 us a pose. The row of a branch is its posture, so it stays the same along a path:
bit 2 shoulder, bit 1 wrist, bit 0 elbow.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numba
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.axis_frames import (
    ALIGNED,
    axes_at_zero,
    frame,
    meeting_point,
    parallel,
    perpendicular,
    turn,
)
from cellwright.cell.transforms import inverse

if TYPE_CHECKING:
    from cellwright.cell.robot import Chain

N_BRANCHES = 8
_ROUNDING = 1e-9
"""How far a cosine or sine may be beyond 1 (stretched arm) or from 0 (parallel axes 4 and 6) and count as there.

Costs at most a nanometre, less than the rounded right angles of published URDFs do."""


def parallel_axes_geometry(chain: Chain) -> FloatArray | None:
    """Return the packed geometry (40,) of a chain of this family for `branches_into`, or None if it is of another.

    Packed: ``T_0_base`` and ``T_flange_6`` (12 numbers each, three rows), a2, a3, d4, d5, six signs, six offsets.
    """
    if chain.n_joints != 6:
        return None
    h, p, T_base_flange = axes_at_zero(chain)
    if not (parallel(h[1], h[2]) and parallel(h[1], h[3]) and all(perpendicular(h[k], h[k + 1]) for k in (0, 3, 4))):
        return None
    o1, gap1 = meeting_point(p[0], h[0], p[1], h[1])
    o4, gap4 = meeting_point(p[4], h[4], p[3], h[3])
    o5, gap5 = meeting_point(p[5], h[5], p[4], h[4])
    if max(gap1, gap4, gap5) > ALIGNED:
        return None
    z = h[1]
    # points of axes 3 and 4 at the height of the first meeting point along their common direction
    o2, o3 = (point + ((o1 - point) @ z) * z for point in (p[2], p[3]))
    a2, a3 = float(np.linalg.norm(o2 - o1)), float(np.linalg.norm(o3 - o2))
    if min(a2, a3) < ALIGNED:
        return None
    x = [np.cross(h[0], z), np.cross(h[0], z), (o2 - o1) / a2, (o3 - o2) / a3, np.cross(z, h[4]), np.cross(h[5], h[4])]
    about = [h[0], z, z, z, h[4], h[5]]
    x.append(x[5])
    offsets = [turn(x[k], x[k + 1], about[k]) for k in range(6)]
    signs = [1.0, 1.0, math.copysign(1.0, h[2] @ z), math.copysign(1.0, h[3] @ z), 1.0, 1.0]
    T_base_0 = frame(x[0], h[0], o1)
    T_flange_6 = inverse(T_base_flange) @ frame(x[5], h[5], o5)
    lengths = [a2, a3, float((o4 - o3) @ z), float((o5 - o4) @ h[4])]
    return np.concatenate([inverse(T_base_0)[:3].ravel(), T_flange_6[:3].ravel(), lengths, signs, offsets])


@numba.njit(cache=True, nogil=True)
def _wrapped(angle: float) -> float:
    wrapped = angle - 2.0 * math.pi * math.ceil(angle / (2.0 * math.pi) - 0.5)
    return wrapped if wrapped > -math.pi else math.pi


@numba.njit(cache=True, nogil=True)
def branches_into(geometry: FloatArray, T_base_flange: FloatArray, out: FloatArray) -> int:
    """Write all branches for one pose (4, 4) to ``out`` (8, 6), rad in (-pi, pi], NaN rows where there is none.

    ``geometry`` is that of `parallel_axes_geometry`. Returns the number of branches. Where axes 4 and 6 are
    parallel, one of infinitely many solutions is given, that with axis 6 at its Denavit-Hartenberg zero.
    """
    R = np.empty((3, 4))
    half = np.empty((3, 4))
    for row in range(3):
        for column in range(4):
            total = geometry[4 * row + 3] if column == 3 else 0.0
            for k in range(3):
                total += geometry[4 * row + k] * T_base_flange[k, column]
            half[row, column] = total
    for row in range(3):
        for column in range(4):
            total = half[row, 3] if column == 3 else 0.0
            for k in range(3):
                total += half[row, k] * geometry[12 + 4 * k + column]
            R[row, column] = total
    out[:, :] = math.nan
    a2, a3, d4, d5 = geometry[24], geometry[25], geometry[26], geometry[27]
    reach = math.hypot(R[0, 3], R[1, 3])
    if reach < 1e-12 and abs(d4) > 1e-12:
        return 0
    sine1 = d4 / reach if reach >= 1e-12 else 0.0
    if abs(sine1) > 1.0 + _ROUNDING:
        return 0
    swing = math.asin(min(1.0, max(-1.0, sine1)))
    heading = math.atan2(R[1, 3], R[0, 3])
    found = 0
    theta = np.empty(6)
    for shoulder in range(2):
        theta[0] = heading + swing if shoulder == 0 else heading + math.pi - swing
        c1, s1 = math.cos(theta[0]), math.sin(theta[0])
        # the direction of axes 2, 3, 4, (s1, -c1, 0), seen in frame 6
        m0 = s1 * R[0, 0] - c1 * R[1, 0]
        m1 = s1 * R[0, 1] - c1 * R[1, 1]
        m2 = s1 * R[0, 2] - c1 * R[1, 2]
        sine5 = math.hypot(m0, m1)
        for wrist in range(2):
            side = 1.0 if wrist == 0 else -1.0
            theta[4] = math.atan2(side * sine5, m2)
            theta[5] = math.atan2(-side * m1, side * m0) if sine5 > _ROUNDING else 0.0
            c6, s6 = math.cos(theta[5]), math.sin(theta[5])
            z4x = -s6 * R[0, 0] - c6 * R[0, 1]
            z4y = -s6 * R[1, 0] - c6 * R[1, 1]
            z4z = -s6 * R[2, 0] - c6 * R[2, 1]
            sum234 = math.atan2(z4x * c1 + z4y * s1, -z4z)
            u = (R[0, 3] - d5 * z4x) * c1 + (R[1, 3] - d5 * z4y) * s1
            v = R[2, 3] - d5 * z4z
            cosine3 = (u * u + v * v - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
            if abs(cosine3) > 1.0 + _ROUNDING:
                continue
            sine3 = math.sqrt(max(0.0, 1.0 - cosine3 * cosine3))
            for elbow in range(2):
                theta[2] = math.atan2(sine3 if elbow == 0 else -sine3, cosine3)
                theta[1] = math.atan2(v, u) - math.atan2(a3 * math.sin(theta[2]), a2 + a3 * math.cos(theta[2]))
                theta[3] = sum234 - theta[1] - theta[2]
                row = 4 * shoulder + 2 * wrist + elbow
                for joint in range(6):
                    out[row, joint] = _wrapped(geometry[28 + joint] * (theta[joint] - geometry[34 + joint]))
                found += 1
    return found


@numba.njit(cache=True, nogil=True)
def branches(geometry: FloatArray, T_base_flange: FloatArray) -> FloatArray:
    """Return all branches (n, 8, 6) of many poses (n, 4, 4); see `branches_into`."""
    out = np.empty((len(T_base_flange), 8, 6))
    for row in range(len(T_base_flange)):
        branches_into(geometry, T_base_flange[row], out[row])
    return out
