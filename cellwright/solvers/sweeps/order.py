"""Order sweeps, and choose each one's direction and alternative, so that the whole plan is short.

Three ways on the same connection costs: the greedy one of Kaiser 2021, section 4.4 (from the current end the
shortest executable connection next), the exact one by dynamic programming over subsets, and local search where
there are too many sweeps for that. Real connections are costly to find, so they are evaluated lazily (as Bohlin
and Kavraki 2000 do with edges): solve on lower bounds, evaluate the connections of the best orders, solve again,
until an order whose connections are all evaluated is no longer than the least bound: it is then proven best.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.solvers.sweeps.order_bound import one_tree_bound
from cellwright.solvers.sweeps.order_kernels import best_options, cheapest_through, held_karp, improve_sequence

MOST_MEMORY = 1 << 30
"""Bytes that dynamic programming may take: 17 sweeps with 8 alternatives need half of it."""
SAME = 1e-9
"""Seconds; differences below this are none."""

MISSING = 1e6
"""Seconds that local search takes for a connection that does not exist: no motion lasts as long."""

Evaluate = Callable[[int, int], float]
"""Cost of the connection from one option's exit to another's entry; infinite if there is none."""


@dataclass(frozen=True, eq=False)
class SweepOptions:
    """The ways to execute each sweep, numbered sweep by sweep; the number after the last is the start configuration.

    Attributes:
        name: What to call each sweep, (sweeps,).
        first: First option of each sweep, and their number, (sweeps + 1,).
        duration: Time that the option takes, (options,) in s.
        reverse: The same alternative in the other direction, (options,).
        least: Lower bounds of the connection costs, (options + 1, options + 1), row to column.
        returns: Whether the plan ends where it starts.
    """

    name: tuple[str, ...]
    first: Int32Array
    duration: FloatArray
    reverse: Int32Array
    least: FloatArray
    returns: bool = False

    @property
    def start(self) -> int:
        """The number that stands for the start configuration."""
        return len(self.duration)


@dataclass(frozen=True, eq=False)
class SweepOrder:
    """An order whose connections have all been evaluated.

    Attributes:
        options: Chosen options in order, (sweeps,).
        duration: Its whole duration in s: sweeps and connections.
        lower_bound: No order on these connection costs is shorter, s.
        proven: Whether it is shortest: duration and bound agree.
    """

    options: Int32Array
    duration: float
    lower_bound: float
    proven: bool


class ConnectionCosts:
    """Connection costs, evaluated when asked for; until then their lower bounds.

    Attributes:
        value: What is known: costs where ``exact``, else lower bounds, (options + 1, options + 1).
        exact: Which are costs.
        n_evaluated: Connections evaluated so far.
    """

    def __init__(self, options: SweepOptions, evaluate: Evaluate) -> None:
        self._options, self._evaluate = options, evaluate
        self.value: FloatArray = options.least.copy()
        self.exact: BoolArray = np.zeros(self.value.shape, bool)
        if not options.returns:
            self.value[:, options.start] = 0.0
            self.exact[:, options.start] = True
        self.n_evaluated = 0

    def at(self, a: int, b: int) -> float:
        """Return the cost of a connection, evaluating it now if need be."""
        if not self.exact[a, b]:
            self.n_evaluated += 1
            self.set(a, b, self._evaluate(a, b))
        return float(self.value[a, b])

    def set(self, a: int, b: int, cost: float) -> None:
        """Store a connection's cost, and that of the same connection run backwards."""
        start, reverse = self._options.start, self._options.reverse
        self.value[a, b], self.exact[a, b] = cost, True
        a_back, b_back = (int(reverse[x]) if x < start else start for x in (a, b))
        if self._options.returns or start not in (a, b):
            self.value[b_back, a_back], self.exact[b_back, a_back] = cost, True

    def bar(self, option: int) -> None:
        """Take an option out: no connection leads to it or away from it."""
        for row, column in ((option, slice(None)), (slice(None), option)):
            self.value[row, column], self.exact[row, column] = np.inf, True

    def total(self, chosen: Sequence[int] | Int32Array, ceiling: float = np.inf) -> float:
        """Return the duration of an order of options, evaluating connections until it is exact.

        As soon as it cannot stay below ``ceiling`` the lower bound so far is returned instead.
        """
        start = self._options.start
        stops = [start, *(int(o) for o in chosen), start]
        links = list(itertools.pairwise(stops))
        own = float(self._options.duration[stops[1:-1]].sum())
        for a, b in links:
            if own + sum(float(self.value[link]) for link in links) >= ceiling:
                break
            self.at(a, b)
        return own + sum(float(self.value[link]) for link in links)


def order_greedily(options: SweepOptions, costs: ConnectionCosts) -> SweepOrder | None:
    """Order sweeps by the shortest connection from the current end (Kaiser 2021, section 4.4); ties: lowest option.

    ``None`` if it ends where no connection leads on: then another order may still exist.
    """
    sweep_of = np.repeat(np.arange(len(options.name)), np.diff(options.first))
    open_options = np.ones(len(options.duration), bool)
    current = options.start
    chosen: list[int] = []
    while open_options.any():
        candidates = np.flatnonzero(open_options)
        best, least = -1, np.inf
        for option in candidates[np.argsort(costs.value[current, candidates], kind="stable")]:
            if costs.value[current, option] > least:
                break
            cost = costs.at(current, int(option))
            if cost < least or (cost == least < np.inf and option < best):
                best, least = int(option), cost
        if best < 0:
            return None
        chosen.append(best)
        open_options[options.first[sweep_of[best]] : options.first[sweep_of[best] + 1]] = False
        current = best
    order = np.array(chosen, np.int32)
    total = costs.total(chosen)
    bound = one_tree_bound(costs.value, options.duration, options.first, total) if np.isfinite(total) else -np.inf
    return SweepOrder(order, total, bound, proven=bound >= total - SAME) if np.isfinite(total) else None


def order_best(
    options: SweepOptions,
    costs: ConnectionCosts,
    known: SweepOrder | None,
    *,
    n_evaluations: int,
    exact_up_to: int = 15,
) -> SweepOrder | None:
    """Return the best order, exact for up to ``exact_up_to`` sweeps, never longer than the ``known`` one.

    Dynamic programming takes time and memory 2^sweeps: beyond that or `MOST_MEMORY`, local search with a lower
    bound. After ``n_evaluations`` connections the search stops with what it has and the bound it has proven.
    ``None`` if no order was found; up to ``exact_up_to`` sweeps and within the evaluations there is none then.
    """
    n_bytes = 2 * 8 * len(options.duration) << len(options.name)
    exactly = len(options.name) <= exact_up_to and n_bytes <= MOST_MEMORY
    start = (np.empty(0, np.int32), np.inf) if known is None else (known.options, known.duration)
    order = (_exact if exactly else _searched)(options, costs, start, n_evaluations)
    return order if np.isfinite(order.duration) else None


def _exact(
    options: SweepOptions, costs: ConnectionCosts, best: tuple[Int32Array, float], n_evaluations: int
) -> SweepOrder:
    """Solve on bounds, evaluate, solve again; drop options through which no order can be shorter any more."""
    budget = costs.n_evaluated + n_evaluations
    best = _local_search(options, costs, _sequence(options, best[0]), best, budget)
    kept = np.arange(len(options.duration))
    while True:
        first = np.searchsorted(kept, options.first).astype(np.int32)
        if np.any(np.diff(first) == 0):
            return SweepOrder(*best, best[1], proven=True)
        with_start = np.append(kept, options.start)
        problem = costs.value[np.ix_(with_start, with_start)], options.duration[kept], first
        totals, orders, states = held_karp(*problem, best[1] - SAME)
        bound = min(float(totals.min()), best[1])
        if bound >= best[1] - SAME or costs.n_evaluated > budget:
            return SweepOrder(*best, bound, proven=bound >= best[1] - SAME)
        through = cheapest_through(states, *problem)
        for row in np.argsort(totals, kind="stable"):
            if totals[row] < best[1] - SAME:
                best = _settled(options, costs, kept[orders[row]], best)
        # cheap, and finds most of what the next subset search would find on the new costs
        best = _local_search(options, costs, _sequence(options, kept[orders[int(np.argmin(totals))]]), best, budget)
        kept = kept[through < best[1] - SAME]


def _searched(
    options: SweepOptions, costs: ConnectionCosts, best: tuple[Int32Array, float], n_evaluations: int
) -> SweepOrder:
    budget = costs.n_evaluated + n_evaluations
    best = _local_search(options, costs, _sequence(options, best[0]), best, budget)
    if not np.isfinite(best[1]):
        return SweepOrder(*best, -np.inf, proven=False)
    bound = one_tree_bound(costs.value, options.duration, options.first, best[1])
    return SweepOrder(*best, bound, proven=bound >= best[1] - SAME)


def _local_search(
    options: SweepOptions, costs: ConnectionCosts, sequence: Int32Array, best: tuple[Int32Array, float], budget: int
) -> tuple[Int32Array, float]:
    """Improve a sequence of sweeps on what is known of the costs, evaluate it, and so on; return the best."""
    while costs.n_evaluated <= budget:
        best = _settled_sequence(options, costs, sequence, best)
        # a connection that does not exist is dear but finite, so that the search leads out of dead ends
        value = np.minimum(costs.value, MISSING)
        total, improved = improve_sequence(sequence, value, options.duration, options.first)
        if total >= best[1] - SAME or np.array_equal(improved, sequence):
            break
        sequence = improved
    return best


def _settled(
    options: SweepOptions, costs: ConnectionCosts, trial: Int32Array, best: tuple[Int32Array, float]
) -> tuple[Int32Array, float]:
    """Evaluate the sequence of ``trial`` with whichever options are best; return the better order and its duration."""
    return _settled_sequence(options, costs, _sequence(options, trial), best)


def _settled_sequence(
    options: SweepOptions, costs: ConnectionCosts, sequence: Int32Array, best: tuple[Int32Array, float]
) -> tuple[Int32Array, float]:
    while True:
        total, picked = best_options(sequence, costs.value, options.duration, options.first)
        if total >= best[1] - SAME:
            return best
        exact = costs.total(picked, best[1] - SAME)
        if exact <= total + SAME:
            return picked, exact


def _sequence(options: SweepOptions, chosen: Int32Array) -> Int32Array:
    """Return the sweeps of chosen options in order, of none chosen all sweeps as they come."""
    if len(chosen) == 0:
        return np.arange(len(options.name), dtype=np.int32)
    return (np.searchsorted(options.first, chosen, side="right") - 1).astype(np.int32)
