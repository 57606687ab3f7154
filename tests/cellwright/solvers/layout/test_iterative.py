from __future__ import annotations

import dataclasses

import numpy as np

from cellwright.solvers.layout.configurations import ConfigurationFinder
from cellwright.solvers.layout.examples import (
    four_station_problem,
    two_machine_problem,
    walled_station_problem,
)
from cellwright.solvers.layout.iterative import CycleObjective, CycleTimes, IterativeSettings, solve_iteratively
from cellwright.solvers.layout.problem import TargetKind
from cellwright.solvers.layout.proxies import PENALTY, best_sequence
from cellwright.solvers.layout.staged import StagedSettings
from cellwright.solvers.layout.symbols import LayoutSymbols
from cellwright.solvers.particle_swarm import SwarmSettings
from cellwright.worker_processes import WorkerProcesses

SMALL = IterativeSettings(swarm=SwarmSettings(24, 8), trajectory=StagedSettings(n_branches=1, n_sweeps=0))


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_early_rejection_changes_nothing() -> None:
    problem = four_station_problem()
    one, other = (
        solve_iteratively(LayoutSymbols(problem), None, generator(), dataclasses.replace(SMALL, reject_early=early))
        for early in (True, False)
    )
    assert one.design.tobytes() == other.design.tobytes()
    assert one.method == "iterative"


def test_processes_change_nothing() -> None:
    problem = walled_station_problem(7)
    designs = generator(1).uniform(problem.lower, problem.upper, (24, problem.n_design))
    infinite = np.full(len(designs), np.inf)
    inner = StagedSettings(n_coarse=3, n_bends=1, most_rounds=2, most_iterations=30)
    with WorkerProcesses(CycleTimes, (problem, inner), 2) as workers:
        alone, together = (
            CycleObjective(ConfigurationFinder(problem, generator()), IterativeSettings(inner=inner), 0, each)
            for each in (None, workers)
        )
        np.testing.assert_array_equal(together(designs, infinite), alone(designs, infinite))
        assert workers.n_begun == 2


def test_full_poses_in_an_empty_room_need_no_process() -> None:
    problem = four_station_problem()
    with WorkerProcesses(CycleTimes, (problem, SMALL.inner), 2) as workers:
        objective = CycleObjective(ConfigurationFinder(problem, generator()), SMALL, 0, workers)
        objective(generator(1).uniform(problem.lower, problem.upper, (300, problem.n_design)), np.full(300, np.inf))
        assert workers.n_begun == 0


def test_the_free_turn_about_the_tool_saves_time_and_never_costs_any() -> None:
    problem = four_station_problem("kr180_r2500_extra", TargetKind.AXIS)
    finder = ConfigurationFinder(problem, generator(), n_turns=3)
    designs = generator(1).uniform(problem.lower, problem.upper, (200, problem.n_design))
    served = np.flatnonzero(~finder.find(designs).unserved.any(axis=1))[:4]
    cycles = CycleTimes(problem, SMALL.inner)
    saved = []
    for row in served.tolist():
        sequence = best_sequence(finder, designs[row])
        time = cycles(designs[row], sequence, 0)
        if time < PENALTY:
            saved.append(sequence.joint_time_s - time)
    assert saved and min(saved) > -1e-6 and max(saved) > 1e-3


def test_a_wall_between_the_stations_costs_time_that_the_proxy_does_not_see() -> None:
    problem = walled_station_problem()
    finder = ConfigurationFinder(problem, generator())
    objective = CycleObjective(finder, IterativeSettings(), 0)
    infinite = np.full(1, np.inf)
    # blue at 0.6 rad on the wall's side of red, first with the wall between them, then with it behind red
    between = np.array([[0.6, 0.0, 0.0, 0.0]])
    behind = np.array([[0.6, 0.0, 0.0, -np.pi / 2.0]])
    blocked, clear = (float(objective(design, infinite)[0]) for design in (between, behind))
    proxied = best_sequence(finder, behind[0]).joint_time_s
    assert best_sequence(finder, between[0]).joint_time_s == proxied
    assert clear < 1.2 * proxied + 0.05
    assert PENALTY > blocked > 1.3 * clear


def test_approaches_of_several_poses_are_followed_and_timed() -> None:
    problem = two_machine_problem("kr180_r2500_extra", cells=2)
    finder = ConfigurationFinder(problem, generator())
    cycles = CycleTimes(problem, SMALL.inner)
    rows = np.array([[d, 0.0, 0.0, 0.0, d, np.pi / 2.0] for d in np.linspace(1.3, 2.3, 11)])
    served = np.flatnonzero(~finder.find(rows).unserved.any(axis=1))
    times = [cycles(rows[row], best_sequence(finder, rows[row]), 0) for row in served.tolist()]
    assert min(times) < PENALTY
    # a quarter turn of axis 1 there and back
    assert min(times) > 2.0 * 0.5 * np.pi / problem.arm.max_velocity[0] * 0.8
