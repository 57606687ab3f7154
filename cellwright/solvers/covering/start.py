"""Prepare a set-cover problem: reduce it, bound it, and find a good cover; what every exact method starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.solvers.covering.bounds import lower_bound
from cellwright.solvers.covering.dive import dive_cover
from cellwright.solvers.covering.greedy import greedy_order, rows_needed
from cellwright.solvers.covering.matrix import TOLERANCE, CoverMatrix, cover_matrix
from cellwright.solvers.covering.reductions import ReducedCover, reduce_cover
from cellwright.solvers.covering.relaxation import Relaxation, solve_relaxation
from cellwright.solvers.covering.search import improve_cover

_SEARCH_SHARE = 0.1
"""Share of the work that one local search over the best columns may use; on measurability matrices it then has the
optimum in nearly all trials."""
_SEARCH_PASSES = 5000
"""Visits of each entry after which a local search ends at the latest: small problems need no more."""
_QUICK_SHARE = 0.01
"""Share of the first local search, over all columns, whose cover scales the steps of the bounds."""
_RELAXATION_SHARE = 0.6
"""Share that the linear program may use; it is the stronger half of the proof."""
_DIVE_SHARE = 0.3
"""Share of the dives."""
_LARGE_COVER = 30
"""Covers of this many columns get dives as well: there the local search alone is weak."""
_CORE_FACTOR = 3
"""Columns for each row in the core that the local search walks, those of lowest reduced cost."""
_MIN_CORE = 1000
"""Columns that are always in the core."""


@dataclass(frozen=True, eq=False)
class CoverStart:
    """A reduced problem with a bound and a good cover.

    Attributes:
        given: The problem as it was given; whole or scaled costs.
        reduced: What the reductions left of it.
        greedy: The greedy columns of the given problem in the order of choice.
        columns: The best cover found, as columns of the reduced matrix, ascending.
        duals: Prices of the reduced rows, (rows,).
        bound: Lower bound on the reduced problem, not rounded.
        n_spare: Rows that may stay uncovered.
        searched: Whether the local search improved on the greedy cover.
        work: Matrix entries visited.
    """

    given: CoverMatrix
    reduced: ReducedCover
    greedy: IntArray
    columns: IntArray
    duals: FloatArray
    bound: float
    n_spare: int
    searched: bool
    work: float

    @property
    def cost(self) -> float:
        """Return the cost of the best cover of the reduced problem."""
        return float(self.reduced.matrix.costs[self.columns].sum())

    @property
    def fixed_cost(self) -> float:
        """Return the cost of the essential columns."""
        return float(self.given.costs[self.reduced.essential].sum())

    @property
    def closed(self) -> bool:
        """Return whether the bound alone proves the cover."""
        return self.cost <= self.reduced.matrix.round_up(self.bound) + TOLERANCE

    @property
    def target(self) -> float:
        """Return the largest cost of a cover that would be better."""
        return self.cost - (1.0 if self.reduced.matrix.whole_costs else 4.0 * TOLERANCE)

    def useful_columns(self) -> BoolArray:
        """Return the columns that a better cover may contain, by their reduced costs, (columns,)."""
        reduced_costs = np.maximum(self.reduced.matrix.reduced_costs(self.duals), 0.0)
        return np.asarray(self.bound + reduced_costs <= self.target + TOLERANCE)


def start_cover(
    matrix: CoverMatrix, tie: FloatArray, min_coverage: float, *, max_work: float, seed: int = 0
) -> CoverStart:
    """Reduce, bound and cover a problem within a share of the work.

    Raises:
        InvalidInputError: If the share is not in (0, 1].
        InfeasibleError: If no column covers any row.
    """
    n_needed = rows_needed(matrix, min_coverage)
    n_spare = int((matrix.row_sizes > 0).sum()) - n_needed
    greedy = greedy_order(matrix, tie, n_needed)
    reduced = reduce_cover(matrix, tie, columns_only=n_spare > 0)
    left = reduced.matrix
    work = 2.0 * len(matrix.column_rows)
    if left.n_rows == 0:
        return CoverStart(matrix, reduced, greedy, np.empty(0, np.int64), np.zeros(0), 0.0, n_spare, False, work)
    first = _cheaper(
        left, _lifted(matrix, reduced, greedy), greedy_order(left, tie[reduced.columns], left.n_rows - n_spare)
    )
    quick_work = min(_QUICK_SHARE * max_work, _SEARCH_PASSES * len(left.column_rows))
    quick = improve_cover(left, first, max_work=quick_work, n_spare=n_spare, seed=seed)
    rough = lower_bound(left, upper_bound=float(left.costs[quick].sum()), n_needed=left.n_rows - n_spare)
    start = CoverStart(
        matrix, reduced, greedy, quick, rough.duals, rough.value, n_spare, _is_cheaper(left, quick, first), work
    )
    if start.closed:
        return start
    relaxed = solve_relaxation(left, rough.duals, n_spare=n_spare, max_work=_RELAXATION_SHARE * max_work)
    best, spent = _search_core(left, quick, relaxed, n_spare, max_work=_SEARCH_SHARE * max_work, seed=seed)
    work += quick_work + relaxed.work + spent
    if n_spare == 0 and len(best) >= _LARGE_COVER:
        best, spent = _dived(left, best, relaxed.duals, _DIVE_SHARE * max_work)
        work += spent
    searched = _is_cheaper(left, best, first)
    return CoverStart(matrix, reduced, greedy, best, relaxed.duals, relaxed.value, n_spare, searched, work)


def _dived(matrix: CoverMatrix, cover: IntArray, duals: FloatArray, max_work: float) -> tuple[IntArray, float]:
    """Return the cheapest of a cover and several dives, and the work."""
    work = 0.0
    for threshold in (0.5, 0.7, 0.9):
        cost = float(matrix.costs[cover].sum())
        found, spent = dive_cover(matrix, duals, threshold=threshold, max_cost=cost, max_work=max_work - work)
        work += spent
        if found is not None:
            cover = found
    return cover, work


def _search_core(
    matrix: CoverMatrix, cover: IntArray, relaxed: Relaxation, n_spare: int, *, max_work: float, seed: int
) -> tuple[IntArray, float]:
    """Improve a cover by local search among its own columns and those of lowest reduced cost; with the work."""
    core = np.zeros(matrix.n_columns, bool)
    size = max(_CORE_FACTOR * matrix.n_rows, _MIN_CORE)
    core[np.argsort(matrix.reduced_costs(relaxed.duals), kind="stable")[:size]] = True
    core[cover] = True
    names = np.flatnonzero(core)
    left = matrix.select(np.ones(matrix.n_rows, bool), core)
    work = min(max_work, float(_SEARCH_PASSES * len(left.column_rows)))
    found = improve_cover(
        left,
        np.searchsorted(names, cover),
        max_work=work,
        target=matrix.round_up(relaxed.value) + TOLERANCE,
        n_spare=n_spare,
        seed=seed,
    )
    return names[found], work


def scaled_matrix(matrix: object, costs: object) -> tuple[CoverMatrix, float]:
    """Return the checked matrix with costs of at least about one, and the factor that restores the given ones."""
    given = cover_matrix(matrix, costs)
    if given.whole_costs or given.n_columns == 0:
        return given, 1.0
    scale = float(given.costs.min())
    return cover_matrix(given, given.costs / scale), scale


def _cheaper(matrix: CoverMatrix, first: IntArray, second: IntArray) -> IntArray:
    return second if _is_cheaper(matrix, second, first) else first


def _is_cheaper(matrix: CoverMatrix, first: IntArray, second: IntArray) -> bool:
    return bool(matrix.costs[first].sum() < matrix.costs[second].sum() - TOLERANCE)


def _lifted(matrix: CoverMatrix, reduced: ReducedCover, columns: IntArray) -> IntArray:
    """Return reduced columns that cover at least what the given columns do, at no greater cost."""
    left = reduced.matrix
    new_row = np.full(matrix.n_rows, -1)
    new_row[reduced.rows] = np.arange(left.n_rows)
    new_column = np.full(matrix.n_columns, -1)
    new_column[reduced.columns] = np.arange(left.n_columns)
    lifted = set()
    for column in columns:
        if new_column[column] >= 0:
            lifted.add(int(new_column[column]))
            continue
        rows = new_row[matrix.rows_of(int(column))]
        rows = rows[rows >= 0]
        if len(rows):
            hits = np.bincount(np.concatenate([left.columns_of(int(row)) for row in rows]), minlength=left.n_columns)
            fit = np.flatnonzero((hits == len(rows)) & (left.costs <= matrix.costs[column]))
            lifted.add(int(fit[0]))
    return np.array(sorted(lifted), np.int64)
