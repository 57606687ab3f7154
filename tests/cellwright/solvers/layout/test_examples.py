from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.solvers.layout.bodies import box_hull
from cellwright.solvers.layout.configurations import ConfigurationFinder
from cellwright.solvers.layout.examples import (
    DOOR_HEIGHTS_M,
    four_station_problem,
    station_distance_problem,
    two_machine_problem,
    walled_station_problem,
)
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.proxies import time_layout
from cellwright.solvers.layout.staged import StagedSettings, solve_staged
from cellwright.solvers.layout.symbols import LayoutSymbols

SMALL = StagedSettings(n_segments=20, n_sweeps=0)


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@settings(max_examples=30, deadline=None)
@given(
    size=st.tuples(*[st.floats(0.1, 3.0)] * 3),
    cells=st.tuples(*[st.integers(1, 4)] * 3),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_hull_of_a_box_contains_it(
    size: tuple[float, float, float], cells: tuple[int, int, int], seed: int
) -> None:
    centre = np.array([0.3, -0.2, 0.7])
    hull = box_hull(size, cells, centre)
    points = centre + generator(seed).uniform(-0.5, 0.5, (500, 3)) * size
    inside = np.linalg.norm(points[:, None] - hull.centres, axis=2) <= hull.radii + 1e-12
    assert inside.any(axis=1).all()


def test_far_stations_are_faster_than_near_ones_on_the_two_joint_robot() -> None:
    problem = station_distance_problem()
    near = np.array([0.4, 0.0, 0.0, -0.4, 0.0, 0.0])
    far = np.array([1.1, 0.21, 0.0, 1.1, -0.21, 0.0])
    slow, fast = (time_layout(problem, design, generator(), SMALL) for design in (near, far))
    assert slow.converged and fast.converged
    assert fast.cycle_time_s < 0.3 * slow.cycle_time_s


def test_the_integrated_solver_turns_the_wall_out_of_the_way() -> None:
    problem = walled_station_problem()
    between = np.array([0.6, 0.0, 0.0, 0.0])
    before = time_layout(problem, between, generator(), SMALL)
    after = solve_staged(LayoutSymbols(problem), between, generator(), StagedSettings())
    assert before.converged and after.converged, (before.report.blocking, after.report.blocking)
    assert after.cycle_time_s < 0.7 * before.cycle_time_s
    assert LayoutGeometry(problem).layout_violation(after.design) < 1e-4


def test_four_stations_can_stand_free_of_each_other_and_in_reach() -> None:
    problem = four_station_problem()
    angles = np.arange(4) * np.pi / 2.0
    design = np.stack([1.9 * np.cos(angles), 1.9 * np.sin(angles), np.full(4, 0.7), np.zeros(4)], axis=1).ravel()
    assert LayoutGeometry(problem).layout_violation(design) == 0.0
    assert not ConfigurationFinder(problem, generator()).find(design[None]).unserved.any()


@pytest.mark.parametrize("robot", ["kr180_r2500_extra", "nj290", "scara"])
def test_six_axis_robots_serve_both_machines_and_the_scara_cannot(robot: str) -> None:
    problem = two_machine_problem(robot)
    distances = np.linspace(0.9, 2.6, 35)
    # one machine in front of the robot, one on its left, their doors towards it
    rows = [[d, 0.0, 0.0, 0.0, d, np.pi / 2.0] for d in distances]
    served = ~ConfigurationFinder(problem, generator()).find(np.array(rows)).unserved
    if robot == "scara":
        stroke = float(problem.arm.upper[2] - problem.arm.lower[2])
        assert stroke < DOOR_HEIGHTS_M[1] - DOOR_HEIGHTS_M[0]
        assert not served[:, 1].any()
    else:
        assert served.all(axis=1).any()
