"""Charts of a study: a metric over an axis, lines and panels for two further axes, published values beside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cellwright.figures.coverage_map import plain_text, png_bytes

_COLOURS = ("#2a9d5c", "#e07a1f", "#3f6fd6", "#a63d2f", "#7b5ea7", "#3fa7d6")

Row = Mapping[str, Any]
"""One run: names of its points by axis, and its figures."""


def study_chart(
    rows: Sequence[Row],
    published: Sequence[Row],
    axes: Mapping[str, Sequence[str]],
    *,
    title: str,
    x: str,
    y: str,
    y_label: str,
    lines: str | None,
    panels: str | None,
    log: bool,
    factor: float,
) -> bytes:
    """Draw mean and range over the runs that share a point, as PNG bytes.

    Args:
        rows: All runs; ``published``: what others report, drawn as open diamonds.
        axes: The points of each axis in their order.
        title: Heading.
        x: Axis along the picture; ``y``: metric; ``lines``, ``panels``: axes, or none.
        y_label: Label of the y axis.
        log: Whether the y axis is logarithmic.
        factor: Factor on the metric.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panel_names = list(axes[panels]) if panels else [""]
    line_names = list(axes[lines]) if lines else [""]
    figure = Figure(figsize=(5.4 * len(panel_names) + 0.8, 4.3), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    first: Any = None
    for number, panel in enumerate(panel_names):
        drawn = figure.add_subplot(1, len(panel_names), number + 1, sharey=first)
        first = first or drawn
        for index, line in enumerate(line_names):
            wanted = {**({panels: panel} if panels else {}), **({lines: line} if lines else {})}
            _draw_line(drawn, rows, axes[x], wanted, x, y, factor, _COLOURS[index % len(_COLOURS)], line)
            _draw_published(drawn, published, axes[x], wanted, x, y, factor, _COLOURS[index % len(_COLOURS)])
        drawn.set_xticks(range(len(axes[x])), [plain_text(point) for point in axes[x]])
        drawn.set_xlim(-0.4, len(axes[x]) - 0.6)
        drawn.set_xlabel(plain_text(x))
        drawn.set_title(plain_text(panel), fontsize=11)
        drawn.spines[["top", "right"]].set_visible(False)
        drawn.grid(axis="y", color="#e3e7eb", linewidth=0.8)
        if log and any(float(row.get(y) or 0) > 0 for row in rows):  # empty axes have no logarithm
            drawn.set_yscale("log")
    first.set_ylabel(plain_text(y_label))
    if lines:
        handles = [drawn for drawn in first.get_lines() if drawn.get_linestyle() != "None"]
        figure.legend(handles=handles, title=plain_text(lines), loc="outside right upper", frameon=False)
    n_without = sum(row.get(y) is None for row in rows)
    missing = f"\n{n_without} of {len(rows)} runs have no {y}" if n_without else ""
    figure.suptitle(plain_text(title + missing))
    return png_bytes(figure)


def _draw_line(
    drawn: Any,
    rows: Sequence[Row],
    points: Sequence[str],
    wanted: Mapping[str, str],
    x: str,
    y: str,
    factor: float,
    colour: str,
    label: str,
) -> None:
    places, lows, means, highs = [], [], [], []
    for place, point in enumerate(points):
        values = [
            factor * float(row[y])
            for row in rows
            if row[x] == point and row.get(y) is not None and all(row[axis] == name for axis, name in wanted.items())
        ]
        if values:
            places.append(place)
            lows.append(min(values))
            highs.append(max(values))
            means.append(float(np.mean(values)))
    drawn.fill_between(places, lows, highs, color=colour, alpha=0.15, linewidth=0)
    drawn.plot(places, means, marker="o", markersize=5, color=colour, label=plain_text(label))


def _draw_published(
    drawn: Any,
    published: Sequence[Row],
    points: Sequence[str],
    wanted: Mapping[str, str],
    x: str,
    y: str,
    factor: float,
    colour: str,
) -> None:
    for row in published:
        # a published row that does not name an axis holds for all of its points
        if y not in row or str(row.get(x)) not in points:
            continue
        if any(axis in row and str(row[axis]) != name for axis, name in wanted.items()):
            continue
        place = list(points).index(str(row[x]))
        drawn.plot(place, factor * float(row[y]), "D", markersize=9, markerfacecolor="none", color=colour)
        drawn.annotate("paper", (place, factor * float(row[y])), xytext=(8, 4), textcoords="offset points", fontsize=9)
