from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from cellwright.arrays import FloatArray
from cellwright.cell.harness import fixed, planar
from cellwright.cell.transforms import inverse, pose
from cellwright.solvers.layout.approach import target_error
from cellwright.solvers.layout.bodies import RobotSpheres, Spheres
from cellwright.solvers.layout.configurations import REACHED, ConfigurationFinder
from cellwright.solvers.layout.examples import DOWN, four_station_problem, station_distance_problem, two_machine_problem
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.problem import Approach, LayoutProblem, Station, TargetKind

PROBLEMS: dict[str, Callable[[], LayoutProblem]] = {
    "six axes, full pose": lambda: four_station_problem("ur10e"),
    "six axes, free turn": lambda: four_station_problem("kr180_r2500_extra", TargetKind.AXIS),
    "six axes, position": lambda: four_station_problem("ur10e", TargetKind.POSITION),
    "two joints": station_distance_problem,
    "SCARA": lambda: two_machine_problem("scara"),
}


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def designs_of(problem: LayoutProblem, n: int, seed: int = 1) -> FloatArray:
    return np.asarray(generator(seed).uniform(problem.lower, problem.upper, (n, problem.n_design)))


@pytest.mark.parametrize("name", PROBLEMS)
def test_every_configuration_reaches_its_pose_within_the_joint_limits(name: str) -> None:
    problem = PROBLEMS[name]()
    designs = designs_of(problem, 80 if name == "SCARA" else 12)
    found = ConfigurationFinder(problem, generator()).find(designs)
    T_base_world = inverse(problem.base_pose(designs))
    T_world_station = problem.station_poses(designs)
    assert found.usable.any()
    for visit, where in enumerate(problem.visits):
        approach = problem.approach_of(visit)
        assert approach is not None
        T_base_station = T_base_world @ T_world_station[:, where.station]
        for q, T_station_tool in (
            (found.first, approach.T_station_tool[0]),
            (found.last, approach.T_station_tool[-1]),
        ):
            row, candidate = np.nonzero(found.usable[:, visit])
            used = q[row, visit, candidate]
            reached = problem.arm.flange_pose(used) @ problem.T_flange_tool
            error = target_error(reached, T_base_station[row] @ T_station_tool, approach.target)
            assert np.abs(error).max(initial=0.0) < 2.0 * REACHED
            assert (used >= problem.arm.lower - 1e-9).all() and (used <= problem.arm.upper + 1e-9).all()


def test_all_branches_of_a_six_axis_arm_are_found() -> None:
    problem = four_station_problem("ur10e")
    arm = problem.arm
    q = np.array([0.3, -1.3, 1.5, -1.8, -1.57, 0.4])
    T = arm.flange_pose(q)
    station = Station("s", fixed(T), approaches=(Approach(np.eye(4)[None]),))
    here = dataclasses.replace(problem, stations=(station, dataclasses.replace(station, name="t")), visits=())
    found = ConfigurationFinder(dataclasses.replace(here, robot_spheres=RobotSpheres()), generator()).find(
        np.zeros((1, 0))
    )
    assert found.usable[0, 0].sum() == 8
    apart = np.abs(np.remainder(found.first[0, 0] - q + math.pi, 2.0 * math.pi) - math.pi).max(axis=1)
    assert apart.min() < 1e-6


def test_what_collides_is_left_out_and_agrees_with_the_geometry() -> None:
    problem = four_station_problem("kr180_r2500_extra")
    tall = Spheres(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.3]]), np.array([0.2, 0.12]))
    stations = tuple(dataclasses.replace(each, hull=tall) for each in problem.stations)
    blocked = dataclasses.replace(problem, stations=stations)
    designs = designs_of(problem, 40, 3)
    free = ConfigurationFinder(problem, generator()).find(designs)
    held = ConfigurationFinder(blocked, generator()).find(designs)
    assert free.usable.any() and not held.usable.any()
    assert (held.reached == free.reached).all()
    geometry = LayoutGeometry(problem)
    for row in range(len(designs)):
        used = free.first[row][free.usable[row]]
        if len(used):
            assert (geometry.motion_gap(designs[row], used) >= -1e-6).all()


def test_an_approach_inside_its_own_hull_is_no_collision_but_its_start_must_be_clear() -> None:
    problem = four_station_problem("kr180_r2500_extra")
    way = pose(np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.25]]), np.repeat(DOWN[None], 2, axis=0))
    there = Approach(np.concatenate([way, way[:1]]), TargetKind.POSE)

    def usable(radius: float) -> bool:
        hull = Spheres(np.zeros((1, 3)), np.array([radius]))
        stations = tuple(
            Station(f"s{k}", planar((1.5, 1.5), (y, y), z=(0.5, 0.8)), hull, (there,))
            for k, y in enumerate((-0.6, 0.6))
        )
        two = dataclasses.replace(problem, stations=stations, visits=())
        return bool(ConfigurationFinder(two, generator()).find(two.lower[None]).usable.any(axis=2).all())

    assert usable(0.4)
    assert not usable(0.48)


def test_the_home_configuration_is_the_only_one_of_its_visit() -> None:
    from cellwright.solvers.layout.problem import HOME, Visit

    problem = station_distance_problem()
    home = dataclasses.replace(problem, home_q=np.array([0.1, 0.2]), visits=(HOME, Visit(0)))
    found = ConfigurationFinder(home, generator()).find(designs_of(problem, 3))
    assert (found.usable[:, 0].sum(axis=1) == 1).all()
    assert (found.first[:, 0, 0] == home.home_q).all()


def test_the_same_generator_finds_the_same_configurations() -> None:
    problem = two_machine_problem("scara")
    designs = designs_of(problem, 5)
    one, other = (ConfigurationFinder(problem, generator(9)).find(designs) for _ in range(2))
    assert one.first.tobytes() == other.first.tobytes()
