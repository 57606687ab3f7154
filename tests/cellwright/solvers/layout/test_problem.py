from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.errors import InvalidInputError
from cellwright.solvers.layout.problem import (
    HOME,
    Approach,
    LayoutCost,
    LayoutProblem,
    RobotSpheres,
    Spheres,
    Station,
    Visit,
    Wall,
    workspace_walls,
)
from tests.cellwright.solvers.small_layouts import polar_arm, ring_harness, two_stations

PROBLEM = two_stations()


def test_designs_are_named_and_sliced_base_first() -> None:
    problem = replace(PROBLEM, base=ring_harness(-0.1, 0.1, 0.0, 0.2))
    assert problem.design_names[:3] == ("base.around", "base.out", "station 1.around")
    design = np.arange(6.0) / 10.0
    np.testing.assert_allclose(problem.base_pose(design), problem.base.poses(design[:2]))
    np.testing.assert_allclose(problem.station_poses(design)[1], problem.stations[1].harness.poses(design[4:]))
    assert problem.station_poses(np.tile(design, (3, 1))).shape == (3, 2, 4, 4)


def test_a_fixed_design_stands_where_the_free_one_did() -> None:
    design = np.array([-0.5, 0.6, 0.4, 0.9])
    still = PROBLEM.with_design(design)
    assert still.n_design == 0
    np.testing.assert_allclose(still.station_poses(np.zeros(0)), PROBLEM.station_poses(design))


def test_a_cycle_closes_and_an_open_sequence_does_not() -> None:
    assert PROBLEM.transitions == ((0, 1), (1, 0))
    assert replace(PROBLEM, cyclic=False).transitions == ((0, 1),)


def test_an_approach_at_a_speed_takes_its_length_or_its_turn() -> None:
    turned = rotation_from_rpy(0, 0, 1.0)
    poses = pose(np.array([[0, 0, 0], [0.2, 0, 0], [0.2, 0, 0]]), np.stack([np.eye(3), np.eye(3), turned]))
    approach = Approach.along(poses, speed_m_s=0.1, turn_rad_s=0.5)
    np.testing.assert_allclose(approach.durations_s, [2.0, 2.0])
    assert approach.duration_s == pytest.approx(4.0)
    assert Approach.along(poses).duration_s == 0.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(PROBLEM, stations=PROBLEM.stations * 2), "own name"),
        (lambda: replace(PROBLEM, visits=(Visit(0), Visit(7))), "station 7"),
        (lambda: replace(PROBLEM, visits=(Visit(0), Visit(0, 3))), "approach 3"),
        (lambda: replace(PROBLEM, visits=(Visit(0),)), "1 visits"),
        (lambda: replace(PROBLEM, visits=(HOME, Visit(0))), "no home"),
        (lambda: replace(PROBLEM, home_q=np.array([9.0, 0.5])), "outside the joint limits"),
        (lambda: replace(PROBLEM, cost=LayoutCost(repeatability=1.0)), "2 joint deviations"),
        (lambda: replace(PROBLEM, clearance_m=-0.1), "negative"),
        (lambda: Spheres(np.zeros((1, 3)), np.array([-1.0])), "negative"),
        (lambda: Spheres(np.zeros((2, 3)), np.zeros(3)), "radii"),
        (lambda: RobotSpheres(np.array([1]), np.zeros((1, 3)), np.ones(1), np.array([[0, 4]])), "sphere 4"),
        (lambda: Wall("w", np.zeros(3), 0.0), "direction"),
        (lambda: workspace_walls(np.array([0, 0, 1.0]), np.array([1, 1, 0.4])), "in z.*more than 0.6"),
        (lambda: Approach(np.zeros((0, 4, 4)), name="a"), "no pose"),
        (lambda: Approach(np.tile(np.eye(4), (2, 1, 1)), durations_s=np.zeros(1)), "positive"),
        (lambda: LayoutProblem(polar_arm(), (Station("s", ring_harness(0, 1)),)), "0 visits"),
    ],
)
def test_what_makes_no_problem_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        make()
