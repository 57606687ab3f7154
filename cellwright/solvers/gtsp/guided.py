"""Good sequences where lower bounds say little: evaluate the motions that a guess, not a bound, holds for cheap.

Bjorkenstam 2014, section 2.1: where no tight bound is known (energy, torque), costs are estimated, and the sequence
that is cheapest by what is known and what is guessed is evaluated, until one is cheapest whose motions are all known.
How much guesses are too high or too low is learnt from the motions evaluated: they are scaled so that few motions turn
out cheaper than guessed. What comes out is no proof; `cellwright.solvers.gtsp.lazy` bounds it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.errors import InvalidInputError
from cellwright.solvers.gtsp.form import tour_form
from cellwright.solvers.gtsp.known_costs import KnownCosts
from cellwright.solvers.gtsp.problem import SequencingProblem, Stop
from cellwright.solvers.gtsp.search import FIRST_CYCLE, TourSearch
from cellwright.solvers.sequencing import tour_of

ROUNDS = FIRST_CYCLE
"""Rounds of search, in each chain, for the sequence to evaluate next: one cycle of annealing."""
FEWEST_RATIOS = 4
"""Motions from which the scale of guesses is learnt; before, guesses stand as they are."""
CHEAPER_THAN_GUESSED = 0.1
"""Share of the motions that may turn out cheaper than guessed."""
SMALLEST_SCALE = 0.25


@dataclass(frozen=True, eq=False)
class GuidedResult:
    """A sequence whose motions have all been evaluated.

    Attributes:
        nodes: The cheapest such sequence; empty if none was found.
        cost: What it costs, infinite if there is none.
        settled: Whether no sequence is cheaper by what is known and guessed.
    """

    nodes: Int32Array
    cost: float
    settled: bool


def search_guided(
    known: KnownCosts,
    guess: FloatArray,
    rng: np.random.Generator,
    *,
    max_evaluations: int | None = None,
    stop: Stop | None = None,
) -> GuidedResult:
    """Return the cheapest sequence that guesses lead to.

    Args:
        known: The problem and what is known of its costs; it learns what is evaluated.
        guess: What motions may cost, (alternatives, alternatives).
        rng: Where the search gets its random numbers from.
        max_evaluations: Motions to evaluate at most, but for those of the last sequence.
        stop: Ends the work early when it returns true.

    Raises:
        InvalidInputError: If guesses are of another shape, negative or not a number, or a true cost is below its bound.
    """
    problem = known.problem
    if guess.shape != problem.cost.shape or not np.all(guess >= 0.0):
        raise InvalidInputError(f"guesses have shape {guess.shape} and must be at least 0: give one a motion")
    most = math.inf if max_evaluations is None else max_evaluations
    best, cost, scale = np.empty(0, np.int32), math.inf, 1.0
    found: list[float] = []
    while True:
        likely = guessed(known, scale * guess)
        form = tour_form(likely)
        tours = (tour_of(likely, form, best),) if len(best) else ()
        tour = TourSearch(form, rng, tours).run(ROUNDS, stop).tour
        if form.tour_cost(tour) >= form.missing:
            return GuidedResult(best, cost, settled=False)
        nodes = form.node[tour]
        nodes = nodes[1:] if nodes[0] < 0 else nodes
        open_ = known.open_legs(nodes)
        for a, b in open_:
            count = known.n_evaluated
            true = known.evaluate(a, b)
            if known.n_evaluated > count and guess[a, b] > 0.0 and math.isfinite(true):
                found.append(true / guess[a, b])
        total = known.present().cost_of(nodes)
        if total < cost:
            best, cost = nodes, total
        if not open_ or known.n_evaluated >= most or (stop is not None and stop()):
            return GuidedResult(best, cost, settled=not open_)
        if len(found) >= FEWEST_RATIOS:
            scale = min(1.0, max(SMALLEST_SCALE, float(np.quantile(found, CHEAPER_THAN_GUESSED))))


def guessed(known: KnownCosts, guess: FloatArray) -> SequencingProblem:
    """Return the problem on what is known and, where that is a bound alone, on a guess that is not below it."""
    return replace(known.problem, cost=np.where(known.evaluated, known.cost, np.maximum(known.cost, guess)))


def ratios(known: KnownCosts, guess: FloatArray) -> FloatArray:
    """Return true costs over guesses of the motions evaluated, those that exist and are guessed at, each once."""
    told = known.evaluated & np.isfinite(known.cost) & (guess > 0.0)
    if known.symmetric:
        told = np.triu(told)
    return np.asarray(known.cost[told] / guess[told])
