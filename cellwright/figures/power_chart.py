"""The mechanical power of plans over time, one above the other, as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cellwright.arrays import FloatArray
from cellwright.figures.charts import CONNECTION_COLOUR, SWEEP_COLOUR
from cellwright.figures.coverage_map import plain_text, png_bytes


@dataclass(frozen=True, eq=False)
class PoweredPlan:
    """A plan to draw.

    Attributes:
        title: Above its panel.
        time: Times in s, (n,).
        power: Mechanical power there in W, (n,).
        sweeps: Begin and end of each sweep in s.
    """

    title: str
    time: FloatArray
    power: FloatArray
    sweeps: Sequence[tuple[float, float]]


def power_chart(plans: Sequence[PoweredPlan]) -> bytes:
    """Draw the power of plans on common axes; sweeps stand on coloured ground."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 2.1 * len(plans) + 0.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(plans), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, plan in zip(panels, plans):
        for begin, end in plan.sweeps:
            axes.axvspan(begin, end, color=SWEEP_COLOUR, alpha=0.15, linewidth=0)
        axes.fill_between(plan.time, plan.power, color=CONNECTION_COLOUR, alpha=0.5, linewidth=0)
        axes.plot(plan.time, plan.power, color="#33475b", linewidth=0.9)
        axes.set_title(plain_text(plan.title), loc="left", fontsize=11)
        axes.set_ylabel("power, W")
        axes.grid(axis="y", color="#e3e7eb", linewidth=0.8)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_xlim(0.0, max(float(plan.time[-1]) for plan in plans))
    panels[0].set_ylim(bottom=0.0)
    panels[-1].set_xlabel("time, s (sweeps on green)")
    return png_bytes(figure)
