"""What a study of sequences does otherwise than one of inspections: its rows, and its table beside published figures.

A run without a sequence is a row with its reason. Sequences that are found by one cost and priced by another have their
weighted cost in parts: motions, strokes and holding still; time, torque and speed.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwright.errors import InfeasibleError, SolverError
from flows.execution import Watcher
from flows.study_row import MADE
from schemas.references import Ref
from schemas.study_file import GridPoint, StudyFile
from storage.lake import Lake

if TYPE_CHECKING:
    from rich.console import Console

_SHOWN = (
    ("weighted_travel", "travel", ".1f"),
    ("weighted_strokes", "strokes", ".1f"),
    ("weighted_holding", "holding", ".1f"),
    ("weighted_cost", "total", ".1f"),
    ("duration_s", "cycle, s", ".2f"),
    ("cost", "cost", ".2f"),
    ("lower_bound", "bound", ".2f"),
    ("likely_bound", "likely bound", ".2f"),
    ("motions_planned", "planned", ".0f"),
)
_PARTS = (
    ("weighted_travel", "motions"),
    ("weighted_strokes", "strokes"),
    ("weighted_holding", "holding still at tasks"),
)
_PLANNING = ("generate_alternatives", "sequence_tasks")


def row(
    file: Path, point: GridPoint, lake: str, refresh: Collection[str], watcher: Watcher, direct: bool
) -> dict[str, Any]:
    """Run one point and return its row of the table, and its recording's reference as `MADE`."""
    from flows import sequence

    found: dict[str, Any] = {**point.point, "error": ""}
    try:
        result = sequence.run(
            file, overrides=point.overrides, lake=lake, refresh=refresh, watcher=watcher, direct=direct
        )
    except (InfeasibleError, SolverError) as error:
        return {**found, "error": str(error)}
    figures = {name: value for name, value in result.summary.items() if isinstance(value, str | int | float)}
    seconds = result.stage_seconds
    planning = sum(spent for name, spent in seconds.items() if name in _PLANNING)
    found |= {MADE: result.refs["recording"], **figures, "planning_s": planning}
    return found | {f"{name} [s]": spent for name, spent in seconds.items()}


def _lines(study: StudyFile, rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Return the head and the lines of the table, published results below those of their point."""
    axes = list(study.axes)
    shown = [each for each in _SHOWN if any(each[0] in one for one in rows)]
    head, lines = [*axes, *(label for _, label, _ in shown)], []
    for one in rows:
        point = {axis: str(one[axis]) for axis in axes}
        lines.append([*point.values(), *(_value(one, name, form) for name, _, form in shown)])
        for published in study.published:
            if all(str(published.get(axis, name)) == name for axis, name in point.items()):
                names = ["" if axis != axes[-1] else "published" for axis in axes]
                lines.append([*names, *(_value(published, name, form) for name, _, form in shown)])
    return head, lines


def _value(row: Mapping[str, Any], name: str, form: str) -> str:
    value = row.get(name)
    return "–" if value is None else format(value, form)


def show(study: StudyFile, rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print the sequences with published results below, and why there is none."""
    from rich.table import Table

    head, lines = _lines(study, rows)
    table = Table(title=study.name, title_justify="left")
    for name in head:
        table.add_column(name, justify="left" if name in study.axes else "right")
    for line in lines:
        table.add_row(*line)
    console.print(table)
    for one in rows:
        if one["error"]:
            point = ", ".join(str(one[axis]) for axis in study.axes)
            console.print(f"No sequence for {point}: {one['error']}", soft_wrap=True)


def summary_page(study: StudyFile, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the table as Markdown."""
    head, lines = _lines(study, rows)
    ruler = [":---" if name in study.axes else "---:" for name in head]
    return f"# {study.name}\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in (head, ruler, *lines))


def further_files(
    study: StudyFile, rows: Sequence[Mapping[str, Any]], made: Sequence[Ref | None], lake: Lake
) -> dict[str, tuple[str, bytes]]:
    """Return name and content of the files beside the table, by what they are: costs in parts, recordings of all runs.

    Raises:
        LakeError: If the lake has lost a recording since its run.
    """
    parts = parts_picture(study, rows)
    found = {} if parts is None else {"weighted cost in parts": ("parts.png", parts)}
    for number, (one, recording) in enumerate(zip(rows, made, strict=True), 1):
        if recording is not None:
            point = ", ".join(str(one[axis]) for axis in study.axes)
            name = f"run_{number}_{re.sub('[^a-z0-9]+', '_', point.lower()).strip('_')[:60]}.mcap"
            found[f"recording: {point}"] = name, lake.read(recording, "recording.mcap")
    return found


def parts_picture(study: StudyFile, rows: Sequence[Mapping[str, Any]]) -> bytes | None:
    """Draw the weighted cost of all sequences in parts, published ones below those of their point; none without."""
    from cellwright.figures.tool_path import parts_chart

    bars: list[tuple[str, list[float]]] = []
    for one in rows:
        if one.get("weighted_cost") is None:
            continue
        point = {axis: str(one[axis]) for axis in study.axes}
        bars.append((", ".join(point.values()), [one[name] for name, _ in _PARTS]))
        for published in study.published:
            fits = all(str(published.get(axis, name)) == name for axis, name in point.items())
            if fits and any(name in published for name, _ in _PARTS):
                bars.append(("published", [published.get(name, 0.0) for name, _ in _PARTS]))
    return parts_chart(bars, [label for _, label in _PARTS], study.name) if bars else None
