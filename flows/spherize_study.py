"""What a study of hulls does otherwise than one of inspections: its rows, its table, the meshes under their hulls.

A run is one hull of one mesh: method and number of spheres. The pictures are those of Baumgaertner 2025, figure 3.
"""

from __future__ import annotations

import itertools
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellwright.errors import InfeasibleError, InvalidInputError, SolverError
from flows.execution import Watcher, open_lake
from flows.run_result import computing_seconds
from flows.runner import Steps
from flows.spherize import cover_mesh, mesh_rows, unit_factor
from flows.study_row import MADE
from schemas.hull_trial import HullTrial, hull_trial
from schemas.references import Ref
from schemas.study_file import FigureSection, GridPoint, StudyFile
from storage.lake import Lake

if TYPE_CHECKING:
    from rich.console import Console

    from cellwright.figures.sphere_hull_picture import HullRow

_HEAD = (
    "spheres", "proven", "covered", "volume ratio", "sticks out, mm (mean)", "(95 %)", "(largest)",
    "gap, mm (mean)", "(95 %)", "(largest)", "fit, s",
)  # fmt: skip
_SHOWN_LENGTHS = (
    "protrusion_mean_m", "protrusion_p95_m", "protrusion_max_m", "gap_mean_m", "gap_p95_m", "gap_max_m"
)  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """One run's settings and its hull in the lake."""

    settings: HullTrial
    hull: Ref


def check(study: StudyFile, point: GridPoint) -> None:
    """Refuse what no run could begin with.

    Raises:
        InvalidInputError: If a setting is malformed, or a mesh that carries its own unit is given another.
    """
    settings = hull_trial(study.path, point.overrides)
    unit_factor(str(settings.mesh), settings.unit)


def row(
    study: Path, point: GridPoint, lake: str, refresh: Collection[str], watcher: Watcher, direct: bool
) -> dict[str, Any]:
    """Run one point and return its row of the table, and the run itself as `MADE`; one stage needs no Prefect."""
    settings = hull_trial(study, point.overrides)
    found: dict[str, Any] = {**point.point, "error": ""}
    facts = {"flow": "spherize", "cell": str(settings.mesh)}
    try:
        with Steps(lake, refresh=refresh, watcher=watcher, direct=True, run_id=uuid.uuid4().hex, facts=facts) as step:
            made = cover_mesh(
                step,
                str(settings.mesh),
                settings.spheres,
                settings.unit,
                settings.seed,
                method=settings.method,
                inflate=settings.inflate,
                n_starts=settings.starts,
            )
            ref = made.ref()
            record = step.records()[-1]
    except (InfeasibleError, SolverError) as error:
        return {**found, "error": str(error)}
    opened = open_lake(lake)
    hull: Any = opened.load(ref)
    [metrics] = mesh_rows(hull)
    del metrics["body"]
    return {**found, **metrics, "fit_s": computing_seconds(opened, record)[0], MADE: Trial(settings, ref)}


def _lines(study: StudyFile, rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    lines = []
    for one in rows:
        names = [str(one[axis]) for axis in study.axes]
        if one["error"]:
            lines.append([*names, *["–"] * len(_HEAD)])
            continue
        proven = "yes" if one["surface_covered"] and one["interior"] != "not covered" else "no"
        lengths = [f"{1e3 * one[name]:.1f}" for name in _SHOWN_LENGTHS]
        shown = [str(one["n_spheres"]), proven, f"{one['coverage']:.2%}", f"{one['volume_ratio']:.3f}"]
        lines.append([*names, *shown, *lengths, f"{one['fit_s']:.2f}"])
    return [*study.axes, *_HEAD], lines


def show(study: StudyFile, rows: Sequence[Mapping[str, Any]], console: Console) -> None:
    """Print the metrics of all hulls, and what could not be covered."""
    from rich.table import Table

    head, lines = _lines(study, rows)
    table = Table(title=study.name, title_justify="left")
    for place, name in enumerate(head):
        table.add_column(name, justify="left" if place < len(study.axes) else "right")
    for line in lines:
        table.add_row(*line)
    console.print(table)
    for one in rows:
        if one["error"]:
            point = ", ".join(str(one[axis]) for axis in study.axes)
            console.print(f"No hull for {point}: {one['error']}", soft_wrap=True)


def summary_page(study: StudyFile, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the table as Markdown."""
    head, lines = _lines(study, rows)
    ruler = [":---" if place < len(study.axes) else "---:" for place in range(len(head))]
    return f"# {study.name}\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in (head, ruler, *lines))


def hulls_picture(
    study: StudyFile,
    figure: FigureSection,
    rows: Sequence[Mapping[str, Any]],
    trials: Sequence[Trial | None],
    lake: Lake,
) -> bytes:
    """Draw meshes under their hulls: a panel for each point of an axis, a line of them for each of the other points.

    Raises:
        InvalidInputError: If the panels of one line cover different meshes.
    """
    from cellwright.figures.sphere_hull_picture import hull_rows_picture

    done = [(one, trial) for one, trial in zip(rows, trials) if trial is not None]
    others = {axis: list(points) for axis, points in study.axes.items() if axis != figure.x}
    shown: list[HullRow] = []
    for names in itertools.product(*others.values()):
        point = dict(zip(others, names))
        line = [(one, trial) for one, trial in done if all(one[axis] == name for axis, name in point.items())]
        if line:
            shown.append(_hull_row(figure, ", ".join(names), line, lake))
    return hull_rows_picture(shown, title=figure.title) if shown else b""


def _hull_row(figure: FigureSection, name: str, line: Sequence[tuple[Mapping[str, Any], Trial]], lake: Lake) -> HullRow:
    from cellwright.cell.mesh_files import mesh_from_bytes

    files = {(trial.settings.mesh, trial.settings.unit) for _, trial in line}
    if len(files) > 1:
        raise InvalidInputError(
            f"figure {figure.title!r} has x: {figure.x}, but the meshes differ along it: choose an axis of one mesh"
        )
    [(path, unit)] = files
    mesh = mesh_from_bytes(path.name, path.read_bytes(), np.full(3, unit_factor(str(path), unit)))
    panels = []
    for one, trial in line:
        hull: Any = lake.load(trial.hull)
        value = "" if figure.y == "n_spheres" else f"\n{figure.y_label or figure.y} {figure.factor * one[figure.y]:.3g}"
        panels.append((f"{one['n_spheres']} spheres{value}", hull.centre_m, hull.radius_m))
    return name, mesh.vertices, mesh.faces, panels
