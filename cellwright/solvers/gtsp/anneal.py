"""The kernel of the large-neighbourhood search: take some clusters out, put them in again elsewhere, anneal.

After Smith and Imeson's GLNS (2017): several ways to choose what is taken out and in which order it goes back, each
used as often as it has proven itself (Ropke and Pisinger 2006), accepted as in simulated annealing. A lower bound on
what inserting a cluster between two nodes costs spares most looks at its alternatives.
"""

from __future__ import annotations

import numba
import numpy as np

from cellwright.arrays import AnyArray, BoolArray, FloatArray, Int32Array
from cellwright.solvers.gtsp.kernels import cluster_nodes, improve_tour, onto_layer, tour_cost

N_REMOVALS = 4
"""Ways to choose what is taken out: a segment, anything, what costs most, what is close to each other."""
N_INSERTIONS = 5
"""How it goes back: in any order, the cheapest first, the dearest first, in any order blind to some places, and in any
order with the best alternatives of the whole tour chosen anew for every place that is tried."""
MOST_ANEW = 6
"""Clusters that the last of these puts in in one round at most: each is dear."""

_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11)


@numba.njit(cache=True, nogil=True)
def _uniform(state: AnyArray) -> float:
    """Return the next number in [0, 1) (SplitMix64, Steele, Lea and Flood 2014)."""
    state[0] += _STEP
    z = state[0]
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    z = z ^ (z >> _S31)
    return float(z >> _S11) * 1.1102230246251565e-16


@numba.njit(cache=True, nogil=True)
def nearest_nodes(cost: FloatArray, first: Int32Array) -> tuple[FloatArray, FloatArray]:
    """Return the least cost from each node into each cluster, and out of each cluster, both (clusters, nodes)."""
    n, m = len(first) - 1, len(cost)
    into, out_of = np.full((n, m), np.inf), np.full((n, m), np.inf)
    for u in range(m):
        for j in range(n):
            for v in range(first[j], first[j + 1]):
                into[j, u] = min(into[j, u], cost[u, v])
                out_of[j, u] = min(out_of[j, u], cost[v, u])
    return into, out_of


@numba.njit(cache=True, nogil=True)
def _place(
    cluster: int, tour: Int32Array, n: int, low: int, high: int,
    cost: FloatArray, back: FloatArray, first: Int32Array, into: FloatArray, out_of: FloatArray,
) -> tuple[float, int, int]:  # fmt: skip
    """Return cost, place and node of the cheapest insertion of a cluster at the places [low, high]."""
    best, place, node = np.inf, -1, -1
    f, last = first[cluster], first[cluster + 1]
    for k in range(low, high + 1):
        a = tour[k - 1]
        d = tour[k] if k < n else tour[0]
        base = cost[a, d]
        if into[cluster, a] + out_of[cluster, d] - base >= best:
            continue
        for v in range(f, last):
            extra = cost[a, v] + back[d, v] - base
            if extra < best:
                best, place, node = extra, k, v
    return best, place, node


@numba.njit(cache=True, nogil=True)
def _window(cluster: int, tour: Int32Array, n: int, owner: Int32Array, earlier: BoolArray) -> tuple[int, int]:
    """Return the first and last place at which a cluster may be inserted."""
    low, high = 1, n
    for k in range(1, n):
        if earlier[owner[tour[k]], cluster]:
            low = k + 1
        if high == n and earlier[cluster, owner[tour[k]]]:
            high = k
    return low, high


@numba.njit(cache=True, nogil=True)
def _remove(
    tour: Int32Array, owner: Int32Array, cost: FloatArray, neighbour: Int32Array, how: int, n_out: int,
    out: Int32Array, state: AnyArray,
) -> int:  # fmt: skip
    """Take ``n_out`` clusters out of a tour; they go to ``out``. Return the length of what is left."""
    n = len(tour)
    gone = np.zeros(n, np.bool_)  # by cluster
    n_gone = 0
    if how == 0:
        at = 1 + int(_uniform(state) * (n - 1))
        for k in range(n_out):
            gone[owner[tour[1 + (at - 1 + k) % (n - 1)]]] = True
        n_gone = n_out
    elif how == 3:
        at = 1 + int(_uniform(state) * (n - 1))
        gone[at] = True
        n_gone = 1
        k = 0
        while n_gone < n_out:
            near = neighbour[at, k % (n - 2)] if n > 2 else at
            k += 1
            if not gone[near] and _uniform(state) < 0.7:
                gone[near] = True
                n_gone += 1
    while n_gone < n_out:
        chosen, most = -1, -np.inf
        for _ in range(1 if how == 1 else 4):
            k = 1 + int(_uniform(state) * (n - 1))
            if not gone[owner[tour[k]]]:
                a, v, d = tour[k - 1], tour[k], tour[(k + 1) % n]
                saved = cost[a, v] + cost[v, d] - cost[a, d]
                if saved > most:
                    chosen, most = owner[v], saved
        if chosen >= 0:
            gone[chosen] = True
            n_gone += 1
    left, n_out = 0, 0
    for k in range(n):
        if gone[owner[tour[k]]]:
            out[n_out] = owner[tour[k]]
            n_out += 1
        else:
            tour[left] = tour[k]
            left += 1
    return left


@numba.njit(cache=True, nogil=True)
def _insert_at(tour: Int32Array, n: int, place: int, node: int) -> None:
    for k in range(n, place, -1):
        tour[k] = tour[k - 1]
    tour[place] = node


@numba.njit(cache=True, nogil=True)
def _insert(
    tour: Int32Array, n: int, out: Int32Array, n_out: int, how: int, constrained: bool, owner: Int32Array,
    cost: FloatArray, back: FloatArray, first: Int32Array, earlier: BoolArray, into: FloatArray, out_of: FloatArray,
    state: AnyArray,
) -> None:  # fmt: skip
    """Put the clusters of ``out`` into the tour of length ``n``, each where it costs least."""
    extra, place, node = np.empty(n_out), np.empty(n_out, np.int32), np.empty(n_out, np.int32)
    greedy = how == 1 or how == 2
    if greedy:
        for i in range(n_out):
            low, high = _window(out[i], tour, n, owner, earlier) if constrained else (1, n)
            extra[i], place[i], node[i] = _place(out[i], tour, n, low, high, cost, back, first, into, out_of)
    while n_out:
        i = int(_uniform(state) * n_out)
        if greedy:
            i = 0
            for k in range(1, n_out):
                if (extra[k] < extra[i]) if how == 1 else (extra[k] > extra[i]):
                    i = k
            at, v = place[i], node[i]
        else:
            low, high = _window(out[i], tour, n, owner, earlier) if constrained else (1, n)
            if how == 3 and high > low:
                # blind to part of the places, so that another one than the cheapest gets its turn
                middle = low + int(_uniform(state) * (high - low))
                low, high = (low, middle) if _uniform(state) < 0.5 else (middle, high)
            _, at, v = _place(out[i], tour, n, low, high, cost, back, first, into, out_of)
        _insert_at(tour, n, at, v)
        n, n_out = n + 1, n_out - 1
        out[i], extra[i], place[i], node[i] = out[n_out], extra[n_out], place[n_out], node[n_out]
        if not greedy:
            continue
        for k in range(n_out):
            if constrained or place[k] == at:
                low, high = _window(out[k], tour, n, owner, earlier) if constrained else (1, n)
                extra[k], place[k], node[k] = _place(out[k], tour, n, low, high, cost, back, first, into, out_of)
                continue
            place[k] += place[k] > at
            other, spot, w = _place(out[k], tour, n, at, at + 1, cost, back, first, into, out_of)
            if other < extra[k]:
                extra[k], place[k], node[k] = other, spot, w


@numba.njit(cache=True, nogil=True)
def _insert_anew(
    tour: Int32Array, n: int, out: Int32Array, n_out: int, constrained: bool, owner: Int32Array,
    cost: FloatArray, back: FloatArray, first: Int32Array, earlier: BoolArray, into: FloatArray, out_of: FloatArray,
    spent: FloatArray, ahead: FloatArray, state: AnyArray,
) -> None:  # fmt: skip
    """Put the clusters of ``out`` in where they cost least if all others' nodes, but the depot's, may change.

    ``spent`` and ``ahead`` are room for the cheapest ways from and to the depot, (clusters + 1, widest cluster).
    """
    widest = spent.shape[1]
    come, go = np.empty(widest), np.empty(widest)
    depot, g = tour[0], first[owner[tour[0]]]
    spent[0, :] = np.inf
    spent[0, depot - g] = 0.0
    valid_from, valid_to = 0, n + 1  # spent is right up to the one, ahead from the other on
    while n_out:
        i = int(_uniform(state) * n_out)
        cluster = out[i]
        n_out -= 1
        out[i] = out[n_out]
        ahead[n, :] = np.inf
        ahead[n, depot - g] = 0.0
        for k in range(valid_from + 1, n):
            onto_layer(spent[k - 1], owner[tour[k - 1]], owner[tour[k]], cost, first, spent[k])
        for k in range(min(valid_to, n) - 1, 0, -1):
            onto_layer(ahead[k + 1], owner[tour[(k + 1) % n]], owner[tour[k]], back, first, ahead[k])
        low, high = _window(cluster, tour, n, owner, earlier) if constrained else (1, n)
        best, place = np.inf, low
        f, size = first[cluster], first[cluster + 1] - first[cluster]
        for k in range(low, high + 1):
            own, other = owner[tour[k - 1]], owner[tour[k % n]]
            least, least_ahead = np.inf, np.inf
            for v in range(first[own], first[own + 1]):
                least = min(least, spent[k - 1, v - first[own]] + into[cluster, v])
            for v in range(first[other], first[other + 1]):
                least_ahead = min(least_ahead, ahead[k, v - first[other]] + out_of[cluster, v])
            if least + least_ahead >= best:
                continue
            onto_layer(spent[k - 1], own, cluster, cost, first, come)
            onto_layer(ahead[k], other, cluster, back, first, go)
            for v in range(size):
                if come[v] + go[v] < best:
                    best, place = come[v] + go[v], k
        _insert_at(tour, n, place, f)
        for k in range(n, place - 1, -1):
            ahead[k + 1] = ahead[k]
        n += 1
        valid_from, valid_to = place - 1, place + 1


@numba.njit(cache=True, nogil=True)
def _renew_nodes(tour: Int32Array, owner: Int32Array, cost: FloatArray, back: FloatArray, first: Int32Array) -> None:
    """Give each place the node of its cluster that is best between its neighbours."""
    n = len(tour)
    for k in range(n):
        a, d, own = tour[k - 1], tour[(k + 1) % n], owner[tour[k]]
        best = cost[a, tour[k]] + back[d, tour[k]]
        for v in range(first[own], first[own + 1]):
            total = cost[a, v] + back[d, v]
            if total < best:
                best, tour[k] = total, v


@numba.njit(cache=True, nogil=True)
def _pick(weight: FloatArray, state: AnyArray) -> int:
    at = _uniform(state) * weight.sum()
    for k in range(len(weight) - 1):
        at -= weight[k]
        if at < 0.0:
            return k
    return len(weight) - 1


@numba.njit(cache=True, nogil=True)
def anneal(
    current: Int32Array, best: Int32Array, owner: Int32Array, cost: FloatArray, back: FloatArray, first: Int32Array,
    earlier: BoolArray, neighbour: Int32Array, into: FloatArray, out_of: FloatArray, weight: FloatArray,
    hot: float, cold: float, most_out: int, promising: float, n_rounds: int, least: float,
    state: AnyArray,
) -> float:  # fmt: skip
    """Anneal ``current`` for a number of rounds, from temperature ``hot`` to ``cold``; ``best`` is kept up to date.

    Args:
        current: Tour to go on from, edited.
        best: Best tour so far, edited when a better one is found.
        owner: Cluster of each node.
        cost: Costs from row to column.
        back: The same transposed, so that both are read along rows.
        first: First node of each cluster.
        earlier: Which cluster must come before which.
        neighbour: The other clusters but the depot, the closest first, (clusters, clusters - 2).
        into: From `nearest_nodes`.
        out_of: From `nearest_nodes`.
        weight: How often each way to remove and insert is used, (N_REMOVALS, N_INSERTIONS), edited.
        hot: Temperature of the first round, in units of cost.
        cold: Temperature of the last round.
        most_out: Clusters that one round takes out at most.
        promising: A tour within this factor of the current one gets the best alternatives for its order.
        n_rounds: Rounds.
        least: Gains below this are rounding.
        state: State of the random numbers, (1,), edited.

    Returns:
        The cost of ``best``.
    """
    n = len(current)
    constrained = bool(earlier.any())
    trial, out = current.copy(), np.empty(n, np.int32)
    have, least_cost = tour_cost(current, cost), tour_cost(best, cost)
    widest = int((first[1:] - first[:-1]).max())
    spent, ahead = np.empty((n + 2, widest)), np.empty((n + 2, widest))
    dearer = len(cost) / 500.0  # what one insertion with new alternatives takes, in ordinary rounds, measured
    score, used = np.zeros(weight.size), np.zeros(weight.size)
    flat = weight.reshape(-1)
    temperature = hot
    cooling = (cold / hot) ** (1.0 / max(1, n_rounds - 1))
    for round_ in range(n_rounds):
        way = _pick(flat, state)
        anew = way % N_INSERTIONS == N_INSERTIONS - 1
        n_out = 1 + int(_uniform(state) * (min(most_out, MOST_ANEW) if anew else most_out))
        trial[:] = current
        left = _remove(trial, owner, cost, neighbour, way // N_INSERTIONS, n_out, out, state)
        if anew:
            _insert_anew(trial, left, out, n_out, constrained, owner, cost, back, first, earlier, into, out_of,
                         spent, ahead, state)  # fmt: skip
            total = cluster_nodes(trial, owner, cost, first, False)
            used[way] += 1.0 + dearer * n_out
        else:
            _insert(trial, left, out, n_out, way % N_INSERTIONS, constrained, owner, cost, back, first, earlier,
                    into, out_of, state)  # fmt: skip
            _renew_nodes(trial, owner, cost, back, first)
            total = tour_cost(trial, cost)
            if total < have * promising and total != have:
                total = cluster_nodes(trial, owner, cost, first, False)
            used[way] += 1.0
        if total < least_cost - least:
            total = improve_tour(trial, owner, cost, first, earlier, least)
            least_cost = total
            best[:] = trial
            score[way] += 8.0
        elif total < have - least:
            score[way] += 2.0
        if total < have or _uniform(state) < np.exp((have - total) / temperature):
            have = total
            current[:] = trial
        temperature *= cooling
        if round_ % 500 == 499:
            for k in range(flat.size):
                if used[k] > 0.0:
                    flat[k] = max(0.1, 0.7 * flat[k] + 0.3 * min(10.0, 20.0 * score[k] / used[k]))
            score[:], used[:] = 0.0, 0.0
    return float(least_cost)
