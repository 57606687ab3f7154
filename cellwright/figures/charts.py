"""The report's flat charts as PNG: predicted uncertainty, and the plan over time."""

from __future__ import annotations

import numpy as np

from cellwright.arrays import AnyArray, FloatArray
from cellwright.figures.coverage_map import plain_text, png_bytes

SWEEP_COLOUR = "#2a9d5c"
CONNECTION_COLOUR = "#9aa5b1"
_MOST_NUMBERS = 40


def uncertainty_histogram(uncertainty: AnyArray, permitted: float) -> bytes:
    """Draw how the predicted uncertainties (values in m, NaN ignored) spread below the permitted one (m)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    micrometres = 1e6 * uncertainty[np.isfinite(uncertainty)]
    figure = Figure(figsize=(8, 3.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    edges = np.linspace(0.0, 1e6 * permitted * 1.02, 52).tolist()
    axes.hist(micrometres, bins=edges, color="#3fa7d6", edgecolor="white", linewidth=0.4)
    axes.axvline(1e6 * permitted, color="#d1495b", linewidth=1.5)
    axes.annotate(
        f"permitted {1e6 * permitted:.0f} µm", (1e6 * permitted, 0.96), xycoords=("data", "axes fraction"),
        ha="right", va="top", xytext=(-6, 0), textcoords="offset points", color="#d1495b",
    )  # fmt: skip
    if len(micrometres):
        median, high = np.quantile(micrometres, [0.5, 0.95])
        axes.set_title(f"median {median:.1f} µm, 95% below {high:.1f} µm", loc="left", fontsize=11)
    axes.set_xlim(0.0, edges[-1])
    axes.set_xlabel("smallest predicted uncertainty of a measured point, µm")
    axes.set_ylabel("points of the verification cloud")
    axes.spines[["top", "right"]].set_visible(False)
    return png_bytes(figure)


def plan_chart(
    time: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    max_velocity: FloatArray,
    joints: tuple[str, ...],
    segments: list[tuple[float, float, bool]],
    *,
    marked: str = "sweeps",
) -> bytes:
    """Draw joint positions and the share of the speed limit over time; sweeps stand numbered on coloured ground.

    Args:
        time: State times in s, (n,).
        position, velocity: Joint states in rad and rad/s, (n, joints).
        max_velocity: Joint speed limits in rad/s, (joints,).
        joints: Joint names.
        segments: Begin and end in s and whether the segment is a sweep.
        marked: What stands on coloured ground, in the plural.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MultipleLocator

    figure = Figure(figsize=(12, 5.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    above = figure.add_subplot(2, 1, 1)
    below = figure.add_subplot(2, 1, 2, sharex=above)
    sweeps = [(begin, end) for begin, end, is_sweep in segments if is_sweep]
    for axes in (above, below):
        for begin, end in sweeps:
            axes.axvspan(begin, end, color=SWEEP_COLOUR, alpha=0.13, linewidth=0)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0)
    for joint, name in enumerate(joints):
        above.plot(time, np.degrees(position[:, joint]), linewidth=1.2, label=plain_text(name))
        below.plot(time, 100 * np.abs(velocity[:, joint]) / max_velocity[joint], linewidth=1.0)
    if len(sweeps) <= _MOST_NUMBERS:  # more would run into each other
        for number, (begin, end) in enumerate(sweeps, 1):
            above.annotate(
                str(number), ((begin + end) / 2, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 3),
                textcoords="offset points", ha="center", fontsize=9, color="#1f7a46",
            )  # fmt: skip
    below.axhline(100, color="#d1495b", linewidth=1)
    below.set_ylim(0, 105)
    above.yaxis.set_major_locator(MultipleLocator(90 if np.ptp(np.degrees(position)) > 180 else 45))
    above.grid(axis="y", color="#e3e7eb", linewidth=0.8)
    above.set_ylabel("joint position, °")
    below.set_ylabel("speed, % of limit")
    below.set_xlabel(f"time, s ({marked} on green, numbered in the order in which they run)")
    above.legend(handles=above.get_lines(), loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=9)
    return png_bytes(figure)
