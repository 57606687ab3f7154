"""Decide small set-cover problems: is there a cover within a budget? Depth-first search with Lagrangian pruning.

At every node a few subgradient steps on the remaining rows raise a bound; columns whose reduced cost would exceed
the budget go; the row with the fewest columns left branches over them. For a few hundred columns a node costs tens
of microseconds. The search counts the matrix entries that it visits and stops at a limit.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.solvers.covering.matrix import TOLERANCE, CoverMatrix

_STEPS = 20
"""Subgradient steps a node; more prune a little better and cost more than they save."""


def search_leaf(
    matrix: CoverMatrix, duals: FloatArray, budget: float, max_work: float
) -> tuple[IntArray | None, bool, float]:
    """Search for a cover that costs at most ``budget``.

    Args:
        matrix: The matrix.
        duals: Prices of the rows, >= 0, (rows,), from which the bounds start.
        budget: Largest cost of interest.
        max_work: Matrix entries to visit at most.

    Returns:
        The columns of such a cover or ``None``; whether the answer is final; the entries visited.
    """
    if matrix.n_rows == 0:
        return np.empty(0, np.int64), True, 0.0
    depth = math.floor((budget + TOLERANCE) / matrix.costs.min()) + 1 if matrix.n_columns else 1
    picked = np.full(min(max(depth, 1), matrix.n_rows) + 1, -1, np.int64)
    state = np.array([0.0, max_work, 0.0])
    found = _descend(
        matrix.column_starts,
        matrix.column_rows,
        matrix.costs,
        np.arange(matrix.n_columns),
        duals.copy(),
        budget + TOLERANCE,
        0,
        picked,
        state,
        _STEPS,
    )
    if found:
        return np.sort(picked[picked >= 0]), True, float(state[0])
    return None, bool(state[2] == 0.0), float(state[0])


@numba.njit(cache=True, nogil=True)
def _raise_bound(starts, rows, costs, duals, best, slope, mean, budget, n_steps):  # type: ignore[no-untyped-def]
    """Raise the bound by subgradient steps until it exceeds the budget; ``best`` takes the prices."""
    n, m = len(starts) - 1, len(duals)
    top_value, factor, stalled = -np.inf, 1.0, 0
    for step in range(n_steps):
        value = 0.0
        for i in range(m):
            slope[i] = 1.0
            value += duals[i]
        for j in range(n):
            rest = costs[j]
            for t in range(starts[j], starts[j + 1]):
                rest -= duals[rows[t]]
            if rest < 0.0:
                value += rest
                for t in range(starts[j], starts[j + 1]):
                    slope[rows[t]] -= 1.0
        stalled += 1
        if value > top_value:
            if value > top_value + 1e-3:
                stalled = 0
            top_value = value
            for i in range(m):
                best[i] = duals[i]
            if value > budget:
                break
        if stalled >= 8:
            factor *= 0.6
            stalled = 0
            for i in range(m):
                duals[i] = best[i]
        norm = 0.0
        for i in range(m):
            if duals[i] <= 0.0 and slope[i] < 0.0:
                slope[i] = 0.0
            mean[i] = slope[i] if step == 0 else 0.5 * (mean[i] + slope[i])
            norm += mean[i] * mean[i]
        if norm < 1e-12:
            break
        length = factor * max(budget + 0.3 - value, 0.05) / norm
        for i in range(m):
            duals[i] = max(0.0, duals[i] + length * mean[i])
    return top_value


@numba.njit(cache=True, nogil=True)
def _descend(starts, rows, costs, names, duals, budget, depth, picked, state, n_steps):  # type: ignore[no-untyped-def]
    """Search below one node; ``state``: entries visited, limit, 1 if the limit ended the search."""
    n, m = len(starts) - 1, len(duals)
    if state[0] > state[1]:
        state[2] = 1.0
        return False
    best, renamed = np.empty(m), np.zeros(m, np.int64)
    bound = _raise_bound(starts, rows, costs, duals, best, np.empty(m), np.zeros(m), budget, n_steps)
    state[0] += 100.0 + (n_steps + 2) * len(rows)
    if bound > budget:
        return False
    keep, reduced, left = np.zeros(n, np.bool_), np.empty(n), np.zeros(m, np.int64)
    for j in range(n):
        rest = costs[j]
        for t in range(starts[j], starts[j + 1]):
            rest -= best[rows[t]]
        reduced[j] = rest
        if bound + max(rest, 0.0) <= budget and costs[j] <= budget:
            keep[j] = True
            for t in range(starts[j], starts[j + 1]):
                left[rows[t]] += 1
    row = 0
    for i in range(m):
        if left[i] < left[row]:
            row = i
    while True:
        # the column of lowest reduced cost among those that cover the branching row and are still allowed
        j = -1
        for k in range(n):
            if keep[k] and (j < 0 or reduced[k] < reduced[j]):
                for t in range(starts[k], starts[k + 1]):
                    if rows[t] == row:
                        j = k
                        break
        if j < 0:
            return False
        keep[j] = False  # later branches need not use it
        for i in range(m):
            renamed[i] = 0
        for t in range(starts[j], starts[j + 1]):
            renamed[rows[t]] = -1
        n_left = 0
        for i in range(m):
            if renamed[i] == 0:
                renamed[i] = n_left
                n_left += 1
        picked[depth] = names[j]
        if n_left == 0:
            for a in range(depth + 1, len(picked)):
                picked[a] = -1
            return True
        rest_budget = budget - costs[j]
        duals_left = np.empty(n_left)
        for i in range(m):
            if renamed[i] >= 0:
                duals_left[renamed[i]] = best[i]
        new_starts, new_rows = np.zeros(n + 1, np.int64), np.empty(len(rows), np.int32)
        new_costs, new_names = np.empty(n), np.empty(n, np.int64)
        p, z = 0, 0
        for k in range(n):
            if keep[k] and costs[k] <= rest_budget:
                for t in range(starts[k], starts[k + 1]):
                    if renamed[rows[t]] >= 0:
                        new_rows[z] = renamed[rows[t]]
                        z += 1
                if z > new_starts[p]:
                    new_names[p] = names[k]
                    new_costs[p] = costs[k]
                    p += 1
                    new_starts[p] = z
        state[0] += len(rows) + 2 * n
        if p > 0 and _descend(
            new_starts[: p + 1], new_rows[:z], new_costs[:p], new_names[:p], duals_left, rest_budget, depth + 1,
            picked, state, n_steps,
        ):  # fmt: skip
            return True
        if state[2] > 0.0:
            return False
