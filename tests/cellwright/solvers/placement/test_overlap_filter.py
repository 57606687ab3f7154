"""The quick filter refuses nothing that the exact test of standing bodies permits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.bodies import WORLD, Body, Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.parametric_parts import revolve
from cellwright.cell.transforms import pose
from cellwright.solvers.placement.judge import PlacementJudge, Refusal
from cellwright.solvers.placement.problem import PlacementProblem
from cellwright.solvers.placement.trial import overlap_depths
from tests.cellwright.solvers import scanning_cell
from tests.cellwright.solvers.placement.placed_sweeps import harness, problem

TABLE_TOP = -0.005
AWAY = 0.4
"""Metres along y from the part to the block in these scenes."""


def scene(shape: Shape, depth: float, **changes: Any) -> PlacementProblem:
    """A block on whose way the part comes to stand ``depth`` m under its surface when it is moved by `AWAY`."""
    cell = scanning_cell.cell()
    at = [0.0, AWAY + 2.0 * scanning_cell.RADIUS - depth, 0.15]
    block = Body("block", shape, WORLD, pose(scanning_cell.PART_AT + np.array(at), np.eye(3)))
    bodies = (*scanning_cell.cell_without_part().bodies, block, cell.bodies[-1])
    given = {"cell": replace(cell, bodies=bodies), "harness": harness(0.5), **changes}
    return problem(2, **given)


THERE = np.array([0.0, AWAY, 0.0])


def is_refused(task: PlacementProblem, values: np.ndarray = THERE) -> bool:
    return PlacementJudge(task).judge(values).refusal == Refusal.OVERLAP


def block() -> Box:
    return Box((0.3, 2.0 * scanning_cell.RADIUS, 0.2))


@pytest.mark.parametrize("depth", [1e-6, 5e-4])
def test_what_is_no_deeper_than_rest_is_not_refused(depth: float) -> None:
    task = scene(block(), depth)
    assert not overlap_depths(task, THERE)
    assert not is_refused(task)


def test_what_is_deeper_is_refused_and_the_exact_test_agrees() -> None:
    task = scene(block(), 0.02)
    assert overlap_depths(task, THERE)["part", "block"] > task.resting
    assert is_refused(task)
    assert not is_refused(replace(task, resting=0.03))


def test_what_may_stand_in_one_another_is_not_refused() -> None:
    task = scene(block(), 0.05)
    rows = len(task.cell.bodies) - 2, len(task.cell.bodies) - 1
    for pair in (rows, rows[::-1]):
        assert not is_refused(replace(task, permitted=(pair,)))


def test_a_part_that_is_flush_in_its_table_may_slide_on_it() -> None:
    cell = scanning_cell.cell(scanning_cell.PART_AT + np.array([0.0, 0.0, TABLE_TOP - 5e-4]))
    assert not is_refused(problem(2, cell=cell, harness=harness(0.5)), np.array([0.05, 0.1, 0.2]))


def ring() -> Mesh:
    """Not convex: a pipe."""
    return revolve(np.array([[0.06, -0.1], [0.12, -0.1], [0.12, 0.1], [0.06, 0.1]]), 24)


SHAPES: list[Shape] = [block(), Sphere(0.12), Cylinder(0.12, 0.2), Capsule(0.1, 0.1), scanning_cell.part(), ring()]


@settings(deadline=None, max_examples=30)
@given(st.sampled_from(SHAPES), st.floats(-0.02, 0.06), st.floats(0.0, 0.02), st.floats(-np.pi, np.pi))
def test_nothing_is_refused_that_the_exact_test_permits(shape: Shape, depth: float, resting: float, yaw: float) -> None:
    task = scene(shape, depth, resting=resting)
    values = np.array([0.0, AWAY, yaw])
    if is_refused(task, values):
        assert overlap_depths(task, values).get(("part", "block"), 0.0) > resting - 1e-4
