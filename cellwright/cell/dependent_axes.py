"""Which axes of an arm depend on one another in every configuration, so that it cannot move in all directions.

Two axes in one line, four that are parallel or four that meet in a point make the Jacobian singular everywhere: a
pose has either no configuration or endlessly many, which no inverse kinematics lists. The Jacobian's null space at a
few random configurations tells which axes take part. Under a millisecond.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.chain_kinematics import jacobian
from cellwright.errors import listed

if TYPE_CHECKING:
    from cellwright.cell.robot import Chain

_TRIALS = 20
_SINGULAR = 1e-8
"""Singular values up to this share of the largest are zero: URDFs round right angles to some 1e-10."""
_ALIKE = 1e-6
"""Largest difference of columns (unit axes; shares of the arm's size) that are the same line."""


def dependent_axes(chain: Chain) -> str | None:
    """Say which axes depend on one another in every configuration; None if the arm is regular somewhere."""
    generator = np.random.default_rng(0)
    samples = generator.uniform(-math.pi, math.pi, (_TRIALS, chain.n_joints))
    J = np.array([jacobian(chain.T_parent_joint, chain.axis, chain.T_last_flange, q) for q in samples])
    # metres become shares of the arm's size, so that it does not count
    J[:, :3] /= max(float(np.linalg.norm(J[:, :3], axis=1).max()), 1e-12)
    _, values, rows = np.linalg.svd(J)
    zero = values <= _SINGULAR * values[:, :1]  # (trials, joints)
    if not zero.any(axis=1).all():
        return None
    # a joint takes part if motions that go nowhere turn it, in any trial
    turns = np.linalg.norm(rows * zero[:, :, None], axis=1).max(axis=0)
    taking_part = np.flatnonzero(turns > _ALIKE)
    in_line = [pair for pair in combinations(taking_part.tolist(), 2) if _same_line(J, *pair)]
    if in_line:
        return f"{listed(f'axes {a + 1} and {b + 1}' for a, b in in_line)} are collinear"
    names = f"axes {', '.join(str(joint + 1) for joint in taking_part[:-1])} and {taking_part[-1] + 1}"
    direction = J[:, 3:, taking_part]
    if np.linalg.norm(np.cross(direction, direction[:, :, :1], axis=1), axis=1).max() < _ALIKE:
        return f"{names} are parallel"
    return f"{names} depend on one another"


def singular_fault(chain: Chain) -> str | None:
    """Say that an arm is singular in every configuration and what to check, or ``None`` if it is not."""
    dependent = dependent_axes(chain)
    if dependent is None:
        return None
    return (
        f"the arm is singular in every configuration: {dependent}, so that its flange cannot move in all directions: "
        "check the joint axes and origins in its URDF, and the base and flange links"
    )


def _same_line(J: FloatArray, a: int, b: int) -> bool:
    one, other = J[:, :, a], J[:, :, b]
    return min(float(np.abs(one - other).max()), float(np.abs(one + other).max())) < _ALIKE
