"""Among equally small covers, one of low uncertainty: exchange chosen columns while everything stays covered.

The paper's objective (Kaiser 2021, section 4.3) is the predicted uncertainty of the chosen views. Here the sum over
the rows of the smallest uncertainty among the chosen columns that cover them falls with every exchange of one column
for another that costs no more, until no exchange helps. A local optimum; deterministic.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.errors import InvalidInputError
from cellwright.solvers.covering.matrix import CoverMatrix

_MAX_PASSES = 50
"""Passes over the chosen columns; three or four are usual."""


def exchange_columns(matrix: CoverMatrix, columns: IntArray, uncertainty: FloatArray) -> IntArray:
    """Return a cover of no greater cost that covers at least the same rows at lower uncertainty, ascending.

    Args:
        matrix: The matrix.
        columns: A cover.
        uncertainty: Uncertainty of each entry in the order of ``matrix.column_rows``, finite, (entries,).

    Raises:
        InvalidInputError: If there is not one uncertainty for each entry.
    """
    if uncertainty.shape != matrix.column_rows.shape:
        raise InvalidInputError(
            f"{uncertainty.size} uncertainties for {len(matrix.column_rows)} entries: give one each"
        )
    chosen = [int(column) for column in np.sort(columns)]
    worst = float(uncertainty.max(initial=0.0))
    for _ in range(_MAX_PASSES):
        changed = False
        for at in range(len(chosen)):
            others = np.array(chosen[:at] + chosen[at + 1 :], np.int64)
            better = _best_exchange(matrix, uncertainty, worst, others, chosen[at])
            if better != chosen[at]:
                chosen[at] = better
                changed = True
        if not changed:
            break
    return np.sort(np.array(chosen, np.int64))


def smallest_uncertainty(matrix: CoverMatrix, columns: IntArray, uncertainty: FloatArray) -> FloatArray:
    """Return the smallest uncertainty at which the columns cover each row; infinite where none does, (rows,)."""
    smallest = np.full(matrix.n_rows, np.inf)
    for column in columns:
        begin, end = matrix.column_starts[column], matrix.column_starts[column + 1]
        rows = matrix.column_rows[begin:end]
        smallest[rows] = np.minimum(smallest[rows], uncertainty[begin:end])
    return smallest


def _best_exchange(matrix: CoverMatrix, uncertainty: FloatArray, worst: float, others: IntArray, column: int) -> int:
    """Return the column that serves best in the place of ``column``, itself unless another is better."""
    without = smallest_uncertainty(matrix, others, uncertainty)
    rows = matrix.rows_of(column)
    alone = rows[np.isinf(without[rows])]
    if len(alone) == 0:
        return column
    hits = np.bincount(np.concatenate([matrix.columns_of(int(row)) for row in alone]), minlength=matrix.n_columns)
    fit = np.flatnonzero((hits == len(alone)) & (matrix.costs <= matrix.costs[column]))
    without = np.minimum(without, worst)  # rows that only this column covers gain from any candidate alike
    gain = np.empty(len(fit))
    for at, candidate in enumerate(fit):
        begin, end = matrix.column_starts[candidate], matrix.column_starts[candidate + 1]
        saved = np.maximum(without[matrix.column_rows[begin:end]] - uncertainty[begin:end], 0.0)
        gain[at] = saved.sum()
    current = gain[np.searchsorted(fit, column)]
    best = int(np.argmax(gain))
    return int(fit[best]) if gain[best] > current * (1.0 + 1e-9) + 1e-15 else column
