"""Cheapest sequences with proof: dynamic programming over subsets, bounded so that few states are ever made.

Bjorkenstam 2014, section 2.1, fills the whole table of Held and Karp (1962): 2^(M-1) subsets times alternatives. Here
a state is kept only if the walk relaxation (`cellwright.solvers.gtsp.bounds`) cannot show that every sequence through
it costs as much as a known one. The number of states is limited, so memory is: where they do not fit, the bound is
tightened and the programme tried again, and when that does not help either, the best sequence and the bound are
returned, unproven.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.solvers.gtsp.bounds import (
    Bounding,
    Walks,
    bounding,
    raise_bound,
    remember_cycles,
    remember_nearest,
    shrink,
    subset_needs,
    through_depot,
)
from cellwright.solvers.gtsp.form import TourForm
from cellwright.solvers.gtsp.problem import Stop
from cellwright.solvers.gtsp.states import BYTES_A_STATE, next_layer
from cellwright.solvers.gtsp.walks import least_within
from cellwright.threads import map_slices

MOST_CLUSTERS = 62
"""Clusters that a set of bits can hold."""
STAGES = ((0, 0, 1, 80, 0), (2, 2, 1, 40, 0), (4, 4, 1, 30, 5_000), (4, 6, 4, 8, 30_000), (4, 8, 5, 6, 150_000),
          (4, 9, 5, 6, 600_000), (4, 10, 6, 6, 3_000_000), (4, 12, 6, 5, 1 << 40))  # fmt: skip
"""Nearest clusters that each remembers, all that it remembers at most, times that memories grow by cycles of the
cheapest walk, subgradient steps each time, states a layer: each stage only if the one before is not enough."""
AGAIN = 0.5
"""Share of the gap that must be left at most, after a better tour, for the same stage to be worth another run."""
STEP_LENGTHS = (0.5, 0.9, 0.03)
"""Length of the steps after memories have grown, what it shrinks by each time, and the least."""
FIRST_PATIENCE, PATIENCE = 6, 4
"""Steps without a better bound after which they get shorter: without memories, and once these have begun to grow."""
AT_ONCE = 2
"""Depot nodes that are worked on at once, always: with another number of threads the same happens."""
DEPOT_STEPS = 20
"""Steps by which prices of all tours are fitted to those through one depot node."""
JOINT_STAGES = 3
"""Stages that tours through any depot node go through together, where there are several."""


@dataclass(eq=False)
class Proof:
    """What is known of the cheapest tour.

    Attributes:
        tour: Best known tour of nodes in the form.
        cost: Its cost.
        bound: No tour costs less.
        stopped_by: ``proof``, ``work``, ``memory``, ``stop``, or ``cheaper`` if that was asked for.
        n_states: States of dynamic programming made.
        work: Sums and comparisons done.
        multiplier: Prices of the clusters but the depot at the best bound, to start a similar problem from.
    """

    tour: Int32Array
    cost: float
    bound: float
    stopped_by: str
    n_states: int
    work: float
    multiplier: FloatArray


@dataclass(eq=False)
class _Limits:
    work: float
    memory: int
    stop: Stop | None
    stopped_by: str = ""
    wanted: float = -np.inf

    def spent(self, work: float) -> bool:
        """Whether that much work, or the time, is over."""
        if work >= self.work:
            self.stopped_by = "work"
            return True
        return self.over()

    def over(self) -> bool:
        """Whether ``stop`` says so, or anything has said so before."""
        if not self.stopped_by and self.stop is not None and self.stop():
            self.stopped_by = "stop"
        return bool(self.stopped_by)


def prove(
    form: TourForm, tour: Int32Array, *, max_work: float, memory: int, stop: Stop | None = None,
    multiplier: FloatArray | None = None,
    n_threads: int | None = None,
    until_cheaper: bool = False,
) -> Proof:  # fmt: skip
    """Prove a tour cheapest, or find a cheaper one that is, within limits of work and memory.

    Args:
        form: The problem.
        tour: A good tour: the better, the less work.
        max_work: Sums and comparisons at most, roughly; about one nanosecond each.
        memory: Bytes that the states may take at most.
        stop: Asked between steps.
        multiplier: Prices to start from.
        n_threads: Threads; the result does not depend on them.
        until_cheaper: Whether to end with the first stage that finds a cheaper tour.
    """
    given = form.tour_cost(tour)
    proof = Proof(tour, given, 0.0, "proof", 0, 0.0, np.zeros(form.n_clusters - 1))
    proof.bound = min(form.least_bound(), proof.cost)
    limits = _Limits(max_work, memory, stop, wanted=form.below(given) if until_cheaper else -np.inf)
    if proof.bound >= form.below(proof.cost) or limits.spent(float(form.n_clusters) * len(form.cost) ** 2):
        proof.stopped_by = limits.stopped_by or "proof"
        return proof
    depots = np.arange(form.first[1], dtype=np.int32)
    joint = bounding(form, depots, multiplier)
    if len(depots) > 1:
        for stage in range(JOINT_STAGES):
            if limits.spent(joint.work) or not _tighten(form, joint, None, proof, stage, limits):
                break
    proof.work, proof.multiplier = joint.work, joint.multiplier
    proof.bound = min(max(joint.bound, proof.bound), proof.cost)
    if joint.bound < form.below(proof.cost) and not limits.spent(proof.work):
        _prove_each(form, joint, depots, proof, limits, n_threads)
    if proof.bound >= form.below(proof.cost):
        proof.bound, limits.stopped_by = proof.cost, "proof"
    proof.stopped_by = limits.stopped_by or "memory"
    return proof


def _prove_each(
    form: TourForm, joint: Bounding, depots: Int32Array, proof: Proof, limits: _Limits, n_threads: int | None
) -> None:
    """Settle the tours through each depot node, stage by stage, the most promising first."""
    begun = JOINT_STAGES if len(depots) > 1 else 0
    left = [(through_depot(form, joint, int(depot)), int(depot)) for depot in depots]
    closed: list[float] = []
    for stage in range(begun, len(STAGES)):
        left.sort(key=lambda pair: pair[0].bound)
        remaining = []
        for pair in (left[k : k + AT_ONCE] for k in range(0, len(left), AT_ONCE)):
            for (problem, depot), outcome in zip(pair, _stage_of(form, pair, stage, begun, proof, limits, n_threads)):
                open_, each, stopped_by = outcome
                if each.cost < proof.cost:
                    proof.tour, proof.cost = each.tour, each.cost
                proof.work, proof.n_states = proof.work + each.work, proof.n_states + each.n_states
                limits.stopped_by = limits.stopped_by or stopped_by
                if open_:
                    remaining.append((problem, depot))
                else:
                    closed.append(problem.bound)
        left = remaining
        if left and not limits.stopped_by and proof.cost < limits.wanted:
            limits.stopped_by = "cheaper"
        if not left or limits.stopped_by:
            break
    proof.bound = max(proof.bound, min([proof.cost, *closed, *(problem.bound for problem, _ in left)]))
    if left:
        proof.multiplier = left[0][0].multiplier


def _stage_of(
    form: TourForm,
    pair: list[tuple[Bounding, int]],
    stage: int,
    begun: int,
    proof: Proof,
    limits: _Limits,
    n_threads: int | None,
) -> list[tuple[bool, Proof, str]]:
    """Go through one stage with some depot nodes at once, none knowing what the others find meanwhile.

    Returns:
        For each whether it is still open, what it has found with its own work and states, and why it was stopped.
    """

    def one(which: slice) -> tuple[bool, Proof, str]:
        problem, depot = pair[which.start]
        own = replace(limits, memory=limits.memory // len(pair))
        each = replace(proof, n_states=0)
        if own.spent(proof.work) or problem.bound >= form.below(proof.cost):
            return problem.bound < form.below(proof.cost), replace(each, work=0.0), own.stopped_by
        before = problem.work
        if stage == begun > 0:
            raise_bound(problem, proof.cost, form.below(proof.cost), DEPOT_STEPS, limits.stop)
        open_ = _tighten(form, problem, depot, each, stage, own)
        return open_, replace(each, work=problem.work - before), own.stopped_by

    return list(map_slices(one, len(pair), 1, n_threads=n_threads))


def _tighten(form: TourForm, problem: Bounding, depot: int | None, proof: Proof, stage: int, limits: _Limits) -> bool:
    """Go through one stage of bounding and dynamic programming; return whether the problem is still open."""
    most = STAGES[stage][-1]
    _raise_with_memory(form, problem, proof, stage, limits)
    if depot is not None:
        _take_tour(form, problem, depot, proof)
    problem.tour = None
    if problem.bound >= form.below(proof.cost):
        return False
    # shrinking takes three more walks: only where there is work left for what it makes possible
    dear = _work_of_a_walk(problem)
    if limits.spent((problem.work if depot is None else proof.work) + 3.0 * dear):
        return True
    if not shrink(problem, form.below(proof.cost)):
        return False
    if depot is None or not most or problem.n_clusters > MOST_CLUSTERS or limits.spent(proof.work):
        return True
    most = min(most, limits.memory // (BYTES_A_STATE + 8 * problem.n_clusters))
    while True:
        cost = proof.cost
        bound = _all_states(form, problem, depot, proof, most, limits)
        problem.bound = max(problem.bound, min(bound, form.below(proof.cost)))
        if problem.bound >= form.below(proof.cost):
            return False
        if proof.cost == cost or not shrink(problem, form.below(proof.cost)):
            return problem.bound < form.below(proof.cost)
        if proof.cost - problem.bound > AGAIN * (cost - problem.bound):
            return True


def _raise_with_memory(form: TourForm, problem: Bounding, proof: Proof, stage: int, limits: _Limits) -> None:
    """Raise the bound in a stage's rounds, each with more memory than the one before, while there is more to learn."""
    n_nearest, n_bits, n_rounds, n_steps, _ = STAGES[stage]
    remember_nearest(problem, n_nearest)
    for number in range(n_rounds):
        if not remember_cycles(problem, n_bits) and number:
            break
        first, factor, least = STEP_LENGTHS
        length, patience = 1.0, FIRST_PATIENCE
        if stage:
            length, patience = max(least, first * factor**problem.n_rounds), PATIENCE
            problem.n_rounds += 1
        few = max(1, min(n_steps, int((limits.work - proof.work) / _work_of_a_walk(problem))))
        ceiling = form.below(proof.cost)
        raise_bound(problem, proof.cost, ceiling, few, limits.stop, length=length, patience=patience)
        if problem.bound >= ceiling or problem.tour is not None or limits.over():
            break


def _work_of_a_walk(problem: Bounding) -> float:
    return float(problem.n_clusters) * len(problem.node) ** 2 * problem.n_masks


def _take_tour(form: TourForm, problem: Bounding, depot: int, proof: Proof) -> None:
    """Take over the tour that the relaxation has found, if it is one and cheaper."""
    if problem.tour is None:
        return
    tour = np.concatenate([[depot], problem.tour]).astype(np.int32)
    order = np.repeat(np.arange(form.n_clusters), np.diff(form.first))[tour]
    if np.tril(form.earlier[np.ix_(order, order)]).any():  # a walk knows what may follow what, not what comes first
        return
    cost = form.tour_cost(tour)
    if cost < proof.cost:
        proof.tour, proof.cost = tour, cost


def _all_states(form: TourForm, problem: Bounding, depot: int, proof: Proof, most: int, limits: _Limits) -> float:
    """Run the dynamic programme with the ``most`` best states a layer; return a bound on the tours through the depot.

    A cheaper tour that it finds goes into ``proof``. The bound is infinite if no further one can be cheaper.
    """
    begun = problem.work
    walks = Walks(problem)
    walks.solve(problem.multiplier)
    least_within(walks.rest)
    n, price, owner = problem.n_clusters, problem.multiplier, walks.owner
    offset = float(price.sum())
    ceiling = form.below(proof.cost) - offset
    memory = np.zeros((n, max(1, int(walks.n_bits.max()))), np.int32)
    for i, bits in enumerate(problem.memory):
        memory[i, : len(bits)] = bits
    rows, to = np.nonzero(np.isfinite(problem.cost))
    way = np.searchsorted(rows, np.arange(len(owner) + 1)).astype(np.int32)
    ways = way, to.astype(np.int32), problem.cost[rows, to]
    start = np.flatnonzero(problem.usable[1] & np.isfinite(problem.begin)).astype(np.int32)
    subset, node = np.int64(1) << owner[start].astype(np.int64), start
    value = problem.begin[start] - price[owner[start]]
    layers = [(node, np.zeros(len(node), np.int32))]
    bound = ceiling
    for place in range(2, n + 1):
        if limits.spent(proof.work + problem.work - begun):
            return -np.inf
        dropped, subset, node, value, parent = next_layer(
            subset, node, value, *ways, owner, problem.first, price, subset_needs(problem), problem.usable[place],
            memory, walks.n_bits, walks.rest[place], ceiling, most,
        )  # fmt: skip
        bound = min(bound, dropped)
        problem.work += 50.0 * len(parent)
        proof.n_states += len(node)
        layers.append((node, parent))
        if not len(node):
            break
    if len(node):
        total = value + problem.end[node]
        at = int(np.argmin(total))
        if total[at] < ceiling:
            tour = np.empty(n + 1, np.int32)
            tour[0] = depot
            for place in range(n, 0, -1):
                nodes, parents = layers[place - 1]
                tour[place], at = problem.node[nodes[at]], int(parents[at])
            proof.tour, proof.cost = tour, form.tour_cost(tour)
    # nothing was dropped for want of room: no tour through the depot is below the cost known before, or the one found
    return np.inf if bound >= ceiling else float(bound + offset)
