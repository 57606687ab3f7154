"""Lazy checks see what lies between the points of a program: samples are as dense as the robot's way asks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwright.solvers.layout.checks import all_checks_at_rows, missing_checks, samples_of
from cellwright.solvers.layout.examples import thin_wall_problem, two_machine_problem
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.mesh import build_mesh, path_mesh
from cellwright.solvers.layout.nlp import LayoutPoint
from cellwright.solvers.layout.optimiser import solve_layout
from cellwright.solvers.layout.paths import promising_paths
from cellwright.solvers.layout.staged import StagedSettings
from tests.cellwright.solvers.small_layouts import two_stations


@pytest.mark.parametrize("long", [0, 3, 7])
def test_a_long_segment_among_short_ones_is_sampled_as_densely(long: int) -> None:
    problem = thin_wall_problem()
    geometry = LayoutGeometry(problem)
    mesh = path_mesh(8)
    # all the way past the wall in one segment, the others stand nearly still
    turn = np.where(np.arange(1, 9) > long, 0.6, -0.6) + 1e-3 * np.arange(1, 9)
    q = np.column_stack([np.append(-0.6, turn), np.full(9, 0.5)])
    point = LayoutPoint(np.zeros(0), q, np.full(8, 0.1))
    samples = samples_of(geometry, mesh, point)
    tool = geometry.robot_world(problem.base_pose(point.design), samples.q)[:, 0]
    steps = np.linalg.norm(np.diff(tool, axis=0), axis=1)
    assert steps.max() <= geometry.sample_step(3e-4, 5e-3) * 1.01
    _, deepest = missing_checks(geometry, point, samples, motion_only=True)
    assert deepest > 0.02


def test_samples_of_a_slower_segment_are_among_those_of_a_faster_one() -> None:
    geometry = LayoutGeometry(thin_wall_problem())
    shares = []
    for turn in (0.05, 0.3, 1.2):
        q = np.array([[-0.6, 0.5], [-0.6 + turn, 0.5]])
        samples = samples_of(geometry, path_mesh(1), LayoutPoint(np.zeros(0), q, np.ones(1)))
        shares.append(set(samples.share.round(9).tolist()))
    assert shares[0] <= shares[1] < shares[2]


def test_no_promising_path_steps_over_a_thin_wall() -> None:
    problem = thin_wall_problem()
    geometry = LayoutGeometry(problem)
    straight = np.column_stack([np.linspace(-0.6, 0.6, 9), np.full(9, 0.5)])
    for seed in range(5):
        for path in promising_paths(geometry, np.zeros(0), straight, np.random.default_rng(seed), 2):
            place = np.linspace(0.0, 8.0, 2001)
            q = np.column_stack([np.interp(place, np.arange(9), column) for column in path.T])
            assert geometry.motion_gap(np.zeros(0), q).min() > -5e-3


@pytest.mark.parametrize("seed", [2, 3])
def test_a_machine_is_not_entered_between_the_samples_of_a_fast_motion(seed: int) -> None:
    problem = two_machine_problem("kr180_r2500_extra")
    settings = StagedSettings(polish=False)
    solution = solve_layout(problem, rng=np.random.default_rng([seed, 0]), settings=settings)
    assert solution.converged, solution.report.blocking


def test_the_last_configuration_of_an_open_sequence_is_checked_too() -> None:
    for cyclic in (True, False):
        problem = replace(two_stations(obstacle=0.1), cyclic=cyclic)
        geometry, mesh = LayoutGeometry(problem), build_mesh(problem, 4)
        checks = all_checks_at_rows(geometry, mesh)
        per_row = len(geometry.hull_radii)
        rows, counts = np.unique(checks.motion[:, 0], return_counts=True)
        # every configuration of the cycle once against every sphere, none of them twice
        assert rows.tolist() == list(range(mesh.n_configs))
        assert set(counts.tolist()) == {per_row}
