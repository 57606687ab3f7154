"""Good sequences where lower bounds say little: evaluate the motions that a guess, not a bound, holds for cheap.

Bjorkenstam 2014, section 2.1: where no tight bound is known (energy, torque), costs are estimated, and the sequence
that is cheapest by what is known and what is guessed is evaluated, until one is cheapest whose motions are all known.
How much guesses are too high or too low is learnt from the motions evaluated: they are scaled so that few motions turn
out cheaper than guessed. What comes out is no proof; `cellwright.solvers.gtsp.lazy` bounds it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.errors import InvalidInputError
from cellwright.solvers.gtsp.form import tour_form
from cellwright.solvers.gtsp.problem import SequencingProblem, Stop
from cellwright.solvers.gtsp.search import TourSearch
from cellwright.solvers.sequencing import tour_of

ROUNDS = 3_000
"""Rounds of search, in each chain, for the sequence to evaluate next."""
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
        known: True costs where ``evaluated``, lower bounds elsewhere, (alternatives, alternatives).
        evaluated: Which are true costs.
        settled: Whether no sequence is cheaper by what is known and guessed.
    """

    nodes: Int32Array
    cost: float
    known: FloatArray
    evaluated: BoolArray
    settled: bool


def search_guided(
    problem: SequencingProblem,
    guess: FloatArray,
    evaluate: Callable[[int, int], float],
    rng: np.random.Generator,
    *,
    symmetric: bool = False,
    max_evaluations: int | None = None,
    stop: Stop | None = None,
) -> GuidedResult:
    """Return the cheapest sequence that guesses lead to.

    Args:
        problem: As for `solve_sequence`, its ``cost`` being lower bounds of the true costs.
        guess: What motions may cost, (alternatives, alternatives).
        evaluate: True cost of one motion, infinite if there is none.
        rng: Where the search gets its random numbers from.
        symmetric: Whether motions cost the same backwards.
        max_evaluations: Motions to evaluate at most, but for those of the last sequence.
        stop: Ends the work early when it returns true.

    Raises:
        InvalidInputError: If guesses are of another shape, negative or not a number.
    """
    if guess.shape != problem.cost.shape or not np.all(guess >= 0.0):
        raise InvalidInputError(f"guesses have shape {guess.shape} and must be at least 0: give one a motion")
    most = math.inf if max_evaluations is None else max_evaluations
    known, evaluated = problem.cost.copy(), np.zeros(problem.cost.shape, bool)
    best, cost, count, scale = np.empty(0, np.int32), math.inf, 0, 1.0
    ratios: list[float] = []
    while True:
        likely = replace(problem, cost=np.where(evaluated, known, np.maximum(known, scale * guess)))
        form = tour_form(likely)
        tours = (tour_of(likely, form, best),) if len(best) else ()
        tour = TourSearch(form, rng, tours).run(ROUNDS, stop).tour
        if form.tour_cost(tour) >= form.missing:
            return GuidedResult(best, cost, known, evaluated, settled=False)
        nodes = form.node[tour]
        nodes = nodes[1:] if nodes[0] < 0 else nodes
        legs = problem.legs(nodes)
        open_ = [leg for leg in legs if not evaluated[leg]]
        for a, b in open_:
            if evaluated[a, b]:
                continue
            known[a, b], evaluated[a, b] = max(evaluate(a, b), known[a, b]), True
            count += 1
            if guess[a, b] > 0.0 and math.isfinite(known[a, b]):
                ratios.append(known[a, b] / guess[a, b])
            if symmetric:
                known[b, a], evaluated[b, a] = known[a, b], True
        total = math.fsum(float(problem.service[v]) for v in nodes) + math.fsum(float(known[leg]) for leg in legs)
        if total < cost:
            best, cost = nodes, total
        if not open_ or count >= most or (stop is not None and stop()):
            return GuidedResult(best, cost, known, evaluated, settled=not open_)
        if len(ratios) >= FEWEST_RATIOS:
            scale = min(1.0, max(SMALLEST_SCALE, float(np.quantile(ratios, CHEAPER_THAN_GUESSED))))
