import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.solvers.covering import tree as set_cover_tree
from cellwright.solvers.covering.leaf import search_leaf
from cellwright.solvers.covering.search import improve_cover
from cellwright.solvers.covering.tree import search_tree
from cellwright.solvers.set_cover import cover_best, cover_exactly, cover_matrix, reduce_cover
from tests.cellwright.solvers.cover_instances import cheapest, small_problems, strips_on_cylinder


@given(small_problems(), st.sampled_from([1.0, 0.6]))
@settings(max_examples=60, deadline=None)
def test_the_integer_program_is_as_cheap_as_brute_force(problem, share):
    matrix, costs = problem
    needed = math.ceil(share * matrix.shape[0] - 1e-9)
    found = cover_exactly(matrix, costs, min_coverage=share)
    assert found.proven
    assert found.cost == pytest.approx(cheapest(matrix, costs, needed))
    assert found.lower_bound == pytest.approx(found.cost)
    assert matrix[:, found.columns].any(axis=1).sum() >= needed


def test_integer_program_and_own_tree_agree_on_strips():
    matrix = strips_on_cylinder(80, 500, seed=1)
    exact, best = cover_exactly(matrix), cover_best(matrix)
    assert exact.proven
    assert best.proven
    assert exact.cost == best.cost


def test_one_node_leaves_a_cover_and_an_honest_gap():
    matrix = strips_on_cylinder(200, 2500, seed=2)
    found = cover_exactly(matrix, node_limit=1, time_limit_s=20.0)
    assert matrix[:, found.columns].any(axis=1).all()
    assert found.lower_bound <= found.cost
    assert found.proven or (found.stopped_by in ("nodes", "time") and found.gap > 0)


def test_no_time_leaves_the_cover_of_the_start_and_says_so():
    matrix = strips_on_cylinder(200, 2500, seed=2)
    found = cover_exactly(matrix, time_limit_s=1e-6)
    assert not found.proven
    assert found.stopped_by == "time"
    assert found.gap > 0
    assert matrix[:, found.columns].any(axis=1).all()


@given(small_problems(), st.integers(0, 2))
@settings(deadline=None)
def test_a_leaf_finds_a_cover_exactly_when_the_budget_allows_one(problem, below):
    matrix, costs = problem
    optimum = cheapest(matrix, costs)
    chosen, final, _ = search_leaf(cover_matrix(matrix, costs), np.zeros(len(matrix)), optimum - below, 1e9)
    assert final
    assert (chosen is not None) == (below == 0)
    if chosen is not None:
        assert matrix[:, chosen].any(axis=1).all()
        assert costs[chosen].sum() <= optimum + 1e-9


@given(small_problems(), st.integers(0, 2))
@settings(max_examples=60, deadline=None)
def test_pair_branching_finds_a_cover_exactly_when_the_budget_allows_one(problem, below):
    matrix, costs = problem
    optimum = cheapest(matrix, costs)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(set_cover_tree, "_LEAF_COLUMNS", 0)
        outcome = search_tree(cover_matrix(matrix, costs), np.zeros(len(matrix)), optimum - below, max_work=1e9)
    assert outcome.closed
    assert (outcome.columns is not None) == (below == 0)
    if outcome.columns is not None:
        assert matrix[:, outcome.columns].any(axis=1).all()
        assert costs[outcome.columns].sum() <= optimum + 1e-9


def test_pair_branching_closes_where_the_relaxation_does_not(monkeypatch):
    monkeypatch.setattr(set_cover_tree, "_LEAF_COLUMNS", 20)
    matrix = strips_on_cylinder(80, 500, seed=1)
    optimum = cover_exactly(matrix).cost
    reduced = reduce_cover(cover_matrix(matrix))
    duals = np.zeros(reduced.matrix.n_rows)
    inside = search_tree(reduced.matrix, duals, optimum - len(reduced.essential), max_work=1e10)
    below = search_tree(reduced.matrix, duals, optimum - len(reduced.essential) - 1, max_work=1e10)
    assert inside.columns is not None
    assert below.columns is None
    assert below.closed
    assert below.n_nodes > 1


def test_a_leaf_without_work_is_not_final():
    matrix = strips_on_cylinder(80, 500, seed=1)
    chosen, final, _ = search_leaf(cover_matrix(matrix), np.zeros(len(matrix)), 9.0, 1e3)
    assert chosen is None
    assert not final


@given(small_problems(), st.integers(0, 3), st.integers(0, 2))
@settings(deadline=None)  # the first call compiles
def test_the_local_search_covers_and_never_gets_dearer(problem, seed, n_spare):
    matrix, costs = problem
    start = np.arange(matrix.shape[1])
    found = improve_cover(cover_matrix(matrix, costs), start, max_work=2e4, n_spare=n_spare, seed=seed)
    assert matrix[:, found].any(axis=1).sum() >= len(matrix) - n_spare
    assert costs[found].sum() <= costs.sum()


def test_the_local_search_depends_on_its_seed_and_work_alone():
    matrix = cover_matrix(strips_on_cylinder(200, 2500, seed=2))
    start = np.arange(matrix.n_columns)
    first = improve_cover(matrix, start, max_work=3e7, seed=4)
    assert improve_cover(matrix, start, max_work=3e7, seed=4).tolist() == first.tolist()
    assert len(improve_cover(matrix, start, max_work=3e7, target=len(first) + 2, seed=4)) <= len(first) + 2
