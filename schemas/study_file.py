"""The study file: one flow over a grid of settings, and the pictures to draw of it.

Every axis is a list of named points; a point is a set of cell-file settings. The grid is all combinations. What a
paper published for some of the points can stand beside the results.
"""

from __future__ import annotations

import difflib
import itertools
import math
from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field, ValidationError, field_validator

from cellwright.errors import InvalidInputError, listed
from schemas.cell_file_document import read_document
from schemas.cell_file_fields import Section, WholeNumber
from schemas.cell_file_messages import faults_of, refusal
from schemas.hull_trial import HULL_METRICS
from schemas.inspection_summary import METRICS
from schemas.layout_summary import LAYOUT_METRICS
from schemas.sequence_summary import SEQUENCE_METRICS

Settings = dict[str, Any]
"""Cell-file settings by their path: ``{planner.sampling.density: 0.005 /mm^2}``."""

MOST_RUNS = 10_000
"""More runs take months; a grid of that many is a slip."""

COLUMNS = METRICS | {"planning_s", "cover_method", "order", "verified_by", "error"}
"""Columns of a study's table beside those of the axes; each stage adds ``STAGE [s]``, its seconds."""

LAYOUT_COLUMNS = LAYOUT_METRICS | {"cpu_s", "attempt_cycle_s", "method", "error"}
"""The same of a study of layouts."""

SEQUENCE_COLUMNS = SEQUENCE_METRICS | {"planning_s", "cost_of", "stopped_by", "verified_by", "error"}
"""The same of a study of sequences."""

HULL_COLUMNS = HULL_METRICS | {"surface_covered", "interior", "volume_kind", "error"}
"""The same of a study of sphere hulls."""

_COLUMNS = {"inspect": COLUMNS, "layout": LAYOUT_COLUMNS, "sequence": SEQUENCE_COLUMNS, "spherize": HULL_COLUMNS}
_SEED_SETTINGS = {"inspect": "planner.seed", "layout": "solver.seed", "sequence": "planner.seed", "spherize": "seed"}
SEED_AXIS = "seed"
"""The axis that `seeds` makes, over which figures take means and tables medians."""


class FigureSection(Section):
    """One picture: a metric over an axis, one line for each point of another axis, one panel for each of a third."""

    title: str = Field(description="Heading.")
    kind: Literal["lines", "cloud", "best_of_n", "from_above", "hulls"] = Field(
        default="lines",
        description="A column over an axis; every run as a point, one column against another; the best of n runs; "
        "the layout of the middle run of every point; meshes under their hulls.",
    )
    x: str = Field(
        description="Axis along the picture; with `cloud` a column, with `best_of_n` the axis of runs, with "
        "`from_above` that of the layouts, with `hulls` that of the panels."
    )
    y: str = Field(description="Column of the study's table.")
    y_label: str = Field(default="", description="Label of the y axis; the column's name if left out.")
    lines: str | None = Field(default=None, description="Axis whose points are lines.")
    panels: str | None = Field(default=None, description="Axis whose points are panels side by side.")
    scale: Literal["linear", "log"] = Field(default="linear", description="Scale of the y axis.")
    factor: float = Field(default=1.0, description="Factor on the column, e.g. 100 for percent.")


class StudyFile(Section):
    """A whole study file."""

    path: Path = Field(alias="__path__", exclude=True)
    version: Literal[1] = Field(alias="cellwright-study", description="Version of the study file: 1.")
    flow: Literal["inspect", "layout", "sequence", "spherize"] = Field(
        default="inspect", description="What is run at each point."
    )
    name: str = Field(description="Name of the study.", min_length=1)
    cell: str = Field(
        default="", description="Cell file, relative to the study file, or the name of a built-in example."
    )
    settings: Settings = Field(default={}, alias="set", description="Settings of all runs.")
    axes: dict[str, dict[str, Settings]] = Field(description="The grid: axis, point, settings.", min_length=1)
    seeds: WholeNumber | None = Field(
        default=None, ge=1, le=1000, description="Runs of each point with the seeds 0, 1, ...: a last axis `seed`."
    )
    figures: tuple[FigureSection, ...] = Field(default=(), description="The pictures.")
    published: tuple[dict[str, Any], ...] = Field(
        default=(), description="Published results: axis points and columns, drawn beside ours."
    )

    @field_validator("axes", mode="before")
    @classmethod
    def _named_points(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {
            str(axis): {str(name): ({} if point is None else point) for name, point in points.items()}
            if isinstance(points, dict)
            else points
            for axis, points in value.items()
        }


@dataclass(frozen=True)
class GridPoint:
    """One run of a study: the names of its points by axis, and its settings as ``path=value`` texts."""

    point: dict[str, str]
    overrides: tuple[str, ...]


def load_study_file(path: Path) -> StudyFile:
    """Read and check a study file.

    Raises:
        InvalidInputError: If it is malformed; the message names file, field, value and mend.
    """
    document = read_document(path, "study file", "cellwright-study: 1")
    try:
        study = _with_seeds(StudyFile.model_validate({**document.data, "__path__": path}))
    except ValidationError as error:
        raise refusal(document, faults_of(error, StudyFile, document)) from error
    for fault in _disagreements(study):
        raise InvalidInputError(f"study file {path}: {fault}")
    return study


def _with_seeds(study: StudyFile) -> StudyFile:
    """Write the axis of `seeds` out."""
    if study.seeds is None or SEED_AXIS in study.axes:
        return study
    setting = _SEED_SETTINGS[study.flow]
    seeds: dict[str, Settings] = {str(seed): {setting: seed} for seed in range(study.seeds)}
    return study.model_copy(update={"axes": {**study.axes, SEED_AXIS: seeds}})


def _disagreements(study: StudyFile) -> Iterator[str]:
    """Find values that are sound by themselves but do not go together."""
    columns = _COLUMNS[study.flow]
    if study.flow == "spherize" and study.cell:
        yield f"cell: {study.cell} is read by no run of flow: spherize: name meshes by the setting `mesh`"
    if study.flow != "spherize" and not study.cell:
        yield "cell is missing: name the cell file, or a built-in example"
    if study.seeds is not None and list(study.axes[SEED_AXIS]) != [str(seed) for seed in range(study.seeds)]:
        yield f"axes.{SEED_AXIS} and seeds are both given: keep one"
    for axis, points in study.axes.items():
        if not points:
            yield f"axes.{axis} has no points: add one or remove the axis"
        if axis in columns:
            yield f"axes.{axis} is named like a column of the table: choose another name"
    n_runs = math.prod(len(points) for points in study.axes.values())
    if n_runs > MOST_RUNS:
        yield f"axes make {n_runs} runs, but a study has at most {MOST_RUNS}: remove points, or split it"
    for figure in study.figures:
        named_axes = [("x", figure.x), ("lines", figure.lines), ("panels", figure.panels)]
        if figure.kind == "from_above" and study.flow != "layout":
            yield f"figure {figure.title!r} has kind: from_above, which draws layouts: use lines, or flow: layout"
        if figure.kind == "hulls" and study.flow != "spherize":
            yield f"figure {figure.title!r} has kind: hulls, which draws sphere hulls: use lines, or flow: spherize"
        if figure.kind == "cloud" and not _is_column(figure.x, columns):
            yield f"figure {figure.title!r} has x: {figure.x}, which is no column: {_nearest(figure.x, columns)}"
        for role, named in named_axes[1:] if figure.kind == "cloud" else named_axes:
            if named is not None and named not in study.axes:
                yield f"figure {figure.title!r} has {role}: {named}, which is no axis: use one of {_all(study.axes)}"
        if not _is_column(figure.y, columns):
            yield f"figure {figure.title!r} has y: {figure.y}, which is no column: {_nearest(figure.y, columns)}"
    for number, row in enumerate(study.published):
        for name, value in row.items():
            if name in study.axes and str(value) not in study.axes[name]:
                yield (
                    f"published.{number}.{name}: {value} is no point of that axis: use one of {_all(study.axes[name])}"
                )
            if name not in study.axes and not _is_column(name, columns):
                yield f"published.{number}.{name} is neither an axis nor a column: {_nearest(name, columns)}"
            if name not in study.axes and (isinstance(value, bool) or not isinstance(value, int | float)):
                yield f"published.{number}.{name}: {value!r} is no number: write one"


def _is_column(name: str, columns: Set[str]) -> bool:
    return name in columns - {"error"} or name.endswith(" [s]")


def _nearest(name: str, columns: Set[str]) -> str:
    near = difflib.get_close_matches(name, columns - {"error"}, n=1)
    return f"did you mean {near[0]}?" if near else f"use one of {_all(sorted(columns - {'error'}))} or STAGE [s]"


def _all(names: Iterable[str]) -> str:
    return listed(names, most=40)


def grid(study: StudyFile) -> list[GridPoint]:
    """Return every combination of the axes' points, the last axis running fastest."""
    runs = []
    for names in itertools.product(*(points for points in study.axes.values())):
        point = dict(zip(study.axes, names))
        merged: Settings = dict(study.settings)
        for axis, name in point.items():
            merged.update(study.axes[axis][name])
        runs.append(GridPoint(point, tuple(f"{path}={_flow_text(value)}" for path, value in merged.items())))
    return runs


def _flow_text(value: Any) -> str:
    """Write a YAML value on one line, as ``--set`` takes it."""
    text: str = yaml.safe_dump(value, default_flow_style=True, width=10**6)
    return text.strip().removesuffix("...").strip()
