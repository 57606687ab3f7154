"""Kernels that improve a tour of clusters: best alternatives of a fixed order, and moves of the order.

A tour is one node of each cluster, the depot cluster 0 at place 0; it closes from the last node to the first. ``cost``
is (nodes, nodes) from row to column, ``first`` the first node of each cluster and their number, ``earlier`` which
cluster must come before which. `cluster_nodes` is the layered shortest path of Fischetti, Salazar and Toth (1997).
"""

from __future__ import annotations

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array

LONGEST_MOVE = 50
"""Clusters that one move carries elsewhere at most: longer ones hardly ever help and their number grows squared."""


@numba.njit(cache=True, nogil=True)
def tour_cost(tour: Int32Array, cost: FloatArray) -> float:
    """Return the cost of a closed tour."""
    n = len(tour)
    total = cost[tour[n - 1], tour[0]]
    for k in range(n - 1):
        total += cost[tour[k], tour[k + 1]]
    return float(total)


@numba.njit(cache=True, nogil=True)
def cluster_nodes(tour: Int32Array, owner: Int32Array, cost: FloatArray, first: Int32Array, anywhere: bool) -> float:
    """Change the nodes of a tour to the best ones for its order of clusters; return the new cost.

    A shortest path through the clusters as layers, from the smallest one and back to it: from each of its nodes if
    ``anywhere``, else from the present one. Time: starts x sum of neighbours' products.
    """
    n = len(tour)
    begin = 0
    widest = 0
    for k in range(n):
        size = first[owner[tour[k]] + 1] - first[owner[tour[k]]]
        widest = max(widest, size)
        if size < first[owner[tour[begin]] + 1] - first[owner[tour[begin]]]:
            begin = k
    base = owner[tour[begin]]
    n_starts = first[base + 1] - first[base]
    spent = np.empty((n_starts, n + 1, widest))
    best, least = 0, np.inf
    for s in range(n_starts):
        if not anywhere and first[base] + s != tour[begin]:
            continue
        spent[s, 0, :] = np.inf
        spent[s, 0, s] = 0.0
        for k in range(1, n + 1):
            onto_layer(spent[s, k - 1], owner[tour[(begin + k - 1) % n]], owner[tour[(begin + k) % n]], cost, first,
                       spent[s, k])  # fmt: skip
        if spent[s, n, s] < least:
            best, least = s, spent[s, n, s]
    tour[begin] = first[base] + best
    for k in range(n - 1, 0, -1):
        at, after = (begin + k) % n, tour[(begin + k + 1) % n]
        f = first[owner[tour[at]]]
        cheapest = np.inf
        for v in range(f, first[owner[tour[at]] + 1]):
            total = spent[best, k, v - f] + cost[v, after]
            if total < cheapest:
                cheapest, tour[at] = total, v
    return least


@numba.njit(cache=True, nogil=True)
def onto_layer(
    spent: FloatArray, before: int, after: int, cost: FloatArray, first: Int32Array, grown: FloatArray
) -> None:
    """Write what reaching the nodes of cluster ``after`` costs, from what those of ``before`` cost."""
    f, size = first[after], first[after + 1] - first[after]
    g, width = first[before], first[before + 1] - first[before]
    for w in range(size):
        grown[w] = np.inf
    for v in range(width):
        have = spent[v]
        if have < np.inf:
            for w in range(size):
                total = have + cost[g + v, f + w]
                grown[w] = total if total < grown[w] else grown[w]


@numba.njit(cache=True, nogil=True)
def _swaps_in_order(tour: Int32Array, owner: Int32Array, earlier: BoolArray, i: int, j: int, k: int) -> bool:
    """Whether the places [i, j] may come after the places [j + 1, k]."""
    for a in range(i, j + 1):
        for b in range(j + 1, k + 1):
            if earlier[owner[tour[a]], owner[tour[b]]]:
                return False
    return True


@numba.njit(cache=True, nogil=True)
def _reverses_in_order(tour: Int32Array, owner: Int32Array, earlier: BoolArray, i: int, j: int) -> bool:
    """Whether the places [i, j] may be taken backwards."""
    for a in range(i, j + 1):
        for b in range(a + 1, j + 1):
            if earlier[owner[tour[a]], owner[tour[b]]]:
                return False
    return True


@numba.njit(cache=True, nogil=True)
def _reverse_segments(tour: Int32Array, owner: Int32Array, cost: FloatArray, earlier: BoolArray, least: float) -> bool:
    """2-opt: reverse segments while one gains more than ``least``. Sums along the tour price asymmetric costs too."""
    n = len(tour)
    improved = False
    back = np.zeros(n + 1)  # what going backwards costs more, up to each place
    again = True
    while again:
        again = False
        for k in range(1, n):
            back[k] = back[k - 1] + cost[tour[k], tour[k - 1]] - cost[tour[k - 1], tour[k]]
        for i in range(1, n - 1):
            a, b = tour[i - 1], tour[i]
            for j in range(i + 1, n):
                c, d = tour[j], tour[(j + 1) % n]
                gain = cost[a, b] + cost[c, d] - cost[a, c] - cost[b, d] - (back[j] - back[i])
                if gain > least and _reverses_in_order(tour, owner, earlier, i, j):
                    tour[i : j + 1] = tour[i : j + 1][::-1].copy()
                    for k in range(i, n):
                        back[k] = back[k - 1] + cost[tour[k], tour[k - 1]] - cost[tour[k - 1], tour[k]]
                    b = tour[i]
                    again = True
        improved = improved or again
    return improved


@numba.njit(cache=True, nogil=True)
def _swap_segments(tour: Int32Array, owner: Int32Array, cost: FloatArray, earlier: BoolArray, least: float) -> bool:
    """3-opt without reversal (or-opt of any length): exchange neighbouring segments while it gains."""
    n = len(tour)
    improved = False
    for i in range(1, n - 1):
        a = tour[i - 1]
        best, at_j, at_k = least, -1, -1
        for j in range(i, min(n - 1, i + LONGEST_MOVE)):
            b, c, d = tour[i], tour[j], tour[j + 1]
            fixed = cost[a, b] + cost[c, d] - cost[a, d]
            if fixed <= best:
                continue
            for k in range(j + 1, n):
                e, f = tour[k], tour[(k + 1) % n]
                gain = fixed + cost[e, f] - cost[e, b] - cost[c, f]
                if gain > best and _swaps_in_order(tour, owner, earlier, i, j, k):
                    best, at_j, at_k = gain, j, k
        if at_j >= 0:
            moved = np.concatenate((tour[at_j + 1 : at_k + 1], tour[i : at_j + 1]))
            tour[i : at_k + 1] = moved
            improved = True
    return improved


@numba.njit(cache=True, nogil=True)
def _move_clusters(
    tour: Int32Array, owner: Int32Array, cost: FloatArray, first: Int32Array, earlier: BoolArray, least: float
) -> bool:
    """Take each cluster out and put its best node in where that costs least."""
    n = len(tour)
    improved = False
    rest = np.empty(n - 1, tour.dtype)
    for cluster in range(1, n):
        at = 1
        while owner[tour[at]] != cluster:
            at += 1
        rest[:at], rest[at:] = tour[:at], tour[at + 1 :]
        a, d = rest[at - 1], rest[at % (n - 1)]
        saved = cost[a, tour[at]] + cost[tour[at], d] - cost[a, d]
        low, high = 1, n - 1
        for k in range(1, n - 1):
            if earlier[owner[rest[k]], cluster]:
                low = k + 1
            if earlier[cluster, owner[rest[k]]] and high == n - 1:
                high = k
        best, place, node = saved - least, -1, -1
        for k in range(low, high + 1):
            a, d = rest[k - 1], rest[k % (n - 1)]
            for v in range(first[cluster], first[cluster + 1]):
                extra = cost[a, v] + cost[v, d] - cost[a, d]
                if extra < best:
                    best, place, node = extra, k, v
        if place >= 0:
            tour[:place], tour[place], tour[place + 1 :] = rest[:place], node, rest[place:]
            improved = True
    return improved


@numba.njit(cache=True, nogil=True)
def improve_tour(
    tour: Int32Array, owner: Int32Array, cost: FloatArray, first: Int32Array, earlier: BoolArray, least: float
) -> float:
    """Improve a tour until no move gains more than ``least``; return its cost.

    The order respects ``earlier`` afterwards if it did before.
    """
    total = cluster_nodes(tour, owner, cost, first, True)
    while True:
        changed = len(tour) > 2 and _move_clusters(tour, owner, cost, first, earlier, least)
        if len(tour) > 2:
            changed = _reverse_segments(tour, owner, cost, earlier, least) or changed
            changed = _swap_segments(tour, owner, cost, earlier, least) or changed
        if not changed:
            return float(total)
        lower = cluster_nodes(tour, owner, cost, first, True)
        if lower >= total - least:
            return float(lower)
        total = lower
