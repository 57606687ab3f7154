"""Find the cheapest sequence of tasks and their alternatives: the generalised travelling-salesman problem.

`solve_sequence` is the entrance: search for a good sequence, then prove it cheapest if it is small enough, else bound
it. `cellwright.solvers.gtsp.lazy.solve_lazily` does the same where costs are dear to evaluate. Neither reads a clock:
work is limited by numbers, the same on every machine; ``stop`` may end it earlier, and then too the best sequence and
its gap come back.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from cellwright.arrays import Int32Array
from cellwright.errors import InvalidInputError
from cellwright.solvers.gtsp.exact import prove
from cellwright.solvers.gtsp.form import TourForm, only_cluster, result_of, tour_form
from cellwright.solvers.gtsp.problem import SequencingProblem, SequencingResult, Stop
from cellwright.solvers.gtsp.search import TourSearch

__all__ = ["Method", "SequencingProblem", "SequencingResult", "Stop", "compile_kernels", "solve_sequence", "tour_of"]

Method = Literal["auto", "exact", "search"]
"""``exact`` proves with all the work and memory allowed; ``search`` does not look for a proof beyond its bound."""

EXACT_UP_TO = 24
"""Clusters up to which ``auto`` looks for a proof first; beyond, most of the work goes into search."""
EXACT_TURNS = ((4_000, 1.0), (10**9, 0.0))
"""Rounds of search and shares of the work on proof, in turn: a proof first, what is left for search if that fails."""
SEARCH_TURNS = ((4_000, 0.1), (40_000, 0.9), (10**9, 0.0))
"""The same for problems that are hardly ever proven: a bound soon, a better one from a better tour, then search."""
HOPELESS = 0.5
"""Share of the cost below which a first bound is left as it is: more work on it would be missed by the search."""
DEFAULT_ROUNDS = 60_000
"""Rounds of search in each chain: about two seconds for a hundred clusters of five."""
DEFAULT_WORK = 3e11
"""Sums and comparisons of a proof: one or two minutes at most, where most problems of this size need seconds."""
BOUND_WORK = 5e9
"""Sums and comparisons of the bounds where no proof is looked for: a few seconds."""
DEFAULT_MEMORY = 1 << 29
"""Bytes that states may take at most; with everything else the process stays below twice that."""


def solve_sequence(
    problem: SequencingProblem,
    rng: np.random.Generator,
    *,
    method: Method = "auto",
    n_rounds: int = DEFAULT_ROUNDS,
    max_work: float | None = None,
    memory: int = DEFAULT_MEMORY,
    stop: Stop | None = None,
    stop_bounds: Stop | None = None,
    known: Sequence[Sequence[int] | Int32Array] = (),
    n_chains: int = 2,
    n_threads: int | None = None,
) -> SequencingResult:
    """Return a cheapest sequence, or the best found with a bound on what any costs.

    Args:
        problem: Clusters, costs, and what the order has to respect.
        rng: Where the search gets its random numbers from; the same state gives the same sequence.
        method: ``auto`` is ``exact`` up to `EXACT_UP_TO` clusters.
        n_rounds: Rounds of search in each chain at most.
        max_work: Sums and comparisons for proof and bound; a default for the method if left out.
        memory: Bytes that the states of dynamic programming may take.
        stop: Ends the work early when it returns true, for example after a time; asked between steps,
            of which the longest takes a second or two.
        stop_bounds: Ends work on proof and bounds; what ``stop`` leaves goes into search. Without it a slow machine
            may spend on bounds what the sequence would have gained more by.
        known: Sequences of alternatives to start from.
        n_chains: Searches side by side.
        n_threads: Threads; the result does not depend on them.

    Raises:
        InvalidInputError: If a setting is out of range or a known sequence does not fit the problem.
        InfeasibleError: If no sequence is found that takes only ways that exist.
    """
    if method not in ("auto", "exact", "search"):
        raise InvalidInputError(f"method is {method!r}: give auto, exact or search")
    for name, value in (("n_rounds", n_rounds), ("memory", memory), ("max_work", 1 if max_work is None else max_work)):
        if not value > 0:
            raise InvalidInputError(f"{name} is {value}: give a positive number")
    if problem.n_clusters == 1:
        return only_cluster(problem)
    form = tour_form(problem)
    tours = tuple(tour_of(problem, form, sequence) for sequence in known)
    exact = method == "exact" or (method == "auto" and problem.n_clusters <= EXACT_UP_TO)
    search = TourSearch(form, rng, tours, n_chains=n_chains)
    work = (DEFAULT_WORK if exact else BOUND_WORK) if max_work is None else max_work
    bound, n_states, multiplier, stopped_by = 0.0, 0, None, ""

    def stopped() -> bool:
        return stop is not None and stop()

    def bounds_stopped() -> bool:
        return stopped() or (stop_bounds is not None and stop_bounds())

    for rounds, share in EXACT_TURNS if exact else SEARCH_TURNS:
        tour = search.run(min(rounds, n_rounds - search.n_rounds), stop, target=bound, n_threads=n_threads).tour
        if share and (bound == 0.0 or bound >= HOPELESS * form.tour_cost(tour)):
            proof = prove(form, tour, max_work=share * work, memory=memory, stop=bounds_stopped, multiplier=multiplier,
                          n_threads=n_threads)  # fmt: skip
            search.take(proof.tour)
            tour, stopped_by, n_states = proof.tour, proof.stopped_by, n_states + proof.n_states
            bound, multiplier = max(bound, proof.bound), proof.multiplier
        if stopped_by == "proof":
            break
        if stopped():
            stopped_by = "stop"
            break
        if stopped_by == "stop":
            stopped_by = "work"  # of the bounds alone
    return result_of(problem, form, tour, bound, stopped_by, search.n_rounds, n_states)


def tour_of(problem: SequencingProblem, form: TourForm, nodes: Sequence[int] | Int32Array) -> Int32Array:
    """Return a sequence of alternatives as a tour of the form's nodes.

    Raises:
        InvalidInputError: If it is no sequence of the problem.
    """
    given = np.asarray(nodes)
    if given.size and (given.min() < 0 or given.max() >= problem.n_alternatives):
        raise InvalidInputError(f"a known sequence names alternatives outside 0 to {problem.n_alternatives - 1}")
    wrong = problem.violation(given)
    if wrong:
        raise InvalidInputError(f"a known sequence does not fit the problem: {wrong}")
    place = np.empty(problem.n_alternatives, np.int32)
    real = form.node >= 0
    place[form.node[real]] = np.flatnonzero(real)
    tour = place[given]
    if not real[0]:
        return np.concatenate([[0], tour]).astype(np.int32)
    return np.roll(tour, -int(np.flatnonzero(tour < form.first[1])[0]))


def compile_kernels() -> None:
    """Run every kernel of the solver once on a small problem, so that numba compiles and keeps them."""
    rng = np.random.default_rng(0)
    n, k = 12, 4
    clusters = tuple(np.arange(k * i, k * i + k, dtype=np.int32) for i in range(n))
    solve_sequence(SequencingProblem(rng.uniform(0.0, 100.0, (n * k, n * k)), clusters), rng, n_rounds=500)
