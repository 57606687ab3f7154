from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InvalidInputError
from cellwright.solvers.gtsp.guided import ratios, search_guided
from cellwright.solvers.gtsp.known_costs import KnownCosts
from cellwright.solvers.gtsp.problem import SequencingProblem


def problem(seed: int, sizes: tuple[int, ...] = (2, 3, 2, 2)):
    """Return bounds far below the costs, and the costs."""
    rng = np.random.default_rng(seed)
    n = sum(sizes)
    true = rng.uniform(1.0, 3.0, (n, n))
    true = true + true.T
    ends = np.cumsum([0, *sizes])
    clusters = tuple(tuple(range(a, b)) for a, b in itertools.pairwise(ends))
    return SequencingProblem(0.1 * true, clusters, rng.uniform(0.0, 1.0, n)), true


def guided(bounds, guess, evaluate, *, symmetric: bool = True, **limits):
    """What guesses lead to, and what is known then."""
    known = KnownCosts(bounds, evaluate, symmetric=symmetric)
    return search_guided(known, guess, np.random.default_rng(0), **limits), known


def cheapest(given: SequencingProblem, true: np.ndarray) -> float:
    best = np.inf
    for order in itertools.permutations(range(1, given.n_clusters)):
        for nodes in itertools.product(*(given.clusters[row] for row in (0, *order))):
            closed = [*nodes, nodes[0]]
            cost = sum(given.service[v] for v in nodes) + sum(true[a, b] for a, b in itertools.pairwise(closed))
            best = min(best, cost)
    return float(best)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6))
def test_guesses_that_are_never_too_high_lead_to_the_cheapest(seed):
    bounds, true = problem(seed)
    low = true * np.random.default_rng(seed + 1).uniform(0.8, 1.0, true.shape)
    found, _ = guided(bounds, np.minimum(low, low.T), lambda a, b: true[a, b])
    assert found.settled and found.cost == pytest.approx(cheapest(bounds, true))


def test_good_guesses_spare_evaluations_that_weak_bounds_ask_for():
    bounds, true = problem(3, (3,) * 8)
    asked: list[tuple[int, int]] = []

    def evaluate(a: int, b: int) -> float:
        asked.append((a, b))
        return float(true[a, b])

    found, known = guided(bounds, 0.95 * true, evaluate)
    assert found.settled and len(set(asked)) == len(asked) == known.n_evaluated < 0.2 * true.size
    assert np.array_equal(known.cost[known.evaluated], true[known.evaluated])
    assert np.array_equal(known.cost[~known.evaluated], bounds.cost[~known.evaluated])
    assert ratios(known, 0.95 * true) == pytest.approx(np.full(len(asked), 1.0 / 0.95))


def test_guesses_learn_that_they_are_too_high():
    """All motions cost 0.6 of what is guessed: those evaluated first must not hide the others."""
    bounds, true = problem(5, (3,) * 6)
    found, _ = guided(bounds, true / 0.6, lambda a, b: true[a, b])
    exact, _ = guided(bounds, true, lambda a, b: true[a, b])
    assert found.cost == pytest.approx(exact.cost)


def test_a_limit_on_evaluations_still_gives_a_sequence():
    bounds, true = problem(1)
    found, known = guided(bounds, true, lambda a, b: true[a, b], symmetric=False, max_evaluations=1)
    assert known.n_evaluated == len(found.nodes) == 4 and found.cost >= cheapest(bounds, true) - 1e-9


def test_motions_that_do_not_exist_are_gone_around():
    bounds, true = problem(2)
    true[0, :] = true[:, 0] = np.inf
    found, _ = guided(bounds, 0.5 * bounds.cost, lambda a, b: true[a, b])
    assert np.isfinite(found.cost) and 0 not in found.nodes


def test_guesses_of_another_shape_are_refused():
    bounds, _ = problem(0)
    with pytest.raises(InvalidInputError, match="guesses"):
        guided(bounds, np.zeros((2, 2)), lambda a, b: 1.0)


def test_a_true_cost_below_its_bound_is_told():
    bounds, true = problem(0)
    with pytest.raises(InvalidInputError, match="its lower bound is"):
        guided(bounds, true, lambda a, b: 0.05 * true[a, b])
