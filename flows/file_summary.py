"""What layout files and sequence files say, for a person who checks them: read, tried as far as is cheap, shown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cellwright.errors import CellwrightError, InvalidInputError
from flows.cell_summary import place_words

if TYPE_CHECKING:
    from rich.console import Console

    from schemas.layout_file import LayoutFile
    from schemas.sequence_file import SequenceFile

Kind = Literal["cell", "layout", "sequence"]


def kind_of(path: Path) -> Kind:
    """Tell by its keys what a file is for: `inspect`, `layout` or `sequence`.

    Raises:
        InvalidInputError: If it cannot be read.
    """
    from schemas.cell_file_document import read_document

    data = read_document(path).data
    if "scanner" not in data and "tasks" in data:
        return "sequence"
    return "layout" if "scanner" not in data and "stations" in data else "cell"


@dataclass(frozen=True, slots=True)
class FileSummary:
    """A checked layout or sequence file, ready to be shown."""

    kind: Kind
    file: LayoutFile | SequenceFile
    lines: tuple[tuple[str, str], ...]
    picture: Path | None = None

    def as_json(self) -> Mapping[str, Any]:
        """Return the whole file, defaults filled in, in SI units."""
        return {
            "valid": True,
            "file": str(self.file.path),
            self.kind: self.file.model_dump(mode="json"),
            **({} if self.picture is None else {"picture": str(self.picture)}),
        }

    def show(self, console: Console) -> None:
        """Print what stands where."""
        from rich.table import Table

        table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
        for name, text in self.lines:
            table.add_row(name, text)
        console.print(f"{self.file.path} is valid", markup=False, highlight=False)
        console.print(table, markup=False, highlight=False)
        if self.picture is not None:
            console.print(f"picture: {self.picture}", markup=False, highlight=False, soft_wrap=True)


def checked_sequence(path: Path, overrides: Sequence[str], picture: Path | None) -> FileSummary:
    """Check a sequence file: its files are read, tables too, and nothing may collide at the start.

    Raises:
        InvalidInputError: If anything is malformed, or bodies collide at the start.
    """
    import tasks
    from flows.sequence import in_words_of_the_file
    from flows.sequence_requests import sequence_request
    from schemas.sequence_file import load_sequence_file

    file = load_sequence_file(path, overrides)
    request = sequence_request(file)
    try:
        sources = tuple(tasks.read_source(params=source) for source in request.cell_files)
        table = None if request.table is None else tasks.read_source(params=request.table)
        listed = tasks.list_tasks(table, params=request.tasks)
        if picture is not None:
            from tasks.assemble_cell import unchecked_cell

            _draw(unchecked_cell(sources, request.cell), listed.T_world_tool.reshape(-1, 4, 4), picture)
        tasks.assemble_cell(sources, params=request.cell)
    except CellwrightError as error:
        raise in_words_of_the_file(error) from error
    notes = (("note", note) for note in request.notes)
    return FileSummary("sequence", file, (*_sequence_lines(file, len(listed.name)), *notes), picture)


def _sequence_lines(file: SequenceFile, n_tasks: int) -> Iterator[tuple[str, str]]:
    yield "cell", file.name
    yield "robot", f"{file.robot.model} at {place_words(file.robot.base.matrix()[:3, 3])}"
    payload = file.tool.payload
    carries = "" if payload is None else f", with it {payload.mass_kg:g} kg on the flange"
    yield "tool", f"tip at {place_words(file.tool.tip.matrix()[:3, 3])} on the flange{carries}"
    if file.part is not None:
        yield "part", f"{file.part.name} at {place_words(file.part.pose.matrix()[:3, 3])}"
    yield "bodies", ", ".join(body.name for body in (*file.tool.bodies, *file.bodies())) or "none"
    table = "" if file.tasks.file is None else f", from {file.tasks.file.name} those beyond {len(file.tasks.list)}"
    yield "tasks", f"{n_tasks}{table}"
    yield "cost", file.planner.cost.replace("_", " ")
    yield "seed", str(file.planner.seed)


def _draw(cell: Any, T_world_task: Any, picture: Path) -> None:
    import numpy as np

    from cellwright.figures.tool_path import tool_path_picture
    from flows.cell_picture import check_name, write_picture

    check_name(picture)
    write_picture(picture, tool_path_picture(cell, np.empty((0, 3)), T_world_task))


def checked_layout(path: Path, overrides: Sequence[str], picture: Path | None) -> FileSummary:
    """Check a layout file: everything it names is there and has the right shape; nothing is optimised.

    Raises:
        InvalidInputError: If anything is malformed, or a picture is asked for, as nothing is placed yet.
    """
    from flows.layout_requests import layout_request
    from schemas.layout_file import load_layout_file

    if picture is not None:
        raise InvalidInputError(
            "a layout file says what is to be placed, not where: run cellwright layout, which draws it, or leave "
            "--picture out"
        )
    file = load_layout_file(path, overrides)
    layout_request(file)
    lines = (
        ("cell", file.name),
        ("robot", str(file.robot.model)),
        ("stations", ", ".join(station.name for station in file.stations)),
        ("visits", f"{len(file.visits())}, {'round and round' if file.cyclic else 'once through'}"),
        ("obstacles", ", ".join(obstacle.name for obstacle in file.obstacles) or "none"),
        ("solver", str(file.solver.method)),
        ("seed", str(file.solver.seed)),
    )
    return FileSummary("layout", file, lines)
