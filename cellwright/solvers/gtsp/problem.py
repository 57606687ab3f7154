"""What is to be sequenced: clusters of alternatives, the costs between them, and what an order has to respect.

The generalised travelling-salesman problem (Fischetti, Salazar and Toth 1997) with what robot tasks add to it: open or
closed sequences, a first and a last task, a cost of each alternative's own, and tasks that must come before others.
One alternative of every cluster is visited once. Costs are any unit: seconds, joules, or a sum of both.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.errors import InvalidInputError, listed

Stop = Callable[[], bool]
"""Asked between rounds of work; true ends the work early. A time limit is one: the library itself reads no clock."""


MOST_COST = 1e100
"""Greatest finite cost: sums and squares of smaller ones stay finite."""


@dataclass(frozen=True, eq=False)
class SequencingProblem:
    """Clusters of alternatives and the costs between them.

    Attributes:
        cost: Cost of going from the row's alternative to the column's, (alternatives, alternatives); infinite where
            there is no way. Entries inside one cluster are not looked at. Never edited.
        clusters: Alternatives of each cluster, as row numbers of ``cost``; each alternative belongs to one cluster.
        service: What executing the alternative costs by itself, (alternatives,); zeros if left out.
        closed: Whether the sequence returns to its first alternative.
        start: Cluster that comes first, or none.
        end: Cluster that comes last, or none. A closed sequence needs ``start`` for that.
        before: Pairs (i, j) of clusters: i somewhere before j. A closed sequence needs ``start`` for that.
        names: What to call each cluster; its number if left out.

    Raises:
        InvalidInputError: If a cost is negative or not a number, a cluster is empty, an alternative belongs to no or
            several clusters, or what must come before what contradicts itself.
    """

    cost: FloatArray
    clusters: tuple[Int32Array, ...]
    service: FloatArray = field(default_factory=lambda: np.empty(0))
    closed: bool = True
    start: int | None = None
    end: int | None = None
    before: tuple[tuple[int, int], ...] = ()
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        try:
            put("cost", _frozen(np.asarray(self.cost, np.float64)))
            put("clusters", tuple(_frozen(np.asarray(c, np.int32).reshape(-1)) for c in self.clusters))
            service = np.asarray(self.service, np.float64).reshape(-1)
            put("service", _frozen(service if len(service) else np.zeros(len(self.cost))))
            put("before", tuple((int(i), int(j)) for i, j in self.before))
        except (TypeError, ValueError) as error:
            raise InvalidInputError(f"the sequencing problem is not made of numbers: {error}") from error
        put("names", tuple(self.names) or tuple(f"cluster {i}" for i in range(len(self.clusters))))
        _check_shapes(self)
        _check_costs(self)
        _check_order(self)

    @property
    def n_clusters(self) -> int:
        """Clusters to visit."""
        return len(self.clusters)

    @property
    def n_alternatives(self) -> int:
        """Alternatives of all clusters together."""
        return len(self.service)

    @property
    def symmetric(self) -> bool:
        """Whether every way costs the same in both directions."""
        return bool(np.array_equal(self.cost, self.cost.T))

    def cluster_of(self) -> Int32Array:
        """Return the cluster of each alternative, (alternatives,)."""
        owner = np.empty(self.n_alternatives, np.int32)
        for i, own in enumerate(self.clusters):
            owner[own] = i
        return owner

    def legs(self, nodes: Sequence[int] | Int32Array) -> list[tuple[int, int]]:
        """Return the ways that a sequence of alternatives takes, with the way back if it is closed."""
        stops = [int(v) for v in nodes]
        legs = list(itertools.pairwise(stops))
        return [*legs, (stops[-1], stops[0])] if self.closed and len(stops) > 1 else legs

    def cost_of(self, nodes: Sequence[int] | Int32Array) -> float:
        """Return what a sequence of alternatives costs, ways and services."""
        own = math.fsum(float(self.service[int(v)]) for v in nodes)
        return own + math.fsum(float(self.cost[a, b]) for a, b in self.legs(nodes))

    def violation(self, nodes: Sequence[int] | Int32Array) -> str | None:
        """Return what a sequence does not respect, in words, or none if it respects everything."""
        owner = self.cluster_of()
        order = [int(owner[int(v)]) for v in nodes]
        if sorted(order) != list(range(self.n_clusters)):
            return f"it visits {len(set(order))} of {self.n_clusters} clusters in {len(order)} stops"
        place = {cluster: k for k, cluster in enumerate(order)}
        if self.start is not None and order[0] != self.start:
            return f"it starts with {self.names[order[0]]}, not {self.names[self.start]}"
        if self.end is not None and order[-1] != self.end:
            return f"it ends with {self.names[order[-1]]}, not {self.names[self.end]}"
        late = [f"{self.names[i]} after {self.names[j]}" for i, j in self.before if place[i] > place[j]]
        return f"it has {listed(late)}" if late else None


@dataclass(frozen=True, eq=False)
class SequencingResult:
    """The best sequence found, and what is proven of it.

    Attributes:
        nodes: Alternatives in the order of execution, (clusters,).
        clusters: Their clusters, (clusters,).
        cost: What it costs, ways and services.
        lower_bound: No sequence costs less.
        proven: Whether it is a cheapest one: cost and bound agree.
        stopped_by: ``proof``, ``work``, ``memory`` or ``stop``.
        n_rounds: Rounds of search in each chain.
        n_states: States of dynamic programming.
    """

    nodes: Int32Array
    clusters: Int32Array
    cost: float
    lower_bound: float
    proven: bool
    stopped_by: str
    n_rounds: int = 0
    n_states: int = 0

    @property
    def gap(self) -> float:
        """Share of the cost by which the bound stays below it; 0 if proven."""
        return max(0.0, (self.cost - self.lower_bound) / self.cost) if self.cost > 0 else 0.0


def ancestors(problem: SequencingProblem) -> BoolArray:
    """Return which cluster (row) must come before which (column), all consequences included, (clusters, clusters)."""
    n = problem.n_clusters
    earlier = np.zeros((n, n), bool)
    for i, j in problem.before:
        earlier[i, j] = True
    others = np.arange(n)
    if problem.start is not None:
        earlier[problem.start, others != problem.start] = True
    if problem.end is not None:
        earlier[others != problem.end, problem.end] = True
    for k in range(n):
        earlier |= earlier[:, k, None] & earlier[None, k, :]
    return earlier


def _frozen(array: FloatArray | Int32Array) -> FloatArray | Int32Array:
    array = array.view()
    array.flags.writeable = False
    return array


def _check_shapes(problem: SequencingProblem) -> None:
    shape = problem.cost.shape
    if len(shape) != 2 or shape[0] != shape[1]:
        raise InvalidInputError(f"cost has shape {shape}: give a square matrix, alternatives by alternatives")
    m, n = shape[0], len(problem.clusters)
    if not n:
        raise InvalidInputError("there are no clusters: give at least one task with an alternative")
    if len(problem.names) != n:
        raise InvalidInputError(f"{len(problem.names)} names for {n} clusters: give one each or none")
    empty = [name for name, own in zip(problem.names, problem.clusters) if not len(own)]
    if empty:
        raise InvalidInputError(f"without alternatives: {listed(empty)}: give each one at least one, or leave it out")
    every = np.concatenate(problem.clusters)
    outside = every[(every < 0) | (every >= m)]
    if len(outside):
        raise InvalidInputError(f"clusters name alternative {outside[0]}, but cost has rows 0 to {m - 1}")
    times = np.bincount(every, minlength=m)
    wrong = np.flatnonzero(times != 1)
    if len(wrong):
        text = "in no cluster" if times[wrong[0]] == 0 else f"in clusters {times[wrong[0]]} times"
        raise InvalidInputError(
            f"alternative {wrong[0]} is {text} ({len(wrong)} such alternatives): put each into exactly one, or leave "
            "its row and column out of cost"
        )
    if len(problem.service) != m:
        raise InvalidInputError(f"service has {len(problem.service)} entries for {m} alternatives: give one each")


def _check_costs(problem: SequencingProblem) -> None:
    owner = problem.cluster_of()
    between = owner[:, None] != owner[None, :]
    for wrong, what, mend in (
        (np.isnan(problem.cost), "not a number", "give infinity where there is no way"),
        (problem.cost < 0, "negative", "shift all costs up by the same amount"),
    ):
        rows, columns = np.nonzero(wrong & between)
        if len(rows):
            a, b = int(rows[0]), int(columns[0])
            raise InvalidInputError(
                f"cost from alternative {a} ({problem.names[owner[a]]}) to {b} ({problem.names[owner[b]]}) is "
                f"{problem.cost[a, b]}, {what} ({len(rows)} such entries): {mend}"
            )
    large = np.argwhere(np.isfinite(problem.cost) & (problem.cost > MOST_COST) & between)
    if len(large):
        a, b = large[0].tolist()
        raise InvalidInputError(
            f"cost from alternative {a} ({problem.names[owner[a]]}) to {b} ({problem.names[owner[b]]}) is "
            f"{problem.cost[a, b]:g}, above {MOST_COST:g}: sums of such costs lose their digits; give costs in a "
            "larger unit, or infinity where there is no way"
        )
    bad = np.flatnonzero(~np.isfinite(problem.service) | (problem.service < 0) | (problem.service > MOST_COST))
    if len(bad):
        raise InvalidInputError(
            f"service cost of alternative {bad[0]} ({problem.names[owner[bad[0]]]}) is {problem.service[bad[0]]} "
            f"({len(bad)} such entries): give costs of at least 0 and at most {MOST_COST:g}, and "
            "leave impossible alternatives out"
        )


def _check_round_trip(problem: SequencingProblem) -> None:
    """Refuse what speaks of first and last where a sequence goes round and round."""
    if not problem.closed or problem.start is not None or problem.n_clusters < 2:
        return
    if problem.end is not None:
        raise InvalidInputError(
            f"{problem.names[problem.end]} is the end of a closed sequence without start, which goes round and round "
            "and ends nowhere: give start too, or closed=False to end there, or leave end out"
        )
    if problem.before:
        i, j = problem.before[0]
        more = f" ({len(problem.before)} such pairs)" if len(problem.before) > 1 else ""
        raise InvalidInputError(
            f"before asks for {problem.names[i]} before {problem.names[j]}{more}, but a closed sequence without start "
            "goes round and round, and each comes before the other: give start, the cluster from which to count, or "
            "closed=False"
        )


def _check_order(problem: SequencingProblem) -> None:
    n = problem.n_clusters
    for what, value in (("start", problem.start), ("end", problem.end)):
        if value is not None and not 0 <= value < n:
            raise InvalidInputError(f"{what} is cluster {value}, but there are clusters 0 to {n - 1}")
    if problem.start is not None and problem.start == problem.end and n > 1:
        raise InvalidInputError(
            f"{problem.names[problem.start]} is both start and end: set closed and leave end out to return to it"
        )
    for i, j in problem.before:
        if not (0 <= i < n and 0 <= j < n):
            raise InvalidInputError(f"before has the pair ({i}, {j}), but there are clusters 0 to {n - 1}")
    _check_round_trip(problem)
    loop = _first_loop(problem)
    if loop:
        raise InvalidInputError(
            f"what must come before what contradicts itself: {' before '.join(loop)}: drop one of these"
        )


def _first_loop(problem: SequencingProblem) -> list[str]:
    """Return the names along a shortest contradiction, first and last the same; empty if there is none."""
    n = problem.n_clusters
    onward: list[list[int]] = [[] for _ in range(n)]
    for i, j in problem.before:
        onward[i].append(j)
    if problem.start is not None:
        onward[problem.start] += [j for j in range(n) if j != problem.start]
    if problem.end is not None:
        for i in range(n):
            if i != problem.end:
                onward[i].append(problem.end)
    shortest: list[int] = []
    for i in sorted({i for i, _ in problem.before}):
        came, layer = {}, [i]
        while layer and i not in came:
            following = []
            for a in layer:
                for b in onward[a]:
                    if b not in came:
                        came[b] = a
                        following.append(b)
            layer = following
        if i in came:
            loop = [i, came[i]]
            while loop[-1] != i:
                loop.append(came[loop[-1]])
            if not shortest or len(loop) < len(shortest):
                shortest = loop[::-1]
    return [problem.names[i] for i in shortest]
