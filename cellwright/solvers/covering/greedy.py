"""The greedy set cover of Kaiser 2021, section 4.3 (Chvatal 1979): always the column that newly covers most.

The cost is at most ``H(d) <= 1 + ln d`` times the optimum, where ``d`` is the most rows that one column covers.
Cost: O(columns) a choice plus O(entries) in all.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.covering.matrix import TOLERANCE, Cover, CoverMatrix, cover_matrix


def cover_greedily(matrix: Any, costs: Any = None, tie: FloatArray | None = None, min_coverage: float = 1.0) -> Cover:
    """Choose columns one by one, each time the one with the most newly covered rows for its cost.

    Args:
        matrix: The matrix, in any form that `cover_matrix` takes.
        costs: Cost of each column; ones if left out.
        tie: Among equally good columns the one of lowest ``tie`` is taken (views: the worst uncertainty of their
            samples), then the one of lowest index, (columns,).
        min_coverage: Stop as soon as this share of the coverable rows is covered, in (0, 1].

    Raises:
        InvalidInputError: If the matrix, costs, ties or share are malformed.
        InfeasibleError: If no column covers any row.
    """
    given = cover_matrix(matrix, costs)
    n_needed = rows_needed(given, min_coverage)
    ties = checked_ties(given, tie)
    chosen = greedy_order(given, ties, n_needed)
    cost = float(given.costs[chosen].sum())
    size = int(given.column_sizes.max())
    bound = max(cost / sum(1.0 / k for k in range(1, size + 1)), float(given.costs.min()))
    proven = cost <= given.round_up(bound) + TOLERANCE
    return Cover(np.sort(chosen), chosen, cost, bound, proven, "", "greedy")


def greedy_order(matrix: CoverMatrix, tie: FloatArray, n_needed: int) -> IntArray:
    """Return the greedy columns in the order of choice until ``n_needed`` rows are covered."""
    return np.asarray(
        _choose(
            matrix.column_starts,
            matrix.column_rows,
            matrix.row_starts,
            matrix.row_columns,
            matrix.costs,
            np.asarray(tie, np.float64),
            n_needed,
        )
    )


def rows_needed(matrix: CoverMatrix, min_coverage: float) -> int:
    """Return how many rows the share of the coverable rows amounts to.

    Raises:
        InvalidInputError: If the share is not in (0, 1].
        InfeasibleError: If no column covers any row.
    """
    if not 0.0 < min_coverage <= 1.0:
        raise InvalidInputError(f"min_coverage is {min_coverage}: give a share above 0 and at most 1")
    coverable = int((matrix.row_sizes > 0).sum())
    if coverable == 0:
        raise InfeasibleError(
            f"none of the {matrix.n_columns} columns covers any of the {matrix.n_rows} rows: there is nothing to choose"
        )
    return max(1, math.ceil(min_coverage * coverable - TOLERANCE))


def checked_ties(matrix: CoverMatrix, tie: FloatArray | None) -> FloatArray:
    """Return the ties, zeros if left out.

    Raises:
        InvalidInputError: If their number is wrong or one is not a number.
    """
    if tie is None:
        return np.zeros(matrix.n_columns)
    checked = np.asarray(tie, np.float64)
    if checked.shape != (matrix.n_columns,) or np.isnan(checked).any():
        raise InvalidInputError(
            f"ties of shape {checked.shape} for {matrix.n_columns} columns, {np.isnan(checked).sum()} of them not a "
            "number: give one number for each column"
        )
    return checked


@numba.njit(cache=True, nogil=True)
def _choose(starts, rows, row_starts, row_columns, costs, tie, n_needed):  # type: ignore[no-untyped-def]
    n = len(costs)
    gain = starts[1:] - starts[:-1]
    covered = np.zeros(len(row_starts) - 1, np.bool_)
    chosen = np.empty(n, np.int64)
    n_chosen, n_covered = 0, 0
    while n_covered < n_needed:
        j = 0
        for k in range(1, n):
            new, old = gain[k] * costs[j], gain[j] * costs[k]
            if new > old or (new == old and tie[k] < tie[j]):
                j = k
        if gain[j] == 0:
            break
        chosen[n_chosen] = j
        n_chosen += 1
        for t in range(starts[j], starts[j + 1]):
            i = rows[t]
            if not covered[i]:
                covered[i] = True
                n_covered += 1
                for x in range(row_starts[i], row_starts[i + 1]):
                    gain[row_columns[x]] -= 1
    return chosen[:n_chosen]
