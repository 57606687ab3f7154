from __future__ import annotations

import io

import numpy as np
from matplotlib.image import imread

from cellwright.figures.surface_view import hidden_points
from cellwright.figures.tool_path import orders_chart, parts_chart, tool_path_picture
from schemas.cell_objects import build_cell
from tests import small_sequence as small


def test_the_way_of_the_tool_is_drawn_even_where_it_leaves_the_cell() -> None:
    cell = build_cell(small.cell())
    way = np.array([[0.5, 0.0, 0.5], [0.5, 0.0, 3.0], [0.8, 0.2, 0.5]])
    tasks = np.eye(4)[None].repeat(1, axis=0)
    tasks[0, :3, 3] = way[-1]
    picture = imread(io.BytesIO(tool_path_picture(cell, way, tasks)))
    red = (picture[..., 0] > 0.7) & (picture[..., 1] < 0.35) & (picture[..., 2] < 0.4)
    assert red.sum() > 200 and not red[0].any() and not red[:, 0].any()
    assert tool_path_picture(cell, way, tasks) == tool_path_picture(cell, way, tasks)


def test_points_behind_a_mesh_are_hidden() -> None:
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    points = np.array([[0.5, 0.5, -0.002], [0.5, 0.5, 0.002], [2.0, 0.5, -0.002]])
    assert hidden_points(square, faces, points, np.array([0.0, 0.0, 1.0])).tolist() == [True, False, False]
    assert hidden_points(square, faces, points, np.array([0.0, 0.0, -1.0])).tolist() == [False, True, False]


def test_the_likely_bound_is_drawn_where_there_is_one() -> None:
    told = {"as listed": 4.0, "sequence": 3.0}, [("motions", 2.0), ("strokes", 1.0)], 2.0, "s", "cost"
    assert orders_chart(*told, np.nan) == orders_chart(*told) != orders_chart(*told, 2.5)


def test_an_order_without_a_way_is_said_and_not_drawn() -> None:
    chart = orders_chart({"as listed": np.inf, "sequence": 3.0}, [("motions", 2.0), ("strokes", 1.0)], 2.5, "s")
    assert imread(io.BytesIO(chart)).shape[0] > 100


def test_the_legend_of_parts_lies_below_the_bars() -> None:
    bars = [("short", (1.0, 1.0, 1.0)), ("long", (100.0, 90.0, 80.0))]
    picture = imread(io.BytesIO(parts_chart(bars, ("motions", "strokes", "holding"), "Parts")))[..., :3]
    waiting = np.array([0xE0, 0xA3, 0x3A]) / 255
    rows = np.flatnonzero((np.abs(picture - waiting) < 0.02).all(axis=2).sum(axis=1) > 10)
    long_bar, *_, legend = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    assert len(legend) < 0.5 * len(long_bar) and legend.min() > long_bar.max() + len(long_bar) / 2
