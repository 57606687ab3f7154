"""Lower bounds on any sequence: the walk relaxation with Lagrange multipliers, tightened where walks repeat clusters.

Subgradient steps raise the price of clusters that the cheapest walk leaves out and lower that of those it repeats.
Memories begin empty, where a step costs little, and grow in stages to the nearest clusters, between which short cycles
run. Nodes, places and ways through which no walk stays below a known sequence are dropped for good, so the problem
shrinks while the bound rises: the dear last stages work on a small rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array, IntArray
from cellwright.solvers.gtsp.form import TourForm
from cellwright.solvers.gtsp.problem import Stop
from cellwright.solvers.gtsp.walks import (
    cheapest_walk,
    complete_walks,
    drop_ways,
    least_within,
    memory_steps,
    through_nodes,
)

MOST_BYTES = 300 << 20
"""Memory that one table of rests may take."""


@dataclass(eq=False)
class Bounding:
    """The walk relaxation of the tours through one depot node, and how far its bound has come.

    Attributes:
        cost: Between the nodes that are left, infinite where dropped, (nodes, nodes).
        begin: From the depot, (nodes,).
        end: To the depot, (nodes,).
        first: First node of each cluster and their number, depot left out.
        node: The form's node of each, (nodes,).
        usable: Whether a node may stand at a place, (N + 1, nodes).
        earlier: What must come before what, (N, N).
        multiplier: Price of each cluster at the best bound.
        memory: Neighbours that each cluster remembers, in the order of their bits.
        bound: Best bound so far.
        walk: Cluster at each place of the cheapest walk at the best bound, (places,).
        n_rounds: Times that memories have grown.
        tour: Tour of the form that the relaxation itself has found, if it has; then it is a cheapest one.
        work: Sums and comparisons so far.
    """

    cost: FloatArray
    begin: FloatArray
    end: FloatArray
    first: Int32Array
    node: Int32Array
    usable: BoolArray
    earlier: BoolArray
    multiplier: FloatArray
    memory: list[list[int]]
    bound: float = -np.inf
    walk: Int32Array = field(default_factory=lambda: np.zeros(0, np.int32))
    n_rounds: int = 0
    tour: Int32Array | None = None
    work: float = 0.0

    @property
    def n_clusters(self) -> int:
        """Clusters besides the depot."""
        return len(self.first) - 1

    @property
    def n_masks(self) -> int:
        """States that a memory can have."""
        return 1 << max(len(bits) for bits in self.memory)

    def owner(self) -> Int32Array:
        """Return the cluster of each node."""
        return np.repeat(np.arange(self.n_clusters, dtype=np.int32), np.diff(self.first))


def bounding(form: TourForm, depots: Int32Array, multiplier: FloatArray | None = None) -> Bounding:
    """Return the relaxation of tours through any of the ``depots``: with several, from any one back to any one."""
    k = int(form.first[1])
    cost = form.cost[k:, k:].copy()
    cost[cost >= form.missing] = np.inf
    begin = form.cost[np.ix_(depots, np.arange(k, len(form.cost)))].min(axis=0)
    end = form.cost[np.ix_(np.arange(k, len(form.cost)), depots)].min(axis=1)
    begin[begin >= form.missing], end[end >= form.missing] = np.inf, np.inf
    n = form.n_clusters - 1
    earlier = form.earlier[1:, 1:]
    place = np.arange(n + 1)[:, None]
    usable = (place > earlier.sum(axis=0)) & (place <= n - earlier.sum(axis=1))  # (places, clusters)
    first = (form.first[1:] - k).astype(np.int32)
    return Bounding(
        cost=cost, begin=begin, end=end, first=first, node=np.arange(k, len(form.cost), dtype=np.int32),
        usable=np.repeat(usable, np.diff(first), axis=1), earlier=earlier,
        multiplier=np.zeros(n) if multiplier is None else multiplier.copy(), memory=[[] for _ in range(n)],
    )  # fmt: skip


def through_depot(form: TourForm, joint: Bounding, depot: int) -> Bounding:
    """Return the relaxation of tours through one of several depot nodes, from what the joint one has dropped."""
    begin, end = form.cost[depot, joint.node], form.cost[joint.node, depot]
    return replace(
        joint,
        cost=joint.cost.copy(),
        begin=np.where((begin < form.missing) & np.isfinite(joint.begin), begin, np.inf),
        end=np.where((end < form.missing) & np.isfinite(joint.end), end, np.inf),
        usable=joint.usable.copy(),
        memory=[list(bits) for bits in joint.memory],
        tour=None,
        work=0.0,
    )


class Walks:
    """The tables of one relaxation at its present size and memories; a new one is made when these change."""

    def __init__(self, problem: Bounding) -> None:
        self.problem = problem
        self.owner = problem.owner()
        some_way = np.maximum.reduceat(np.isfinite(problem.cost), problem.first[:-1], axis=0)
        some_way = np.maximum.reduceat(some_way, problem.first[:-1], axis=1)
        self.follows = np.ascontiguousarray(_follows(problem.earlier) & some_way)
        n = problem.n_clusters
        n_masks = problem.n_masks
        self.local, self.n_bits = np.full((n, n), -1, np.int32), np.zeros(n, np.int32)
        for i, bits in enumerate(problem.memory):
            self.local[i, bits] = np.arange(len(bits))
            self.n_bits[i] = len(bits)
        self.step = memory_steps(self.local, self.n_bits)
        self.onto = np.ascontiguousarray(problem.cost.T)
        self.rest = np.empty((n + 1, n_masks, len(problem.node)))
        self.work = float(n) * len(problem.node) ** 2 * float(np.mean(1 << self.n_bits))

    def solve(self, multiplier: FloatArray) -> tuple[float, Int32Array]:
        """Return the bound at these prices and the nodes of the cheapest walk; infinite if there is no walk."""
        p = self.problem
        complete_walks(self.onto, p.end, p.first, multiplier, p.usable, self.follows, self.step, self.rest)
        walk = np.zeros(p.n_clusters, np.int32)
        least = cheapest_walk(p.cost, p.begin, p.first, self.owner, multiplier, self.follows, self.step,
                              self.rest, walk)  # fmt: skip
        p.work += self.work
        return float(least + multiplier.sum()), walk

    def ahead(self, multiplier: FloatArray) -> FloatArray:
        """Return the rests of the reversed problem: what it costs from the depot to a node."""
        p = self.problem
        table = np.empty_like(self.rest)
        usable = np.concatenate([p.usable[:1], p.usable[:0:-1]])
        complete_walks(p.cost, p.begin, p.first, multiplier, usable, np.ascontiguousarray(self.follows.T), self.step,
                       table)  # fmt: skip
        p.work += self.work
        return table


def raise_bound(
    problem: Bounding,
    upper: float,
    ceiling: float,
    n_steps: int,
    stop: Stop | None = None,
    *,
    length: float = 1.0,
    patience: int = 6,
) -> None:
    """Take subgradient steps; keep the best prices, the bound and the walk there.

    Args:
        problem: Edited: multiplier, bound, walk, tour, work.
        upper: Cost of a known sequence, which scales the steps.
        ceiling: A bound this high proves that sequence.
        n_steps: Steps at most.
        stop: Asked before each step.
        length: Share of the gap that the first step would close if the bound were linear.
        patience: Steps without a better bound after which they get shorter.
    """
    walks = Walks(problem)
    multiplier = problem.multiplier.copy()
    since = 0
    direction = np.zeros(problem.n_clusters)
    best = -np.inf  # of walks alone: dynamic programming may have brought the bound higher than they reach
    for number in range(n_steps):
        if number and stop is not None and stop():
            break
        bound, walk = walks.solve(multiplier)
        if bound > best:
            gained = bound - best > 1e-4 * max(upper - bound, 0.0)
            best, since = bound, 0 if gained else since + 1
            problem.multiplier, problem.walk = multiplier.copy(), walks.owner[walk]
            problem.bound = max(problem.bound, bound)
        else:
            since += 1
        if problem.bound >= ceiling or not np.isfinite(bound):
            break
        lacking = 1.0 - np.bincount(walks.owner[walk], minlength=problem.n_clusters)
        if not lacking.any():
            problem.tour = problem.node[walk]
            break
        if since >= patience:
            length, since = 0.6 * length, 0
            multiplier, direction = problem.multiplier.copy(), np.zeros(problem.n_clusters)
            if length < 0.01:
                break
            continue
        direction = lacking + 0.6 * direction
        multiplier = multiplier + length * max(upper - bound, 1e-9 * upper) / float(direction @ direction) * direction


def remember_nearest(problem: Bounding, n_bits: int) -> None:
    """Let each cluster remember the ``n_bits`` to which it is cheapest to go and come back: short cycles go there."""
    apart = np.minimum.reduceat(problem.cost, problem.first[:-1], axis=0)
    apart = np.minimum.reduceat(apart, problem.first[:-1], axis=1)
    there_and_back = apart + apart.T
    np.fill_diagonal(there_and_back, np.inf)
    ranked = np.argsort(there_and_back, axis=1, kind="stable")
    for i, memory in enumerate(problem.memory):
        near = (int(j) for j in ranked[i] if np.isfinite(there_and_back[i, j]))
        memory += [j for j in near if j not in memory][: max(0, _room(problem, n_bits) - len(memory))]


def remember_cycles(problem: Bounding, n_bits: int) -> bool:
    """Let clusters remember what the best walk comes back to across them, ``n_bits`` each at most; tell if any can.

    Such a walk is impossible then, and the bound can rise (Roberti and Mingozzi 2014, dynamic ng-path relaxation).
    """
    room = _room(problem, n_bits)
    last: dict[int, int] = {}
    order = problem.walk.tolist()
    learnt = False
    for place, cluster in enumerate(order):
        for between in order[last.get(cluster, place) + 1 : place]:
            memory = problem.memory[between]
            if between != cluster and cluster not in memory and len(memory) < room:
                memory.append(cluster)
                learnt = True
        last[cluster] = place
    return learnt


def _room(problem: Bounding, n_bits: int) -> int:
    """Return how many of ``n_bits`` a cluster may remember, so that a table of rests takes `MOST_BYTES` at most."""
    states = 8.0 * (problem.n_clusters + 1) * len(problem.node)
    return min(n_bits, int(np.log2(max(1.0, MOST_BYTES / states))))


def shrink(problem: Bounding, ceiling: float) -> bool:
    """Drop nodes, places and ways through which no walk stays below ``ceiling``; return whether some walk is left."""
    walks = Walks(problem)
    bound, _ = walks.solve(problem.multiplier)
    if bound >= ceiling:
        problem.bound = max(problem.bound, bound)
        return False
    ahead, rest = walks.ahead(problem.multiplier), walks.rest
    left = ceiling - float(problem.multiplier.sum())
    least_ahead, least_rest = ahead.min(axis=1), rest.min(axis=1)
    drop_ways(problem.cost, least_ahead, least_rest, problem.multiplier[walks.owner], left)
    least_within(rest)
    through = through_nodes(ahead, rest, problem.multiplier, walks.owner)
    problem.usable = problem.usable & (through < left)
    keep = problem.usable[1:].any(axis=0)
    counts = np.bincount(walks.owner[keep], minlength=problem.n_clusters)
    if not counts.all():
        problem.bound = max(problem.bound, ceiling)
        return False
    problem.cost = np.ascontiguousarray(problem.cost[np.ix_(keep, keep)])
    problem.begin, problem.end, problem.node = problem.begin[keep], problem.end[keep], problem.node[keep]
    problem.usable = np.ascontiguousarray(problem.usable[:, keep])
    problem.first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    return True


def subset_needs(problem: Bounding) -> IntArray:
    """Return as bits which clusters must have been visited before each."""
    bits = np.int64(1) << np.arange(problem.n_clusters, dtype=np.int64)
    return np.array([int(bits[column].sum()) for column in problem.earlier.T], np.int64)


def _follows(earlier: BoolArray) -> BoolArray:
    """Return whether the column's cluster may come right after the row's: not before it, and nothing between them."""
    between = (earlier.astype(np.int64) @ earlier.astype(np.int64)) > 0
    return np.ascontiguousarray(~(earlier.T | between))
