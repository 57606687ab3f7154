import numpy as np
import pytest
from hypothesis import given, settings

from cellwright.solvers.set_cover import cover_matrix, reduce_cover
from tests.cellwright.solvers.cover_instances import cheapest, small_problems


def dense(matrix):
    found = np.zeros((matrix.n_rows, matrix.n_columns), bool)
    found[matrix.column_rows, matrix.entry_columns()] = True
    return found


@given(small_problems())
@settings(deadline=None)  # the first call compiles
def test_the_optimum_survives_all_reductions(problem):
    matrix, costs = problem
    reduced = reduce_cover(cover_matrix(matrix, costs))
    left = cheapest(dense(reduced.matrix), reduced.matrix.costs) if reduced.matrix.n_rows else 0.0
    assert left + costs[reduced.essential].sum() == pytest.approx(cheapest(matrix, costs))


@given(small_problems())
@settings(deadline=None)  # the first call compiles
def test_nothing_is_left_to_reduce(problem):
    matrix, costs = problem
    left = reduce_cover(cover_matrix(matrix, costs)).matrix
    found = dense(left)
    assert np.all(left.row_sizes != 1)
    for j in range(left.n_columns):
        for k in range(left.n_columns):
            inside = not np.any(found[:, j] & ~found[:, k])
            assert j == k or not (inside and left.costs[k] <= left.costs[j])
    for i in range(left.n_rows):
        for k in range(left.n_rows):
            assert i == k or np.any(found[i] & ~found[k])


@given(small_problems())
@settings(deadline=None)  # the first call compiles
def test_reduced_columns_keep_their_names_and_rows(problem):
    matrix, costs = problem
    reduced = reduce_cover(cover_matrix(matrix, costs))
    assert np.array_equal(dense(reduced.matrix), matrix[np.ix_(reduced.rows, reduced.columns)])
    assert np.array_equal(reduced.matrix.costs, costs[reduced.columns])


@given(small_problems())
@settings(deadline=None)  # the first call compiles
def test_columns_only_keeps_every_partial_optimum(problem):
    matrix, costs = problem
    reduced = reduce_cover(cover_matrix(matrix, costs), columns_only=True)
    assert len(reduced.essential) == 0
    assert len(reduced.rows) == len(matrix)
    for needed in range(1, len(matrix) + 1):
        assert cheapest(dense(reduced.matrix), reduced.matrix.costs, needed) == cheapest(matrix, costs, needed)


def test_of_equal_columns_the_lower_tie_stays_then_the_lower_index():
    matrix = cover_matrix(np.array([[1, 1, 1, 1, 0], [1, 1, 1, 0, 1], [0, 0, 0, 1, 1]], bool))
    assert reduce_cover(matrix).columns.tolist() == [0, 3, 4]
    assert reduce_cover(matrix, np.array([3.0, 1.0, 1.0, 0.0, 0.0])).columns.tolist() == [1, 3, 4]


def test_an_essential_column_takes_its_rows_along():
    matrix = cover_matrix(np.array([[1, 0, 0], [1, 1, 1], [0, 1, 1]], bool))
    reduced = reduce_cover(matrix)
    assert reduced.essential.tolist() == [0, 1]
    assert reduced.matrix.n_rows == 0
    assert reduced.restore(np.empty(0, np.int64)).tolist() == [0, 1]
