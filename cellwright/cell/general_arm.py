"""Inverse kinematics of any six-axis arm with turning joints: all branches as the roots of a polynomial of degree 16.

Method: Raghavan and Roth 1993, "Inverse kinematics of the general 6R manipulator and related linkages", as an
eigenvalue problem (Manocha and Canny 1994). Both ends of the chain are brought to the line of axis 6 as the middle of
the arm sees it: ``E3 E4 E5 (p, l) = E2^-1 E1^-1 (p', l')``. Fourteen functions of point p and direction l are bilinear
in the cosines and sines of joints 1 and 2, which are eliminated linearly; what is left is a 12 x 12 matrix, quadratic
in the half-angle tangent of joint 3, whose null vectors hold joints 4 and 5. The coefficients are not derived but
measured: three angles a joint fix a function that is linear in its cosine and sine.

Axes that meet or are parallel make the matrices singular. So not the arm itself is eliminated but variants of it whose
axes are moved and turned a little at random; Newton's method takes their roots to the arm's own. What one variant
loses, where two roots lie close together, another one finds. About 0.3 ms a pose and variant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from cellwright.arrays import AnyArray, FloatArray
from cellwright.cell.axis_frames import axes_at_zero
from cellwright.cell.chain_kinematics import flange_poses, track_pose
from cellwright.cell.transforms import inverse, pose

if TYPE_CHECKING:
    from cellwright.cell.robot import Chain

N_BRANCHES = 16
VARIANTS = (1e-5, 1e-4, 1e-4, 1e-3, 1e-5, 1e-4, 1e-6)
"""How far the axes of each variant are moved and turned, relative to the arm's size."""
_POLISH_STEPS = 16
_POLISHED = 1e-10
"""Metres and radians that polished roots miss their pose by at most."""
_ANGLES = np.array([0.0, 2.0, 4.0]) * math.pi / 3.0
_TO_COEFFICIENTS = np.linalg.inv(np.stack([np.cos(_ANGLES), np.sin(_ANGLES), np.ones(3)], -1))
"""Takes values at the three angles to the factors of cosine, sine and 1."""
_TO_POWERS = np.array([[-1.0, 0.0, 1.0], [0.0, 2.0, 0.0], [1.0, 0.0, 1.0]])
"""Cosine, sine and 1 times ``1 + x^2`` as polynomials in x, the tangent of the half angle: factors of x^2, x, 1."""
_SHIFTS = (0.7297, -1.2151, 2.0943)
"""Angles of joints 3, 4, 5 at which their tangents vanish: half a turn from there, where they are infinite, no arm
has a posture of its own."""
_REAL = 0.2
"""Largest imaginary part of a root, relative, that may come from two real roots close together; polishing decides."""


@dataclass(frozen=True, eq=False)
class GeneralArm:
    """What the elimination needs of an arm.

    Attributes:
        point, direction: Axis 6 at q = 0 relative to ``origin`` in units of ``length``, (3,).
        origin: A point of axis 3 in the base, (3,) in m.
        length: About the size of the arm, m.
        T_flange_base: Inverse of the flange's pose at q = 0, (4, 4).
        left: Factors of the fourteen functions of joints 3, 4, 5, (14, 3, 3, 3).
        ends: ``E2^-1 E1^-1`` at three angles each of joints 1 and 2, (3, 3, 4, 4).
    """

    point: FloatArray
    direction: FloatArray
    origin: FloatArray
    length: float
    T_flange_base: FloatArray
    left: FloatArray
    ends: FloatArray


def variants(chain: Chain) -> list[GeneralArm]:
    """Return the variants of a chain in the order in which they serve most, the same ones each time."""
    return [_general_arm(chain, change, seed) for seed, change in enumerate(VARIANTS)]


def candidates(chain: Chain, arms: list[GeneralArm], T_base_flange: FloatArray) -> FloatArray:
    """Return polished configurations (n, 24 variants, 6) in rad for poses (n, 4, 4); NaN rows between them, doubles."""
    found = np.concatenate([_roots_or_none(arm, T_base_flange) for arm in arms], axis=1)
    q = np.concatenate([found, np.zeros((*found.shape[:2], 1))], axis=2)
    there = np.isfinite(found).all(axis=2)
    T = np.broadcast_to(T_base_flange[:, None], (*there.shape, 4, 4))[there]
    h, _, T_zero = axes_at_zero(chain)
    some = q[there]
    some[:, 5] = _last_angle(
        T_zero[:3, :3].T @ h[5], flange_poses(chain.T_parent_joint, chain.axis, chain.T_last_flange, some), T
    )
    _polish(chain.T_parent_joint, chain.axis, chain.T_last_flange, T, some)
    q[:] = np.nan
    q[there] = some
    return q


def _last_angle(axis: FloatArray, T_at_zero: FloatArray, T: FloatArray) -> FloatArray:
    """Return the turns (n,) about ``axis`` (3,), fixed in the flange, that bring poses closest to others."""
    R = np.einsum("nji,njk->nik", T_at_zero[:, :3, :3], T[:, :3, :3])
    twist = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], -1)
    turned: FloatArray = np.arctan2(
        twist @ axis, np.trace(R, axis1=1, axis2=2) - np.einsum("i,nij,j->n", axis, R, axis)
    )
    return turned


@numba.njit(cache=True, nogil=True)
def _polish(
    T_parent_joint: FloatArray, axis: FloatArray, T_last_flange: FloatArray, T_base_flange: FloatArray, q: FloatArray
) -> None:
    """Take candidates (n, 6) to their poses (n, 4, 4) in place; NaN where that fails."""
    for row in range(len(q)):
        found, arrived = track_pose(
            T_parent_joint, axis, T_last_flange, q[row], T_base_flange[row], _POLISHED, _POLISH_STEPS
        )
        q[row] = found if arrived else np.full(q.shape[1], math.nan)


def _roots_or_none(arm: GeneralArm, T_base_flange: FloatArray) -> FloatArray:
    """Return the roots (n, 24, 5); NaN at poses where the matrices are singular or not finite."""
    try:
        return _roots(arm, T_base_flange)
    except np.linalg.LinAlgError:
        if len(T_base_flange) == 1:
            return np.full((1, 24, 5), np.nan)
    return np.concatenate([_roots_or_none(arm, T_base_flange[row : row + 1]) for row in range(len(T_base_flange))])


def _general_arm(chain: Chain, change: float, seed: int) -> GeneralArm:
    """Measure the elimination's factors of a chain of six turning joints, its axes changed at random."""
    h, p, T_base_flange = axes_at_zero(chain)
    origin = p[2].copy()
    length = max(1e-3, float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum()))
    generator = np.random.default_rng(seed)
    p = (p - origin) / length + change * generator.uniform(-1.0, 1.0, (6, 3))
    h = h + change * generator.uniform(-1.0, 1.0, (6, 3))
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    E = np.array([_turns(p[k], h[k]) for k in range(6)])  # (6, 3, 4, 4)
    middle = np.einsum("aij,bjk,ckl->abcil", E[2], E[3], E[4])
    values = _functions(middle @ np.append(p[5], 1.0), middle[..., :3, :3] @ h[5])  # (3, 3, 3, 14)
    left = np.einsum("abcf,ia,jb,kc->fijk", values, *(_TO_COEFFICIENTS,) * 3)
    return GeneralArm(
        p[5],
        h[5],
        origin,
        length,
        inverse(T_base_flange),
        np.einsum("fijk,ia,jb,kc->fabc", left, *(_shifted(angle) for angle in _SHIFTS)),
        inverse(np.einsum("aij,bjk->abik", E[0], E[1])),
    )


def _roots(arm: GeneralArm, T_base_flange: FloatArray) -> FloatArray:
    """Return candidates (n, 24, 5) of the first five joints in rad for poses (n, 4, 4), NaN where there are fewer."""
    T = T_base_flange @ arm.T_flange_base
    T[:, :3, 3] = (T[:, :3, 3] - arm.origin + T[:, :3, :3] @ arm.origin) / arm.length
    point, direction = T @ np.append(arm.point, 1.0), T[:, :3, :3] @ arm.direction
    ends = arm.ends
    values = _functions(
        np.einsum("abij,nj->nabi", ends, point), np.einsum("abij,nj->nabi", ends[..., :3, :3], direction)
    )
    right = np.einsum("nabf,ia,jb->nfij", values, _TO_COEFFICIENTS, _TO_COEFFICIENTS).reshape(-1, 14, 9)
    constant, Q = right[..., 8], right[..., :8]
    left = np.broadcast_to(arm.left, (len(T), 14, 3, 3, 3)).copy()
    left[..., 2, 2, 2] -= constant
    U, s, V = np.linalg.svd(Q)
    x, y = _eigenpairs(np.einsum("nfm,nfijk->nmijk", U[..., 8:], left))
    with np.errstate(divide="ignore", invalid="ignore"):
        tangents = np.stack([x, *_tangents(y)], -1)  # (n, 24, 3), complex
        real = (np.abs(tangents.imag) <= _REAL * (1.0 + np.abs(tangents.real))).all(axis=-1)
        # two close real roots of the arm may be a conjugate pair of a variant: real + imaginary part keeps them apart
        turned = 2.0 * np.arctan(np.where(real[..., None], tangents.real + tangents.imag, np.nan))  # (n, 24, 3)
    trigonometric = np.stack([np.cos(turned), np.sin(turned), np.ones_like(turned)], -1)
    reached = np.einsum("nfijk,nri,nrj,nrk->nrf", left, *(trigonometric[:, :, k] for k in range(3)))
    inverted = np.where(s > 1e-9 * s[:, :1], 1.0 / np.maximum(s, 1e-300), 0.0)
    m = np.einsum("nij,ni,nfi,nrf->nrj", V, inverted, U[..., :8], reached)  # (n, 24, 8): products of joints 1 and 2
    q1, q2 = np.arctan2(m[..., 5], m[..., 2]), np.arctan2(m[..., 7], m[..., 6])
    return np.concatenate([np.stack([q1, q2], -1), turned + np.array(_SHIFTS)], -1)


def _eigenpairs(M: FloatArray) -> tuple[AnyArray, AnyArray]:
    """Return the roots x3 (n, 24) and their null vectors (n, 24, 4, 3): powers 3 to 0 of x4, 2 to 0 of x5.

    ``M`` (n, 6, 3, 3, 3): factors of cosine, sine and 1 of joints 3, 4, 5.
    """
    P = np.einsum("nmijk,ia,jb,kc->nmabc", M, *(_TO_POWERS,) * 3)
    whole = np.zeros((len(P), 12, 3, 4, 3))
    whole[:, :6, :, 1:] = P
    whole[:, 6:, :, :3] = P
    A, B, C = (whole[:, :, power].reshape(-1, 12, 12) for power in range(3))
    companion = np.zeros((len(P), 24, 24))
    companion[:, :12, 12:] = np.eye(12)
    companion[:, 12:] = -np.linalg.solve(A, np.concatenate([C, B], axis=2))
    values, vectors = np.linalg.eig(companion)
    return values, vectors[:, :12].transpose(0, 2, 1).reshape(-1, 24, 4, 3)


def _tangents(y: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return x4 and x5 (n, 24) of null vectors (n, 24, 4, 3), from their greatest entries."""
    # a power and the next one stand beside each other; the pair with the greatest sum is the least rounded
    found = []
    for high, low in ((y[:, :, :3], y[:, :, 1:]), (y[..., :2], y[..., 1:])):
        high, low = (part.reshape(*y.shape[:2], -1) for part in (high, low))
        best = np.argmax(np.abs(high) + np.abs(low), axis=2)[..., None]
        found.append((np.take_along_axis(high, best, 2) / np.take_along_axis(low, best, 2))[..., 0])
    return found[0], found[1]


def _functions(p: FloatArray, l: FloatArray) -> FloatArray:  # noqa: E741
    """Return the fourteen functions (..., 14) of points (..., 3 or 4) and directions (..., 3)."""
    p = p[..., :3]
    pp, pl = (p * p).sum(axis=-1, keepdims=True), (p * l).sum(axis=-1, keepdims=True)
    return np.concatenate([p, l, pp, pl, np.cross(p, l), pp * l - 2.0 * pl * p], axis=-1)


def _turns(p: FloatArray, h: FloatArray) -> FloatArray:
    """Return the turns (3, 4, 4) about a line by the three angles."""
    K = np.array([[0.0, -h[2], h[1]], [h[2], 0.0, -h[0]], [-h[1], h[0], 0.0]])
    R = np.eye(3) + np.sin(_ANGLES)[:, None, None] * K + (1.0 - np.cos(_ANGLES))[:, None, None] * (K @ K)
    return pose(p - R @ p, R)


def _shifted(angle: float) -> FloatArray:
    """Return cosine, sine and 1 of an angle by those of the angle less ``angle``: rows by columns."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
