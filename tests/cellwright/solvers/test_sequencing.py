from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.gtsp.bounds import Walks, bounding, raise_bound, remember_cycles, remember_nearest, shrink
from cellwright.solvers.gtsp.exact import prove
from cellwright.solvers.gtsp.form import tour_form
from cellwright.solvers.gtsp.gtsplib import read_gtsplib
from cellwright.solvers.gtsp.kernels import cluster_nodes, improve_tour
from cellwright.solvers.gtsp.problem import SequencingProblem
from cellwright.solvers.gtsp.search import TourSearch
from cellwright.solvers.sequencing import compile_kernels, solve_sequence
from tests.cellwright.solvers.sequencing_problems import (
    brute_force,
    groups,
    plane_problem,
    robot_problem,
    uniform_problem,
)

PUBLIC = Path(__file__).parents[4] / "shared" / "data" / "gtsp"


def rng(seed=0):
    return np.random.default_rng(seed)


def precedence(generator, n):
    """Some pairs that agree with a random order of the clusters."""
    order = generator.permutation(n)
    pairs = [(int(a), int(b)) for a, b in itertools.combinations(order, 2) if generator.random() < 0.25]
    return order, tuple(pairs)


def small_problem(seed, kind, *, share_missing=0.0):
    """A problem of up to five clusters, closed or open, with or without ends and precedence."""
    generator = rng(seed)
    n = int(generator.integers(1, 6))
    sizes = generator.integers(1, 4, n).tolist()
    order, pairs = precedence(generator, n)
    ends = {
        "closed": {},
        "closed, start": {"start": int(order[0]), "before": pairs},
        "open": {"closed": False},
        "open, start": {"closed": False, "start": int(order[0])},
        "open, end": {"closed": False, "end": int(order[-1]) if n > 1 else None},
        "open, both": {"closed": False, "start": int(order[0]), "end": int(order[-1]) if n > 1 else None},
        "open, order": {"closed": False, "before": pairs},
    }[kind]
    return uniform_problem(seed, sizes, service=True, share_missing=share_missing, **ends)


KINDS = ["closed", "closed, start", "open", "open, start", "open, end", "open, both", "open, order"]


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_the_proven_sequence_is_that_of_brute_force(kind, seed):
    problem = small_problem(seed, kind)
    found = solve_sequence(problem, rng(), n_rounds=200)
    assert found.proven and found.stopped_by == "proof" and found.gap == 0.0
    assert problem.violation(found.nodes) is None
    assert found.cost == pytest.approx(problem.cost_of(found.nodes), abs=1e-9)
    assert found.cost == pytest.approx(brute_force(problem), abs=1e-7)


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(KINDS))
@settings(max_examples=40, deadline=None)
def test_missing_ways_are_not_taken(seed, kind):
    problem = small_problem(seed, kind, share_missing=0.35)
    least = brute_force(problem)
    try:
        found = solve_sequence(problem, rng(), n_rounds=200)
    except InfeasibleError:
        assert least == np.inf
    else:
        assert found.proven and found.cost == pytest.approx(least, abs=1e-7)


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(KINDS))
@settings(max_examples=25, deadline=None)
def test_the_programme_finds_the_optimum_from_any_tour(seed, kind):
    """Without any search: bounds and dynamic programming alone, from the first tour that respects the order."""
    problem = small_problem(seed, kind)
    if problem.n_clusters == 1:
        return
    form = tour_form(problem)
    start = np.array(form.first[:-1], np.int32)
    order = [0, *(1 + np.argsort(form.earlier[1:, 1:].sum(axis=0), kind="stable"))]
    proof = prove(form, start[order], max_work=1e9, memory=1 << 26)
    assert proof.stopped_by == "proof"
    assert proof.cost == pytest.approx(brute_force(problem), abs=1e-7)


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(KINDS), n_bits=st.integers(0, 4))
@settings(max_examples=30, deadline=None)
def test_bounds_stay_below_the_optimum_also_after_shrinking(seed, kind, n_bits):
    problem = small_problem(seed, kind)
    if problem.n_clusters == 1:
        return
    form, optimum = tour_form(problem), brute_force(problem)
    relaxed = bounding(form, np.arange(form.first[1], dtype=np.int32))
    # a ceiling above the optimum: shrinking must keep every cheaper sequence, and so the bound below the optimum
    ceiling = 1.02 * optimum + 1e-6
    for _ in range(3):
        remember_nearest(relaxed, n_bits)
        raise_bound(relaxed, ceiling, np.inf, 30)
        remember_cycles(relaxed, n_bits + 2)
        raise_bound(relaxed, ceiling, np.inf, 10)
        assert relaxed.bound <= optimum + 1e-7
        assert shrink(relaxed, ceiling)


@pytest.mark.parametrize("seed", range(4))
def test_memories_learn_from_cycles_until_the_bound_has_risen(seed):
    form = tour_form(robot_problem(seed, [4] * 10, closed=False)[0])
    upper = TourSearch(form, rng(seed)).run(500).cost
    relaxed = bounding(form, np.array([0], np.int32))
    raise_bound(relaxed, upper, np.inf, 60)
    before, walk = relaxed.bound, relaxed.walk.tolist()
    assert len(set(walk)) < len(walk), "the cheapest walk comes back to a cluster"
    for _ in range(12):
        if not remember_cycles(relaxed, 5):
            break
        least, _ = Walks(relaxed).solve(relaxed.multiplier)
        assert least >= relaxed.bound - 1e-9 * upper, "at the same prices more memory never lowers it"
        raise_bound(relaxed, upper, np.inf, 15, length=0.2)
    assert before + 1e-6 * upper < relaxed.bound <= upper * (1.0 + 1e-9)


def test_memories_stay_within_the_bytes_of_their_tables(monkeypatch):
    form = tour_form(robot_problem(0, [4] * 10, closed=False)[0])
    relaxed = bounding(form, np.array([0], np.int32))
    raise_bound(relaxed, 1e4, np.inf, 5)
    a_table = 8 * (relaxed.n_clusters + 1) * len(relaxed.node)
    monkeypatch.setattr("cellwright.solvers.gtsp.bounds.MOST_BYTES", 4 * a_table)
    remember_nearest(relaxed, 6)
    assert not remember_cycles(relaxed, 6)
    assert relaxed.n_masks == 4 and Walks(relaxed).rest.nbytes <= 4 * a_table


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(KINDS))
@settings(max_examples=30, deadline=None)
def test_a_proof_until_something_cheaper_finds_that_or_is_a_whole_one(seed, kind):
    problem = small_problem(seed, kind)
    if problem.n_clusters == 1:
        return
    form, optimum = tour_form(problem), brute_force(problem)
    order = [0, *(1 + np.argsort(form.earlier[1:, 1:].sum(axis=0), kind="stable"))]
    start = np.array(form.first[:-1], np.int32)[order]
    proof = prove(form, start, max_work=1e9, memory=1 << 26, until_cheaper=True)
    assert proof.bound <= optimum + 1e-7
    if proof.stopped_by == "cheaper":
        assert proof.cost < form.tour_cost(start)
    else:
        assert proof.stopped_by == "proof" and proof.cost == pytest.approx(optimum, abs=1e-7)


def test_alternatives_of_a_fixed_order_are_the_best_ones():
    problem = uniform_problem(5, [3, 2, 4, 3])
    form = tour_form(problem)
    owner = np.repeat(np.arange(4, dtype=np.int32), np.diff(form.first))
    tour = np.array(form.first[:-1], np.int32)
    cost = cluster_nodes(tour, owner, form.cost, form.first, True)
    own = [range(form.first[i], form.first[i + 1]) for i in range(4)]
    assert cost == pytest.approx(form.tour_cost(tour))
    assert cost == pytest.approx(min(form.tour_cost(np.array(t)) for t in itertools.product(*own)))


@pytest.mark.parametrize("seed", range(3))
def test_local_search_respects_what_comes_first(seed):
    generator = rng(seed)
    order, pairs = precedence(generator, 12)
    problem = uniform_problem(seed, [3] * 12, closed=False, before=pairs)
    form = tour_form(problem)
    owner = np.repeat(np.arange(13, dtype=np.int32), np.diff(form.first))
    place = {int(problem.clusters[i][0]): i for i in range(12)}
    at = {place[int(form.node[form.first[k]])]: k for k in range(1, 13)}
    tour = form.first[[0, *(at[int(i)] for i in order)]].astype(np.int32)
    before = form.tour_cost(tour)
    after = improve_tour(tour, owner, form.cost, form.first, form.earlier, 1e-9)
    assert after < before and after == pytest.approx(form.tour_cost(tour))
    assert problem.violation(form.node[tour][1:]) is None


@pytest.mark.parametrize("kind", ["search", "exact"])
def test_precedence_holds_in_larger_problems(kind):
    _, pairs = precedence(rng(1), 14)
    problem = uniform_problem(2, [3] * 14, closed=False, before=pairs)
    found = solve_sequence(problem, rng(), method=kind, n_rounds=2_000)
    assert problem.violation(found.nodes) is None
    assert found.lower_bound <= found.cost


@pytest.mark.parametrize(
    "problem",
    [
        robot_problem(0, (6, 8, 16, 12, 9, 10, 6, 7, 6, 11))[0],
        plane_problem(1, 10, 8),
        plane_problem(2, 9, 6, spread=np.inf),
        uniform_problem(3, [7] * 9),
    ],
    ids=["robot", "clusters in the plane", "anywhere in the plane", "no structure"],
)
def test_the_proof_agrees_with_plain_dynamic_programming(problem):
    from cellwright.solvers.sweeps.order_kernels import held_karp

    found = solve_sequence(problem, rng(), n_rounds=500)
    assert found.proven
    m, own = problem.n_alternatives, problem.clusters
    least = np.inf
    for depot in own[0]:  # the sweeps' kernel knows one start: the others are ordered from each alternative of task 0
        rest = [*range(int(own[0][-1]) + 1, m), int(depot)]
        first = (np.array([c[0] for c in own[1:]] + [m]) - len(own[0])).astype(np.int32)
        cost = problem.cost[np.ix_(rest, rest)]
        totals, _, _ = held_karp(cost, problem.service[rest[:-1]].copy(), first, np.inf)
        least = min(least, float(totals.min()) + float(problem.service[depot]))
    assert found.cost == pytest.approx(least, abs=1e-7)


def test_the_same_seed_gives_the_same_sequence_whatever_the_threads():
    problem, _ = robot_problem(3, [6] * 30)
    runs = [
        solve_sequence(problem, rng(7), method="search", n_rounds=1_500, max_work=1e8, n_threads=n) for n in (1, 2, 2)
    ]
    assert np.array_equal(runs[0].nodes, runs[1].nodes) and np.array_equal(runs[1].nodes, runs[2].nodes)
    assert {run.cost for run in runs} == {runs[0].cost} and {run.lower_bound for run in runs} == {runs[0].lower_bound}


def test_a_time_limit_returns_a_sequence_with_its_gap():
    problem, _ = robot_problem(4, [8] * 25)
    asked = itertools.count()
    found = solve_sequence(problem, rng(), stop=lambda: next(asked) >= 1)
    assert found.stopped_by == "stop" and not found.proven
    assert problem.violation(found.nodes) is None
    assert 0.0 < found.lower_bound < found.cost and 0.0 < found.gap < 1.0


def test_a_time_limit_that_is_over_at_once_still_returns_a_sequence():
    problem, _ = robot_problem(4, [8] * 25)
    found = solve_sequence(problem, rng(), stop=lambda: True)
    assert found.stopped_by == "stop" and problem.violation(found.nodes) is None and found.lower_bound > 0.0


def test_a_memory_ceiling_leaves_a_bound_instead_of_a_proof():
    problem = plane_problem(4, 17, 4, spread=np.inf)
    full = solve_sequence(problem, rng(), n_rounds=500)
    tight = solve_sequence(problem, rng(), n_rounds=500, memory=500)
    assert full.proven
    assert tight.lower_bound <= full.cost <= tight.cost
    assert problem.violation(tight.nodes) is None
    assert not tight.proven and tight.stopped_by == "memory"


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2**20, 2**34]))
def test_large_whole_numbers_that_differ_by_ones_are_told_apart(seed, size):
    generator = rng(seed)
    cost = size + generator.integers(0, 4, (12, 12)).astype(float)
    problem = SequencingProblem(cost, groups([2] * 6))
    found = solve_sequence(problem, rng(), n_rounds=1)
    assert found.lower_bound <= brute_force(problem) <= found.cost
    assert found.proven


def test_whole_numbers_too_large_for_that_are_proven_to_a_billionth():
    assert tour_form(SequencingProblem(np.full((6, 6), 2.0**34), groups([2, 2, 2]))).integral
    large = tour_form(SequencingProblem(np.full((6, 6), 2.0**39), groups([2, 2, 2])))
    assert not large.integral and large.below(3 * 2.0**39) > 3 * 2.0**39 * (1.0 - 2e-9)


def test_every_cycle_after_the_first_begins_with_a_double_bridge(monkeypatch):
    """Even the second, in the first run, and if all chains have come to tours of the same cost."""
    from cellwright.solvers.gtsp import search

    kicked = []

    def counted(tour, owner, form, generator):
        kicked.append(len(tour))
        return tour

    monkeypatch.setattr(search, "_double_bridge", counted)
    form = tour_form(SequencingProblem(np.ones((12, 12)), groups([2] * 6)))
    TourSearch(form, rng()).run(search.FIRST_CYCLE)
    assert kicked == []
    TourSearch(form, rng()).run(search.FIRST_CYCLE + 1)
    assert kicked == [6]


def test_search_goes_on_from_a_known_sequence():
    problem, _ = robot_problem(5, [5] * 26)
    good = solve_sequence(problem, rng(), method="search", n_rounds=3_000, max_work=1e7)
    again = solve_sequence(problem, rng(1), method="search", n_rounds=1, max_work=1e7, known=[good.nodes])
    assert again.cost <= good.cost
    with pytest.raises(InvalidInputError, match="visits 3 of 26"):
        solve_sequence(problem, rng(), known=[[0, 5, 10]])


@pytest.mark.parametrize("setting", [{"method": "magic"}, {"n_rounds": 0}, {"memory": -1}, {"max_work": 0.0}])
def test_settings_out_of_range_are_refused(setting):
    with pytest.raises(InvalidInputError, match=next(iter(setting))):
        solve_sequence(uniform_problem(0, [2, 2]), rng(), **setting)


def test_compiling_ahead_reaches_every_kernel():
    from cellwright.solvers.gtsp import anneal, kernels, states, walks

    compile_kernels()
    entries = [anneal.anneal, anneal.nearest_nodes, kernels.improve_tour, states.next_layer]
    entries += [
        getattr(walks, name)
        for name in ("memory_steps", "complete_walks", "cheapest_walk", "least_within", "through_nodes", "drop_ways")
    ]
    assert all(len(kernel.signatures) == 1 for kernel in entries)


@pytest.mark.parametrize("scale", [0.0, 1e-7, 1e9])
def test_the_unit_of_the_costs_does_not_matter(scale):
    problem = uniform_problem(8, [3] * 7)
    scaled = SequencingProblem(scale * problem.cost, problem.clusters)
    found = solve_sequence(scaled, rng(), n_rounds=500)
    assert found.proven
    assert found.cost == pytest.approx(scale * solve_sequence(problem, rng(), n_rounds=500).cost, rel=1e-8)


def test_one_cluster_is_its_cheapest_alternative():
    problem = SequencingProblem(np.zeros((3, 3)), ((0, 1, 2),), np.array([3.0, 1.0, 2.0]))
    found = solve_sequence(problem, rng())
    assert found.nodes.tolist() == [1] and found.cost == 1.0 and found.proven


def test_a_problem_without_sequence_is_told():
    cost = np.full((3, 3), np.inf)
    cost[0, 1] = cost[1, 0] = cost[1, 2] = cost[2, 1] = 1.0
    with pytest.raises(InfeasibleError, match="there is no sequence without a missing way"):
        solve_sequence(SequencingProblem(cost, groups([1, 1, 1])), rng())


@pytest.mark.skipif(not PUBLIC.is_dir(), reason="the public GTSPLIB files are not beside the project")
def test_a_public_problem_reaches_its_best_known_tour():
    problem = read_gtsplib(PUBLIC / "39rat195.gtsp")
    search = TourSearch(tour_form(problem), rng())
    assert search.run(20_000, target=854.0).cost == 854.0
