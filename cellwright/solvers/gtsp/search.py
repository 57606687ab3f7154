"""Search for a cheap sequence: several annealed large-neighbourhood searches that hand the best tour on to each other.

Each chain anneals in cycles that double in length, so that any moment is a good one to stop; a new cycle starts from
the best tour of all chains after a double bridge (Martin, Otto and Felten 1991) and local search, or from the chain's
own. Everything is a function of the generator and the number of rounds; threads and clock change nothing, but that
``stop`` may end it early.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import AnyArray, FloatArray, Int32Array
from cellwright.errors import InvalidInputError
from cellwright.solvers.gtsp.anneal import N_INSERTIONS, N_REMOVALS, anneal, nearest_nodes
from cellwright.solvers.gtsp.form import TourForm
from cellwright.solvers.gtsp.kernels import improve_tour
from cellwright.solvers.gtsp.problem import Stop
from cellwright.threads import n_usable_cores

FIRST_CYCLE = 2_000
"""Rounds of the first annealing cycle; each further one is twice as long, up to `LONGEST_CYCLE`."""
LONGEST_CYCLE = 128_000
SLICE = 2_000
"""Rounds between two questions to ``stop``."""
HOT, COLD = 8.0, 0.005
"""Temperatures of a cycle in units of the mean cost of a way in the best tour. From 1 and 0.01,
tasks whose alternatives lie near each other or anywhere ended about 2 % dearer after ten seconds (`hundred` of
``benchmarks.sequencing``); the first cycle alone, 2,000 rounds, gains on some problems and loses as much on others."""
PROMISING = 1.05
"""A round's tour within this factor of the current one gets the best alternatives for its order."""
MOST_OUT, SHARE_OUT = (20, 40), 0.35
"""Clusters that a round takes out: at most so many, chain by chain in turn, and this share of all. Few suit tasks whose
alternatives lie together, many those whose alternatives lie anywhere."""


@dataclass(eq=False)
class _Chain:
    current: Int32Array
    best: Int32Array
    cost: float
    weight: FloatArray
    most_out: int
    state: AnyArray


@dataclass(frozen=True, eq=False)
class FoundTour:
    """A tour of nodes in a `TourForm` and how the search for it ended."""

    tour: Int32Array
    cost: float
    n_rounds: int
    stopped: bool


class TourSearch:
    """A search that can go on: `run` does some more rounds. The arrays it prepares are kept between runs.

    Args:
        form: The problem.
        rng: Where the chains get their seeds from.
        known: Tours to start from; random insertion if left out.
        n_chains: Searches side by side; the result depends on it, unlike on the number of threads.
    """

    def __init__(
        self, form: TourForm, rng: np.random.Generator, known: tuple[Int32Array, ...] = (), *, n_chains: int = 2
    ) -> None:
        if n_chains < 1:
            raise InvalidInputError(f"n_chains is {n_chains}: give at least 1")
        self.form = form
        self.n_rounds = 0
        n = form.n_clusters
        self._owner = np.repeat(np.arange(n, dtype=np.int32), np.diff(form.first))
        self._back = np.ascontiguousarray(form.cost.T)
        self._into, self._out_of = nearest_nodes(form.cost, form.first)
        self._neighbour = _neighbours(self._into, form.first)
        self._least = 1e-10 * form.missing / n
        self._rng = rng
        self._cycle = FIRST_CYCLE
        self._left = 0
        self._heat = 0.0, 0.0
        self._chains: list[_Chain] = []
        for number in range(n_chains):
            tour = known[number].copy() if number < len(known) else _in_order(form)
            tour = np.ascontiguousarray(tour, np.int32)
            cost = self._improve(tour)
            state = np.array([rng.integers(2**63)], np.uint64)
            weight = np.ones((N_REMOVALS, N_INSERTIONS))
            self._chains.append(_Chain(tour.copy(), tour, cost, weight, MOST_OUT[number % len(MOST_OUT)], state))

    def best(self) -> tuple[Int32Array, float]:
        """Return the best tour so far and its cost; of equal ones that of the lowest chain."""
        chain = min(self._chains, key=lambda c: c.cost)
        return chain.best, chain.cost

    def take(self, tour: Int32Array) -> None:
        """Go on from a tour found elsewhere: it replaces the worst chain's."""
        worst = max(self._chains, key=lambda chain: chain.cost)
        given = np.ascontiguousarray(tour, np.int32).copy()
        cost = self._improve(given)
        if cost < worst.cost:
            worst.current, worst.best, worst.cost = given.copy(), given, cost

    def run(self, n_rounds: int, stop: Stop | None = None, *, target: float = -np.inf, n_threads: int | None = None
            ) -> FoundTour:  # fmt: skip
        """Do ``n_rounds`` more rounds in each chain; end early when ``stop`` says so or ``target`` is reached."""
        if self.form.n_clusters == 2:  # nothing to order, and local search has found the nodes
            return FoundTour(*self.best(), self.n_rounds, stopped=False)
        done, stopped = 0, False
        wanted = n_usable_cores() if n_threads is None else n_threads
        with ThreadPoolExecutor(max(1, min(wanted, len(self._chains)))) as pool:
            while done < n_rounds and self.best()[1] > target:
                if stop is not None and stop():
                    stopped = True
                    break
                if not self._left:
                    self._begin_cycle()
                part = min(SLICE, n_rounds - done, self._left)
                list(pool.map(lambda chain, part=part: self._anneal(chain, part), self._chains))
                done, self._left = done + part, self._left - part
                self.n_rounds += part
        return FoundTour(*self.best(), self.n_rounds, stopped)

    def _begin_cycle(self) -> None:
        tour, cost = self.best()
        tour = tour.copy()
        if self.n_rounds or any(chain.cost > cost for chain in self._chains):
            # the worst chain goes on from the best tour, kicked; the others from their own
            worst = max(self._chains, key=lambda c: c.cost)
            if len(self._chains) > 1:
                worst.current[:] = _double_bridge(tour, self._owner, self.form, self._rng)
                total = self._improve(worst.current)
                if total < worst.cost:
                    worst.best[:], worst.cost = worst.current, total
        mean = max(cost / self.form.n_clusters, 1e-12)
        self._heat = HOT * mean, COLD * mean
        self._left = self._cycle
        self._length = self._cycle
        self._cycle = min(2 * self._cycle, LONGEST_CYCLE)

    def _anneal(self, chain: _Chain, n_rounds: int) -> None:
        hot, cold = self._heat
        begun, ended = (1.0 - self._left / self._length), (1.0 - (self._left - n_rounds) / self._length)
        span = cold / hot
        n = self.form.n_clusters
        chain.cost = anneal(
            chain.current, chain.best, self._owner, self.form.cost, self._back, self.form.first, self.form.earlier,
            self._neighbour, self._into, self._out_of, chain.weight, hot * span**begun, hot * span**ended,
            max(1, min(chain.most_out, n - 1, round(SHARE_OUT * n))), PROMISING, n_rounds, self._least, chain.state,
        )  # fmt: skip

    def _improve(self, tour: Int32Array) -> float:
        form = self.form
        return float(improve_tour(tour, self._owner, form.cost, form.first, form.earlier, self._least))


def _in_order(form: TourForm) -> Int32Array:
    """Return a tour that respects what comes before what: of the clusters that may come next the lowest-numbered."""
    left = list(range(1, form.n_clusters))
    order = [0]
    while left:
        ready = next(j for j in left if not form.earlier[left, j].any())
        left.remove(ready)
        order.append(ready)
    return form.first[order].astype(np.int32)


def _neighbours(into: FloatArray, first: Int32Array) -> Int32Array:
    """Return the other clusters but the depot, the closest first, (clusters, clusters - 2)."""
    n = len(first) - 1
    apart = np.minimum.reduceat(into, first[:-1], axis=1).T  # (clusters, clusters), row to column
    apart = np.minimum(apart, apart.T)
    np.fill_diagonal(apart, np.inf)
    neighbour = np.zeros((n, max(0, n - 2)), np.int32)
    for i in range(1, n):
        ranked = np.argsort(apart[i], kind="stable")
        neighbour[i] = ranked[(ranked != i) & (ranked != 0)]
    return neighbour


def _double_bridge(tour: Int32Array, owner: Int32Array, form: TourForm, rng: np.random.Generator) -> Int32Array:
    """Exchange two neighbouring segments; the tour unchanged if nothing of the sort respects what comes before what."""
    n = len(tour)
    if n < 4:
        return tour
    for _ in range(20):
        i, j, k = np.sort(rng.choice(np.arange(1, n + 1), 3, replace=False))
        if not form.earlier[np.ix_(owner[tour[i:j]], owner[tour[j:k]])].any():
            return np.concatenate([tour[:i], tour[j:k], tour[i:j], tour[k:]])
    return tour
