"""Kernels that order sweeps: dynamic programming over subsets (Held and Karp 1962) and local search.

Every sweep has options (alternative and direction), numbered sweep by sweep: those of sweep ``i`` are
``first[i]`` to ``first[i + 1]``. ``cost`` is (options + 1, options + 1): from the exit of the row's option to the
entry of the column's; the last row and column are the start configuration. ``duration`` is each option's own.
"""

from __future__ import annotations

import numba
import numpy as np

from cellwright.arrays import AnyArray, FloatArray, Int32Array


@numba.njit(cache=True, nogil=True)
def held_karp(
    cost: FloatArray, duration: FloatArray, first: Int32Array, ceiling: float
) -> tuple[FloatArray, Int32Array, FloatArray]:
    """Return for each option the cheapest order that ends with it, and those orders.

    Subsets are taken in rising order, so each state is final before it is extended. States are not bounded away:
    with several alternatives a sweep, relaxations (one-trees among them) are too weak to drop any worth the while.
    Memory 8 bytes x 2^sweeps x options; time 2^sweeps options^2 / 2 additions in vector registers.

    Returns:
        Costs with the way home, infinite if not below ``ceiling``, (options,); options in order, (options, sweeps);
        the cost of each state, (2^sweeps, options).
    """
    n, m = len(first) - 1, len(duration)
    n_subsets = 1 << n
    best = np.full((n_subsets, m), np.inf)
    into = np.ascontiguousarray(cost[:m, :m].T) + duration.reshape(-1, 1)
    for i in range(n):
        for p in range(first[i], first[i + 1]):
            best[1 << i, p] = cost[m, p] + duration[p]
    for subset in range(1, n_subsets - 1):
        for j in range(n):
            if not subset >> j & 1:
                for p in range(first[j], first[j + 1]):
                    best[subset | 1 << j, p] = _least_sum(best[subset], into[p])
    totals = np.full(m, np.inf)
    orders = np.full((m, n), np.int32(-1), np.int32)
    for option in range(m):
        totals[option] = best[n_subsets - 1, option] + cost[option, m]
        if totals[option] < ceiling:
            _trace_back(best, into, first, option, orders[option])
        else:
            totals[option] = np.inf
    return totals, orders, best


@numba.njit(cache=True, nogil=True)
def cheapest_through(best: FloatArray, cost: FloatArray, duration: FloatArray, first: Int32Array) -> FloatArray:
    """Return for each option what the cheapest order that uses it costs, (options,).

    ``best`` holds the states' costs from `held_karp`; the same recursion from the end adds what is still to come.
    """
    n, m = len(first) - 1, len(duration)
    after = np.full(best.shape, np.inf)
    after[-1] = cost[:m, m]
    onward = cost[:m, :m] + duration
    through: FloatArray = best[-1] + after[-1]
    following = np.empty(m)
    for subset in range(len(best) - 2, 0, -1):
        following[:] = np.inf
        for j in range(n):
            if not subset >> j & 1:
                own = slice(first[j], first[j + 1])
                following[own] = after[subset | 1 << j, own]
        for i in range(n):
            if subset >> i & 1:
                for o in range(first[i], first[i + 1]):
                    after[subset, o] = _least_sum(following, onward[o])
                    through[o] = min(through[o], best[subset, o] + after[subset, o])
    return through


@numba.njit(cache=True, nogil=True, fastmath={"nnan", "nsz", "reassoc"})
def _least_sum(a: FloatArray, b: FloatArray) -> float:
    """Return the least of ``a + b``; free to reorder, so that it runs in vector registers: a minimum is exact."""
    least = np.inf
    for k in range(len(a)):
        least = min(least, a[k] + b[k])
    return least


@numba.njit(cache=True, nogil=True)
def _trace_back(best: FloatArray, into: FloatArray, first: Int32Array, option: int, order: Int32Array) -> None:
    """Write the options of the cheapest order that ends with ``option``: each state's lowest cheapest predecessor."""
    n = len(order)
    subset = len(best) - 1
    for place in range(n - 1, 0, -1):
        order[place] = option
        subset ^= 1 << (int(np.searchsorted(first, option, side="right")) - 1)
        before = 0
        for o in range(best.shape[1]):
            if best[subset, o] + into[option, o] < best[subset, before] + into[option, before]:
                before = o
        option = before
    order[0] = option


def best_options(
    sequence: Int32Array, cost: FloatArray, duration: FloatArray, first: Int32Array
) -> tuple[float, Int32Array]:
    """Return the cost of the cheapest options of sweeps in a given ``sequence``, and those options."""
    start = len(duration)
    before, spent = np.array([start]), np.zeros(1)
    layers: list[tuple[AnyArray, AnyArray]] = []
    for i in sequence:
        own = np.arange(first[i], first[i + 1])
        totals = spent[:, None] + cost[before[:, None], own] + duration[own]
        came = np.argmin(totals, axis=0)
        layers.append((own, came))
        before, spent = own, totals[came, np.arange(len(own))]
    spent = spent + cost[before, start]
    row = int(np.argmin(spent))
    chosen = np.empty(len(sequence), np.int32)
    for place in range(len(sequence) - 1, -1, -1):
        own, came = layers[place]
        chosen[place], row = own[row], came[row]
    return float(spent.min()), chosen


@numba.njit(cache=True, nogil=True)
def _sequence_cost(sequence: Int32Array, cost: FloatArray, duration: FloatArray, first: Int32Array) -> float:
    """Return the cost of the cheapest options of sweeps in a given ``sequence``."""
    m = len(duration)
    spent = np.empty(m)
    for place in range(len(sequence)):
        i = sequence[place]
        for p in range(first[i], first[i + 1]):
            spent[p] = cost[m, p] + duration[p] if place == 0 else np.inf
            if place > 0:
                h = sequence[place - 1]
                for o in range(first[h], first[h + 1]):
                    spent[p] = min(spent[p], spent[o] + cost[o, p] + duration[p])
    least = np.inf
    last = sequence[len(sequence) - 1]
    for o in range(first[last], first[last + 1]):
        least = min(least, spent[o] + cost[o, m])
    return least


@numba.njit(cache=True, nogil=True)
def improve_sequence(
    sequence: Int32Array, cost: FloatArray, duration: FloatArray, first: Int32Array
) -> tuple[float, Int32Array]:
    """Improve a sequence until no reversal (2-opt) and no move of up to three neighbours (or-opt) helps."""
    n = len(sequence)
    current = sequence.copy()
    trial = sequence.copy()
    least = _sequence_cost(current, cost, duration, first)
    improved = True
    while improved:
        improved = False
        for i in range(n):
            for j in range(i + 1, n):
                trial[:] = current
                for k in range(j - i + 1):
                    trial[i + k] = current[j - k]
                total = _sequence_cost(trial, cost, duration, first)
                if total < least - 1e-9:
                    least, improved = total, True
                    current[:] = trial
        for length in range(1, min(4, n)):
            for i in range(n - length + 1):
                for to in range(n - length + 1):
                    if to == i:
                        continue
                    _move(current, i, length, to, trial)
                    total = _sequence_cost(trial, cost, duration, first)
                    if total < least - 1e-9:
                        least, improved = total, True
                        current[:] = trial
    return least, current


@numba.njit(cache=True, nogil=True)
def _move(source: AnyArray, i: int, length: int, to: int, target: AnyArray) -> None:
    """Write ``source`` with ``length`` entries from ``i`` taken out and put in so that they begin at ``to``."""
    n, write = len(source), 0
    for read in range(n):
        if read < i or read >= i + length:
            if write == to:
                write += length
            target[write] = source[read]
            write += 1
    for k in range(length):
        target[to + k] = source[i + k]
