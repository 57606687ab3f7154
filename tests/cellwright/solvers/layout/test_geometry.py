from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.harness import DesignJoint, Harness, X, Y, Z
from cellwright.errors import InvalidInputError
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.measures import robot_bodies, touching_bodies
from cellwright.solvers.layout.problem import RobotSpheres, Spheres, Wall
from tests.cellwright.solvers.small_layouts import two_stations


def crowded(base: Harness | None = None) -> LayoutGeometry:
    problem = two_stations(obstacle=0.15)
    rng = np.random.default_rng(0)
    hull = Spheres(rng.normal(0, 0.1, (3, 3)), rng.uniform(0.05, 0.2, 3))
    stations = tuple(replace(station, hull=hull) for station in problem.stations)
    spheres = RobotSpheres(
        np.array([0, 1, 2]), rng.normal(0, 0.2, (3, 3)), np.array([0.3, 0.1, 0.05]), np.array([[0, 2]])
    )
    walls = (Wall("north", np.array([0.0, -1.0, 0.0]), -0.9), Wall("floor", np.array([0, 0, 1.0]), -0.4, False))
    crowd = replace(problem, stations=stations, robot_spheres=spheres, walls=walls, clearance_m=0.01)
    return LayoutGeometry(crowd if base is None else replace(crowd, base=base))


def apart(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(((one - other) ** 2).sum()))


SLIDE_AND_TURN = Harness((DesignJoint("slide", False, Y, -0.5, 0.9), DesignJoint("turn", True, Z, -1.0, 1.0)))


@given(st.integers(0, 10_000), st.sampled_from([None, SLIDE_AND_TURN]))
@settings(max_examples=30, deadline=None)
def test_gaps_equal_those_measured_one_by_one(seed: int, base: Harness | None) -> None:
    geometry = crowded(base)
    problem = geometry.problem
    rng = np.random.default_rng(seed)
    design = rng.uniform(problem.lower, problem.upper)
    q = rng.uniform(problem.arm.lower, problem.arm.upper)
    poses, links = problem.station_poses(design), problem.base_pose(design) @ problem.arm.link_poses(q)
    spheres = problem.robot_spheres
    robot = [links[link] @ np.append(c, 1.0) for link, c in zip(spheres.link, spheres.centres)]
    smallest = np.inf
    station_penetration = 0.0
    for s, station in enumerate(problem.stations):
        for centre, radius in zip(station.hull.centres, station.hull.radii):
            world = poses[s] @ np.append(centre, 1.0)
            for body, link, own in zip(robot, spheres.link, spheres.radii):
                gap = apart(body, world) - radius - own - 0.01
                if link > 0:
                    smallest = min(smallest, gap)
                elif station.harness.n_joints or base is not None:
                    station_penetration += max(-gap, 0.0)
            if station.harness.n_joints:
                station_penetration += max(radius - (0.9 - world[1]), 0.0) + max(radius - (world[2] + 0.4), 0.0)
            for t in range(s):
                if not (station.harness.n_joints or problem.stations[t].harness.n_joints):
                    continue
                for centre2, radius2 in zip(problem.stations[t].hull.centres, problem.stations[t].hull.radii):
                    gap = apart(world, poses[t] @ np.append(centre2, 1.0)) - radius - radius2 - 0.01
                    station_penetration += max(-gap, 0.0)
    for body, link, own in zip(robot, spheres.link, spheres.radii):
        if link > 0:
            smallest = min(smallest, 0.9 - body[1] - own - 0.01)
        elif base is not None:
            # the floor holds no robot, and a base that does not move is held by nothing
            station_penetration += max(own - (0.9 - body[1]), 0.0)
    smallest = min(smallest, apart(robot[0], robot[2]) - spheres.radii[0] - spheres.radii[2])
    np.testing.assert_allclose(geometry.motion_gap(design, q[None])[0], smallest, atol=1e-12)
    np.testing.assert_allclose(geometry.layout_violation(design), station_penetration, atol=1e-12)
    np.testing.assert_allclose(geometry.layout_violation(np.tile(design, (2, 1)))[1], station_penetration, atol=1e-12)


def test_an_approach_does_not_see_its_own_station() -> None:
    geometry = LayoutGeometry(two_stations())
    design = np.array([-1.0, 0.8, 1.0, 0.8])
    inside = np.array([[-1.0, 0.8]])
    assert geometry.motion_gap(design, inside)[0] < 0.0 < geometry.motion_gap(design, inside, 0)[0]


def test_many_designs_are_measured_as_one_by_one() -> None:
    geometry = crowded(SLIDE_AND_TURN)
    problem, rng = geometry.problem, np.random.default_rng(1)
    designs = rng.uniform(problem.lower, problem.upper, (4, problem.n_design))
    q = rng.uniform(problem.arm.lower, problem.arm.upper, (4, 3, problem.arm.n_joints))
    q[2, 1] = np.nan
    for own in (-1, 1):
        together = geometry.motion_gap(designs, q, own)
        single = [geometry.motion_gap(design, each, own) for design, each in zip(designs, q)]
        np.testing.assert_allclose(together, single, rtol=0.0, atol=1e-12)
        assert np.isnan(together[2, 1]) and np.isnan(together).sum() == 1


def test_a_moving_base_keeps_off_the_walls_that_it_can_reach_and_is_named() -> None:
    problem = two_stations()
    slide = Harness((DesignJoint("slide", False, X, -1.0, 0.1), DesignJoint("turn", True, Z, -1.0, 1.0)))
    walls = (Wall("west", X, -0.5), Wall("floor", Z, 0.0), Wall("fence", X, 0.0, False))
    geometry = LayoutGeometry(replace(problem, base=slide, walls=walls))
    outside = np.array([-0.9, 0.0, -1.0, 0.8, 1.0, 0.8])
    # the column of 0.15 m radius stands in the floor wherever it slides, and the fence does not hold the robot
    west = [gap for gap in geometry.worst_layout_gaps(outside) if gap.second == "robot base" and gap.gap_m < 0.0]
    assert [gap.first for gap in west] == ["west"]
    np.testing.assert_allclose(west[0].gap_m, -0.9 + 0.5 - 0.15)
    inside = np.array([-0.3, 0.5, *outside[2:]])
    assert geometry.layout_violation(outside) - geometry.layout_violation(inside) > 0.5
    tilting = Harness((DesignJoint("tilt", True, X, -0.1, 0.1),))
    tilted = LayoutGeometry(replace(problem, base=tilting, walls=walls))
    assert tilted.base_wall_pairs[:, 0].tolist() == [1]


def test_the_worst_gap_has_names() -> None:
    geometry = LayoutGeometry(two_stations())
    worst = geometry.worst_layout_gaps(np.array([0.0, 0.8, 0.1, 0.8]))[0]
    assert {worst.first, worst.second} == {"station 1", "station 2"}
    assert worst.gap_m < 0.0


def test_what_touches_is_named_as_the_urdf_names_it_or_as_the_spheres_do() -> None:
    geometry = crowded()
    problem = geometry.problem
    design = problem.lower
    expected = ["robot base", "link 'turret'", "link 'beam'"]
    assert robot_bodies(problem) == expected
    tool = replace(problem.robot_spheres, body=("robot base", "the turret", "the tool"))
    named = LayoutGeometry(replace(problem, robot_spheres=tool))
    rng = np.random.default_rng(0)
    for q in rng.uniform(problem.arm.lower, problem.arm.upper, (20, problem.arm.n_joints)):
        (one, other), (also, beside) = (touching_bodies(each, design, q, -1) for each in (geometry, named))
        assert tool.body[expected.index(one)] == also
        assert tool.body[expected.index(other)] == beside if other in expected else other == beside


def test_names_of_bodies_are_one_a_sphere() -> None:
    with pytest.raises(InvalidInputError, match="2 bodies are named for 1 spheres"):
        RobotSpheres(np.array([1]), np.zeros((1, 3)), np.ones(1), body=("a", "b"))
