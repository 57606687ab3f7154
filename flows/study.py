"""Run a study: one flow for each point of a grid, one table, and the pictures.

Runs share every stage that does not differ, through the lake; the seconds in the table are those of the run that
computed the stage, whenever that was. A run without a solution is a row with its message, not the end of the study.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellwright.errors import InfeasibleError, SolverError
from flows import layout_study, sequence_study, spherize_study
from flows.examples import find_cell_file
from flows.execution import REFRESHED, Watcher, open_lake
from flows.result_folder import prepare_folder, write_files
from flows.study_row import MADE
from schemas.inspection_summary import METRICS
from schemas.study_file import GridPoint, StudyFile, grid, load_study_file

if TYPE_CHECKING:
    from rich.console import Console


_MODULES: dict[str, Any] = {"layout": layout_study, "sequence": sequence_study, "spherize": spherize_study}
"""What makes, shows and writes down the rows of a flow other than an inspection."""

_PICTURES: dict[str, Callable[..., bytes]] = {
    "from_above": layout_study.from_above,
    "hulls": spherize_study.hulls_picture,
}
"""What draws a kind of figure of the runs' artefacts."""


@dataclass(frozen=True)
class StudyResult:
    """What a study produced.

    Attributes:
        study: The study file.
        rows: One mapping a run: points by axis, figures of the plan, seconds by stage, ``error`` if it failed.
        files: Paths of table and figures.
    """

    study: StudyFile
    rows: list[dict[str, Any]]
    files: dict[str, Path]

    def as_json(self) -> Mapping[str, Any]:
        """Return the result as plain values."""
        files = {name: str(path) for name, path in self.files.items()}
        return {"study": self.study.name, "rows": self.rows, "files": files}

    def show(self, console: Console) -> None:
        """Print the table's main columns, what had no solution, and the paths."""
        module = _MODULES.get(self.study.flow)
        if module is not None:
            module.show(self.study, self.rows, console)
        else:
            self._show_plans(console)
        for name, path in self.files.items():
            console.print(f"{name}: {path}", soft_wrap=True)

    def _show_plans(self, console: Console) -> None:
        from rich.table import Table

        table = Table(title=self.study.name, title_justify="left")
        for axis in self.study.axes:
            table.add_column(axis)
        for name in ("candidates", "sweeps", "samples", "coverage", "cycle", "planning"):
            table.add_column(name, justify="right")
        for row in self.rows:
            names = [row[axis] for axis in self.study.axes]
            if row["error"]:
                table.add_row(*names, "no plan", *["–"] * 5)
                continue
            table.add_row(
                *names,
                f"{row['candidates']:,}",
                str(row["sweeps"]),
                f"{row['coverage_of_samples']:.1%}",
                f"{row['coverage']:.2%}",
                f"{row['duration_s']:.1f} s",
                f"{row['planning_s']:.1f} s",
            )
        console.print(table)
        for row in self.rows:
            if row["error"]:
                point = ", ".join(row[axis] for axis in self.study.axes)
                console.print(f"No plan for {point}: {row['error']}", soft_wrap=True)


def run(
    study_path: Path, *, lake: str, refresh: Collection[str], out: Path | None, watcher: Watcher, direct: bool = False
) -> StudyResult:
    """Run every point of a study's grid and write table and figures into ``out`` (default: a folder named after it).

    A stage in ``refresh`` is computed anew at every point, but only once where several points share its result.

    Raises:
        InvalidInputError: If the study file or one of its settings is malformed, or the folder cannot be written;
            nothing runs then.
        LakeError: If the lake fails.
    """
    study = load_study_file(study_path)
    cell = _cell_file(study)
    points = grid(study)
    for point in points:
        _check(study, cell, point)
    folder = out or Path(study_path.stem)
    prepare_folder(folder)
    module = _MODULES.get(study.flow)
    run_point = _row if module is None else module.row
    token = REFRESHED.set(set())  # what several runs share is refreshed once
    try:
        rows = []
        for number, point in enumerate(points, 1):
            name = f"run {number} of {len(points)} ({', '.join(point.point.values())})"
            watcher.started(name)
            begun = time.monotonic()
            rows.append(run_point(cell, point, lake, refresh, watcher, direct))
            if rows[-1]["error"]:
                watcher.failed(name)
            else:
                watcher.finished(name, cached=False, seconds=time.monotonic() - begun)
    finally:
        REFRESHED.reset(token)
    made = [row.pop(MADE, None) for row in rows]
    return StudyResult(study, rows, _write(study, rows, folder, made, lake))


def _check(study: StudyFile, cell: Path, point: GridPoint) -> None:
    from schemas.cell_file import load_cell_file
    from schemas.layout_file import load_layout_file
    from schemas.sequence_file import load_sequence_file

    if study.flow == "spherize":
        spherize_study.check(study, point)
    elif study.flow == "sequence":
        load_sequence_file(cell, point.overrides)
    elif study.flow == "layout":
        load_layout_file(cell, point.overrides)
    else:
        load_cell_file(cell, point.overrides)


def _cell_file(study: StudyFile) -> Path:
    if study.flow == "spherize":
        return study.path  # its runs read settings alone, with paths beside the study
    beside = study.path.parent / study.cell
    return beside if beside.is_file() else find_cell_file(study.cell)


def _row(
    cell: Path, point: GridPoint, lake: str, refresh: Collection[str], watcher: Watcher, direct: bool
) -> dict[str, Any]:
    from flows import inspection

    row: dict[str, Any] = {**point.point, "error": ""}
    try:
        result = inspection.run(
            cell, overrides=point.overrides, lake=lake, refresh=refresh, out=None, watcher=watcher, direct=direct
        )
    except (InfeasibleError, SolverError) as error:
        return {**row, "error": str(error)}
    figures = {name: value for name, value in result.summary.items() if name in METRICS or isinstance(value, str)}
    seconds = result.stage_seconds
    planning = sum(spent for name, spent in seconds.items() if inspection.is_planning(name))
    return {**row, **figures, "planning_s": planning, **{f"{name} [s]": spent for name, spent in seconds.items()}}


def _write(
    study: StudyFile,
    rows: list[dict[str, Any]],
    folder: Path,
    made: Sequence[Any],
    lake: str,
) -> dict[str, Path]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from cellwright.figures.study_charts import study_chart

    columns = list(dict.fromkeys(name for row in rows for name in row))
    table = pa.BufferOutputStream()
    pq.write_table(pa.table({name: [row.get(name) for row in rows] for name in columns}), table)
    names, contents = {"table": "table.parquet"}, {"table.parquet": table.getvalue().to_pybytes()}
    axes = {axis: list(points) for axis, points in study.axes.items()}
    module = _MODULES.get(study.flow)
    if module is not None:
        names["summary"] = "summary.md"
        contents["summary.md"] = module.summary_page(study, rows).encode()
    if study.flow == "sequence":
        for what, (name, content) in sequence_study.further_files(study, rows, made, open_lake(lake)).items():
            names[what], contents[name] = name, content
    for number, figure in enumerate(study.figures, 1):
        name = f"figure_{number}_{re.sub('[^a-z0-9_]+', '_', figure.y).strip('_')}.png"
        names[figure.title] = name
        if figure.kind in _PICTURES:
            name = f"figure_{number}_{figure.kind}.png"
            names[figure.title] = name
            contents[name] = _PICTURES[figure.kind](study, figure, rows, made, open_lake(lake))
            continue
        if figure.kind != "lines":
            contents[name] = layout_study.drawn(study, figure, rows)
            continue
        contents[name] = study_chart(
            rows,
            study.published,
            axes,
            title=figure.title,
            x=figure.x,
            y=figure.y,
            y_label=figure.y_label or figure.y,
            lines=figure.lines,
            panels=figure.panels,
            log=figure.scale == "log",
            factor=figure.factor,
        )
    write_files(folder, contents, mark="table.parquet")
    return {what: folder / name for what, name in names.items()}
