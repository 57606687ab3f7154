"""Read tables of tasks: CSV with a head line, and the HDF5 files in which drilling targets were published.

CSV: columns ``x``, ``y``, ``z`` (position), ``dx``, ``dy``, ``dz`` (direction of the tool's z axis), and, if wanted,
``name``, ``dwell_s`` and ``after`` (names separated by ``;``), in any order. HDF5: a dataset ``targets`` (n, 6) of
position and direction in m, as in the data of RoboTSP (Suarez-Ruiz, Lembono and Pham 2018).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

from cellwright.cell.hdf5_tables import read_dataset
from cellwright.errors import InvalidInputError, listed

SUFFIXES = (".csv", ".hdf5", ".h5")
DATASET = "targets"
_NUMBERS = ("x", "y", "z", "dx", "dy", "dz")
_COLUMNS = (*_NUMBERS, "name", "dwell_s", "after")
_MOST_ROWS = 100_000
_LONGEST = 1e100
"""A direction longer than this is shortened as it is read."""


@dataclass(frozen=True)
class TaskRow:
    """One task of a table and its line; lengths in the table's unit, ``metres`` if it has one of its own (HDF5: m)."""

    name: str
    place: tuple[float, float, float]
    direction: tuple[float, float, float]
    dwell: float | None = None
    after: tuple[str, ...] = ()
    metres: float | None = None
    line: int = 0

    def position(self, metres_per_unit: float) -> tuple[float, float, float]:
        """Return the position in m; ``metres_per_unit`` is what a table without a unit of its own is read in."""
        x, y, z = (value * (self.metres or metres_per_unit) for value in self.place)
        return x, y, z


def read_task_table(name: str, content: bytes) -> list[TaskRow]:
    """Return the tasks of a table; tasks without a name are called by their number, from 1.

    Raises:
        InvalidInputError: If the table is malformed; the message names line, column and value.
    """
    if PurePath(name).suffix.lower() != ".csv":
        rows = read_dataset(name, content, DATASET)
        if rows.ndim != 2 or rows.shape[1] != 6:
            raise InvalidInputError(f"{name}: {DATASET!r} has shape {rows.shape}: it must be (n, 6)")
        found = [_row(name, number, row, {}, 1.0) for number, row in enumerate(rows.tolist(), 1)]
    else:
        found = _csv_rows(name, content)
    if not found:
        raise InvalidInputError(f"{name} holds no task: write one a line below the head")
    return found


def _csv_rows(name: str, content: bytes) -> list[TaskRow]:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{name} is not text in UTF-8 (byte {error.start}): save it so") from error
    lines = csv.reader(io.StringIO(text))
    try:
        head = [word.strip() for word in next(lines, [])]
        unknown, missing = [w for w in head if w not in _COLUMNS], [w for w in _NUMBERS if w not in head]
        if unknown or missing or len(set(head)) != len(head):
            what = f"lacks {listed(missing, 6)}" if missing else "names a column twice"
            if unknown:
                what = f"has the column {unknown[0]!r}"
            raise InvalidInputError(
                f"{name}, line 1: the head {what}: write x,y,z,dx,dy,dz and, if wanted, name, dwell_s, after"
            )
        rows: list[TaskRow] = []
        for cells in lines:
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(head):
                raise InvalidInputError(
                    f"{name}, line {lines.line_num}: has {len(cells)} entries where the head has {len(head)}: "
                    "write one a column"
                )
            if len(rows) == _MOST_ROWS:
                raise InvalidInputError(f"{name} has more than {_MOST_ROWS} tasks: split it")
            given = dict(zip(head, (cell.strip() for cell in cells)))
            rows.append(_row(name, lines.line_num, [given[word] for word in _NUMBERS], given, None, len(rows) + 1))
    except csv.Error as error:
        raise InvalidInputError(f"{name}, line {lines.line_num}: not readable as CSV ({error}): correct it") from error
    return rows


def _row(
    file: str, line: int, numbers: Sequence[str | float], given: dict[str, str], metres: float | None, count: int = 0
) -> TaskRow:
    x, y, z, dx, dy, dz = (_number(file, line, word, value) for word, value in zip(_NUMBERS, numbers))
    longest = max(abs(dx), abs(dy), abs(dz))
    if longest > _LONGEST:  # its square would be too large for a number
        dx, dy, dz = dx / longest, dy / longest, dz / longest
    if math.hypot(dx, dy, dz) < 1e-9:
        raise InvalidInputError(f"{file}, line {line}: the direction (dx, dy, dz) has no length: give one")
    dwell = _number(file, line, "dwell_s", given["dwell_s"]) if given.get("dwell_s") else None
    if dwell is not None and dwell < 0.0:
        raise InvalidInputError(f"{file}, line {line}, dwell_s: {dwell:g} is negative: write a time of at least 0")
    after = tuple(word.strip() for word in given.get("after", "").split(";") if word.strip())
    name = given.get("name") or str(count or line)
    return TaskRow(name, (x, y, z), (dx, dy, dz), dwell, after, metres, line)


def _number(file: str, line: int, column: str, value: str | float) -> float:
    try:
        number = float(value)
    except ValueError as error:
        raise InvalidInputError(f"{file}, line {line}, {column}: {value!r} is not a number: write one") from error
    if not math.isfinite(number):
        raise InvalidInputError(f"{file}, line {line}, {column}: {value!r} is not finite: write a number")
    return number
