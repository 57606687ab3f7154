"""The kernel of dynamic programming over subsets (Held and Karp 1962), with bounds: one layer of states at a time.

A state is the set of clusters visited and the node of the last one; only its cheapest way is kept. A state whose cost
and whose cheapest rest, from the walk relaxation, together reach the cost of a known sequence is dropped at once.
"""

from __future__ import annotations

import numba
import numpy as np

from cellwright.arrays import AnyArray, FloatArray, Int32Array, IntArray

BYTES_A_STATE = 160
"""Memory that a state may take: twice its own 32 bytes before the layer is cut to its best, once more while arrays
grow, the hash table that finds it, and what is kept to trace the sequence back."""

_MIX = np.uint64(0x9E3779B97F4A7C15)
_S29 = np.uint64(29)


@numba.njit(cache=True, nogil=True)
def _slot(subset: int, node: int, size: int) -> np.int64:
    z = (np.uint64(subset) * np.uint64(1024) + np.uint64(node) + np.uint64(subset >> 54)) * _MIX
    z = (z ^ (z >> _S29)) * _MIX
    return np.int64(z ^ (z >> _S29)) & np.int64(size - 1)


@numba.njit(cache=True, nogil=True)
def _grown(array: AnyArray, n: int) -> AnyArray:
    wider = np.empty(n, array.dtype)
    wider[: len(array)] = array
    return wider


@numba.njit(cache=True, nogil=True)
def _table(subset: IntArray, node: Int32Array, n: int, size: int) -> Int32Array:
    """Return a hash table of ``size`` slots with the first ``n`` states."""
    table = np.full(size, np.int32(-1), np.int32)
    for s in range(n):
        slot = _slot(subset[s], node[s], size)
        while table[slot] >= 0:
            slot = (slot + 1) & (size - 1)
        table[slot] = s
    return table


@numba.njit(cache=True, nogil=True)
def _best_part(reach: FloatArray, count: int, wanted: int) -> tuple[IntArray, float]:
    """Return the ``wanted`` of ``count`` states that reach the least, in order, and the least of those left out."""
    threshold = np.partition(reach[:count], wanted)[wanted]
    n_below = 0
    for s in range(count):
        n_below += reach[s] < threshold
    kept, n_ties, n_kept = np.empty(wanted, np.int64), wanted - n_below, 0
    for s in range(count):
        if reach[s] < threshold or (reach[s] == threshold and n_ties > 0):
            n_ties -= reach[s] == threshold
            kept[n_kept] = s
            n_kept += 1
    return kept, threshold


@numba.njit(cache=True, nogil=True)
def next_layer(
    subset: IntArray, node: Int32Array, value: FloatArray, way: Int32Array, to: Int32Array, cost: FloatArray,
    owner: Int32Array, first: Int32Array, multiplier: FloatArray, needs: IntArray, usable: AnyArray,
    memory: Int32Array, n_bits: Int32Array, rest: FloatArray, ceiling: float, most: int,
) -> tuple[float, IntArray, Int32Array, FloatArray, Int32Array]:  # fmt: skip
    """Visit one more cluster from every state; keep what stays below ``ceiling``, the ``most`` best of it.

    Args:
        subset: Clusters visited, as bits, (states,).
        node: Last node, (states,).
        value: Cost so far less the prices of the visited clusters, (states,).
        way: First way out of each node, and their number, (nodes + 1,).
        to: Where each way leads.
        cost: What each way costs.
        owner: Cluster of each node.
        first: First node of each cluster.
        multiplier: Price of each cluster.
        needs: Clusters that must have been visited before each, as bits.
        usable: Whether a node may stand at the next place.
        memory: Clusters that the bits of each cluster's memory stand for, (clusters, most bits).
        n_bits: Bits of each cluster's memory.
        rest: Cheapest rests at the next place, after `least_within`, (2^most bits, nodes).
        ceiling: Cost to stay below, less all prices.
        most: States of the next layer at most.

    Returns:
        A value that nothing goes below that was dropped for want of room, else infinite; subset, node, value of the
        next layer's states, and the state each came from.
    """
    n, m = len(first) - 1, len(owner)
    room, size = 1 << 12, 1 << 14
    to_subset, to_node = np.empty(room, np.int64), np.empty(room, np.int32)
    to_value, parent, reach = np.empty(room), np.empty(room, np.int32), np.empty(room)
    table = np.full(size, np.int32(-1), np.int32)
    count = 0
    dropped = np.inf
    bound = np.full(m, np.inf)  # of the rests, for the subset at hand
    known = np.int64(-1)
    for s in range(len(subset)):
        visited, u, have = subset[s], node[s], value[s]
        if visited != known:
            known = visited
            for j in range(n):
                shut = visited >> j & 1 or needs[j] & ~visited
                mask = 0
                if not shut:
                    for b in range(n_bits[j]):
                        if not visited >> memory[j, b] & 1:
                            mask |= 1 << b
                for w in range(first[j], first[j + 1]):
                    bound[w] = np.inf if shut or not usable[w] else rest[mask, w] - multiplier[j]
        for a in range(way[u], way[u + 1]):
            w = to[a]
            reaches = have + cost[a] + bound[w]
            if not reaches < ceiling:
                continue
            j = owner[w]
            total = have + cost[a] - multiplier[j]
            target = visited | np.int64(1) << np.int64(j)
            slot = _slot(target, w, size)
            while table[slot] >= 0 and (to_subset[table[slot]] != target or to_node[table[slot]] != w):
                slot = (slot + 1) & (size - 1)
            at = table[slot]
            if at >= 0:
                if total < to_value[at]:
                    to_value[at], parent[at], reach[at] = total, s, reaches
                continue
            if count == room:
                if room < 2 * most:
                    room = min(2 * most, 2 * room)
                    to_subset, to_node = _grown(to_subset, room), _grown(to_node, room)
                    to_value, parent = _grown(to_value, room), _grown(parent, room)
                    reach = _grown(reach, room)
                else:
                    kept, ceiling = _best_part(reach, count, most)
                    dropped = ceiling
                    count = most
                    to_subset[:count], to_node[:count] = to_subset[kept], to_node[kept]
                    to_value[:count], parent[:count] = to_value[kept], parent[kept]
                    reach[:count] = reach[kept]
                    table = _table(to_subset, to_node, count, size)
                    if not reaches < ceiling:
                        continue
                    slot = _slot(target, w, size)
                    while table[slot] >= 0:
                        slot = (slot + 1) & (size - 1)
            table[slot] = count
            to_subset[count], to_node[count], to_value[count] = target, w, total
            parent[count], reach[count] = s, reaches
            count += 1
            if 2 * count > size:
                size *= 4
                table = _table(to_subset, to_node, count, size)
    if count > most:
        kept, dropped = _best_part(reach, count, most)
        return dropped, to_subset[kept], to_node[kept], to_value[kept], parent[kept]
    return dropped, to_subset[:count].copy(), to_node[:count].copy(), to_value[:count].copy(), parent[:count].copy()
