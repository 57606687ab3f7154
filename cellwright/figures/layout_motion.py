"""Charts of a layout as PNG: joint positions over the cycle with their limits, and how its starts scatter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cellwright.figures.coverage_map import plain_text, png_bytes

if TYPE_CHECKING:
    from cellwright.arrays import BoolArray, FloatArray

_LINE, _LIMIT, _GROUND = "#3f6fd6", "#d1495b", "#eef1f4"
_PASSED, _MISSED = "#2a9d5c", "#9aa5b1"
_ROOM = 0.08


def motion_chart(
    motions: Sequence[tuple[str, FloatArray, FloatArray]],
    joints: Sequence[str],
    revolute: BoolArray,
    lower: FloatArray,
    upper: FloatArray,
) -> bytes:
    """Draw each joint's position over the cycle, a panel each, with its limits where they are near.

    Args:
        motions: Title, times in s from the cycle's beginning (n,), and positions (n, joints) of each transition.
        joints: Names.
        revolute: Whether a joint turns (rad, drawn in degrees) or slides (m, drawn in mm), (joints,).
        lower, upper: Limits in rad or m, (joints,).
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n = len(joints)
    figure = Figure(figsize=(11.0, 1.0 + 1.15 * n), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
    for joint, axes in enumerate(panels):
        factor = 180.0 / np.pi if revolute[joint] else 1e3
        for number, (title, time, position) in enumerate(motions):
            if number % 2 == 0:
                axes.axvspan(time[0], time[-1], color=_GROUND, linewidth=0)
            axes.plot(time, factor * position[:, joint], color=_LINE, linewidth=1.4)
            if joint == 0:
                middle = 0.5 * (time[0] + time[-1])
                axes.annotate(
                    plain_text(title), (middle, 1.03), xycoords=("data", "axes fraction"), ha="center", fontsize=7
                )
        moved = np.concatenate([position[:, joint] for _, _, position in motions])
        low, high = float(moved.min()), float(moved.max())
        room = max(high - low, 0.02 * float(upper[joint] - lower[joint]), 1e-6)
        axes.set_ylim(factor * (low - 0.25 * room), factor * (high + 0.25 * room))
        for limit in (lower[joint], upper[joint]):
            if low - 0.25 * room <= limit <= high + 0.25 * room:
                axes.axhline(factor * limit, color=_LIMIT, linewidth=1.0)
        unit = "°" if revolute[joint] else "mm"
        limits = f"{factor * lower[joint]:.0f} to {factor * upper[joint]:.0f}{unit if unit == '°' else ' mm'}"
        axes.set_ylabel(f"{plain_text(joints[joint])}\n{unit}", fontsize=8)
        axes.annotate(f"limits {limits}", (1.005, 0.5), xycoords="axes fraction", va="center", fontsize=7, color=_LIMIT)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=7)
        axes.margins(x=0)
    panels[-1].set_xlabel("time in the cycle, s (transitions alone; a limit is drawn where it is near)", fontsize=9)
    return png_bytes(figure)


def starts_chart(cycle_s: FloatArray, converged: BoolArray, before_s: float) -> bytes:
    """Draw the cycle times of all starts in ascending order; those that missed their gate are grey.

    Args:
        cycle_s: Cycle times in s, (starts,).
        converged: Whether each passed its gate, (starts,).
        before_s: Cycle time where the first start began; NaN if there is none.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    order = np.lexsort((cycle_s, ~converged))
    figure = Figure(figsize=(max(5.0, min(11.0, 3.0 + 0.4 * len(cycle_s))), 3.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    colours = [_PASSED if converged[row] else _MISSED for row in order]
    axes.bar(np.arange(len(order)), cycle_s[order], color=colours, width=0.7)
    for place, row in enumerate(order.tolist()):
        axes.annotate(f"{cycle_s[row]:.2f}", (place, cycle_s[row]), ha="center", va="bottom", fontsize=7)
    if np.isfinite(before_s):
        axes.axhline(before_s, color=_LIMIT, linewidth=1.0)
        axes.annotate(
            f"before: {before_s:.2f} s", (0.995, before_s), xycoords=("axes fraction", "data"), ha="right", va="bottom",
            fontsize=8, color=_LIMIT,
        )  # fmt: skip
    axes.set_xticks(np.arange(len(order)), [str(row) for row in order], fontsize=7)
    axes.set_xlabel("start (its number in the lake's table); grey: missed its gate", fontsize=9)
    axes.set_ylabel("cycle time, s")
    axes.set_ylim(0.0, (1.0 + _ROOM) * float(max(cycle_s.max(), before_s if np.isfinite(before_s) else 0.0)))
    axes.spines[["top", "right"]].set_visible(False)
    return png_bytes(figure)
