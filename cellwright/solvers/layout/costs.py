"""The paper's extra cost L as expressions and as numbers: manipulability and repeatability.

Manipulability is Yoshikawa's ``sqrt(det(J J^T))`` (``sqrt(det(J^T J))`` below six joints). It is to be large: the paper
writes it as a cost to be minimised, which would drive the arm into singularities, so it enters here with a minus sign.
Repeatability after Baumgaertner 2023 ("Optimal robot workpiece placement for maximized repeatability"): joint
position errors propagate through the Jacobian to the tool's position, as the expected (root mean square) error for
independent joint deviations, or as the worst case of three deviations each.
"""

from __future__ import annotations

import itertools
from typing import Any

import casadi
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.serial_arm import SerialArm
from cellwright.solvers.layout.problem import LayoutCost

WORST_DEVIATIONS = 3.0
"""Standard deviations of each joint that the worst case adds up."""
_SMOOTHING = 1e-12
"""Keeps the root differentiable at singularities; changes the value by at most 1e-6."""


def manipulability_expression(J: Any) -> Any:
    """Return the manipulability of a Jacobian (6 x joints) as an expression."""
    if J.size1() == J.size2():
        return casadi.sqrt(_determinant(J) ** 2 + _SMOOTHING)
    return casadi.sqrt(_determinant(J @ J.T if J.size2() >= J.size1() else J.T @ J) + _SMOOTHING)


def _determinant(A: Any) -> Any:
    """Return the determinant of a square expression; of 6 x 6 by Laplace's expansion in pairs of 3 x 3 minors.

    Its second derivatives take a tenth of the operations that those of the expansion by rows take.
    """
    if A.size1() != 6:
        return casadi.det(A)
    total = casadi.SX(0.0)
    for columns in itertools.combinations(range(6), 3):
        others = [column for column in range(6) if column not in columns]
        sign = (-1.0) ** (sum(columns) - 3)
        total += sign * _triple(A[:3, list(columns)]) * _triple(A[3:, others])
    return total


def _triple(A: Any) -> Any:
    return casadi.dot(A[:, 0], casadi.cross(A[:, 1], A[:, 2]))


def repeatability_expression(J: Any, deviation: FloatArray, *, worst_case: bool) -> Any:
    """Return the position error at the tool in m of joint deviations (joints,) in rad or m, as an expression."""
    columns = J[:3, :] @ casadi.diag(casadi.DM(deviation))
    if not worst_case:
        return casadi.sqrt(casadi.sumsqr(columns) + _SMOOTHING)
    worst = WORST_DEVIATIONS * casadi.sum2(casadi.sqrt(columns**2 + _SMOOTHING**2))
    return casadi.sqrt(casadi.sumsqr(worst) + _SMOOTHING)


def cost_expression(J: Any, cost: LayoutCost) -> Any:
    """Return one configuration's share of L in s, from the tool's Jacobian (6 x joints) there, as an expression."""
    total = casadi.SX(0.0)
    if cost.manipulability != 0.0:
        total -= cost.manipulability * manipulability_expression(J)
    if cost.repeatability != 0.0:
        error = repeatability_expression(J, np.array(cost.joint_deviation), worst_case=cost.worst_case)
        total += cost.repeatability * error
    return total


def extra_costs(arm: SerialArm, q: FloatArray, cost: LayoutCost, T_flange_tool: FloatArray | None = None) -> FloatArray:
    """Return the share (n,) of L in s of configurations ``q`` (n, joints)."""
    total = np.zeros(len(q))
    if cost.manipulability != 0.0:
        total -= cost.manipulability * manipulability(arm, q, T_flange_tool)
    if cost.repeatability != 0.0:
        deviation = np.array(cost.joint_deviation)
        total += cost.repeatability * repeatability(arm, q, deviation, T_flange_tool, worst_case=cost.worst_case)
    return total


def manipulability(arm: SerialArm, q: FloatArray, T_flange_tool: FloatArray | None = None) -> FloatArray:
    """Return the manipulability (n,) of an arm at ``q`` (n, joints)."""
    J = arm.jacobian(q, T_flange_tool)
    transposed = np.swapaxes(J, -1, -2)
    square = J @ transposed if arm.n_joints >= 6 else transposed @ J
    return np.asarray(np.sqrt(np.maximum(np.linalg.det(square), 0.0)))


def repeatability(
    arm: SerialArm,
    q: FloatArray,
    deviation: FloatArray,
    T_flange_tool: FloatArray | None = None,
    *,
    worst_case: bool = False,
) -> FloatArray:
    """Return the tool's position error (n,) in m at ``q`` (n, joints) of joint deviations (joints,)."""
    columns = arm.jacobian(q, T_flange_tool)[..., :3, :] * np.asarray(deviation, float)
    if worst_case:
        return np.asarray(WORST_DEVIATIONS * np.linalg.norm(np.abs(columns).sum(axis=-1), axis=-1))
    return np.asarray(np.sqrt(np.sum(columns**2, axis=(-2, -1))))
