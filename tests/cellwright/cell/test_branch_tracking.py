from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.branch_tracking import solve_paths
from cellwright.cell.inverse_kinematics import inverse_kinematics_for
from tests.cellwright.cell.test_inverse_kinematics import poses_of, ur10e


class CountedSolver:
    """The closed form of the UR10e, its rows shuffled like those of a solver without postures."""

    def __init__(self) -> None:
        self.solver = inverse_kinematics_for(ur10e())
        self.n_poses = 0

    def solve(self, poses: FloatArray) -> FloatArray:
        self.n_poses += len(poses)
        return self.solver.solve(poses)[:, np.random.default_rng(len(poses)).permutation(8)]


def straight(n: int, step: float, generator: np.random.Generator) -> FloatArray:
    """A straight path of one orientation from a random configuration's pose."""
    T = np.tile(poses_of(ur10e(), generator.uniform(-math.pi, math.pi, (1, 6))), (n, 1, 1))
    direction = generator.normal(size=3)
    T[:, :3, 3] += np.arange(n)[:, None] * step * direction / np.linalg.norm(direction)
    return T


def missing(found: FloatArray, expected: FloatArray) -> int:
    """Configurations (branches, joints) of ``expected`` that are not among ``found``."""
    expected, found = (rows[np.isfinite(rows[:, 0])] for rows in (expected, found))
    if not len(found):
        return len(expected)
    apart = np.abs(np.remainder(expected[:, None] - found + math.pi, 2 * math.pi) - math.pi).max(axis=2)
    return int((apart.min(axis=1) > 1e-3).sum())


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_followed_branches_are_the_solved_ones(seed: int) -> None:
    generator = np.random.default_rng(seed)
    lengths = generator.integers(1, 50, 3)
    T = np.concatenate([straight(n, 0.005, generator) for n in lengths])
    counted = CountedSolver()
    found = solve_paths(counted.solve, ur10e(), T, np.concatenate([[0], np.cumsum(lengths)]))
    expected = counted.solver.solve(T)
    assert found.shape == expected.shape
    assert sum(missing(theirs, ours) for ours, theirs in zip(found, expected)) == 0, "nothing is invented"
    lost = sum(missing(ours, theirs) for ours, theirs in zip(found, expected))
    assert lost <= 0.01 * np.isfinite(expected[..., 0]).sum(), "singular poses have infinitely many solutions"


def test_only_few_poses_are_solved_where_nothing_happens() -> None:
    q = np.array([[0.3, -1.2, 1.3, -0.8, -1.2, 0.2]])
    T = np.tile(poses_of(ur10e(), q), (41, 1, 1))
    T[:, 2, 3] += np.linspace(0.0, 0.2, 41)
    counted = CountedSolver()
    found = solve_paths(counted.solve, ur10e(), T, np.array([0, 41]))
    assert counted.n_poses == 6
    assert (np.isfinite(found[..., 0]).sum(axis=1) == np.isfinite(found[0, :, 0]).sum()).all()


def test_a_path_out_of_reach_is_solved_up_to_the_border() -> None:
    q = np.array([[0.0, -0.3, 0.3, 0.2, -1.57, 0.0]])
    T = np.tile(poses_of(ur10e(), q), (61, 1, 1))
    T[:, 0, 3] += np.linspace(0.0, math.copysign(0.3, T[0, 0, 3]), 61)
    counted = CountedSolver()
    found = solve_paths(counted.solve, ur10e(), T, np.array([0, 61]))
    expected = counted.solver.solve(T)
    ends = [int(np.isfinite(rows).any(axis=(1, 2)).sum()) for rows in (found, expected)]
    assert 0 < ends[0] < 61 and ends[0] == ends[1]


def test_no_poses_have_no_branches() -> None:
    assert solve_paths(CountedSolver().solve, ur10e(), np.empty((0, 4, 4)), np.array([0])).shape == (0, 8, 6)
