from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.solvers.sweeps.order import ConnectionCosts, SweepOptions, order_best, order_greedily
from cellwright.solvers.sweeps.order_bound import one_tree_bound
from cellwright.solvers.sweeps.order_kernels import best_options, cheapest_through, held_karp


def problem(seed, n_sweeps, n_alternatives, *, returns=False, share_missing=0.0):
    """Sweeps between random points of the plane: options and the true, symmetric connection costs."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, n_alternatives + 1, n_sweeps)
    ends = rng.uniform(0, 3, (counts.sum(), 2, 2))
    entry = np.append(np.stack([ends[:, 0], ends[:, 1]], 1).reshape(-1, 2), [[1.5, 1.5]], axis=0)
    exit_ = np.append(np.stack([ends[:, 1], ends[:, 0]], 1).reshape(-1, 2), [[1.5, 1.5]], axis=0)
    m = len(entry) - 1
    reverse = np.arange(m, dtype=np.int32) ^ 1
    back = np.append(reverse, m)
    least = np.abs(exit_[:, None] - entry[None]).max(-1)
    true = least * (1.0 + rng.uniform(0, 1, least.shape))
    true[rng.random(true.shape) < share_missing] = np.inf
    for a, b in itertools.product(range(m + 1), range(m + 1)):
        if returns or m not in (a, b):
            true[back[b], back[a]] = true[a, b]
    first = np.concatenate([[0], np.cumsum(2 * counts)]).astype(np.int32)
    names = tuple(f"view {i}" for i in range(n_sweeps))
    duration = np.repeat(rng.uniform(1, 2, m // 2), 2)
    return SweepOptions(names, first, duration, reverse, least, returns), true


def costs_of(options, true):
    return ConnectionCosts(options, lambda a, b: float(true[a, b]))


def duration_of(options, true, chosen):
    total = true[options.start, chosen[0]] + options.duration[list(chosen)].sum()
    total += sum(true[a, b] for a, b in itertools.pairwise(chosen))
    return total + (true[chosen[-1], options.start] if options.returns else 0.0)


def brute_force(options, true):
    sets = [range(options.first[i], options.first[i + 1]) for i in range(len(options.name))]
    return min(
        duration_of(options, true, chosen)
        for sequence in itertools.permutations(range(len(sets)))
        for chosen in itertools.product(*(sets[i] for i in sequence))
    )


@pytest.mark.parametrize("returns", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_the_exact_order_is_that_of_brute_force(seed, returns):
    options, true = problem(seed, 4, 2, returns=returns, share_missing=0.1)
    costs = costs_of(options, true)
    best = order_best(options, costs, order_greedily(options, costs), n_evaluations=10_000)
    assert best.proven
    assert best.duration == pytest.approx(brute_force(options, true), abs=1e-9)
    assert best.duration == pytest.approx(duration_of(options, true, best.options), abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_exact_order_needs_few_connections_and_is_not_longer_than_the_greedy_one(seed):
    options, true = problem(seed, 9, 4)
    costs = costs_of(options, true)
    greedy = order_greedily(options, costs)
    best = order_best(options, costs, greedy, n_evaluations=10_000)
    assert best.proven and best.lower_bound <= best.duration + 1e-9 and best.duration <= greedy.duration
    assert costs.n_evaluated < 0.2 * true.size
    everything = order_best(options, all_known(options, true), greedy, n_evaluations=1)
    assert best.duration == pytest.approx(everything.duration, abs=1e-9)


def all_known(options, true):
    costs = costs_of(options, true)
    for a, b in itertools.product(range(len(true)), repeat=2):
        if b < options.start or options.returns:
            costs.at(a, b)
    return costs


def test_the_greedy_order_takes_the_shortest_connection_each_time():
    options, true = problem(1, 5, 2, share_missing=0.1)
    greedy = order_greedily(options, costs_of(options, true))
    left, current = set(range(5)), options.start
    for option in greedy.options:
        open_options = [o for i in left for o in range(options.first[i], options.first[i + 1])]
        assert true[current, option] == min(true[current, o] for o in open_options)
        left.remove(int(np.searchsorted(options.first, option, side="right")) - 1)
        current = option
    assert not left
    assert greedy.duration == pytest.approx(duration_of(options, true, greedy.options))


def test_every_sweep_is_executed_once_whatever_the_search():
    options, true = problem(3, 8, 3)
    for most_exact in (15, 0):
        costs = costs_of(options, true)
        greedy = order_greedily(options, costs)
        order = order_best(options, costs, greedy, n_evaluations=10_000, exact_up_to=most_exact)
        sweeps = np.searchsorted(options.first, order.options, side="right") - 1
        assert sorted(sweeps.tolist()) == list(range(8))


@pytest.mark.parametrize("seed", range(4))
def test_local_search_lies_between_its_bound_and_the_greedy_order(seed):
    options, true = problem(seed, 8, 2)
    exact_costs = costs_of(options, true)
    greedy = order_greedily(options, exact_costs)
    exact = order_best(options, exact_costs, greedy, n_evaluations=10_000)
    costs = costs_of(options, true)
    searched = order_best(options, costs, order_greedily(options, costs), n_evaluations=10_000, exact_up_to=0)
    assert searched.lower_bound <= exact.duration + 1e-9
    assert exact.duration - 1e-9 <= searched.duration <= greedy.duration + 1e-9
    assert searched.duration <= 1.1 * exact.duration


def test_many_sweeps_are_ordered_with_a_bound():
    options, true = problem(0, 30, 2)
    costs = costs_of(options, true)
    greedy = order_greedily(options, costs)
    best = order_best(options, costs, greedy, n_evaluations=10_000)
    assert best.duration < greedy.duration
    assert 0.7 * best.duration < best.lower_bound <= best.duration
    assert not best.proven


@pytest.mark.parametrize("returns", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_the_one_tree_bound_is_below_the_optimum_and_near_it(seed, returns):
    options, true = problem(seed, 5, 1, returns=returns)
    costs = all_known(options, true)
    optimum = brute_force(options, true)
    bound = one_tree_bound(costs.value, options.duration, options.first, 1.5 * optimum)
    assert 0.85 * optimum <= bound <= optimum + 1e-9


def dead_end():
    """Sweep 2 is met from sweep 0 alone, which is nearest to the start: who goes there first gets stuck."""
    options, true = problem(0, 3, 1)
    ways, start, first = np.full_like(true, np.inf), options.start, options.first
    for a, b, cost in (
        (start, first[0], 0.1),
        (start, first[1], 0.2),
        (first[0], first[1], 1.0),
        (first[0], first[2], 1.0),
    ):
        ways[a, b] = ways[b, a] = cost
    least = np.where(np.isfinite(ways), ways, 0.05)
    return replace(options, least=least, reverse=np.arange(6, dtype=np.int32)), ways


@pytest.mark.parametrize("most_exact", [15, 0])
def test_a_dead_end_of_the_greedy_order_does_not_end_the_search(most_exact):
    options, true = dead_end()
    costs = costs_of(options, true)
    assert order_greedily(options, costs) is None
    best = order_best(options, costs, None, n_evaluations=1000, exact_up_to=most_exact)
    assert best.options.tolist() == [options.first[1], options.first[0], options.first[2]]
    assert best.duration == pytest.approx(brute_force(options, true))


@pytest.mark.parametrize("most_exact", [15, 0])
def test_where_a_sweep_has_no_connection_there_is_no_order(most_exact):
    options, true = problem(0, 4, 2)
    own = slice(options.first[2], options.first[3])
    true[own, :], true[:, own] = np.inf, np.inf
    costs = costs_of(options, true)
    assert order_greedily(options, costs) is None
    assert order_best(options, costs, None, n_evaluations=1000, exact_up_to=most_exact) is None


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_whatever_is_missing_the_exact_order_is_that_of_brute_force(seed, returns):
    options, true = problem(seed, 4, 2, returns=returns, share_missing=0.6)
    costs = costs_of(options, true)
    greedy = order_greedily(options, costs)
    best = order_best(options, costs, greedy, n_evaluations=10_000)
    least = brute_force(options, true)
    if np.isinf(least):
        assert greedy is None and best is None
    else:
        assert best.proven and best.duration == pytest.approx(least, abs=1e-9)
        assert greedy is None or greedy.lower_bound <= least + 1e-9


def test_a_stopped_search_says_what_it_has_proven():
    options, true = problem(2, 9, 4)
    costs = costs_of(options, true)
    greedy = order_greedily(options, costs)
    stopped = order_best(options, costs, greedy, n_evaluations=0)
    full = order_best(options, costs_of(options, true), greedy, n_evaluations=10_000)
    assert stopped.lower_bound <= full.duration <= stopped.duration


@pytest.mark.parametrize("returns", [False, True])
def test_the_cheapest_order_through_each_option_is_that_of_brute_force(returns):
    options, true = problem(5, 4, 2, returns=returns)
    value = all_known(options, true).value
    totals, orders, states = held_karp(value, options.duration, options.first, np.inf)
    through = cheapest_through(states, value, options.duration, options.first)
    assert through.min() == pytest.approx(totals.min())
    cheapest = np.full(options.start, np.inf)
    for sequence in itertools.permutations(range(4)):
        for chosen in itertools.product(*(range(options.first[i], options.first[i + 1]) for i in sequence)):
            total = duration_of(options, true, chosen)
            cheapest[list(chosen)] = np.minimum(cheapest[list(chosen)], total)
    assert through == pytest.approx(cheapest)
    for option, order in enumerate(orders):
        assert order[-1] == option
        assert duration_of(options, true, order) == pytest.approx(totals[option])


@pytest.mark.parametrize("seed", range(4))
def test_options_of_one_sequence_are_chosen_as_by_brute_force(seed):
    options, true = problem(seed, 4, 2, share_missing=0.2)
    value = all_known(options, true).value
    sequence = np.random.default_rng(seed).permutation(4).astype(np.int32)
    total, chosen = best_options(sequence, value, options.duration, options.first)
    sets = (range(options.first[i], options.first[i + 1]) for i in sequence)
    cheapest = min(duration_of(options, true, picked) for picked in itertools.product(*sets))
    assert total == pytest.approx(cheapest)
    assert total == pytest.approx(duration_of(options, true, chosen))
