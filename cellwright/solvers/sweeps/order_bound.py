"""A lower bound on any order of sweeps: the one-tree relaxation with Lagrange multipliers (Held and Karp 1970).

The way from the start through all sweeps, closed over a copy of the start, is a tour; every tour is a one-tree.
Multipliers on the nodes' degrees, found by subgradient steps, lift the least one-tree towards the least tour.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray, Int32Array, IntArray

ROUNDS = 150
"""Subgradient steps; the bound changes in its third digit only after that."""


def one_tree_bound(
    cost: FloatArray, duration: FloatArray, first: Int32Array, upper: float, n_rounds: int = ROUNDS
) -> float:
    """Return a bound that no order undercuts.

    ``cost``, ``duration`` and ``first`` as in `cellwright.solvers.sweeps.order_kernels`; ``upper`` is the cost of a
    known order, which scales the steps and stands for connections that do not exist.
    """
    n = len(first) - 1
    between = np.full((n + 1, n + 1), np.inf)  # undirected, the start last
    to_end = np.empty(n)  # from a sweep to the copy of the start
    for i in range(n):
        own = slice(int(first[i]), int(first[i + 1]))
        to_end[i] = cost[own, -1].min()
        between[i, n] = between[n, i] = cost[-1, own].min()
        for j in range(i):
            other = slice(int(first[j]), int(first[j + 1]))
            between[i, j] = between[j, i] = min(cost[own, other].min(), cost[other, own].min())
    between, to_end = np.minimum(between, upper), np.minimum(to_end, upper)
    fixed = sum(float(duration[first[i] : first[i + 1]].min()) for i in range(n))
    multiplier = np.zeros(n + 1)
    best, step = -np.inf, 1.0
    for _ in range(n_rounds):
        tree_cost, degree = _least_tree(between + multiplier[:, None] + multiplier[None, :])
        ends = to_end + multiplier[:n]
        last = int(np.argmin(ends))
        degree[last] += 1
        degree[n] += 1
        bound = tree_cost + ends[last] + multiplier[n] - 2.0 * multiplier.sum() + fixed
        best, step = (bound, step) if bound > best else (best, 0.95 * step)
        excess = degree - 2
        if not excess.any() or best >= upper:
            break
        multiplier = multiplier + step * (upper - bound) / float(excess @ excess) * excess
    return min(float(best), upper)


def _least_tree(weight: FloatArray) -> tuple[float, IntArray]:
    """Return cost and node degrees of the least spanning tree (Prim)."""
    n = len(weight)
    degree = np.zeros(n, np.int64)
    inside = np.zeros(n, bool)
    inside[0] = True
    nearest, distance = np.zeros(n, np.int64), weight[0].copy()
    total = 0.0
    for _ in range(n - 1):
        node = int(np.argmin(np.where(inside, np.inf, distance)))
        total += float(distance[node])
        degree[node] += 1
        degree[nearest[node]] += 1
        inside[node] = True
        closer = weight[node] < distance
        nearest[closer], distance[closer] = node, weight[node][closer]
    return total, degree
