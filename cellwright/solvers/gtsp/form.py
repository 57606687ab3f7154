"""One form for all sequencing problems: a closed tour that begins at a depot cluster.

An open sequence becomes a tour through a depot without cost; a fixed first cluster becomes the depot; a fixed last one
comes after all others. Service costs go half onto the ways in and half onto the ways out, which keeps symmetric
problems symmetric. So the solvers know one problem only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.errors import InfeasibleError, listed
from cellwright.solvers.gtsp.problem import SequencingProblem, SequencingResult, ancestors

SAME = 1e-9
"""Share of a cost below which differences are rounding."""
EXACT = 1e-12
"""The same where costs are whole numbers: bounds are sums of thousands of numbers, each rounded in its 16th digit."""
MOST_EXACT = 2.0**38
"""Whole-number costs of a sequence that surely stay below this are told apart: `EXACT` of it is well below 1."""


@dataclass(frozen=True, eq=False)
class TourForm:
    """A closed tour over clusters, the depot being cluster 0; nodes are numbered cluster by cluster.

    Attributes:
        cost: Cost from row to column with half of either's service, (nodes, nodes); ``missing`` where there is no way.
        first: First node of each cluster, and their number, (clusters + 1,).
        earlier: Whether the row's cluster must come before the column's, depot left out, (clusters, clusters).
        node: The problem's alternative, -1 for a depot that stands for nothing, (nodes,).
        missing: A tour that costs this much or more takes a way that does not exist.
        integral: Whether all costs are whole numbers, small enough to be told apart, so that bounds may be rounded up.
    """

    cost: FloatArray
    first: Int32Array
    earlier: BoolArray
    node: Int32Array
    missing: float
    integral: bool

    @property
    def n_clusters(self) -> int:
        """Clusters, with the depot."""
        return len(self.first) - 1

    def tour_cost(self, tour: Int32Array) -> float:
        """Return the cost of a tour of nodes."""
        return float(self.cost[tour, np.roll(tour, -1)].sum())

    def least_bound(self) -> float:
        """Return a bound at no cost: every cluster is entered once, and left once, for the least that this can cost."""
        into = np.minimum.reduceat(self.cost.min(axis=0), self.first[:-1]).sum()
        out_of = np.minimum.reduceat(self.cost.min(axis=1), self.first[:-1]).sum()
        return float(max(into, out_of))

    def below(self, upper: float) -> float:
        """Return the value that a bound must reach to prove that nothing is cheaper than ``upper``."""
        return upper - 1.0 + max(1e-6, EXACT * upper) if self.integral else upper * (1.0 - SAME)


def tour_form(problem: SequencingProblem) -> TourForm:
    """Bring a problem of at least two clusters into the one form.

    Raises:
        InfeasibleError: If no way leads into or out of some cluster.
    """
    n = problem.n_clusters
    depot = problem.start
    if depot is None and problem.closed:
        depot = int(np.argmin([len(own) for own in problem.clusters]))
    order = [i for i in range(n) if i != depot]
    order = order if depot is None else [depot, *order]
    node = np.concatenate([problem.clusters[i] for i in order]).astype(np.int32)
    sizes = [len(problem.clusters[i]) for i in order]
    half = 0.5 * problem.service[node]
    cost = problem.cost[np.ix_(node, node)] + half[:, None] + half[None, :]
    if depot is None:
        cost = np.pad(cost, ((1, 0), (1, 0)))
        cost[0, 1:], cost[1:, 0] = half, half
        node, sizes, order = np.concatenate([[-1], node]).astype(np.int32), [1, *sizes], [-1, *order]
    elif not problem.closed:
        cost[:, : sizes[0]] = np.concatenate([np.zeros(sizes[0]), half[sizes[0] :]])[:, None] + half[None, : sizes[0]]
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    owner = np.repeat(np.arange(len(sizes)), sizes)
    between = owner[:, None] != owner[None, :]
    finite = np.isfinite(cost) & between
    _check_reachable(problem, finite, first, order)
    missing = 1.0 + len(sizes) * float(cost[finite].max(initial=0.0))
    cost = np.where(finite, cost, missing)
    numbers = (problem.cost[problem.cost < np.inf], problem.service)
    greatest = n * math.fsum(float(x.max(initial=0.0)) for x in numbers)
    integral = all(bool(np.all(x == np.floor(x))) for x in numbers) and greatest < MOST_EXACT
    return TourForm(cost, first, _earlier(problem, order), node, missing, integral)


def result_of(
    problem: SequencingProblem, form: TourForm, tour: Int32Array, bound: float, stopped_by: str, n_rounds: int = 0,
    n_states: int = 0,
) -> SequencingResult:  # fmt: skip
    """Bring a tour back into the problem's own terms.

    Raises:
        InfeasibleError: If the tour takes a way that does not exist.
    """
    nodes = form.node[tour]
    if nodes[0] < 0:
        nodes = nodes[1:]
    owner = problem.cluster_of()
    if problem.closed and problem.start is None:
        nodes = np.roll(nodes, -int(np.flatnonzero(owner[nodes] == 0)[0]))
    cost = problem.cost_of(nodes)
    if not np.isfinite(cost):
        gone = [f"{problem.names[owner[a]]} to {problem.names[owner[b]]}" for a, b in problem.legs(nodes)
                if not np.isfinite(problem.cost[a, b])]  # fmt: skip
        proof = "there is no sequence without" if bound >= form.missing else "no sequence was found without"
        raise InfeasibleError(f"{proof} a missing way; the best one lacks {listed(gone)}: add alternatives or ways")
    proven = bound >= form.below(cost)
    if form.integral and np.isfinite(bound):  # no sequence costs a fraction
        bound = float(math.ceil(bound - max(1e-6, EXACT * abs(bound))))
    return SequencingResult(
        nodes=np.asarray(nodes, np.int32),
        clusters=owner[nodes],
        cost=cost,
        lower_bound=cost if proven else max(0.0, min(bound, cost)),
        proven=proven,
        stopped_by="proof" if proven else stopped_by,
        n_rounds=n_rounds,
        n_states=n_states,
    )


def only_cluster(problem: SequencingProblem) -> SequencingResult:
    """Return the result of a problem of one cluster: its cheapest alternative, nothing to travel."""
    own = problem.clusters[0]
    best = int(own[int(np.argmin(problem.service[own]))])
    cost = float(problem.service[best])
    return SequencingResult(np.array([best], np.int32), np.zeros(1, np.int32), cost, cost, True, "proof")


def _earlier(problem: SequencingProblem, order: list[int]) -> BoolArray:
    closure = ancestors(problem)
    earlier = np.zeros((len(order), len(order)), bool)
    earlier[1:, 1:] = closure[np.ix_(order[1:], order[1:])]
    return earlier


def _check_reachable(problem: SequencingProblem, finite: BoolArray, first: Int32Array, order: list[int]) -> None:
    for axis, way in ((0, "into"), (1, "out of")):
        usable = np.add.reduceat(finite.any(axis=axis).astype(int), first[:-1])
        stuck = [problem.names[order[i]] for i in np.flatnonzero(usable == 0) if order[i] >= 0]
        if stuck:
            raise InfeasibleError(f"no way leads {way} {listed(stuck)}: all costs there are infinite; add alternatives")
