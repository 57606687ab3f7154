"""Good covers fast by local search with row weights (Gao, Weise and Li 2015, "RWLS"; there for unit costs).

One column is taken out of a cover until something is uncovered; then, step by step, the least useful column leaves
and the most useful one of a random uncovered row enters, while rows that stay uncovered gain weight, which drives
the search out of local optima. No guarantee, but on measurability matrices it finds the optimum within the first
thousands of steps. Cost: O(entries of the rows that change) a step; the budget counts those entries, so the result
does not depend on the machine.
"""

from __future__ import annotations

import numba
import numpy as np

from cellwright.arrays import IntArray
from cellwright.solvers.covering.matrix import CoverMatrix


def improve_cover(
    matrix: CoverMatrix,
    start: IntArray,
    *,
    max_work: float,
    target: float = 0.0,
    n_spare: int = 0,
    seed: int = 0,
) -> IntArray:
    """Return a cover that costs no more than ``start``, ascending columns.

    Args:
        matrix: The matrix; every row that has to be covered is covered by ``start``.
        start: Columns of a cover.
        max_work: Matrix entries to visit at most.
        target: Stop at a cover that costs no more.
        n_spare: Rows that may stay uncovered.
        seed: Seed of the choice among uncovered rows.

    Raises:
        InvalidInputError: Never; a start that covers too little is returned as it came.
    """
    if len(start) == 0 or matrix.n_rows <= n_spare:
        return np.sort(start)
    state = np.uint64((seed * 2 + 1) * 0x9E3779B97F4A7C15 % 2**64)
    found = _search(
        matrix.column_starts,
        matrix.column_rows,
        matrix.row_starts,
        matrix.row_columns,
        matrix.costs,
        np.asarray(start, np.int64),
        float(max_work),
        float(target),
        n_spare,
        state,
    )
    return np.sort(found)


@numba.njit(cache=True, nogil=True)
def _switch(j, sign, starts, rows, row_starts, row_columns, count, weight, score, allowed, chosen, open_rows, place):  # type: ignore[no-untyped-def]
    """Add (sign 1) or remove (sign -1) column j; return the entries visited and the change of uncovered rows.

    ``score`` is the weight a column would newly cover, or, negative, the weight that a chosen one alone covers.
    """
    n_open = open_rows[-1]
    work = 0
    score[j] = -score[j]
    chosen[j] = sign > 0
    for t in range(starts[j], starts[j + 1]):
        i = rows[t]
        count[i] += sign
        begin, end = row_starts[i], row_starts[i + 1]
        work += end - begin
        gain = weight[i]
        now = count[i]
        if sign > 0 and now == 1:
            n_open -= 1
            last, spot = open_rows[n_open], place[i]
            open_rows[spot], place[last] = last, spot
            open_rows[n_open], place[i] = i, n_open
        if sign < 0 and now == 0:
            last, spot = open_rows[n_open], place[i]
            open_rows[spot], place[last] = last, spot
            open_rows[n_open], place[i] = i, n_open
            n_open += 1
        single = (sign > 0 and now == 2) or (sign < 0 and now == 1)
        turned = (sign > 0 and now == 1) or (sign < 0 and now == 0)
        for x in range(begin, end):
            k = row_columns[x]
            allowed[k] = True
            if turned:
                if k != j:
                    score[k] -= sign * gain
            elif single and chosen[k] and k != j:
                score[k] += sign * gain
    open_rows[-1] = n_open
    if sign < 0:
        allowed[j] = False
    return work


@numba.njit(cache=True, nogil=True)
def _better(a, b, score, costs, stamp):  # type: ignore[no-untyped-def]
    """Whether column a is the better one to enter or to leave: more score a cost, then longer untouched, then lower."""
    left, right = score[a] * costs[b], score[b] * costs[a]
    if left != right:
        return left > right
    if stamp[a] != stamp[b]:
        return stamp[a] < stamp[b]
    return a < b


@numba.njit(cache=True, nogil=True)
def _search(starts, rows, row_starts, row_columns, costs, start, max_work, target, n_spare, state):  # type: ignore[no-untyped-def]
    n, m = len(starts) - 1, len(row_starts) - 1
    count, weight = np.zeros(m, np.int64), np.ones(m, np.int64)
    score, stamp = starts[1:] - starts[:-1], np.zeros(n, np.int64)
    allowed, chosen = np.ones(n, np.bool_), np.zeros(n, np.bool_)
    place = np.arange(m)
    open_rows = np.empty(m + 1, np.int64)  # uncovered rows first; the last element is their number
    open_rows[:m] = place
    open_rows[m] = m
    picked = np.empty(n, np.int64)
    n_picked, cost, work, step, tabu = 0, 0.0, 0.0, 0, -1
    for j in start:
        if not chosen[j]:
            work += _switch(
                j, 1, starts, rows, row_starts, row_columns, count, weight, score, allowed, chosen, open_rows, place
            )
            picked[n_picked] = j
            n_picked += 1
            cost += costs[j]
    best, best_cost = start.copy(), np.inf
    while work < max_work:
        step += 1
        covered = open_rows[m] <= n_spare
        if covered and cost < best_cost:
            best, best_cost = picked[:n_picked].copy(), cost
            if cost <= target:
                break
        leaving = -1
        for a in range(n_picked):
            if (covered or picked[a] != tabu) and (
                leaving < 0 or _better(picked[a], picked[leaving], score, costs, stamp)
            ):
                leaving = a
        if leaving >= 0:
            j = picked[leaving]
            work += n_picked + _switch(
                j, -1, starts, rows, row_starts, row_columns, count, weight, score, allowed, chosen, open_rows, place
            )
            stamp[j] = step
            cost -= costs[j]
            n_picked -= 1
            picked[leaving] = picked[n_picked]
        if covered or open_rows[m] <= n_spare:
            continue
        state ^= state << np.uint64(13)
        state ^= state >> np.uint64(7)
        state ^= state << np.uint64(17)
        row = open_rows[np.int64(state % np.uint64(open_rows[m]))]
        entering = -1
        for x in range(row_starts[row], row_starts[row + 1]):
            k = row_columns[x]
            if allowed[k] and (entering < 0 or _better(k, entering, score, costs, stamp)):
                entering = k
        if entering < 0:
            entering = row_columns[row_starts[row]]
        # with unequal costs several columns may have to make room before one enters
        if cost + costs[entering] < best_cost:
            work += _switch(
                entering, 1, starts, rows, row_starts, row_columns, count, weight, score, allowed, chosen,
                open_rows, place,
            )  # fmt: skip
            picked[n_picked] = entering
            n_picked += 1
            cost += costs[entering]
            stamp[entering] = step
            tabu = entering
        for a in range(open_rows[m]):
            i = open_rows[a]
            weight[i] += 1
            work += row_starts[i + 1] - row_starts[i]
            for x in range(row_starts[i], row_starts[i + 1]):
                score[row_columns[x]] += 1
    return best
