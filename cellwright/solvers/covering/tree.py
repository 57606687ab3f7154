"""Prove that no cheaper cover exists, or find one: branch and bound on pairs of rows.

A node is itself a set-cover problem. Its linear relaxation bounds it; columns whose reduced cost exceeds what is left
of the budget go; then two rows a and b branch as Ryan and Foster (1981) do for partitioning: either one chosen column
covers both (a new row, whose columns are those that a and b share), or none does (these columns go). Both sides stay
set-cover problems and the bound rises on both, while fixing single columns moves it on one side only. Nodes of few
columns are finished by `search_leaf`.

Open nodes are taken in fixed batches, so the result depends on the work budget but neither on a clock nor on the
number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial

import numba
import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.solvers.covering.leaf import search_leaf
from cellwright.solvers.covering.matrix import TOLERANCE, CoverMatrix, cover_matrix
from cellwright.solvers.covering.reductions import reduce_cover
from cellwright.solvers.covering.relaxation import solve_relaxation

_BATCH = 4
"""Open nodes that are worked on together; more threads than this do not help."""
_LEAF_COLUMNS = 300
"""Nodes of no more columns go to the depth-first search."""

_PRICE_FLOOR = 1e-3
"""Added to prices, so that the split decides between rows that cost nothing."""


@dataclass(frozen=True, eq=False)
class TreeOutcome:
    """What the branch and bound found.

    Attributes:
        columns: Columns of a cover within the budget, ascending, or ``None``.
        bound: No cover costs less, if none was found.
        closed: Whether the search is complete: a cover was found or none exists.
        work: Matrix entries visited.
        n_nodes: Nodes opened.
    """

    columns: IntArray | None
    bound: float
    closed: bool
    work: float
    n_nodes: int


@dataclass(frozen=True, eq=False)
class _Node:
    """A subproblem: its matrix with the original columns, prices, the columns taken and their cost.

    ``bound`` holds for the whole cover, the columns taken included.
    """

    matrix: CoverMatrix
    columns: IntArray
    duals: FloatArray
    taken: IntArray
    spent: float
    bound: float


@dataclass
class _Result:
    work: float = 0.0
    found: IntArray | None = None
    children: list[_Node] = field(default_factory=list)


def search_tree(
    matrix: CoverMatrix,
    duals: FloatArray,
    budget: float,
    *,
    max_work: float,
    max_nodes: float = math.inf,
    n_threads: int = 2,
    progress: Callable[[float], None] | None = None,
) -> TreeOutcome:
    """Search for a cover that costs at most ``budget``; all rows have to be covered.

    Args:
        matrix: The matrix, reduced.
        duals: Prices of the rows, >= 0, (rows,), as good as at hand.
        budget: Largest cost of interest.
        max_work: Matrix entries to visit, checked between batches of nodes.
        max_nodes: Nodes to open, checked likewise.
        n_threads: Threads; the result does not depend on them.
        progress: Called with the work that is done.

    Raises:
        InvalidInputError: Never; the matrix has been checked.
    """
    columns = np.arange(matrix.n_columns)
    bound = matrix.bound(duals)
    stack = [_Node(matrix, columns, duals, np.empty(0, np.int64), 0.0, bound)]
    work, n_nodes = 0.0, 0
    with ThreadPoolExecutor(max_workers=n_threads) as pool:
        while stack and work < max_work and n_nodes < max_nodes:
            batch = [stack.pop() for _ in range(min(_BATCH, len(stack)))]
            n_nodes += len(batch)
            share = (max_work - work) / len(batch)
            for result in pool.map(partial(_expand, limit=budget, max_work=share), batch):
                work += result.work
                if progress is not None:
                    progress(work)
                if result.found is not None:
                    return TreeOutcome(result.found, bound, True, work, n_nodes)
                stack += result.children
    open_bound = min((node.bound for node in stack), default=np.inf)
    return TreeOutcome(None, max(bound, open_bound), not stack, work, n_nodes)


def _expand(node: _Node, limit: float, max_work: float) -> _Result:
    """Bound a node and return its children, none if nothing below it can be within the budget."""
    reduced = reduce_cover(node.matrix)
    result = _Result(work=2.0 * len(node.matrix.column_rows))
    taken = np.concatenate([node.taken, node.columns[reduced.essential]])
    spent = node.spent + float(node.matrix.costs[reduced.essential].sum())
    budget = limit - spent
    columns, duals, left = node.columns[reduced.columns], node.duals[reduced.rows], reduced.matrix
    if budget < -TOLERANCE or np.any(node.matrix.row_sizes == 0):
        return result
    if left.n_rows == 0:
        result.found = np.sort(taken)
        return result
    if left.n_columns <= _LEAF_COLUMNS:
        _finish(_Node(left, columns, duals, taken, spent, node.bound), budget, max_work, result)
        return result
    relaxed = solve_relaxation(left, duals, stop_above=budget + TOLERANCE, max_work=max_work)
    result.work += relaxed.work
    if relaxed.value > budget + TOLERANCE:
        return result
    all_rows = np.ones(left.n_rows, bool)
    kept = relaxed.value + np.maximum(left.reduced_costs(relaxed.duals), 0.0) <= budget + TOLERANCE
    bound = max(node.bound, spent + relaxed.value)
    pair = _branching_rows(left, relaxed.share, relaxed.duals) if relaxed.solved else None
    if pair is None:
        small = _Node(left.select(all_rows, kept), columns[kept], relaxed.duals, taken, spent, bound)
        _finish(small, budget, max_work, result)
        return result
    both = np.zeros(left.n_columns, bool)
    both[np.intersect1d(left.columns_of(pair[0]), left.columns_of(pair[1]))] = True
    apart = left.select(all_rows, kept & ~both)
    together = _with_row(left.select(all_rows, kept), both[kept])
    # the new row takes over the prices of the two that it makes redundant
    moved = np.append(relaxed.duals, relaxed.duals[list(pair)].sum())
    moved[list(pair)] = 0.0
    result.children.append(_Node(apart, columns[kept & ~both], relaxed.duals, taken, spent, bound))
    result.children.append(_Node(together, columns[kept], moved, taken, spent, bound))
    return result


def _finish(node: _Node, budget: float, max_work: float, result: _Result) -> None:
    """Decide a small node by depth-first search; keep it open if the work does not suffice."""
    chosen, final, work = search_leaf(node.matrix, node.duals, budget, max_work)
    result.work += work
    if chosen is not None:
        result.found = np.sort(np.concatenate([node.taken, node.columns[chosen]]))
    elif not final:
        result.children.append(node)


def _branching_rows(matrix: CoverMatrix, share: FloatArray, duals: FloatArray) -> tuple[int, int] | None:
    """Return two rows that the linear program covers together about half; ``None`` if none is split.

    Pairs of two highly priced rows come first: there the bound moves most.
    """
    # whole multiples of 2^-20: sums are exact
    weight = np.rint(share * 2.0**20).astype(np.int64)
    together = _covered_together(matrix.column_starts, matrix.column_rows, weight, matrix.n_rows) / 2.0**20
    split = np.minimum(together, 1.0 - together)
    if split.max() < 1e-3:
        return None
    score = np.maximum(split, 0.0) * (_PRICE_FLOOR + np.minimum(duals[:, None], duals[None, :]))
    first, second = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(first), int(second)


@numba.njit(cache=True, nogil=True)
def _covered_together(starts, rows, weight, n_rows):  # type: ignore[no-untyped-def]
    """Return the weight of the columns that cover both rows of each pair, zero on the diagonal, (rows, rows)."""
    together = np.zeros((n_rows, n_rows), np.int64)
    for j in range(len(weight)):
        if weight[j] > 0:
            for s in range(starts[j], starts[j + 1]):
                for t in range(starts[j], starts[j + 1]):
                    together[rows[s], rows[t]] += weight[j]
    for i in range(n_rows):
        together[i, i] = 0
    return together


def _with_row(matrix: CoverMatrix, members: FloatArray) -> CoverMatrix:
    """Return the matrix with one more row, covered by the columns marked true."""
    added = np.flatnonzero(members)
    at = matrix.column_starts[added + 1]
    rows = np.insert(matrix.column_rows, at, matrix.n_rows)
    starts = matrix.column_starts + np.concatenate([[0], np.cumsum(members)])
    return cover_matrix((starts, rows, matrix.n_rows + 1), matrix.costs)
