"""Pictures of layouts as PNG: cells from above with the tool's way, and cycle time against processor time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cellwright.figures.coverage_map import plain_text, png_bytes

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from cellwright.solvers.layout.problem import LayoutProblem
    from cellwright.solvers.layout.solution import Transition

_COLOURS = ("#3f6fd6", "#d1495b", "#2a9d5c", "#e07a1f", "#7b5ea7", "#3fa7d6", "#8d6a3f", "#c9a227")
_TARGET = "#f4c430"
_ROBOT = "#5c6670"
_WAY = "#22304f"
_REACH_SAMPLES = 4000
_WAY_SAMPLES = 120
_MOST_COLUMNS = 4


class Drawn(Protocol):
    """What of a layout is drawn; solutions have it."""

    @property
    def design(self) -> FloatArray:
        """Design joints, (n_design,)."""

    @property
    def transitions(self) -> tuple[Transition, ...]:
        """The robot's motions; none are drawn if there are none."""


def layout_view(problem: LayoutProblem, layouts: Sequence[tuple[str, Drawn]]) -> bytes:
    """Draw layouts of one problem, for instance before and after, side by side from above as PNG bytes.

    Args:
        problem: What the layouts solve.
        layouts: A title and a solution each.
    """
    return layout_views([(problem, title, solution) for title, solution in layouts])


def layout_views(layouts: Sequence[tuple[LayoutProblem, str, Drawn]], *, title: str = "") -> bytes:
    """Draw layouts side by side from above as PNG bytes.

    Stations are their hulls' spheres with a tick along their x axis, yellow dots the tool's targets, the dark line the
    tool's way in one cycle, the grey disc the robot's base and the dashed circle how far its tool reaches.

    Args:
        layouts: A problem, a title and a solution each.
        title: Heading of all.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n_columns = min(len(layouts), _MOST_COLUMNS)
    n_rows = -(-len(layouts) // n_columns)
    figure = Figure(figsize=(4.2 * n_columns, 4.5 * n_rows), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(plain_text(title), fontsize=11)
    shared: Any = None
    for number, (problem, name, solution) in enumerate(layouts, 1):
        shared = axes = figure.add_subplot(n_rows, n_columns, number, sharex=shared, sharey=shared)
        axes.set_title(plain_text(name), fontsize=10, loc="left")
        axes.set_aspect("equal", adjustable="box")
        _draw_robot(axes, problem, solution.design, _reach(problem))
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


def _draw_way(axes: Any, problem: LayoutProblem, solution: Drawn) -> None:
    T_world_base = problem.base_pose(solution.design)
    for transition in solution.transitions:
        q = transition.at(np.linspace(0.0, transition.duration_s, _WAY_SAMPLES))
        tool = (T_world_base @ problem.arm.flange_pose(q) @ problem.T_flange_tool)[:, :2, 3]
        axes.plot(tool[:, 0], tool[:, 1], color=_WAY, linewidth=1.2, alpha=0.9, zorder=3)


def time_scatter(
    runs: Sequence[tuple[str, float, float]],
    *,
    title: str = "",
    published: Sequence[tuple[str, float, float]] = (),
    labels: tuple[str, str] = ("processor time, s", "cycle time, s"),
) -> bytes:
    """Draw cycle time against processor time, and the distribution of the cycle times, as PNG bytes.

    Args:
        runs: Solver, processor time in s and cycle time in s of each run that passed its gate.
        title: Heading.
        published: The same of what others report, drawn as open diamonds.
        labels: Of the two axes.
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
        for solver, time, cycle_time in published:
            if solver == name:
                left.plot([time], [cycle_time], "D", markersize=9, markerfacecolor="none", color=colour)
                left.annotate("paper", (time, cycle_time), xytext=(8, 4), textcoords="offset points", fontsize=8)
    left.set_xscale("log")
    left.xaxis.set_major_formatter("{x:g}")
    left.set_xlabel(plain_text(labels[0]))
    left.set_ylabel(plain_text(labels[1]))
    left.set_ylim(bottom=0.0)
    if names:
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


def best_of_n_chart(cycles: Mapping[str, Sequence[float]], *, title: str = "", y_label: str = "cycle time, s") -> bytes:
    """Draw the expected best cycle time of n runs over n, a line a solver, as PNG bytes.

    The expectation is over all choices of n of the runs; it is drawn from where every choice holds a run that passed.

    Args:
        cycles: Cycle times in s of each solver's runs; infinite where a run missed its gate.
        title: Heading.
        y_label: Label of the y axis.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(7.5, 4.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for number, (name, values) in enumerate(cycles.items()):
        ordered = np.sort(np.asarray(values, float))
        counts = np.arange(1, len(ordered) + 1)
        expected = np.array([expected_best(ordered, int(n)) for n in counts])
        shown = np.isfinite(expected)
        axes.plot(
            counts[shown], expected[shown], marker="o", markersize=3, color=_COLOURS[number % len(_COLOURS)],
            label=plain_text(name),
        )  # fmt: skip
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("runs that the best is taken of")
    axes.set_ylabel(plain_text(y_label))
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, fontsize=8)
    axes.grid(axis="y", linewidth=0.4, alpha=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    if title:
        axes.set_title(plain_text(title), loc="left", fontsize=11)
    return png_bytes(figure)


def expected_best(ordered: FloatArray, n: int) -> float:
    """Return the mean of the smallest of ``n`` values over all choices of n of ascending values (m,), n at most m."""
    total = len(ordered)
    share = np.zeros(total)
    for row in range(total - n + 1):
        # the rest of the choice lies above this value
        share[row] = math.comb(total - 1 - row, n - 1) / math.comb(total, n)
    used = share > 0.0
    return float((share[used] * ordered[used]).sum())


def interval_chart(rows: Sequence[tuple[str, int, float]], *, title: str = "") -> bytes:
    """Draw how deep motions enter obstacles against the intervals N that their solver was given, as PNG bytes.

    Args:
        rows: Solver, N and penetration in m that the dense check found.
        title: Heading.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.8), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for number, name in enumerate(dict.fromkeys(name for name, _, _ in rows)):
        own = sorted((n, 1e3 * depth) for solver, n, depth in rows if solver == name)
        counts, depths = [n for n, _ in own], [depth for _, depth in own]
        axes.plot(counts, depths, "o-", color=_COLOURS[number % len(_COLOURS)], label=plain_text(name))
    axes.set_xscale("log")
    counts = sorted({n for _, n, _ in rows})
    axes.set_xticks(counts, [str(n) for n in counts])
    axes.minorticks_off()
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("intervals N of a transition")
    axes.set_ylabel("penetration between its points, mm")
    axes.legend(frameon=False, fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", linewidth=0.4, alpha=0.5)
    if title:
        axes.set_title(plain_text(title), loc="left", fontsize=11)
    return png_bytes(figure)
