"""Kernels of the walk relaxation: the cheapest way through N places that may visit a cluster twice, if it must.

A walk takes one node at each of the places 1 to N, from the depot and back to it. Forgetting which clusters were
visited makes this a shortest path over (place, node); remembering for each cluster a few neighbours (the ng-sets of
Baldacci, Mingozzi and Roberti 2011) forbids the short cycles that matter. Multipliers on the clusters (a price for
each visit) pull the walk towards visiting each once.

``local[i, j]`` is the bit that stands for cluster j in the memory of cluster i, or -1; ``step[i, j, mask]`` the memory
at i of a walk that goes on to j with the memory ``mask`` there, or -1 if that walk comes back to i and j knows.
"""

from __future__ import annotations

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array


@numba.njit(cache=True, nogil=True)
def memory_steps(local: Int32Array, n_bits: Int32Array) -> Int32Array:
    """Return ``step`` for the memories that ``local`` describes, (clusters, clusters, 2^most bits)."""
    n = len(local)
    step = np.full((n, n, 1 << n_bits.max()), np.int32(-1), np.int32)
    for i in range(n):
        for j in range(n):
            if i == j:
                continue
            base = 1 << local[i, j] if local[i, j] >= 0 else 0
            for mask in range(1 << n_bits[j]):
                if local[j, i] >= 0 and mask >> local[j, i] & 1:
                    continue
                kept = base
                for other in range(n):
                    if local[j, other] >= 0 and mask >> local[j, other] & 1 and local[i, other] >= 0:
                        kept |= 1 << local[i, other]
                step[i, j, mask] = kept
    return step


@numba.njit(cache=True, nogil=True)
def complete_walks(
    onto: FloatArray, end: FloatArray, first: Int32Array, multiplier: FloatArray, usable: BoolArray,
    follows: BoolArray, step: Int32Array, rest: FloatArray,
) -> None:  # fmt: skip
    """Fill in what the cheapest rest of a walk costs: from a node at a place to the depot, for each memory.

    Args:
        onto: Cost into the row's node from the column's, (nodes, nodes): the cost matrix transposed.
        end: Cost from each node to the depot.
        first: First node of each cluster.
        multiplier: Price of each cluster, taken off the cost of a walk that visits it.
        usable: Whether a node may stand at a place, (N + 1, nodes); place 0 is the depot's.
        follows: Whether the column's cluster may come right after the row's.
        step: From `memory_steps`.
        rest: Written: (N + 1, 2^most bits, nodes), infinite where there is no walk. The node's own price is not in it.
    """
    n = len(first) - 1
    n_masks = rest.shape[1]
    rest[:] = np.inf
    m = len(end)
    for v in range(m):
        if usable[n, v]:
            rest[n, 0, v] = end[v]
    merged = np.empty((n_masks, m))
    touched = np.zeros(n_masks, np.bool_)
    reached = np.empty(n_masks, np.int32)
    alive, n_alive = np.empty((n, n_masks), np.int32), np.empty(n, np.int64)
    for place in range(n - 1, 0, -1):
        there, here = rest[place + 1], rest[place]
        for j in range(n):
            n_alive[j] = 0
            for mask in range(n_masks):
                for w in range(first[j], first[j + 1]):
                    if there[mask, w] < np.inf:
                        alive[j, n_alive[j]] = mask
                        n_alive[j] += 1
                        break
        for i in range(n):
            f, last = first[i], first[i + 1]
            reachable = False
            for v in range(f, last):
                reachable = reachable or usable[place, v]
            if not reachable:
                continue
            for j in range(n):
                if i == j or not follows[i, j]:
                    continue
                g, end_ = first[j], first[j + 1]
                n_reached = 0
                for k in range(n_alive[j]):
                    mask = alive[j, k]
                    to = step[i, j, mask]
                    if to < 0:
                        continue
                    if not touched[to]:
                        touched[to] = True
                        reached[n_reached] = to
                        n_reached += 1
                        for w in range(g, end_):
                            merged[to, w] = there[mask, w]
                    else:
                        for w in range(g, end_):
                            merged[to, w] = min(merged[to, w], there[mask, w])
                for k in range(n_reached):
                    to = reached[k]
                    touched[to] = False
                    for w in range(g, end_):
                        have = merged[to, w] - multiplier[j]
                        if have < np.inf:
                            for v in range(f, last):
                                total = onto[w, v] + have
                                here[to, v] = total if total < here[to, v] else here[to, v]
            for v in range(f, last):
                if not usable[place, v]:
                    for mask in range(n_masks):
                        here[mask, v] = np.inf


@numba.njit(cache=True, nogil=True)
def cheapest_walk(
    cost: FloatArray, begin: FloatArray, first: Int32Array, owner: Int32Array, multiplier: FloatArray,
    follows: BoolArray, step: Int32Array, rest: FloatArray, walk: Int32Array,
) -> float:  # fmt: skip
    """Write the nodes of a cheapest walk; return its cost less the prices of its visits, infinite if there is none."""
    n, m = len(first) - 1, len(begin)
    n_masks = rest.shape[1]
    least, node, memory = np.inf, -1, -1
    for mask in range(n_masks):
        for v in range(m):
            total = begin[v] + (rest[1, mask, v] - multiplier[owner[v]])
            if total < least:
                least, node, memory = total, v, mask
    if node < 0:
        return np.inf
    walk[0] = node
    for place in range(1, n):
        i = owner[node]
        best, to_node, to_memory = np.inf, -1, -1
        for j in range(n):
            if i == j or not follows[i, j]:
                continue
            for mask in range(n_masks):
                if step[i, j, mask] == memory:
                    for w in range(first[j], first[j + 1]):
                        total = cost[node, w] + (rest[place + 1, mask, w] - multiplier[j])
                        if total < best:
                            best, to_node, to_memory = total, w, mask
        node, memory = to_node, to_memory
        walk[place] = node
    return least


@numba.njit(cache=True, nogil=True)
def least_within(rest: FloatArray) -> None:
    """Replace each memory's entry by the least over all memories inside it: rests that visit nothing else of it."""
    n_places, n_masks, m = rest.shape
    for place in range(1, n_places):
        bit = 1
        while bit < n_masks:
            for mask in range(n_masks):
                if mask & bit:
                    for v in range(m):
                        rest[place, mask, v] = min(rest[place, mask, v], rest[place, mask ^ bit, v])
            bit <<= 1


@numba.njit(cache=True, nogil=True)
def through_nodes(ahead: FloatArray, rest: FloatArray, multiplier: FloatArray, owner: Int32Array) -> FloatArray:
    """Return what the cheapest walk through a node at a place costs less prices, (N + 1, nodes).

    ``ahead`` holds the walks from the depot as rests of the reversed problem, ``rest`` the rests after `least_within`.
    """
    n_places, n_masks, m = rest.shape
    through = np.full((n_places, m), np.inf)
    for place in range(1, n_places):
        for mask in range(n_masks):
            for v in range(m):
                total = ahead[n_places - place, mask, v] + rest[place, n_masks - 1 - mask, v]
                through[place, v] = min(through[place, v], total)
        for v in range(m):
            through[place, v] -= multiplier[owner[v]]
    return through


@numba.njit(cache=True, nogil=True)
def drop_ways(cost: FloatArray, ahead: FloatArray, rest: FloatArray, price: FloatArray, ceiling: float) -> None:
    """Make ways infinite through which no walk costs less than ``ceiling`` (which has all prices taken off).

    ``ahead`` and ``rest`` are the least over all memories, (N + 1, nodes), ``price`` each node's.
    """
    n_places, m = rest.shape
    best = np.empty(m)
    for u in range(m):
        best[:] = np.inf
        for place in range(1, n_places - 1):
            before = ahead[n_places - place, u]
            if before < np.inf:
                for w in range(m):
                    total = before + rest[place + 1, w]
                    best[w] = total if total < best[w] else best[w]
        for w in range(m):
            if best[w] + cost[u, w] - price[u] - price[w] >= ceiling:
                cost[u, w] = np.inf
