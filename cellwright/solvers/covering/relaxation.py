"""The linear relaxation of a set-cover problem by HiGHS with column generation.

Measurability matrices have ten to thirty times more columns than rows and few of them matter: the linear program is
solved over the columns of lowest reduced cost, the duals price the others, and those that would still improve it
join until none does. The bound is always the Lagrangian bound of the duals over all columns, so it is valid even if
HiGHS stopped early. Work is bounded by simplex iterations, never by a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.solvers.covering.matrix import CoverMatrix

_PRICING_TOLERANCE = 1e-7
"""Reduced costs above its negative count as zero; HiGHS solves to the same tolerance."""
_MAX_ROUNDS = 40
"""Pricing rounds; four are usual."""


@dataclass(frozen=True, eq=False)
class Relaxation:
    """The solved relaxation.

    Attributes:
        value: Lower bound on the cost of a cover.
        duals: Price of each row that proves it, >= 0, (rows,).
        share: Value of each column in the linear program, (columns,).
        solved: Whether ``value`` is the optimum of the linear program.
        work: Matrix entries visited, estimated from the simplex iterations.
    """

    value: float
    duals: FloatArray
    share: FloatArray
    solved: bool
    work: float


def solve_relaxation(
    matrix: CoverMatrix,
    duals: FloatArray,
    *,
    n_spare: int = 0,
    stop_above: float = math.inf,
    max_work: float = math.inf,
) -> Relaxation:
    """Solve the linear relaxation, starting from prices that need not be good.

    Args:
        matrix: The matrix; every row is covered by some column.
        duals: Prices of the rows, >= 0, (rows,).
        n_spare: Rows that may stay uncovered.
        stop_above: Stop as soon as the bound exceeds this.
        max_work: Work at most, in visited entries.

    Raises:
        InvalidInputError: Never; the matrix has been checked.
    """
    n_needed = matrix.n_rows - n_spare
    active = _first_columns(matrix, duals)
    solver = build_program(matrix, active, n_spare=n_spare)
    best, best_value, work, solved = duals, matrix.bound(duals, n_needed), 0.0, False
    share = np.zeros(matrix.n_columns)
    listed = np.flatnonzero(active)
    for _ in range(_MAX_ROUNDS):
        a_pivot = _work_of_a_pivot(matrix.n_rows, len(listed))
        limit = min((max_work - work) / a_pivot, 2.0**31 - 1)
        if limit < 1:
            break
        solver.setOptionValue("simplex_iteration_limit", int(limit))
        solver.run()
        work += a_pivot * max(solver.getInfo().simplex_iteration_count, 1) + len(matrix.column_rows)
        solution = solver.getSolution()
        if not (solution.value_valid and solution.dual_valid):
            break
        priced = np.maximum(np.asarray(solution.row_dual[: matrix.n_rows]), 0.0)
        value = matrix.bound(priced, n_needed)
        if value > best_value:
            best, best_value = priced, value
        if best_value > stop_above or solver.modelStatusToString(solver.getModelStatus()) != "Optimal":
            break
        share[:] = 0.0
        share[listed] = np.asarray(solution.col_value[n_spare_columns(matrix, n_spare) :])
        reduced = matrix.reduced_costs(priced)
        missing = np.flatnonzero((reduced < -_PRICING_TOLERANCE) & ~active)
        if len(missing) == 0:
            solved = True
            break
        missing = missing[np.argsort(reduced[missing], kind="stable")[: max(matrix.n_rows // 2, 50)]]
        active[missing] = True
        listed = np.concatenate([listed, missing])
        _add_columns(solver, matrix, missing)
    return Relaxation(max(best_value, 0.0), best, share, solved, work)


def n_spare_columns(matrix: CoverMatrix, n_spare: int) -> int:
    """Return how many slack columns stand before the views in `build_program`."""
    return matrix.n_rows if n_spare > 0 else 0


def build_program(matrix: CoverMatrix, active: BoolArray, *, n_spare: int = 0, whole: bool = False) -> Any:
    """Return a HiGHS model over the ``active`` columns: quiet, one thread, fixed seed, ready to run.

    With ``n_spare`` > 0, one slack column a row comes first, and a last row lets at most that many be used.
    ``whole`` asks for zero or one.
    """
    import highspy

    solver = highspy.Highs()
    for option, value in (("output_flag", False), ("threads", 1), ("parallel", "off"), ("random_seed", 0)):
        solver.setOptionValue(option, value)
    m, n_slack = matrix.n_rows, n_spare_columns(matrix, n_spare)
    columns = np.flatnonzero(active)
    starts, rows = _columns_of(matrix, columns)
    n = n_slack + len(columns)
    program = highspy.HighsLp()
    program.num_col_, program.num_row_ = n, m + (1 if n_slack else 0)
    program.col_cost_ = np.concatenate([np.zeros(n_slack), matrix.costs[columns]])
    program.col_lower_ = np.zeros(n)
    upper = 1.0 if whole else highspy.kHighsInf
    program.col_upper_ = np.concatenate([np.ones(n_slack), np.full(len(columns), upper)])
    program.row_lower_ = np.concatenate([np.ones(m), np.full(1 if n_slack else 0, -highspy.kHighsInf)])
    program.row_upper_ = np.concatenate([np.full(m, highspy.kHighsInf), np.full(1 if n_slack else 0, float(n_spare))])
    slack_rows = np.stack([np.arange(n_slack), np.full(n_slack, m)], axis=1).reshape(-1)
    program.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    program.a_matrix_.start_ = np.concatenate([2 * np.arange(n_slack), starts + 2 * n_slack]).astype(np.int32)
    program.a_matrix_.index_ = np.concatenate([slack_rows, rows]).astype(np.int32)
    program.a_matrix_.value_ = np.ones(2 * n_slack + len(rows))
    if whole:
        program.integrality_ = [highspy.HighsVarType.kInteger] * n
    else:
        # presolve costs more than it saves here and loses the basis between pricing rounds
        solver.setOptionValue("presolve", "off")
        solver.setOptionValue("solver", "simplex")
    solver.passModel(program)
    return solver


def _work_of_a_pivot(n_rows: int, n_columns: int) -> float:
    """Estimate a simplex iteration in visited entries: dense rows of basis inverse and tableau."""
    return 0.4 * n_rows * n_rows + n_columns


def _first_columns(matrix: CoverMatrix, duals: FloatArray) -> BoolArray:
    """Return the columns of lowest reduced cost, twice as many as rows, such that every row is covered."""
    reduced = matrix.reduced_costs(duals)
    active = np.zeros(matrix.n_columns, bool)
    active[np.argsort(reduced, kind="stable")[: 2 * matrix.n_rows]] = True
    covered = np.zeros(matrix.n_rows, bool)
    covered[matrix.column_rows[np.repeat(active, matrix.column_sizes)]] = True
    for row in np.flatnonzero(~covered):
        columns = matrix.columns_of(int(row))
        active[columns[np.argsort(reduced[columns], kind="stable")[:5]]] = True
    return active


def _columns_of(matrix: CoverMatrix, columns: IntArray) -> tuple[IntArray, IntArray]:
    """Return starts and rows of the given columns, one after the other."""
    sizes = matrix.column_sizes[columns]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    offset = np.repeat(matrix.column_starts[columns] - starts[:-1], sizes)
    return starts, matrix.column_rows[np.arange(starts[-1]) + offset].astype(np.int64)


def _add_columns(solver: Any, matrix: CoverMatrix, columns: IntArray) -> None:
    import highspy

    starts, rows = _columns_of(matrix, columns)
    solver.addCols(
        len(columns),
        matrix.costs[columns],
        np.zeros(len(columns)),
        np.full(len(columns), highspy.kHighsInf),
        len(rows),
        starts[:-1].astype(np.int32),
        rows.astype(np.int32),
        np.ones(len(rows)),
    )
