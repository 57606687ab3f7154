"""Pick few columns of a zero-one matrix that together cover its rows: the set-covering problem.

`cover_greedily` is the method of Kaiser 2021, section 4.3 (Chvatal 1979): at most ``1 + ln d`` times the optimum, d the
most rows that one column covers. `cover_best` is the default: reductions, Lagrangian and linear-programming bounds,
a local search, and a branch and bound that proves the result or leaves an honest gap within a fixed amount of work; it
reads no clock, so its result is the same on every machine. `cover_exactly` hands the reduced problem to HiGHS.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError
from cellwright.solvers.covering.bounds import LowerBound, lower_bound
from cellwright.solvers.covering.exact import cover_exactly, found_cover
from cellwright.solvers.covering.exchange import exchange_columns, smallest_uncertainty
from cellwright.solvers.covering.greedy import checked_ties, cover_greedily, rows_needed
from cellwright.solvers.covering.matrix import TOLERANCE, Cover, CoverMatrix, cover_matrix
from cellwright.solvers.covering.reductions import ReducedCover, reduce_cover
from cellwright.solvers.covering.start import scaled_matrix, start_cover
from cellwright.solvers.covering.tree import search_tree

__all__ = [
    "Cover",
    "CoverMatrix",
    "LowerBound",
    "ReducedCover",
    "cover_best",
    "cover_exactly",
    "cover_greedily",
    "cover_matrix",
    "exchange_columns",
    "lower_bound",
    "reduce_cover",
    "rows_needed",
    "smallest_uncertainty",
]

DEFAULT_WORK = 6e9
"""Matrix entries that `cover_best` may visit: about four seconds on two cores."""


def cover_best(
    matrix: Any,
    costs: Any = None,
    *,
    tie: FloatArray | None = None,
    min_coverage: float = 1.0,
    max_work: float = DEFAULT_WORK,
    node_limit: int | None = None,
    seed: int = 0,
    n_threads: int = 2,
    progress: Callable[[float], None] | None = None,
) -> Cover:
    """Find a smallest cover, or the best within a fixed amount of work with the gap to a proven bound.

    Args:
        matrix: The matrix, in any form that `cover_matrix` takes.
        costs: Cost of each column; ones if left out.
        tie: Ties of the greedy method, and which of equal columns is kept, (columns,).
        min_coverage: Share of the coverable rows to cover, in (0, 1]. Below 1 there is no branch and bound: the gap
            is that of the linear program.
        max_work: Matrix entries to visit at most; about one nanosecond each.
        node_limit: Nodes of the branch and bound at most; unlimited if left out.
        seed: Seed of the local search.
        n_threads: Threads; the result does not depend on them.
        progress: Called with the share of the permitted work that is done; a proof may come long before its end.

    Raises:
        InvalidInputError: If the matrix, costs, ties or limits are malformed.
        InfeasibleError: If no column covers any row.
    """
    if not max_work > 0:
        raise InvalidInputError(f"max_work is {max_work}: give a positive number")
    given, scale = scaled_matrix(matrix, costs)
    start = start_cover(given, checked_ties(given, tie), min_coverage, max_work=max_work, seed=seed)
    left, work, nodes = start.reduced.matrix, start.work, 0
    best, bound, method, closed = start.columns, start.bound, "search", start.closed
    tell = progress or (lambda share: None)
    while not closed and start.n_spare == 0 and work < max_work and nodes < (node_limit or math.inf):
        cost = float(left.costs[best].sum())
        target = cost - (start.cost - start.target)
        kept = start.bound + np.maximum(left.reduced_costs(start.duals), 0.0) <= target + TOLERANCE
        outcome = search_tree(
            left.select(np.ones(left.n_rows, bool), kept),
            start.duals,
            target,
            max_work=max_work - work,
            max_nodes=math.inf if node_limit is None else node_limit - nodes,
            n_threads=n_threads,
            progress=lambda more, before=work: tell(min(1.0, (before + more) / max_work)),  # type: ignore[misc]
        )
        work, nodes = work + outcome.work, nodes + outcome.n_nodes
        if outcome.columns is None:
            # what the fixing left out costs more than the target, so the bound never passes the known cost
            bound, closed = max(bound, min(outcome.bound, cost)), outcome.closed
            break
        best, method = np.flatnonzero(kept)[outcome.columns], "tree"
        closed = float(left.costs[best].sum()) <= left.round_up(bound) + TOLERANCE
    spent_nodes = node_limit is not None and nodes >= node_limit
    bound = float(left.costs[best].sum()) if closed else bound
    return found_cover(start, best, bound, closed, "nodes" if spent_nodes else "work", method, scale)
