"""Pictures of layouts as PNG: cells from above with the tool's way, and cycle time against processor time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cellwright.figures.coverage_map import plain_text, png_bytes

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from cellwright.solvers.layout.problem import LayoutProblem
    from cellwright.solvers.layout.solution import LayoutSolution

_COLOURS = ("#3f6fd6", "#d1495b", "#2a9d5c", "#e07a1f", "#7b5ea7", "#3fa7d6", "#8d6a3f", "#c9a227")
_TARGET = "#f4c430"
_ROBOT = "#5c6670"
_WAY = "#22304f"
_REACH_SAMPLES = 4000
_WAY_SAMPLES = 120
_MOST_COLUMNS = 4


def layout_view(problem: LayoutProblem, layouts: Sequence[tuple[str, LayoutSolution]]) -> bytes:
    """Draw layouts side by side from above as PNG bytes.

    Stations are their hulls' spheres with a tick along their x axis, yellow dots the tool's targets, the dark line the
    tool's way in one cycle, the grey disc the robot's base and the dashed circle how far its tool reaches.

    Args:
        problem: What the layouts solve.
        layouts: A title and a solution each, for instance before and after.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n_columns = min(len(layouts), _MOST_COLUMNS)
    n_rows = -(-len(layouts) // n_columns)
    figure = Figure(figsize=(4.2 * n_columns, 4.5 * n_rows), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    reach = _reach(problem)
    shared: Any = None
    for number, (title, solution) in enumerate(layouts, 1):
        shared = axes = figure.add_subplot(n_rows, n_columns, number, sharex=shared, sharey=shared)
        axes.set_title(plain_text(title), fontsize=10, loc="left")
        axes.set_aspect("equal", adjustable="box")
        _draw_robot(axes, problem, solution.design, reach)
        _draw_stations(axes, problem, solution.design)
        _draw_walls(axes, problem, solution.design)
        _draw_way(axes, problem, solution)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=8)
        if number > len(layouts) - n_columns:
            axes.set_xlabel("x, m", fontsize=9)
        if number % n_columns == 1 or n_columns == 1:
            axes.set_ylabel("y, m", fontsize=9)
    return png_bytes(figure)


def _reach(problem: LayoutProblem) -> float:
    """Return the largest horizontal distance of the tool from the base's z axis in m, over fixed samples."""
    arm = problem.arm
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper, (_REACH_SAMPLES, arm.n_joints))
    tool = (arm.flange_pose(q) @ problem.T_flange_tool)[:, :2, 3]
    return float(np.linalg.norm(tool, axis=1).max())


def _draw_robot(axes: Any, problem: LayoutProblem, design: FloatArray, reach: float) -> None:
    from matplotlib.patches import Circle

    T = problem.base_pose(design)
    spheres = problem.robot_spheres
    base = np.flatnonzero(spheres.link == 0)
    centres = (spheres.centres[base] @ T[:3, :3].T + T[:3, 3])[:, :2]
    for centre, radius in zip(centres.tolist(), spheres.radii[base].tolist()):
        axes.add_patch(Circle(centre, radius, facecolor=_ROBOT, alpha=0.35, linewidth=0))
    axes.add_patch(Circle(T[:2, 3].tolist(), reach, fill=False, linestyle=(0, (5, 4)), color=_ROBOT, linewidth=0.9))
    axes.plot(*T[:2, 3].tolist(), marker="s", color=_ROBOT, markersize=5)
    axes.plot([T[0, 3] - reach, T[0, 3] + reach], [T[1, 3] - reach, T[1, 3] + reach], alpha=0.0)


def _draw_stations(axes: Any, problem: LayoutProblem, design: FloatArray) -> None:
    from matplotlib.patches import Circle

    poses = problem.station_poses(design)
    for number, station in enumerate(problem.stations):
        T, colour = poses[number], _COLOURS[number % len(_COLOURS)]
        centres = (station.hull.centres @ T[:3, :3].T + T[:3, 3])[:, :2]
        for centre, radius in zip(centres.tolist(), station.hull.radii.tolist()):
            axes.add_patch(Circle(centre, radius, facecolor=colour, alpha=0.22, edgecolor=colour, linewidth=0.5))
        origin = T[:2, 3]
        tip = origin + 0.12 * T[:2, 0] * max(1.0, _size(station.hull.radii))
        axes.plot([origin[0], tip[0]], [origin[1], tip[1]], color=colour, linewidth=2.0)
        axes.annotate(
            plain_text(station.name), origin, xytext=(4, -10), textcoords="offset points", fontsize=7, color=colour
        )
        for approach in station.approaches:
            way = (T @ approach.T_station_tool)[:, :2, 3]
            axes.plot(way[:, 0], way[:, 1], color=_TARGET, linewidth=1.5, zorder=4)
            axes.plot(
                way[[0], 0], way[[0], 1], "o", color=_TARGET, markersize=5, markeredgecolor="black",
                markeredgewidth=0.4, zorder=5,
            )  # fmt: skip


def _size(radii: FloatArray) -> float:
    return 1.0 if not len(radii) else 2.0 * float(radii.max())


def _draw_walls(axes: Any, problem: LayoutProblem, design: FloatArray) -> None:
    middle = problem.base_pose(design)[:2, 3]
    for wall in problem.walls:
        normal = wall.normal[:2]
        if np.linalg.norm(normal) < 0.5:
            continue
        foot = middle + (wall.offset_m - normal @ middle) * normal
        along = np.array([-normal[1], normal[0]])
        axes.axline(foot.tolist(), (foot + along).tolist(), color="black", linewidth=1.2)


def _draw_way(axes: Any, problem: LayoutProblem, solution: LayoutSolution) -> None:
    T_world_base = problem.base_pose(solution.design)
    for transition in solution.transitions:
        q = transition.at(np.linspace(0.0, transition.duration_s, _WAY_SAMPLES))
        tool = (T_world_base @ problem.arm.flange_pose(q) @ problem.T_flange_tool)[:, :2, 3]
        axes.plot(tool[:, 0], tool[:, 1], color=_WAY, linewidth=1.2, alpha=0.9, zorder=3)


def time_scatter(runs: Sequence[tuple[str, float, float]], *, title: str = "") -> bytes:
    """Draw cycle time against processor time, and the distribution of the cycle times, as PNG bytes.

    Args:
        runs: Solver, processor time in s and cycle time in s of each run that passed its gate.
        title: Heading.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(name for name, _, _ in runs))
    figure = Figure(figsize=(11.0, 4.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=[3, 2])
    spread = []
    for number, name in enumerate(names):
        colour = _COLOURS[number % len(_COLOURS)]
        cpu = np.array([time for solver, time, _ in runs if solver == name])
        cycle = np.array([time for solver, _, time in runs if solver == name])
        spread.append(cycle)
        left.plot(cpu, cycle, "o", color=colour, alpha=0.45, markersize=4, markeredgewidth=0)
        left.plot(
            [np.median(cpu)], [np.median(cycle)], "D", color=colour, markersize=9, markeredgecolor="black",
            markeredgewidth=0.7, label=plain_text(name),
        )  # fmt: skip
    left.set_xscale("log")
    left.xaxis.set_major_formatter("{x:g}")
    left.set_xlabel("processor time, s")
    left.set_ylabel("cycle time, s")
    left.set_ylim(bottom=0.0)
    left.legend(frameon=False, fontsize=8, title="diamonds: medians", title_fontsize=8)
    boxes = right.boxplot(spread, patch_artist=True, widths=0.6, medianprops={"color": "black"}, flierprops={"ms": 3})
    for number, box in enumerate(boxes["boxes"]):
        box.set(facecolor=_COLOURS[number % len(_COLOURS)], alpha=0.55)
    right.set_xticks(
        range(1, len(names) + 1), [plain_text(name) for name in names], fontsize=7, rotation=25, ha="right"
    )
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", linewidth=0.4, alpha=0.5)
    if title:
        left.set_title(plain_text(title), loc="left", fontsize=11)
    return png_bytes(figure)
