"""What a study of layouts does otherwise than one of inspections: its rows, its table, its clouds of runs.

A run is one attempt: what misses its gate is a row with its reason, its tracking cost and the cycle time that it would
have had (`attempt_cycle_s`); `cycle_s` holds gated cycles alone. Processor seconds are those of the run that computed
the optimisation, whenever that was.
"""

from __future__ import annotations

import statistics
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwright.errors import InfeasibleError, SolverError
from flows.execution import Watcher
from flows.layout_requests import layout_request
from flows.study_row import MADE
from schemas.layout_file import load_layout_file
from schemas.layout_objects import build_problem
from schemas.layout_objects import drawn as drawn_layout
from schemas.layout_params import LayoutProblemParams
from schemas.references import Ref
from schemas.study_file import SEED_AXIS, FigureSection, GridPoint, StudyFile
from storage.lake import Lake

if TYPE_CHECKING:
    from rich.console import Console

_MOST_REASONS = 5
_GATED = ("cycle_s", "transition_s", "approach_s", "extra_cost_s", "median_cycle_s", "worst_cycle_s")
_LABELS = {"cpu_s": "processor time, s", "iterations": "iterations", "tracking_m": "d, m"}
_SHOWN = (("cycle_s", "cycle, s"), ("cpu_s", "CPU, s"), ("tracking_m", "d, m"))


@dataclass(frozen=True)
class Attempt:
    """One run's problem, and its artefacts by what they are."""

    problem: LayoutProblemParams
    refs: Mapping[str, Ref]


def row(
    file: Path, point: GridPoint, lake: str, refresh: Collection[str], watcher: Watcher, direct: bool
) -> dict[str, Any]:
    """Run one point and return its row of the table, and the attempt itself as `MADE`."""
    from flows import layout

    found: dict[str, Any] = {**point.point, "error": ""}
    wanted = load_layout_file(file, point.overrides)
    try:
        result = layout.run(wanted, lake=lake, refresh=refresh, watcher=watcher, direct=direct, attempt=True)
    except (InfeasibleError, SolverError) as error:
        return {**found, "error": str(error)}
    found[MADE] = Attempt(layout_request(wanted).layout.problem, result.refs)
    figures = {
        name: value
        for name, value in result.summary.items()
        if isinstance(value, str | int | float) and name not in ("converged", "blocking")
    }
    found |= figures | {"attempt_cycle_s": result.summary["cycle_s"], "cpu_s": result.cpu_s}
    found |= {f"{name} [s]": spent for name, spent in result.stage_seconds.items()}
    if not result.summary["converged"]:
        found |= dict.fromkeys(_GATED) | {"error": result.summary["blocking"]}
    return found


def groups(study: StudyFile, rows: Sequence[Mapping[str, Any]]) -> dict[tuple[str, ...], list[Mapping[str, Any]]]:
    """Return the rows that differ in their seed alone, by the points of the other axes."""
    axes = [axis for axis in study.axes if axis != SEED_AXIS]
    found: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for each in rows:
        found.setdefault(tuple(str(each[axis]) for axis in axes), []).append(each)
    return found


def _lines(study: StudyFile, rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Return the head and the lines of the table of medians, published results below those of their point."""
    axes = [axis for axis in study.axes if axis != SEED_AXIS]
    head = [*axes, "gated", *(label for _, label in _SHOWN), "best cycle, s"]
    lines: list[list[str]] = []
    for names, each in groups(study, rows).items():
        gated = [one["cycle_s"] for one in each if one.get("cycle_s") is not None]
        best = f"{min(gated):.3f}" if gated else "–"
        lines.append([*names, f"{len(gated)}/{len(each)}", *(_median(each, name) for name, _ in _SHOWN), best])
        point = dict(zip(axes, names))
        for published in study.published:
            if all(str(published.get(axis, name)) == name for axis, name in point.items()):
                shown = [f"{published[name]:.3g}" if name in published else "–" for name, _ in _SHOWN]
                lines.append([*("published" if axis == axes[-1] else "" for axis in axes), "", *shown, "–"])
    return head, lines


def _median(rows: Sequence[Mapping[str, Any]], name: str) -> str:
    values = [each[name] for each in rows if each.get(name) is not None]
    return f"{statistics.median(values):.3g}" if values else "–"


def show(study: StudyFile, rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print medians over the seeds with the published results below, and why attempts failed."""
    from rich.table import Table

    head, lines = _lines(study, rows)
    table = Table(title=f"{study.name} (medians over the seeds)", title_justify="left")
    for name in head:
        table.add_column(name, justify="left" if name in study.axes else "right")
    for line in lines:
        table.add_row(*line)
    console.print(table)
    failed = [each for each in rows if each["error"]]
    for each in failed[:_MOST_REASONS]:
        point = ", ".join(str(each[axis]) for axis in study.axes)
        console.print(f"No layout for {point}: {each['error']}", soft_wrap=True)
    if len(failed) > _MOST_REASONS:
        console.print(f"and {len(failed) - _MOST_REASONS} more without a layout, in the table.")


def summary_page(study: StudyFile, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of medians as Markdown."""
    head, lines = _lines(study, rows)
    ruler = [":---" if name in study.axes else "---:" for name in head]
    return f"# {study.name}\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in (head, ruler, *lines))


def from_above(
    study: StudyFile,
    figure: FigureSection,
    rows: Sequence[Mapping[str, Any]],
    attempts: Sequence[Attempt | None],
    lake: Lake,
) -> bytes:
    """Draw the layout of the middle run of each point of an axis, of those that passed their gate if any did.

    Raises:
        LakeError: If the lake has lost a layout since its run.
    """
    from cellwright.figures.layout_charts import layout_views

    shown = []
    for name in study.axes[figure.x]:
        of_point = [(one, attempt) for one, attempt in zip(rows, attempts) if str(one[figure.x]) == name and attempt]
        passed = [each for each in of_point if each[0].get("cycle_s") is not None]
        ordered = sorted(passed or of_point, key=lambda each: each[0]["attempt_cycle_s"])
        if not ordered:
            continue
        one, attempt = ordered[(len(ordered) - 1) // 2]
        parts: dict[str, Any] = {part: lake.load(ref) for part, ref in attempt.refs.items()}
        problem = build_problem(attempt.problem, parts.get("urdf"), parts.get("robot"), parts.get("hulls"))
        value = one.get(figure.y)
        label = "no way" if value is None else f"{figure.factor * value:.3g} {figure.y_label}".rstrip()
        shown.append((problem, f"{name}: {label}", drawn_layout(parts["layout"])))
    return layout_views(shown, title=figure.title) if shown else b""


def drawn(study: StudyFile, figure: FigureSection, rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Draw every run as a point, or the best of n runs."""
    from cellwright.figures.layout_charts import best_of_n_chart, time_scatter

    axis = figure.lines or next(iter(study.axes))
    values = {name: [each for each in rows if str(each[axis]) == name] for name in study.axes[axis]}
    if figure.kind == "best_of_n":
        cycles = {
            name: [figure.factor * one[figure.y] if one.get(figure.y) is not None else float("inf") for one in each]
            for name, each in values.items()
        }
        return best_of_n_chart(cycles, title=figure.title, y_label=figure.y_label or figure.y)
    points = [
        (name, float(one[figure.x]), figure.factor * float(one[figure.y]))
        for name, each in values.items()
        for one in each
        if one.get(figure.x) is not None and one.get(figure.y) is not None
    ]
    published = [
        (str(one[axis]), float(one[figure.x]), figure.factor * float(one[figure.y]))
        for one in study.published
        if axis in one and figure.x in one and figure.y in one
    ]
    labels = (_LABELS.get(figure.x, figure.x), figure.y_label or figure.y)
    return time_scatter(points, title=figure.title, published=published, labels=labels)
