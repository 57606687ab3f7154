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
    torque: FloatArray | None = None,
    max_torque: FloatArray | None = None,
) -> bytes:
    """Draw joint positions and shares of the speed limits over time; sweeps stand numbered on coloured ground.

    Shares of the torque limits stand below where torques are known.

    Args:
        time: State times in s, (n,).
        position, velocity: Joint states in rad and rad/s, (n, joints).
        max_velocity: Joint speed limits in rad/s, (joints,).
        joints: Joint names.
        segments: Begin and end in s and whether the segment is a sweep.
        marked: What stands on coloured ground, in the plural.
        torque: Joint torques in N m, (n, joints); (n, 0) or left out where they are not known.
        max_torque: Their limits, (joints,).
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MultipleLocator

    shares = {"speed": np.abs(velocity) / max_velocity}
    if torque is not None and max_torque is not None and torque.size:
        shares["torque"] = np.abs(torque) / max_torque
    count = 1 + len(shares)
    figure = Figure(figsize=(12, 2.8 * count), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    above = figure.add_subplot(count, 1, 1)
    panels = [figure.add_subplot(count, 1, row, sharex=above) for row in range(2, count + 1)]
    sweeps = [(begin, end) for begin, end, is_sweep in segments if is_sweep]
    for axes in (above, *panels):
        for begin, end in sweeps:
            axes.axvspan(begin, end, color=SWEEP_COLOUR, alpha=0.13, linewidth=0)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0)
    for joint, name in enumerate(joints):
        above.plot(time, np.degrees(position[:, joint]), linewidth=1.2, label=plain_text(name))
    if len(sweeps) <= _MOST_NUMBERS:  # more would run into each other
        for number, (begin, end) in enumerate(sweeps, 1):
            above.annotate(
                str(number), ((begin + end) / 2, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 3),
                textcoords="offset points", ha="center", fontsize=9, color="#1f7a46",
            )  # fmt: skip
    for axes, (what, share) in zip(panels, shares.items()):
        axes.plot(time, 100 * share, linewidth=1.0)
        axes.axhline(100, color="#d1495b", linewidth=1)
        most = float(share.max()) if what == "torque" else 1.0  # torques may exceed limits that nothing keeps
        axes.set_ylim(0, 105.0 * max(1.0, most))
        axes.set_ylabel(f"{what}, % of limit")
    above.yaxis.set_major_locator(MultipleLocator(90 if np.ptp(np.degrees(position)) > 180 else 45))
    above.grid(axis="y", color="#e3e7eb", linewidth=0.8)
    above.set_ylabel("joint position, °")
    panels[-1].set_xlabel(f"time, s ({marked} on green, numbered in the order in which they run)")
    above.legend(handles=above.get_lines(), loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=9)
    return png_bytes(figure)
