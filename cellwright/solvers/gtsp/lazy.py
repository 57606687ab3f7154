"""Cheapest sequences where a cost is dear to know: evaluate only the motions of sequences that could still win.

Bjorkenstam 2014, section 2.1: begin with lower bounds of all costs, find the cheapest sequence on them, evaluate its
motions, put their true costs in, and so on. What is proven cheapest on costs of which the others are lower bounds is
cheapest altogether. Between proofs the search alone finds sequences that could win, and a sequence is evaluated
motion by motion only as long as it can: both spare proofs and evaluations.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.gtsp.exact import Proof, prove
from cellwright.solvers.gtsp.form import SAME, TourForm, only_cluster, result_of, tour_form
from cellwright.solvers.gtsp.problem import SequencingProblem, SequencingResult, Stop
from cellwright.solvers.gtsp.search import TourSearch
from cellwright.solvers.sequencing import BOUND_WORK, DEFAULT_MEMORY, DEFAULT_WORK, EXACT_UP_TO, tour_of

Evaluate = Callable[[int, int], float]
"""True cost of going from one alternative to another; infinite if there is no motion."""

ROUNDS_BETWEEN = 3_000
"""Rounds of search, in each chain, for the next sequence that could win."""


@dataclass(frozen=True, eq=False)
class LazyResult:
    """A sequence whose motions have all been evaluated.

    Attributes:
        result: The sequence, its true cost, and what is proven of it.
        n_evaluated: Motions evaluated.
        n_motions: Motions that there are: ordered pairs of alternatives of different clusters, or unordered ones
            where both directions cost the same.
        n_proofs: How often dynamic programming or a bound ran.
        cost: Costs as known at the end: true ones where ``evaluated``, else lower bounds.
        evaluated: Which are true costs, (alternatives, alternatives).
    """

    result: SequencingResult
    n_evaluated: int
    n_motions: int
    n_proofs: int
    cost: FloatArray
    evaluated: BoolArray

    @property
    def share_evaluated(self) -> float:
        """Share of all motions that had to be evaluated."""
        return self.n_evaluated / max(1, self.n_motions)


def velocity_bounds(q: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the least time that any motion takes between configurations: the slowest joint at its highest speed.

    Args:
        q: Joint positions of each alternative, (alternatives, joints), in rad.
        speed: Highest speed of each joint, (joints,), in rad/s.

    Returns:
        Times max_j |q_j - q'_j| / speed_j in s, (alternatives, alternatives).

    Raises:
        InvalidInputError: If a speed is not positive or the shapes do not fit.
    """
    q, speed = np.asarray(q, np.float64), np.asarray(speed, np.float64)
    if q.ndim != 2 or speed.shape != (q.shape[1],):
        raise InvalidInputError(f"q has shape {q.shape} and speed {speed.shape}: give one speed a joint")
    if not (np.isfinite(q).all() and np.isfinite(speed).all() and (speed > 0).all()):
        raise InvalidInputError("q and speed must be finite and every speed above 0 rad/s")
    times = np.zeros((len(q), len(q)))
    for joint in range(len(speed)):  # joint by joint: no array of all joints at once
        np.maximum(times, np.abs(q[:, None, joint] - q[None, :, joint]) / speed[joint], out=times)
    return times


def solve_lazily(
    problem: SequencingProblem,
    evaluate: Evaluate,
    rng: np.random.Generator,
    *,
    symmetric: bool = False,
    target_gap: float = 0.0,
    max_evaluations: int | None = None,
    max_work: float | None = None,
    memory: int = DEFAULT_MEMORY,
    stop: Stop | None = None,
    n_threads: int | None = None,
) -> LazyResult:
    """Return the cheapest sequence by true costs, evaluating as few of them as proving that needs.

    Args:
        problem: As for `solve_sequence`, its ``cost`` being lower bounds of the true costs.
        evaluate: True cost of one motion. Called at most once a motion.
        rng: Where the search gets its random numbers from.
        symmetric: Whether motions cost the same backwards, so that one evaluation is worth two.
        target_gap: Share of the cost by which the bound may stay below it.
        max_evaluations: Motions to evaluate at most, but for those of the first sequence.
        max_work: Sums and comparisons of each proof.
        memory: Bytes that the states of dynamic programming may take.
        stop: Ends the work early when it returns true.
        n_threads: Threads of the search; the result does not depend on them.

    Raises:
        InvalidInputError: If a true cost is below its lower bound, or not a number, or a setting is out of range.
        InfeasibleError: If no sequence is found whose motions all exist.
    """
    if not 0.0 <= target_gap < 1.0:
        raise InvalidInputError(f"target_gap is {target_gap}: give a share of at least 0 and below 1")
    if problem.n_clusters == 1:
        only = only_cluster(problem)
        return LazyResult(only, 0, 0, 0, problem.cost, np.zeros(problem.cost.shape, bool))
    known = _Known(problem, evaluate, symmetric)
    work = (DEFAULT_WORK if problem.n_clusters <= EXACT_UP_TO else BOUND_WORK) if max_work is None else max_work
    return _Lazy(known, rng, work, memory, stop, n_threads).solve(target_gap, max_evaluations)


class _Known:
    """What is known of the costs."""

    def __init__(self, problem: SequencingProblem, evaluate: Evaluate, symmetric: bool) -> None:
        self.problem, self._evaluate, self._symmetric = problem, evaluate, symmetric
        self.cost: FloatArray = problem.cost.copy()
        self.evaluated: BoolArray = np.zeros(self.cost.shape, bool)
        self.n_evaluated = 0
        sizes = np.array([len(own) for own in problem.clusters])
        self.n_motions = int((sizes.sum() ** 2 - (sizes**2).sum()) // (2 if symmetric else 1))

    def present(self) -> SequencingProblem:
        """Return the problem on what is known now."""
        return replace(self.problem, cost=self.cost)

    def settle(self, nodes: Int32Array, ceiling: float, n_most: float) -> float:
        """Evaluate the motions of a sequence while it can cost less than ``ceiling``; return its cost if all are.

        Infinite if it turns out to cost as much, or if ``n_most`` evaluations are spent before.
        """
        legs = self.problem.legs(nodes)
        own = math.fsum(float(self.problem.service[v]) for v in nodes)
        # the longest first: where most can be lost, so that what cannot win is found out soon
        open_ = sorted((leg for leg in legs if not self.evaluated[leg]), key=lambda leg: (-self.cost[leg], leg))
        for leg in open_:
            total = own + math.fsum(float(self.cost[each]) for each in legs)
            if total >= ceiling or self.n_evaluated >= n_most:
                return math.inf
            self._settle_leg(*leg)
        total = own + math.fsum(float(self.cost[each]) for each in legs)
        return total if total < ceiling else math.inf

    def _settle_leg(self, a: int, b: int) -> None:
        if self.evaluated[a, b]:
            return
        true, least = float(self._evaluate(a, b)), float(self.cost[a, b])
        self.n_evaluated += 1
        if math.isnan(true) or true < least - 1e-6 * max(1.0, abs(least)):
            raise InvalidInputError(
                f"the motion from alternative {a} to {b} costs {true:g}, but its lower bound is {least:g}: no proof "
                "holds on bounds that are none; lower them"
            )
        self.cost[a, b], self.evaluated[a, b] = max(true, least), True
        if self._symmetric:
            self.cost[b, a], self.evaluated[b, a] = self.cost[a, b], True


class _Lazy:
    """The loop of search, evaluation and proof, and what it has come to."""

    def __init__(
        self,
        known: _Known,
        rng: np.random.Generator,
        work: float,
        memory: int,
        stop: Stop | None,
        n_threads: int | None,
    ) -> None:
        self.known, self.rng, self.work, self.memory = known, rng, work, memory
        self.stop, self.n_threads = stop, n_threads
        self.cost, self.nodes = math.inf, np.empty(0, np.int32)
        self.n_proofs = self.n_states = self.n_rounds = 0
        self.multiplier: FloatArray | None = None

    def solve(self, target_gap: float, max_evaluations: int | None) -> LazyResult:
        """Search and evaluate, then prove and evaluate, until nothing can win or a limit is met."""
        most = math.inf if max_evaluations is None else float(max_evaluations)
        bound = 0.0
        while True:
            self._search(most)
            proof, nodes = self._prove()
            bound = max(bound, min(proof.bound, self.cost))
            if bound >= self.cost * (1.0 - target_gap - SAME):
                return self._result(bound, "gap" if target_gap else "proof")
            if self._stopped():
                return self._result(bound, "stop")
            if not self._wins(proof.cost):
                return self._result(bound, proof.stopped_by)
            if self._spent(most):
                return self._result(bound, "evaluations")
            self._settle(nodes, most)

    def _search(self, most: float) -> None:
        """Evaluate what search finds to be cheaper, as known, than the best, until it finds nothing."""
        while not (self._spent(most) or self._stopped()):
            form = tour_form(self.known.present())
            search = TourSearch(form, self.rng, self._tours(form))
            found = search.run(ROUNDS_BETWEEN, self.stop, n_threads=self.n_threads)
            self.n_rounds += search.n_rounds
            if not self._wins(found.cost):
                return
            self._check_ways(form, found.tour)
            self._settle(_nodes(form, found.tour), most)

    def _prove(self) -> tuple[Proof, Int32Array]:
        """Bound the costs as known; return the proof and the cheapest sequence on them that it knows."""
        form = tour_form(self.known.present())
        tours = self._tours(form)
        if not tours:  # stopped before any sequence was settled: one must be, to have something to return
            tours = (TourSearch(form, self.rng).best()[0],)
            self._check_ways(form, tours[0])
            self._settle(_nodes(form, tours[0]), math.inf)
            return self._prove()
        proof = prove(
            form,
            tours[0],
            max_work=self.work,
            memory=self.memory,
            stop=self.stop,
            multiplier=self.multiplier,
            n_threads=self.n_threads,
        )
        self.n_proofs, self.n_states = self.n_proofs + 1, self.n_states + proof.n_states
        if proof.multiplier.any():
            self.multiplier = proof.multiplier
        return proof, _nodes(form, proof.tour)

    def _settle(self, nodes: Int32Array, most: float) -> None:
        cost = self.known.settle(nodes, self.cost, most if len(self.nodes) else math.inf)
        if cost < self.cost:
            self.cost, self.nodes = cost, nodes

    def _wins(self, cost: float) -> bool:
        return cost < self.cost * (1.0 - SAME) if len(self.nodes) else True

    def _spent(self, most: float) -> bool:
        return bool(len(self.nodes)) and self.known.n_evaluated >= most

    def _stopped(self) -> bool:
        return bool(len(self.nodes)) and self.stop is not None and self.stop()

    def _tours(self, form: TourForm) -> tuple[Int32Array, ...]:
        return (tour_of(self.known.problem, form, self.nodes),) if len(self.nodes) else ()

    def _check_ways(self, form: TourForm, tour: Int32Array) -> None:
        if form.tour_cost(tour) >= form.missing:
            raise InfeasibleError(
                f"no sequence was found whose motions all exist, after {self.known.n_evaluated} evaluated motions: "
                "add alternatives, or let evaluate look harder"
            )

    def _result(self, bound: float, stopped_by: str) -> LazyResult:
        known, problem = self.known, self.known.present()
        form = tour_form(problem)
        tour = tour_of(problem, form, self.nodes)
        result = result_of(problem, form, tour, bound, stopped_by, self.n_rounds, self.n_states)
        return LazyResult(result, known.n_evaluated, known.n_motions, self.n_proofs, known.cost, known.evaluated)


def _nodes(form: TourForm, tour: Int32Array) -> Int32Array:
    nodes = form.node[tour]
    return nodes[1:] if nodes[0] < 0 else nodes
