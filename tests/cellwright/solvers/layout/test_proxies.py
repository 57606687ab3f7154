from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from cellwright.arrays import FloatArray
from cellwright.cell.serial_arm import SerialArm
from cellwright.solvers.layout.bodies import RobotSpheres, Spheres
from cellwright.solvers.layout.configurations import ConfigurationFinder
from cellwright.solvers.layout.examples import four_station_problem, station_distance_problem
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.optimiser import solve_layout
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.proxies import (
    PENALTY,
    Proxy,
    ProxyObjective,
    ProxySettings,
    best_sequence,
    propose_layout,
    solve_by_proxy,
    unwound,
)
from cellwright.solvers.layout.staged import StagedSettings
from cellwright.solvers.layout.symbols import LayoutSymbols
from cellwright.solvers.particle_swarm import SwarmSettings
from tests.cellwright.solvers.small_layouts import two_stations

SMALL = SwarmSettings(30, 12)
INFINITE = np.full(1, np.inf)


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def on_a_circle(problem: LayoutProblem, distance: float, angles: list[float]) -> FloatArray:
    """A design of the two- or four-station problem with the stations about the robot, facing outwards."""
    per_station = problem.n_design // len(angles)
    parts = []
    for angle in angles:
        height = [0.6] if per_station == 4 else []
        parts.append([distance * math.cos(angle), distance * math.sin(angle), *height, 0.0])
    return np.concatenate(parts)


def value(problem: LayoutProblem, proxy: Proxy, design: FloatArray) -> float:
    return float(ProxyObjective(ConfigurationFinder(problem, generator()), proxy)(design[None], INFINITE)[0])


def test_the_proxies_of_two_stations_are_what_one_computes_by_hand() -> None:
    problem = station_distance_problem()
    design = on_a_circle(problem, 1.0, [0.0, 0.5])
    apart = 2.0 * math.sin(0.25)
    assert value(problem, Proxy.EUCLIDEAN, design) == pytest.approx(2.0 * apart, abs=1e-9)
    assert value(problem, Proxy.TO_ROBOT, design) == pytest.approx(2.0 * math.hypot(1.0, 0.5), abs=1e-9)
    assert value(problem, Proxy.JOINT, design) == pytest.approx(2.0 * 0.5, abs=1e-6)
    assert value(problem, Proxy.JOINT_TIME, design) == pytest.approx(2.0 * 0.5 / 1.5, abs=1e-6)


def test_each_violated_constraint_costs_a_thousand() -> None:
    problem = station_distance_problem()
    overlapping = on_a_circle(problem, 1.0, [0.0, 0.1])
    assert int(value(problem, Proxy.EUCLIDEAN, overlapping) // PENALTY) == 1
    out_of_reach = np.array([1.2, 1.2, 0.0, -1.2, 1.2, 0.0])
    assert int(value(problem, Proxy.JOINT, out_of_reach) // PENALTY) == 2
    both = np.array([1.2, 1.2, 0.0, 1.2, 1.15, 0.0])
    assert int(value(problem, Proxy.JOINT, both) // PENALTY) == 3


def test_a_robot_that_touches_a_hull_at_a_station_is_penalised() -> None:
    problem = station_distance_problem()
    tall = Spheres(np.array([[0.0, 0.0, 0.4]]), np.array([0.2]))
    blocked = dataclasses.replace(problem, stations=tuple(dataclasses.replace(s, hull=tall) for s in problem.stations))
    design = on_a_circle(problem, 1.0, [0.0, 0.5])
    assert value(blocked, Proxy.JOINT_TIME, design) >= 2.0 * PENALTY


def test_the_joint_time_is_no_more_than_that_of_any_choice_of_branches() -> None:
    problem = four_station_problem()
    finder = ConfigurationFinder(problem, generator())
    design = on_a_circle(problem, 1.8, [0.0, 0.8, 1.6, 2.4])
    found = finder.find(design[None])
    best = float(ProxyObjective(finder, Proxy.JOINT_TIME)(design[None], INFINITE)[0])
    sequence = best_sequence(finder, design)
    # no joint of these few visits needs a full turn more
    assert sequence.joint_time_s == pytest.approx(best, rel=1e-9)
    rng, speed = generator(3), problem.arm.max_velocity
    for _ in range(300):
        q = [found.first[0, v, rng.choice(np.flatnonzero(found.usable[0, v]))] for v in range(4)]
        first, last = unwound(problem.arm, np.array(q), np.array(q))
        times = [(np.abs(first[b] - last[a]) / speed).max() for a, b in problem.transitions]
        assert best <= math.fsum(times) + 1e-9


def test_unwinding_stays_within_the_limits_and_moves_by_whole_turns() -> None:
    arm: SerialArm = four_station_problem("ur10e").arm
    rng = generator(5)
    q = rng.uniform(np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi), (7, 6))
    first, last = unwound(arm, q, q)
    turns = (first - q) / (2.0 * math.pi)
    assert np.abs(turns - np.round(turns)).max() < 1e-12
    assert (first >= arm.lower).all() and (first <= arm.upper).all()
    assert (first == last).all()
    free = arm.upper - arm.lower > 4.0 * math.pi - 1e-6
    assert np.abs(np.diff(first, axis=0))[:, free].max() <= 2.0 * math.pi


@pytest.mark.parametrize("proxy", list(Proxy))
def test_a_proposed_layout_keeps_the_constraints_and_is_timed(proxy: Proxy) -> None:
    problem = station_distance_problem()
    settings = ProxySettings(proxy, SMALL, StagedSettings(n_branches=1, n_sweeps=0))
    solution = solve_by_proxy(LayoutSymbols(problem), None, generator(), settings)
    assert solution.converged, solution.report.blocking
    assert solution.method == f"proxy: {proxy.value}"
    assert solution.design.shape == (problem.n_design,)
    assert LayoutGeometry(problem).layout_violation(solution.design) < 1e-5
    assert (solution.design >= problem.lower).all() and (solution.design <= problem.upper).all()


def test_the_cycle_is_never_faster_than_the_joint_time_allows() -> None:
    problem = four_station_problem()
    result, finder = propose_layout(problem, Proxy.JOINT_TIME, generator(), SMALL)
    solution = solve_by_proxy(LayoutSymbols(problem), None, generator(), ProxySettings(Proxy.JOINT_TIME, SMALL))
    assert (solution.design == result.position).all()
    assert solution.converged, solution.report.blocking
    assert solution.cycle_time_s >= best_sequence(finder, result.position).joint_time_s - 1e-3


def test_the_same_seed_gives_the_same_layout_to_the_last_bit() -> None:
    problem = four_station_problem()
    one, other = (propose_layout(problem, Proxy.JOINT, generator(2), SMALL)[0] for _ in range(2))
    assert one.position.tobytes() == other.position.tobytes()


def test_stations_that_cannot_part_do_not_converge_because_they_are_held_fixed() -> None:
    problem = two_stations(radius=0.5, ranges=((0.0, 0.2), (0.1, 0.3)))
    problem = dataclasses.replace(problem, robot_spheres=RobotSpheres())
    settings = ProxySettings(Proxy.JOINT_TIME, SwarmSettings(8, 3), StagedSettings(n_branches=1, n_sweeps=0))
    solution = solve_layout(problem, "proxy", settings=settings)
    deepest = LayoutGeometry(problem).worst_layout_gaps(solution.design)[0]
    assert not solution.converged
    assert "station 1 and station 2 overlap" in solution.report.blocking
    assert solution.report.layout_violation_m == pytest.approx(-deepest.gap_m)
    assert deepest.gap_m < -0.5
