"""Pictures of layouts are PNG that show what they are given, and are the same bytes for the same data."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from cellwright.arrays import AnyArray
from cellwright.figures.layout_charts import interval_chart, layout_view, time_scatter
from cellwright.solvers.layout.examples import station_distance_problem
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.proxies import time_layout
from cellwright.solvers.layout.solution import LayoutSolution
from cellwright.solvers.layout.staged import StagedSettings


def pixels(png: bytes) -> AnyArray:
    with Image.open(io.BytesIO(png)) as image:
        return np.asarray(image.convert("RGB")).astype(int)


@pytest.fixture(scope="module")
def solved() -> tuple[LayoutProblem, LayoutSolution]:
    problem = station_distance_problem()
    design = np.array([0.9, 0.0, 0.0, 0.0, 0.9, 0.5])
    return problem, time_layout(problem, design, np.random.default_rng(0), StagedSettings(n_segments=10))


def test_layouts_stand_side_by_side(solved: tuple[LayoutProblem, LayoutSolution]) -> None:
    problem, solution = solved
    one = pixels(layout_view(problem, [("before", solution)]))
    two = pixels(layout_view(problem, [("before", solution), ("after, $1", solution)]))
    assert two.shape[1] == 2 * one.shape[1]
    yellow = np.abs(two - np.array([244, 196, 48])).max(axis=-1) <= 8
    left, right = np.hsplit(yellow, 2)
    assert left.sum() > 20 and right.sum() > 20


def test_a_station_that_moves_changes_the_picture_and_nothing_else_does(
    solved: tuple[LayoutProblem, LayoutSolution],
) -> None:
    problem, solution = solved
    picture = layout_view(problem, [("", solution)])
    assert layout_view(problem, [("", solution)]) == picture
    moved = solution.design + np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    other = time_layout(problem, moved, np.random.default_rng(0), StagedSettings(n_segments=10))
    assert layout_view(problem, [("", other)]) != picture


def test_the_scatter_shows_every_solver() -> None:
    rng = np.random.default_rng(0)
    runs = [(f"solver {k}", float(rng.uniform(0.1, 10)), float(rng.uniform(1, 3))) for k in range(3) for _ in range(9)]
    png = time_scatter(runs, title="cycle against time, $")
    assert time_scatter(runs, title="cycle against time, $") == png
    seen = pixels(png)
    for colour in ((63, 111, 214), (209, 73, 91), (42, 157, 92)):
        assert (np.abs(seen - np.array(colour)).max(axis=-1) <= 8).sum() > 30


def test_a_chart_of_intervals_is_the_same_bytes_for_the_same_rows_and_changes_with_them() -> None:
    rows = [("direct", 10, 0.02), ("direct", 100, 0.001), ("ours", 10, 0.0)]
    chart = interval_chart(rows, title="wall")
    assert chart.startswith(b"\x89PNG")
    assert chart == interval_chart(list(rows), title="wall")
    assert chart != interval_chart(rows[:2], title="wall")
