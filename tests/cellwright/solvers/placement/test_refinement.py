"""Following the gradient of a plan between hulls: shorter straight motions, within trust, and distances that hold."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.transforms import pose
from cellwright.solvers.layout.bodies import Spheres
from cellwright.solvers.placement.problem import PlacementProblem
from cellwright.solvers.placement.refined_trials import refine_trials
from cellwright.solvers.placement.refinement import (
    MOVED,
    Refinement,
    layout_problem,
    proven_gaps,
    refine_design,
)
from cellwright.solvers.placement.search import FoundDesigns
from cellwright.solvers.placement.trial import Trial, TrialSettings, try_designs
from cellwright.solvers.stitched_plan import StitchSettings
from tests.cellwright.solvers.placement import placed_sweeps

BLOCK = Body("block", Box((0.2, 0.2, 0.2)), WORLD, pose(np.array([0.0, -0.9, 0.1]), np.eye(3)))
SETTINGS = TrialSettings(StitchSettings(scan_speed=0.2, max_alternatives=4), "best", 0)
ZERO = np.zeros(3)


def with_block(**changes: Any) -> PlacementProblem:
    given = placed_sweeps.problem(**changes)
    bodies = given.cell.bodies
    return replace(given, cell=replace(given.cell, bodies=(*bodies[:-1], BLOCK, bodies[-1])))


@cache
def trial() -> Trial:
    """The present placement, stitched."""
    judge = placed_sweeps.judge()
    present = judge.judge(ZERO)
    found = FoundDesigns(ZERO[None], np.array([present.estimate]), present, {}, 1, np.zeros((0, 2)))
    (tried,) = try_designs(judge, found, SETTINGS, cycle_now=np.inf)
    return tried


def hulls(problem: PlacementProblem, radius: float = 0.05) -> dict[str, Spheres]:
    """One sphere in the middle of every body."""
    return {body.name: Spheres(np.zeros((1, 3)), np.array([radius])) for body in problem.cell.bodies}


def refined(trust: float, **changes: Any) -> Refinement | None:
    problem = placed_sweeps.problem(**changes)
    return refine_design(problem, {}, trial().plan, ZERO, trust=trust)


def test_a_trial_tells_its_sweeps_as_it_executes_them() -> None:
    problem, plan = placed_sweeps.problem(), trial().plan
    assert sorted(sweep.name for sweep in plan) == sorted(problem.names)
    layout = layout_problem(problem, {}, plan, ZERO)
    for sweep, approach in zip(plan, layout.stations[0].approaches):
        row = problem.names.index(sweep.name)
        T = problem.cell.bodies[-1].T_parent_body @ approach.T_station_tool
        travel = np.linalg.inv(problem.sweeps.T_world_scanner[row]) @ T
        # along the sweep's own x and nowhere else, from one end to the other
        np.testing.assert_allclose(travel[:, 1:3, 3], 0.0, atol=1e-3)
        np.testing.assert_allclose(np.sort(travel[[0, -1], 0, 3]), problem.required[row], atol=6e-3)


def test_straight_motions_get_shorter_and_more_trust_goes_further() -> None:
    little, much = refined(0.05), refined(0.5)
    assert little is not None and much is not None
    assert much.connections[1] < little.connections[1] < little.connections[0] == much.connections[0]
    harness = placed_sweeps.harness()
    assert (np.abs(little.values) <= 0.05 * (harness.upper - harness.lower) + 1e-9).all()


def test_nothing_is_found_where_nothing_may_move() -> None:
    assert refined(1.0, harness=placed_sweeps.harness(1e-9, 1e-9)) is None


def test_the_base_moves_instead_of_the_part() -> None:
    moved = refined(0.5, moves_base=True)
    assert moved is not None and moved.connections[1] < moved.connections[0]


def test_what_moves_keeps_clear_of_a_hull_in_its_way() -> None:
    free = refined(0.5)
    assert free is not None
    problem = placed_sweeps.problem()
    part = problem.cell.bodies[-1]
    there = (problem.motion(free.values) @ part.T_parent_body)[:3, 3]
    here = part.T_parent_body[:3, 3]
    # a ball beside where the part wants to go, clear of where it stands
    away = float(np.linalg.norm(there - here))
    obstacle = Body("ball", Box((0.01, 0.01, 0.01)), WORLD, pose(there, np.eye(3)))
    bodies = problem.cell.bodies
    blocked = replace(problem, cell=replace(problem.cell, bodies=(*bodies[:-1], obstacle, bodies[-1])))
    spheres = {name: Spheres(np.zeros((1, 3)), np.array([0.4 * away])) for name in ("ball", part.name)}
    found = refine_design(blocked, spheres, trial().plan, ZERO, trust=0.5)
    at = ZERO if found is None else found.values
    assert min(proven_gaps(blocked, spheres, at).values()) >= -1e-6
    assert proven_gaps(blocked, spheres, free.values)[part.name, "ball"] < 0.0


def test_hulls_that_touch_already_are_left_to_exact_tests() -> None:
    problem = with_block()
    clear = layout_problem(problem, {name: hulls(problem)[name] for name in ("block", "part")}, trial().plan, ZERO)
    assert [station.name for station in clear.stations] == [MOVED, "block"]
    touching = layout_problem(problem, hulls(problem, 2.0), trial().plan, ZERO)
    assert [station.name for station in touching.stations] == [MOVED]


@pytest.mark.parametrize("moves_base", [False, True])
def test_gaps_are_those_of_what_moves_against_what_stands(moves_base: bool) -> None:
    problem = with_block(moves_base=moves_base)
    values = np.array([0.1, -0.05, 0.3])
    given = {name: hulls(problem)[name] for name in ("block", "part")}
    found = proven_gaps(problem, given, values)
    if moves_base:
        assert found == {}  # the base has no hull here
        return
    cell = problem.moved_cell(values)
    apart = np.linalg.norm(cell.bodies[-1].T_parent_body[:3, 3] - BLOCK.T_parent_body[:3, 3])
    assert found == {("part", "block"): pytest.approx(apart - 0.1, abs=1e-12)}


def test_no_further_trial_is_worse_than_it_promised_and_a_hopeless_one_is_not_tried() -> None:
    judge = placed_sweeps.judge()
    further = refine_trials(judge, [trial()], {}, SETTINGS, most=1, gain=0.01)
    assert all(each.method == "gradient" and each.bound < trial().cycle for each in further)
    assert all(each.cycle >= each.bound - 1e-9 for each in further)
    assert refine_trials(judge, [trial()], {}, SETTINGS, most=1, gain=100.0) == []
    lost = replace(trial(), cycle=np.inf, plan=())
    assert refine_trials(judge, [lost], {}, SETTINGS, most=1, gain=0.01) == []
