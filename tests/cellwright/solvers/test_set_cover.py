import math
import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.set_cover import Cover, cover_best, cover_greedily, cover_matrix
from tests.cellwright.solvers.cover_instances import cheapest, rail_problem, small_problems, strips_on_cylinder


def naive_greedy(matrix, costs, tie, n_needed):
    covered, chosen = np.zeros(matrix.shape[0], bool), []
    while covered.sum() < n_needed:
        gains = (matrix & ~covered[:, None]).sum(axis=0)
        best = min(range(matrix.shape[1]), key=lambda j: (-gains[j] / costs[j], tie[j], j))
        chosen.append(best)
        covered |= matrix[:, best]
    return chosen


def assert_covers(found: Cover, matrix, costs, n_needed=None):
    needed = matrix.shape[0] if n_needed is None else n_needed
    assert matrix[:, found.columns].any(axis=1).sum() >= needed
    assert found.cost == pytest.approx(costs[found.columns].sum())
    assert np.all(np.diff(found.columns) > 0)


@given(small_problems(), st.sampled_from([1.0, 0.7, 0.3]))
@settings(deadline=None)  # the first call compiles
def test_greedy_chooses_what_a_naive_greedy_chooses(problem, share):
    matrix, costs = problem
    tie = np.arange(matrix.shape[1])[::-1] // 2
    needed = math.ceil(share * matrix.shape[0] - 1e-9)
    found = cover_greedily(matrix, costs, tie=tie, min_coverage=share)
    assert found.order.tolist() == naive_greedy(matrix, costs, tie, needed)


@given(small_problems())
@settings(deadline=None)  # the first call compiles
def test_greedy_keeps_its_guarantee_and_its_bound_holds(problem):
    matrix, costs = problem
    found = cover_greedily(matrix, costs)
    optimum = cheapest(matrix, costs)
    assert found.cost <= (1 + math.log(matrix.sum(axis=0).max())) * optimum + 1e-9
    assert found.lower_bound <= optimum + 1e-9
    assert not found.proven or found.cost == pytest.approx(optimum)


def test_ties_go_to_the_lower_tie_value_then_to_the_lowest_column():
    matrix = np.array([[1, 1, 1, 0], [1, 1, 1, 0], [0, 0, 0, 1]], bool)
    assert cover_greedily(matrix).order.tolist() == [0, 3]
    assert cover_greedily(matrix, tie=np.array([2.0, 1.0, 1.0, 0.0])).order.tolist() == [1, 3]


@given(small_problems(), st.sampled_from([1.0, 1.0, 0.6]))
@settings(max_examples=150, deadline=None)
def test_best_is_as_cheap_as_brute_force_and_proves_whole_covers(problem, share):
    matrix, costs = problem
    needed = math.ceil(share * matrix.shape[0] - 1e-9)
    found = cover_best(matrix, costs, min_coverage=share, max_work=1e7)
    optimum = cheapest(matrix, costs, needed)
    assert_covers(found, matrix, costs, needed)
    assert found.lower_bound <= optimum + 1e-6
    assert found.cost >= optimum - 1e-9
    if share == 1.0:
        assert found.proven
        assert found.cost == pytest.approx(optimum)
    assert not found.proven or found.cost == pytest.approx(optimum)


@given(small_problems())
@settings(max_examples=50, deadline=None)
def test_costs_that_are_not_whole_are_covered_as_cheaply_as_can_be(problem):
    matrix, whole = problem
    costs = whole * 0.37 + 0.011 * np.arange(len(whole))
    costs = np.maximum(costs, 0.1)
    found = cover_best(matrix, costs, max_work=1e7)
    assert found.proven
    assert found.cost == pytest.approx(cheapest(matrix, costs), rel=1e-4)


def test_strips_are_covered_with_fewer_than_greedy_takes_and_the_proof_closes():
    matrix = strips_on_cylinder(120, 1200, seed=4)
    found, greedy = cover_best(matrix), cover_greedily(matrix)
    assert_covers(found, matrix, np.ones(matrix.shape[1]))
    assert found.proven
    assert found.stopped_by == "optimality"
    assert found.cost < greedy.cost
    assert found.method in ("search", "tree")


def test_little_work_gives_a_cover_with_an_honest_gap():
    matrix = strips_on_cylinder(200, 2500, seed=2)
    small, large = cover_best(matrix, max_work=2e6), cover_best(matrix)
    assert_covers(small, matrix, np.ones(matrix.shape[1]))
    assert not small.proven
    assert small.stopped_by == "work"
    assert small.gap > 0
    assert small.lower_bound <= large.cost <= small.cost <= cover_greedily(matrix).cost


def test_the_result_depends_neither_on_threads_nor_on_the_run():
    matrix = strips_on_cylinder(200, 2500, seed=2)
    first = cover_best(matrix, max_work=3e8, n_threads=1)
    for n_threads in (1, 2, 4):
        again = cover_best(matrix, max_work=3e8, n_threads=n_threads)
        assert again.columns.tolist() == first.columns.tolist()
        assert again.lower_bound == first.lower_bound


def test_a_node_limit_stops_the_tree_and_is_reported():
    matrix = strips_on_cylinder(200, 2500, seed=2)
    found = cover_best(matrix, node_limit=1)
    assert not found.proven
    assert found.stopped_by == "nodes"


def test_every_form_of_the_matrix_means_the_same():
    dense = strips_on_cylinder(60, 200)
    sparse = scipy.sparse.csc_matrix(dense)
    forms = (
        dense,
        sparse,
        scipy.sparse.csr_array(dense),
        (sparse.indptr, sparse.indices),
        (sparse.indptr, sparse.indices, dense.shape[0]),
        cover_matrix(dense),
    )
    covers = {tuple(cover_greedily(form).order.tolist()) for form in forms}
    assert len(covers) == 1


def test_entries_given_twice_count_once():
    matrix = cover_matrix((np.array([0, 3, 4]), np.array([1, 0, 1, 1])))
    assert matrix.column_rows.tolist() == [0, 1, 1]
    assert matrix.row_columns.tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    ("matrix", "costs", "words"),
    [
        ((np.array([0, 2, 1]), np.array([0, 1])), None, "column starts"),
        ((np.array([0, 1]), np.array([-1])), None, "rows run from -1"),
        ((np.array([0, 1]), np.array([5]), 3), None, "has 3 rows"),
        (np.ones((2, 2), bool), [1.0], "1 costs for 2 columns"),
        (np.ones((2, 2), bool), [1.0, 0.0], "column 1 costs 0.0"),
        (np.ones((2, 2), bool), [1.0, np.nan], "column 1 costs nan"),
        (np.ones(3, bool), None, "shape (3,)"),
    ],
)
def test_malformed_matrices_and_costs_are_refused_with_their_numbers(matrix, costs, words):
    with pytest.raises(InvalidInputError) as caught:
        cover_best(matrix, costs)
    assert words in str(caught.value)


@pytest.mark.parametrize("share", [0.0, -1.0, 1.5, np.nan])
def test_a_share_outside_zero_to_one_is_refused(share):
    with pytest.raises(InvalidInputError, match="min_coverage"):
        cover_greedily(np.ones((2, 2), bool), min_coverage=share)


def test_a_matrix_that_covers_nothing_has_no_cover():
    with pytest.raises(InfeasibleError, match="none of the 3 columns"):
        cover_best(np.zeros((2, 3), bool))


def test_rows_that_nothing_covers_are_left_out_of_account():
    matrix = np.array([[0, 0], [1, 0], [0, 1]], bool)
    assert cover_best(matrix).columns.tolist() == [0, 1]
    assert cover_greedily(matrix, min_coverage=0.5).columns.tolist() == [0]


def test_importing_the_solvers_does_not_import_highs():
    code = "import sys, cellwright.solvers.set_cover; sys.exit('highspy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize(("name", "best_known", "at_most"), [("rail516", 182, 182), ("rail507", 174, 177)])
def test_crew_schedules_come_close_to_the_best_known(name, best_known, at_most):
    matrix, costs = rail_problem(name)
    found = cover_best(matrix, costs)
    assert found.lower_bound <= best_known + 1e-6
    assert best_known <= found.cost <= at_most
    assert np.all(cover_matrix(matrix, costs).times_covered(found.columns) > 0)
