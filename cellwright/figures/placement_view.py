"""Two placements of one cell from above, side by side, with the way of the flange: sweeps thick, connections thin."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellwright.arrays import BoolArray, FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import flange_pose
from cellwright.figures.cell_layout import COLOURS, PART_ROLE, ROBOT, SCANNER, STANDING, Layout, laid_out
from cellwright.figures.charts import CONNECTION_COLOUR, SWEEP_COLOUR
from cellwright.figures.coverage_map import plain_text, png_bytes

MOST_STATES = 4000
"""States of a way that are drawn at most."""
_INK = "#1d2731"


@dataclass(frozen=True, eq=False)
class PlacedPlan:
    """A plan where it runs.

    Attributes:
        cell: The cell, with the part.
        position: Joint positions over time, (states, joints) in rad.
        sweeping: Whether the state belongs to a sweep, (states,).
        title: What to write above it.
    """

    cell: Cell
    position: FloatArray
    sweeping: BoolArray
    title: str


def flange_way(cell: Cell, position: FloatArray) -> FloatArray:
    """Return where the flange is in the world at joint ``position`` (states, joints), (states, 3) in m."""
    chain = cell.robot.chain
    p_base = np.array(
        [flange_pose(chain.T_parent_joint, chain.axis, chain.T_last_flange, q)[:3, 3] for q in position]
    ).reshape(-1, 3)
    return np.asarray(p_base @ cell.T_world_base[:3, :3].T + cell.T_world_base[:3, 3])


def placement_picture(before: PlacedPlan, after: PlacedPlan) -> bytes:
    """Draw both plans from above on one scale, as PNG bytes; what stood elsewhere before is dashed in the second."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 6.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    layouts = [laid_out(plan.cell) for plan in (before, after)]
    ways = [_thinned(plan) for plan in (before, after)]
    seen = np.concatenate([*(_framing(layout) for layout in layouts), *(way[:, :2] for way, _ in ways)])
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.06 * float((high - low).max())
    for place, (plan, layout, (way, sweeping)) in enumerate(zip((before, after), layouts, ways)):
        axes = figure.add_subplot(1, 2, 1 + place)
        _draw_bodies(axes, layout)
        if place:
            _draw_earlier(axes, layouts[0], layout)
        _draw_way(axes, way, sweeping)
        axes.set_title(plain_text(plan.title), loc="left", fontsize=11)
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
        axes.set_aspect("equal")
        axes.grid(color="#e3e7eb", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xlabel("x in the world, m")
        axes.set_ylabel("y in the world, m")
    _legend(figure)
    return png_bytes(figure)


def _thinned(plan: PlacedPlan) -> tuple[FloatArray, BoolArray]:
    """Return the flange's way, and whether it sweeps there, at few enough states."""
    stride = max(1, math.ceil(len(plan.position) / MOST_STATES))
    kept = np.unique(np.append(np.arange(0, len(plan.position), stride), max(len(plan.position) - 1, 0)))
    kept = kept[kept < len(plan.position)]
    return flange_way(plan.cell, plan.position[kept]), plan.sweeping[kept]


def _framing(layout: Layout) -> FloatArray:
    """Return the points (n, 2) of what sets the frame: all bodies but floors and walls."""
    points = [corners[:, :2] for corners, large in zip(layout.corners, layout.large) if not large]
    return np.concatenate([np.zeros((0, 2)), *points])


def _outline(corners: FloatArray) -> FloatArray:
    """Return the convex outline of a body from above, (n, 2)."""
    from scipy.spatial import ConvexHull

    flat = np.unique(np.round(corners[:, :2], 6), axis=0)
    if len(flat) < 3 or np.linalg.matrix_rank(flat - flat[0], tol=1e-6) < 2:
        return flat
    return np.asarray(flat[ConvexHull(flat).vertices])


def _draw_bodies(axes: Any, layout: Layout) -> None:
    """Draw bodies from below to above, so that what lies higher covers what lies lower."""
    rows = sorted(range(len(layout.names)), key=lambda row: (float(layout.corners[row][:, 2].max()), row))
    for row in rows:
        outline, role = _outline(layout.corners[row]), layout.roles[row]
        if layout.large[row]:
            axes.fill(*outline.T, facecolor=COLOURS[role], edgecolor="none", alpha=0.10, zorder=1)
            continue
        alpha = 0.35 if role in (ROBOT, SCANNER) else 0.85
        axes.fill(*outline.T, facecolor=COLOURS[role], edgecolor=_INK, linewidth=0.6, alpha=alpha, zorder=2)
        if role in (PART_ROLE, STANDING):
            axes.annotate(
                plain_text(layout.names[row]), (outline[:, 0].mean(), outline[:, 1].min()), xytext=(0, -3),
                textcoords="offset points", ha="center", va="top", fontsize=8, color=_INK, zorder=6,
            )  # fmt: skip


def _draw_earlier(axes: Any, earlier: Layout, layout: Layout) -> None:
    """Draw dashed where bodies stood that stand elsewhere now."""
    for row, corners in enumerate(earlier.corners):
        if earlier.large[row] or np.allclose(corners, layout.corners[row], atol=1e-9):
            continue
        outline = _outline(corners)
        closed = np.concatenate([outline, outline[:1]])
        axes.plot(*closed.T, color=_INK, linewidth=0.8, linestyle=(0, (4, 3)), alpha=0.6, zorder=3)


def _draw_way(axes: Any, way: FloatArray, sweeping: BoolArray) -> None:
    if not len(way):
        return
    axes.plot(*way[:, :2].T, color=CONNECTION_COLOUR, linewidth=1.3, zorder=4)
    sweeps = np.where(sweeping[:, None], way[:, :2], np.nan)
    axes.plot(*sweeps.T, color=SWEEP_COLOUR, linewidth=3.0, zorder=5, solid_capstyle="round")
    axes.plot(*way[0, :2], marker="o", markersize=5, color=_INK, zorder=6)


def _legend(figure: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], color=SWEEP_COLOUR, linewidth=3.0, label="flange on sweeps"),
        Line2D([], [], color=CONNECTION_COLOUR, linewidth=1.3, label="flange between them"),
        Line2D([], [], color=_INK, marker="o", markersize=5, linewidth=0, label="start"),
        *(Patch(color=COLOURS[role], label=role) for role in (PART_ROLE, STANDING, ROBOT, SCANNER)),
        Line2D([], [], color=_INK, linewidth=0.8, linestyle=(0, (4, 3)), label="where it stood before"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=8, frameon=False, fontsize=9)
