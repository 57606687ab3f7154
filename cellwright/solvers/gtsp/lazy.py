"""Cheapest sequences where a cost is dear to know: evaluate only the motions of sequences that could still win.

Bjorkenstam 2014, section 2.1: begin with lower bounds of all costs, find the cheapest sequence on them, evaluate its
motions, put their true costs in, and so on. What is proven cheapest on costs of which the others are lower bounds is
cheapest altogether. Between proofs the search alone finds sequences that could win, and a sequence is evaluated
motion by motion only as long as it can: both spare proofs and evaluations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.gtsp.exact import Proof, prove
from cellwright.solvers.gtsp.form import SAME, TourForm, only_cluster, result_of, tour_form
from cellwright.solvers.gtsp.known_costs import Evaluate, KnownCosts
from cellwright.solvers.gtsp.problem import SequencingProblem, SequencingResult, Stop
from cellwright.solvers.gtsp.search import FIRST_CYCLE, TourSearch
from cellwright.solvers.sequencing import BOUND_WORK, DEFAULT_MEMORY, DEFAULT_WORK, EXACT_UP_TO, tour_of

ROUNDS_BETWEEN = FIRST_CYCLE
"""Rounds of search, in each chain, for the next sequence that could win: one cycle of annealing."""


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
        max_evaluations: Motions to evaluate at most, but for those of the first sequence: while there is none, as many
            more as a sequence has.
        max_work: Sums and comparisons of each proof.
        memory: Bytes that the states of dynamic programming may take.
        stop: Ends the work early when it returns true.
        n_threads: Threads of the search; the result does not depend on them.

    Raises:
        InvalidInputError: If a true cost is below its lower bound, or not a number, or a setting is out of range.
        InfeasibleError: If no sequence is found whose motions all exist, or none before a limit is met.
    """
    return solve_known(
        KnownCosts(problem, evaluate, symmetric=symmetric),
        rng,
        target_gap=target_gap,
        max_evaluations=max_evaluations,
        max_work=max_work,
        memory=memory,
        stop=stop,
        n_threads=n_threads,
    )


def solve_known(
    known: KnownCosts,
    rng: np.random.Generator,
    *,
    start: Sequence[int] | Int32Array | None = None,
    target_gap: float = 0.0,
    max_evaluations: int | None = None,
    max_work: float | None = None,
    memory: int = DEFAULT_MEMORY,
    stop: Stop | None = None,
    n_threads: int | None = None,
) -> LazyResult:
    """Return what `solve_lazily` does, going on from costs that are known already.

    Args:
        known: What is known; it learns what is evaluated. Its evaluations before count towards the limit.
        rng: As for `solve_lazily`.
        start: A sequence whose motions all exist, evaluated or to be evaluated first whatever the limit.
        target_gap: As for `solve_lazily`, like the rest.
        max_evaluations: See there.
        max_work: See there.
        memory: See there.
        stop: See there.
        n_threads: See there.

    Raises:
        InvalidInputError: As `solve_lazily`; also if ``start`` does not fit the problem.
        InfeasibleError: As `solve_lazily`.
    """
    if not 0.0 <= target_gap < 1.0:
        raise InvalidInputError(f"target_gap is {target_gap}: give a share of at least 0 and below 1")
    problem = known.problem
    if problem.n_clusters == 1:
        return LazyResult(only_cluster(problem), known.n_evaluated, 0, 0, known.cost, known.evaluated)
    work = (DEFAULT_WORK if problem.n_clusters <= EXACT_UP_TO else BOUND_WORK) if max_work is None else max_work
    lazy = _Lazy(known, rng, work, memory, stop, n_threads, max_evaluations)
    if start is not None:
        lazy.begin(np.asarray(start, np.int32))
    return lazy.solve(target_gap)


class _Lazy:
    """The loop of search, evaluation and proof, and what it has come to."""

    def __init__(
        self,
        known: KnownCosts,
        rng: np.random.Generator,
        work: float,
        memory: int,
        stop: Stop | None,
        n_threads: int | None,
        max_evaluations: int | None,
    ) -> None:
        self.known, self.rng, self.work, self.memory = known, rng, work, memory
        self.stop, self.n_threads = stop, n_threads
        self.cost, self.nodes = math.inf, np.empty(0, np.int32)
        self.n_proofs = self.n_states = self.n_rounds = 0
        self.multiplier: FloatArray | None = None
        self.most = math.inf if max_evaluations is None else float(max_evaluations)
        self.n_legs = len(known.problem.clusters)
        self.ceiling = self.most + self.n_legs  # what may be evaluated as long as there is no sequence

    def begin(self, nodes: Int32Array) -> None:
        """Take a sequence to begin with; one with a way that does not exist is none."""
        wrong = self.known.problem.violation(nodes)
        if wrong:
            raise InvalidInputError(f"the sequence to begin with does not fit the problem: {wrong}")
        cost = self.known.settle(nodes, math.inf, lambda: False)
        if cost < math.inf:
            self.cost, self.nodes = cost, nodes

    def solve(self, target_gap: float) -> LazyResult:
        """Search and evaluate, then prove and evaluate, until nothing can win or a limit is met."""
        bound = 0.0
        while True:
            proof, nodes = self._prove(self._search())
            bound = max(bound, min(proof.bound, self.cost))
            if bound >= self.cost * (1.0 - target_gap - SAME):
                return self._result(bound, "gap" if target_gap else "proof")
            if self._stopped():
                return self._result(bound, "stop")
            if not self._wins(proof.cost):
                return self._result(bound, proof.stopped_by)
            if self._spent():
                return self._result(bound, "evaluations")
            self._settle(nodes)

    def _search(self) -> Int32Array:
        """Evaluate what search finds to be cheaper, as known, than the best, until it finds nothing; return the last.

        Without any sequence it goes on a little beyond the limits: as far as one more sequence has motions. Where no
        more may be evaluated, the cheapest as known is still what a proof begins with best.
        """
        while True:
            stopped = self._stopped()
            if len(self.nodes) and stopped:
                return self.nodes
            if stopped:
                self.ceiling = min(self.ceiling, self.known.n_evaluated + self.n_legs)
            form = tour_form(self.known.present())
            search = TourSearch(form, self.rng, self._tours(form))
            found = search.run(ROUNDS_BETWEEN, self.stop, n_threads=self.n_threads)
            self.n_rounds += search.n_rounds
            nodes = _nodes(form, found.tour)
            if not self._wins(found.cost) or (len(self.nodes) and self._spent()):
                return nodes
            self._check_ways(form, found.tour)
            self._settle(nodes)
            self._check_budget()

    def _prove(self, nodes: Int32Array) -> tuple[Proof, Int32Array]:
        """Bound the costs as known; return the proof and the cheapest sequence on them that it knows."""
        problem = self.known.present()
        form = tour_form(problem)
        proof = prove(
            form,
            tour_of(problem, form, nodes),
            max_work=self.work,
            memory=self.memory,
            stop=self.stop,
            multiplier=self.multiplier,
            n_threads=self.n_threads,
            until_cheaper=not self._spent(),  # what ends with a cheaper one has not done all it can for the bound
        )
        self.n_proofs, self.n_states = self.n_proofs + 1, self.n_states + proof.n_states
        if proof.multiplier.any():
            self.multiplier = proof.multiplier
        return proof, _nodes(form, proof.tour)

    def _settle(self, nodes: Int32Array) -> None:
        cost = self.known.settle(nodes, self.cost, self._is_over)
        if cost < self.cost:
            self.cost, self.nodes = cost, nodes

    def _wins(self, cost: float) -> bool:
        return cost < self.cost * (1.0 - SAME) if len(self.nodes) else True

    def _is_over(self) -> bool:
        """Whether nothing more may be evaluated."""
        if len(self.nodes):
            return self._spent() or self._stopped()
        return self.known.n_evaluated >= self.ceiling

    def _spent(self) -> bool:
        return self.known.n_evaluated >= self.most

    def _stopped(self) -> bool:
        return self.stop is not None and self.stop()

    def _tours(self, form: TourForm) -> tuple[Int32Array, ...]:
        return (tour_of(self.known.problem, form, self.nodes),) if len(self.nodes) else ()

    def _check_budget(self) -> None:
        if not len(self.nodes) and self._is_over():
            limit = f"{self.most:.0f} motions" if self.known.n_evaluated >= self.most else "time"
            raise InfeasibleError(
                f"no sequence was found whose motions all exist before the limit of {limit} was met, "
                f"{self.known.n_evaluated} evaluated: allow more, add alternatives, or let evaluate look harder"
            )

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
