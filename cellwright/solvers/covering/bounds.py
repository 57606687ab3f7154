"""A lower bound on the cost of any cover by Lagrangian relaxation (Held and Karp 1971; Beasley 1990).

The covering constraints move into the objective with prices (duals) on the rows; the relaxed problem separates by
columns, so a bound costs one walk over the matrix. A subgradient method of a fixed number of steps raises it. Any
prices >= 0 give a valid bound, whatever the method does, so the result needs no trust in convergence; it stays
below the bound of the linear program by a percent or so. Cost: O(entries) a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError
from cellwright.solvers.covering.matrix import CoverMatrix, cover_matrix

_PATIENCE = 20
"""Steps without progress before the step length shrinks; fewer give up early, more waste steps."""


@dataclass(frozen=True, eq=False)
class LowerBound:
    """A proven lower bound on the cost of a cover and the prices that prove it.

    Attributes:
        value: No cover costs less (not rounded).
        duals: Price of each row, >= 0, (rows,).
    """

    value: float
    duals: FloatArray


def lower_bound(
    matrix: Any, costs: Any = None, *, n_steps: int = 400, upper_bound: float | None = None, n_needed: int | None = None
) -> LowerBound:
    """Bound the cost of every cover from below. Deterministic.

    Args:
        matrix: The matrix, in any form that `cover_matrix` takes.
        costs: Cost of each column; ones if left out.
        n_steps: Subgradient steps.
        upper_bound: Cost of a known cover: scales the steps; estimated if left out.
        n_needed: Rows that have to be covered; all rows that any column covers if left out.

    Raises:
        InvalidInputError: If the matrix or costs are malformed, or fewer than ``n_needed`` rows can be covered.
    """
    given = cover_matrix(matrix, costs)
    coverable = given.row_sizes > 0
    needed = int(coverable.sum()) if n_needed is None else n_needed
    if not 0 <= needed <= coverable.sum():
        raise InvalidInputError(f"{needed} rows are to be covered but only {coverable.sum()} can be")
    duals = np.zeros(given.n_rows)
    if needed == 0:
        return LowerBound(0.0, duals)
    left = given if coverable.all() else given.select(coverable, np.ones(given.n_columns, bool))
    start = _first_duals(left)
    top = 2.0 * start.sum() + left.costs.max() if upper_bound is None else upper_bound
    duals[coverable] = _ascend(left, needed, start, top, max(n_steps, 1))
    return LowerBound(max(0.0, left.bound(duals[coverable], needed)), duals)


def _first_duals(matrix: CoverMatrix) -> FloatArray:
    """Return dual feasible prices: each row costs its share of its cheapest column."""
    share = matrix.costs / np.maximum(matrix.column_sizes, 1)
    return np.minimum.reduceat(share[matrix.row_columns], matrix.row_starts[:-1])


def _ascend(matrix: CoverMatrix, n_needed: int, duals: FloatArray, top: float, n_steps: int) -> FloatArray:
    """Return the best prices found; the direction is a running mean of subgradients, which damps zigzags."""
    best, best_value = duals, -np.inf
    mean = np.zeros(matrix.n_rows)
    factor, stalled = 1.0, 0
    for step in range(n_steps):
        slope = np.ones(matrix.n_rows)
        if n_needed < matrix.n_rows:
            # a partial cover pays for its cheapest rows only
            slope[np.argsort(duals, kind="stable")[n_needed:]] = 0.0
        value = float((slope * duals).sum()) + _relax(
            matrix.column_starts, matrix.column_rows, matrix.costs, duals, slope
        )
        stalled += 1
        if value > best_value:
            if value > best_value + 1e-4 * abs(best_value):
                stalled = 0
            best, best_value = duals, value
        if stalled >= _PATIENCE:
            factor *= 0.6
            stalled = 0
            duals = best
        slope[(duals <= 0.0) & (slope < 0.0)] = 0.0
        mean = slope if step == 0 else 0.5 * (mean + slope)
        norm = float((mean * mean).sum())
        if norm < 1e-12:
            break
        duals = np.maximum(0.0, duals + factor * max(top - value, 0.01) / norm * mean)
    return best


@numba.njit(cache=True, nogil=True)
def _relax(starts, rows, costs, duals, slope):  # type: ignore[no-untyped-def]
    """Return the sum of the negative reduced costs and take their columns' rows off the slope."""
    value = 0.0
    for j in range(len(costs)):
        rest = costs[j]
        for t in range(starts[j], starts[j + 1]):
            rest -= duals[rows[t]]
        if rest < 0.0:
            value += rest
            for t in range(starts[j], starts[j + 1]):
                slope[rows[t]] -= 1.0
    return value
