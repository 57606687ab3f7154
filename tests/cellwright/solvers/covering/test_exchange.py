import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InvalidInputError
from cellwright.solvers.set_cover import cover_greedily, cover_matrix, exchange_columns, smallest_uncertainty
from tests.cellwright.solvers.cover_instances import small_problems


@given(small_problems(), st.integers(0, 10_000))
@settings(deadline=None)  # the first call compiles
def test_exchanges_keep_the_cover_and_its_cost_and_lower_the_uncertainty(problem, seed):
    dense, costs = problem
    matrix = cover_matrix(dense, costs)
    uncertainty = np.random.default_rng(seed).uniform(1.0, 9.0, len(matrix.column_rows))
    before = cover_greedily(matrix).columns
    after = exchange_columns(matrix, before, uncertainty)
    assert dense[:, after].any(axis=1).all()
    assert costs[after].sum() <= costs[before].sum()
    was, now = (smallest_uncertainty(matrix, columns, uncertainty).sum() for columns in (before, after))
    assert now <= was + 1e-9
    for out in after:
        for entry in range(matrix.n_columns):
            trial = np.union1d(np.setdiff1d(after, [out]), [entry])
            if costs[entry] <= costs[out] and len(trial) == len(after) and dense[:, trial].any(axis=1).all():
                alone = ~dense[:, np.setdiff1d(after, [out])].any(axis=1)
                if alone.any():
                    assert smallest_uncertainty(matrix, trial, uncertainty).sum() >= now - 1e-6


def test_of_two_equal_columns_the_one_of_lower_uncertainty_is_taken():
    matrix = cover_matrix(np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]], bool))
    uncertainty = np.array([5.0, 5.0, 2.0, 3.0, 1.0])
    assert exchange_columns(matrix, np.array([0, 2]), uncertainty).tolist() == [1, 2]


def test_a_missing_uncertainty_is_refused():
    with pytest.raises(InvalidInputError, match="2 uncertainties for 3 entries"):
        exchange_columns(cover_matrix(np.ones((3, 1), bool)), np.array([0]), np.ones(2))
