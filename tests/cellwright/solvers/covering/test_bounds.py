import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from cellwright.errors import InvalidInputError
from cellwright.solvers.covering.relaxation import solve_relaxation
from cellwright.solvers.set_cover import cover_matrix, lower_bound
from tests.cellwright.solvers.cover_instances import cheapest, small_problems, strips_on_cylinder


def linear_optimum(matrix, costs, n_spare=0):
    """The relaxation with slack variables for rows that may stay uncovered."""
    m, n = matrix.shape
    rows = np.concatenate([np.hstack([-matrix.astype(float), -np.eye(m)]), np.r_[np.zeros(n), np.ones(m)][None]])
    limits = np.r_[-np.ones(m), n_spare]
    return linprog(np.r_[costs, np.zeros(m)], A_ub=rows, b_ub=limits, bounds=[(0, None)] * n + [(0, 1)] * m).fun


@given(small_problems(), st.integers(0, 3), st.integers(1, 60))
@settings(deadline=None)
def test_the_lagrangian_bound_never_exceeds_the_linear_optimum(problem, n_spare, n_steps):
    matrix, costs = problem
    needed = max(0, matrix.shape[0] - n_spare)
    found = lower_bound(matrix, costs, n_steps=n_steps, n_needed=needed)
    assert found.value <= linear_optimum(matrix, costs, n_spare) + 1e-6
    assert found.value <= cheapest(matrix, costs, needed) + 1e-9
    assert np.all(found.duals >= 0)


@given(small_problems(), st.integers(0, 2))
@settings(deadline=None)
def test_column_generation_reaches_the_linear_optimum_from_any_prices(problem, n_spare):
    matrix, costs = problem
    spare = min(n_spare, matrix.shape[0] - 1)
    relaxed = solve_relaxation(cover_matrix(matrix, costs), np.zeros(matrix.shape[0]), n_spare=spare)
    assert relaxed.solved
    assert relaxed.value == pytest.approx(linear_optimum(matrix, costs, spare), abs=1e-6)


def test_on_strips_the_lagrangian_bound_is_close_to_the_linear_optimum_and_pricing_reaches_it():
    matrix = strips_on_cylinder(150, 3000)
    exact = linear_optimum(matrix, np.ones(3000))
    priced = lower_bound(matrix)
    relaxed = solve_relaxation(cover_matrix(matrix), priced.duals)
    assert 0.9 * exact <= priced.value <= exact + 1e-6
    assert relaxed.value == pytest.approx(exact, abs=1e-5)
    assert cover_matrix(matrix).bound(relaxed.duals) == pytest.approx(relaxed.value)


def test_a_relaxation_that_runs_out_of_work_still_gives_a_valid_bound():
    matrix = strips_on_cylinder(150, 3000)
    start = lower_bound(matrix, n_steps=20)
    short = solve_relaxation(cover_matrix(matrix), start.duals, max_work=3e5)
    assert not short.solved
    assert start.value <= short.value <= linear_optimum(matrix, np.ones(3000)) + 1e-6


def test_more_rows_than_can_be_covered_are_refused():
    with pytest.raises(InvalidInputError, match="3 rows are to be covered but only 2"):
        lower_bound(np.array([[1], [1], [0]], bool), n_needed=3)


def test_nothing_to_cover_costs_nothing():
    assert lower_bound(np.zeros((2, 2), bool)).value == 0.0
