"""The rounds of collision avoidance in the configuration space of a two-joint arm, as Bjorkenstam 2014, Fig. 2."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.figures.coverage_map import plain_text, png_bytes
from cellwright.solvers.optimal_control.clearance_boxes import ClearanceScene
from cellwright.solvers.optimal_control.collision_free import Stage

_GRID = 90
_PATH, _FOUND, _BOX, _BLOCKED = "#5c6670", "#3f6fd6", "#2a9d5c", "#d1495b"
_NUMERALS = ("I", "II", "III", "IV", "V", "VI")


def trust_region_stages(
    scene: ClearanceScene,
    stages: list[Stage],
    shown: list[int],
    box: tuple[FloatArray, FloatArray],
    *,
    names: tuple[str, str] = ("joint 1", "joint 2"),
) -> bytes:
    """Draw rounds side by side as PNG bytes: the path each begins with, its trust regions, and what it finds.

    Args:
        scene: Distances of the two-joint arm; its clearance is the border of the red area.
        stages: The rounds of `avoid`.
        shown: Rows of ``stages`` to draw.
        box: Lower and upper joint positions (2,) in rad of the picture.
        names: What the axes are called.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.4 * len(shown), 4.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    first, second = (np.linspace(box[0][k], box[1][k], _GRID) for k in (0, 1))
    distance = 1e3 * np.array([[scene.distance(np.array([a, b])) for a in first] for b in second])
    plots = np.atleast_1d(figure.subplots(1, len(shown), sharex=True, sharey=True))
    for number, (axes, row) in enumerate(zip(plots, shown)):
        _draw_distance(axes, first, second, distance, 1e3 * scene.clearance_m)
        _draw_stage(axes, stages[row])
        stage = _NUMERALS[number] if number < len(_NUMERALS) else str(number + 1)
        cost = stages[row].motion.curve.cost
        axes.set_title(f"Stage {stage}: round {row + 1}, cost {cost:.4g}", loc="left", fontsize=10)
        axes.set_xlabel(f"{plain_text(names[0])}, rad", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    plots[0].set_ylabel(f"{plain_text(names[1])}, rad", fontsize=9)
    handles, labels = plots[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9)
    return png_bytes(figure)


def _draw_distance(axes: Any, first: FloatArray, second: FloatArray, distance: FloatArray, clearance: float) -> None:
    axes.contourf(first, second, distance, levels=[-1.0, max(clearance, 1e-3)], colors=[_BLOCKED], alpha=0.45)
    spread = np.linspace(clearance, float(distance.max()), 9)[1:-1]
    axes.contour(first, second, distance, levels=spread, colors="#9aa5b1", linewidths=0.5)
    axes.fill([], [], color=_BLOCKED, alpha=0.45, label=f"closer than {clearance:.3g} mm")


def _draw_stage(axes: Any, stage: Stage) -> None:
    from matplotlib.patches import Rectangle

    label: str | None = "trust region"
    for low, high in zip(stage.lower, stage.upper):
        width, height = (high - low).tolist()
        axes.add_patch(
            Rectangle(low.tolist(), width, height, fill=False, edgecolor=_BOX, linewidth=0.8, alpha=0.9, label=label)
        )
        label = None
    axes.plot(*stage.q.T, "o--", color=_PATH, markersize=3, linewidth=0.9, label="path before")
    curve = stage.motion.curve.motion.position
    axes.plot(*curve.T, color=_FOUND, linewidth=1.6, label="path found")
    axes.plot(*stage.motion.discrete.q.T, "o", color=_FOUND, markersize=3)
    axes.plot(*curve[[0, -1]].T, "s", color="black", markersize=5, linestyle="none", label="start and goal")
