from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from cellwright.solvers.parameter_rates import fastest_rates
from cellwright.solvers.path_timing import trapezoid_time


class PeerPath:
    """A path as toppra calls it."""

    def __init__(self, path, grid):
        self.path, self.path_interval, self.dof = path, grid[[0, -1]], path(0.0).shape[0]
        self.duration = float(grid[-1] - grid[0])

    def __call__(self, s, order=0):
        return self.path(np.atleast_1d(s), order)


def rates_of_peer(path, grid, velocity, acceleration):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # toppra's docstrings hold invalid escapes
        from toppra import algorithm, constraint
    bounds = [
        constraint.JointVelocityConstraint(np.stack([-velocity, velocity], axis=1)),
        constraint.JointAccelerationConstraint(
            np.stack([-acceleration, acceleration], axis=1),
            discretization_scheme=constraint.DiscretizationType.Interpolation,
        ),
    ]
    solver = algorithm.TOPPRA(bounds, PeerPath(path, grid), gridpoints=grid, solver_wrapper="seidel")
    return solver.compute_parameterization(0.0, 0.0)[1]


def duration(grid, rate):
    return float((2.0 * np.diff(grid) / (rate[:-1] + rate[1:])).sum())


@pytest.mark.parametrize("seed", range(8))
def test_rates_are_as_fast_as_those_of_a_peer(seed):
    rng = np.random.default_rng(seed)
    knots = np.linspace(0.0, 1.0, rng.integers(3, 10))
    path = CubicSpline(knots, rng.uniform(-2.0, 2.0, (len(knots), 6)))
    velocity, acceleration = rng.uniform(1.0, 3.0, 6), rng.uniform(2.0, 10.0, 6)
    grid = np.linspace(0.0, 1.0, 121)
    ours = fastest_rates(path(grid, 1), path(grid, 2), grid, velocity, acceleration)
    peer = rates_of_peer(path, grid, velocity, acceleration)
    assert duration(grid, ours) == pytest.approx(duration(grid, peer), rel=1e-4)
    assert ours[0] == ours[-1] == 0.0


@pytest.mark.parametrize("seed", range(8))
def test_rates_keep_all_limits_at_both_ends_of_each_interval(seed):
    rng = np.random.default_rng(seed)
    knots = np.linspace(0.0, 1.0, 6)
    path = CubicSpline(knots, rng.uniform(-2.0, 2.0, (6, 4)))
    velocity, acceleration = rng.uniform(1.0, 3.0, 4), rng.uniform(2.0, 10.0, 4)
    grid = np.linspace(0.0, 1.0, 80)
    first, second = path(grid, 1), path(grid, 2)
    square = fastest_rates(first, second, grid, velocity, acceleration) ** 2
    assert np.all(np.abs(first) * np.sqrt(square)[:, None] <= velocity * (1 + 1e-9))
    change = (np.diff(square) / (2.0 * np.diff(grid)))[:, None]
    for end in (slice(0, -1), slice(1, None)):
        accelerations = first[end] * change + second[end] * square[end, None]
        assert np.all(np.abs(accelerations) <= acceleration * (1 + 1e-6))


def test_a_straight_path_takes_its_trapezoid():
    grid = np.linspace(0.0, 1.0, 1001)
    first = np.tile([2.0, -1.0], (1001, 1))
    rate = fastest_rates(first, np.zeros_like(first), grid, np.array([1.0, 2.0]), np.array([3.0, 3.0]))
    assert duration(grid, rate) == pytest.approx(float(trapezoid_time(np.array(2.0), 1.0, 3.0)), rel=1e-3)
