"""Pictures of a sequence of tasks: the way of the tool through the cell, and the orders that were compared."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.figures.cell_layout import laid_out
from cellwright.figures.cell_view import draw_overview
from cellwright.figures.coverage_map import png_bytes
from cellwright.figures.surface_view import hidden_points

PATH = "#d1263f"
WORKING = "#2a9d5c"
WAITING = "#e0a33a"
MOVING = "#9aa5b1"
OFF_THE_WORK = 0.002
"""Metres before a task, along its tool, from which it is looked at: it lies on the work itself."""
_MOST_NUMBERS = 60
"""More numbers than these hide each other."""


def tool_path_picture(cell: Cell, way: FloatArray, T_world_task: FloatArray) -> bytes:
    """Draw a cell at its start configuration with the way of the tool point, as PNG bytes.

    Tasks that something hides are rings with their number below, so that tasks on both sides of a sheet all show.

    Args:
        cell: The cell.
        way: Positions of the tool point over time, (states, 3) in m, in the world.
        T_world_task: Poses of the tool at the tasks in the order of the sequence, (tasks, 4, 4), z into the work.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 7.6), dpi=110)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.16, 0.03, 0.68, 0.94))
    layout = laid_out(cell)
    stops = T_world_task[:, :3, 3]
    layout = replace(layout, framed=np.concatenate([layout.framed, way, stops]))
    _, onto, towards = draw_overview(axes, layout, None, cell.robot.name)
    axes.plot(*onto(way).T, color="white", linewidth=2.6, alpha=0.7, solid_joinstyle="round")
    axes.plot(*onto(way).T, color=PATH, linewidth=1.2, solid_joinstyle="round")
    solids = layout.solids(large=False)
    hidden = hidden_points(solids.vertices, solids.faces, stops - OFF_THE_WORK * T_world_task[:, :3, 2], towards)
    places = onto(stops)
    dots: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.6, "markersize": 5.5, "color": WORKING}
    rings: dict[str, Any] = {
        "markeredgecolor": WORKING,
        "markeredgewidth": 1.6,
        "markersize": 9.5,
        "markerfacecolor": "none",
    }
    axes.plot(*places[~hidden].T, "o", **dots, label="task")
    axes.plot(*places[hidden].T, "o", **rings, label="task, hidden from here")
    for number, (place, behind) in enumerate(list(zip(places, hidden))[:_MOST_NUMBERS], 1):
        axes.annotate(
            str(number), place, xytext=(-5, -5) if behind else (4, 4), textcoords="offset points", fontsize=8,
            ha="right" if behind else "left", va="top" if behind else "bottom", color="#12351f",
            bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.65},
        )  # fmt: skip
    if hidden.any():
        figure.legend(*axes.get_legend_handles_labels(), loc="lower right", frameon=False, fontsize=9)
    return png_bytes(figure)


def orders_chart(
    costs: Mapping[str, float],
    parts: Sequence[tuple[str, float]],
    bound: float,
    unit: str,
    what: str = "cost",
    likely: float = math.nan,
) -> bytes:
    """Draw what the compared orders cost, the last of them in its parts, and the lower bound, as PNG bytes.

    Args:
        costs: Cost by the name of the order, infinite where a way has no motion; the last is the sequence's.
        parts: Name and cost of the parts of the last one.
        bound: No sequence costs less.
        unit: Unit of the costs.
        what: What the costs are called.
        likely: What no sequence likely undercuts; not a number where nothing is said about it.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = list(costs)
    figure = Figure(figsize=(12, 0.9 + 0.55 * len(names)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    left = 0.0
    for (name, cost), colour in zip(parts, (MOVING, WORKING, WAITING)):
        axes.barh(len(names) - 1, cost, left=left, color=colour, label=name, height=0.62)
        left += cost
    for row, name in enumerate(names[:-1]):
        axes.barh(row, costs[name] if np.isfinite(costs[name]) else 0.0, color="#cfd6dd", height=0.62)
    for row, name in enumerate(names):
        finite = bool(np.isfinite(costs[name]))
        words = f"{costs[name]:.2f} {unit}".strip() if finite else "a way has no motion"
        axes.annotate(words, (costs[name] if finite else 0.0, row), xytext=(6, 0), textcoords="offset points",
                      va="center", fontsize=10)  # fmt: skip
    axes.axvline(bound, color=PATH, linewidth=1.3, label="lower bound, proven")
    if math.isfinite(likely):
        axes.axvline(likely, color=PATH, linewidth=1.3, linestyle="--", label="lower bound, likely")
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel(f"{what}, {unit}" if unit else what)
    axes.margins(x=0.12)
    axes.set_xlim(left=0.0)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=9)
    return png_bytes(figure)


def parts_chart(bars: Sequence[tuple[str, Sequence[float]]], parts: Sequence[str], title: str) -> bytes:
    """Draw what sequences cost in parts, one bar each from the top, as PNG bytes.

    Args:
        bars: Name of a sequence, and what its parts cost.
        parts: Names of the parts.
        title: Heading.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 1.6 + 0.5 * len(bars)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    left = np.zeros(len(bars))
    rows = np.arange(len(bars))
    for number, (part, colour) in enumerate(zip(parts, (MOVING, WORKING, WAITING))):
        width = np.array([values[number] for _, values in bars])
        axes.barh(rows, width, left=left, color=colour, label=part, height=0.62)
        left += width
    for row, total in enumerate(left.tolist()):
        axes.annotate(f"{total:,.0f}", (total, row), xytext=(6, 0), textcoords="offset points", va="center")
    axes.set_yticks(rows, [name for name, _ in bars])
    axes.invert_yaxis()
    axes.set_title(title, loc="left", fontsize=11)
    axes.set_xlabel("cost")
    axes.margins(x=0.1)
    axes.set_xlim(left=0.0)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=len(parts), frameon=False, fontsize=9)
    return png_bytes(figure)
