"""Inverse kinematics of six-axis arms with an offset wrist like the FANUC CRX series, by the crx-kinematics library.

The family: axes 2 and 3 parallel, all other neighbours perpendicular and intersecting, with an offset along axis 5
that keeps the wrist from being spherical. Up to sixteen branches (Abbes and Poisson 2024, "Geometric approach for
inverse kinematics of the FANUC CRX collaborative robot"). The arm's own frames are mapped to those of the library
by Denavit-Hartenberg frames on the axes of both. About 20 us a pose; the library holds the interpreter's lock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

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

N_BRANCHES = 16
_MM = 1000.0
_HAND_MM = 160.0
"""Distance from axis 5 to the library's flange: any but 0, which its solver cannot take. It cancels out."""


@dataclass(frozen=True, eq=False)
class OffsetWrist:
    """Where an arm of the family differs from another one of the same three lengths.

    Its Denavit-Hartenberg angles are ``signs * q + offsets``.

    Attributes:
        upper_arm, forearm, wrist_offset: Distance of axes 2 and 3, of axes 3 and 5, of axes 4 and 6, in m.
        T_base_0: Frame on axis 1 at its crossing with axis 2, (4, 4).
        T_6_flange: Flange in the frame on axis 6 at its crossing with axis 5, (4, 4).
        signs, offsets: Sense and zero of each joint, (6,).
    """

    upper_arm: float
    forearm: float
    wrist_offset: float
    T_base_0: FloatArray
    T_6_flange: FloatArray
    signs: FloatArray
    offsets: FloatArray


def offset_wrist(chain: Chain) -> OffsetWrist | None:
    """Read the family's geometry off a chain; None if the chain is of another family."""
    if chain.n_joints != 6:
        return None
    h, p, T_base_flange = axes_at_zero(chain)
    if not (parallel(h[1], h[2]) and all(perpendicular(h[k], h[k + 1]) for k in (0, 2, 3, 4))):
        return None
    (o1, gap1), (o3, gap3), (o4, gap4), (o5, gap5) = (
        meeting_point(p[k], h[k], p[k - 1], h[k - 1]) for k in (1, 3, 4, 5)
    )
    z1 = h[1]
    o2 = p[2] + ((o1 - p[2]) @ z1) * z1
    if max(gap1, gap3, gap4, gap5, abs(float((o3 - o2) @ z1))) > ALIGNED:
        return None
    z3 = h[3] * math.copysign(1.0, (o4 - o3) @ h[3])
    z4 = h[4] * math.copysign(1.0, (o5 - o4) @ h[4])
    lengths = [float(np.linalg.norm(o2 - o1)), float((o4 - o3) @ z3), float((o5 - o4) @ z4)]
    if min(lengths) < ALIGNED:
        return None
    z = [h[0], z1, z1, z3, z4, h[5]]
    first = np.cross(z[0], z[1])
    x = [first, first, (o2 - o1) / lengths[0], np.cross(z1, z3), np.cross(z3, z4), np.cross(z4, z[5])]
    x.append(x[5])
    signs = np.array([1.0, 1.0, math.copysign(1.0, h[2] @ z1), *(float(h[k] @ z[k]) for k in (3, 4)), 1.0])
    return OffsetWrist(
        lengths[0],
        lengths[1],
        lengths[2],
        frame(x[0], z[0], o1),
        inverse(frame(x[5], z[5], o5)) @ T_base_flange,
        np.sign(signs),
        np.array([turn(x[k], x[k + 1], z[k]) for k in range(6)]),
    )


class OffsetWristSolver:
    """All branches of an arm of the family, by crx-kinematics on the arm's own lengths."""

    def __init__(self, geometry: OffsetWrist) -> None:
        import crx_kinematics

        self._own = geometry
        lengths = (geometry.upper_arm, geometry.forearm, geometry.wrist_offset)
        self._crx: Any = crx_kinematics.Crx.from_params(lengths[0] * _MM, lengths[1] * _MM, _HAND_MM, lengths[2] * _MM)
        flange = np.array(self._crx.fk(np.zeros(6)))
        flange[:3, 3] /= _MM
        found = offset_wrist(_library_chain(*lengths, flange))
        if found is None:
            raise RuntimeError("crx-kinematics has changed its conventions")
        self._library = found

    def candidates(self, T_base_flange: FloatArray) -> FloatArray:
        """Return candidates (n, 16, 6) in rad for poses (n, 4, 4), NaN where there are fewer."""
        own, library = self._own, self._library
        targets = (
            library.T_base_0 @ inverse(own.T_base_0) @ T_base_flange @ inverse(own.T_6_flange) @ library.T_6_flange
        )
        targets[:, :3, 3] *= _MM
        found = np.full((len(targets), N_BRANCHES, 6), np.nan)
        for row, target in enumerate(targets):
            solutions = self._crx.ik(target)[:N_BRANCHES]
            found[row, : len(solutions)] = solutions
        q = np.deg2rad(found)
        q[..., 2] += q[..., 1]  # the controller counts joint 3 from the horizontal
        theta = library.signs * q + library.offsets
        return np.asarray(own.signs * (theta - own.offsets))


def _library_chain(upper_arm: float, forearm: float, wrist_offset: float, flange: FloatArray) -> Chain:
    """Return the library's arm as a chain: FANUC's zero posture, upper arm upright, forearm along x."""
    from cellwright.cell.robot import Chain

    fixed = np.tile(np.eye(4), (6, 1, 1))
    fixed[2, 2, 3], fixed[4, 0, 3], fixed[5, 1, 3] = upper_arm, forearm, -wrist_offset
    axis = np.array([[0, 0, 1], [0, 1, 0], [0, -1, 0], [-1, 0, 0], [0, -1, 0], [-1, 0, 0]], float)
    before = np.eye(4)
    for T in fixed:
        before = before @ T
    ones = np.ones(6)
    return Chain(fixed, axis, inverse(before) @ flange, -ones, ones, ones, ones)
