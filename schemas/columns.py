"""Declare what an artefact's fields mean: columns, facts and blobs with dtype, unit, frame and meaning.

A column belongs to a table; all columns of one table have one length. The storage layer derives the Arrow
schema from these declarations, so a unit is written down once.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

ANY_WIDTH = -1
"""A second dimension that differs from artefact to artefact, as the number of joints does."""

FieldRole = Literal["column", "fact", "blob"]


@dataclass(frozen=True, slots=True)
class FieldSpec:
    """One declared field of an artefact.

    Attributes:
        role: ``column`` (array, one row an entry), ``fact`` (one value) or ``blob`` (bytes of a file).
        dtype: NumPy dtype name, or ``str``, ``bool``.
        width: Length of the second dimension of a column; ``None`` for a flat column, ``ANY_WIDTH`` if open.
        unit: SI unit of the values, empty for pure numbers.
        frame: Frame in which vectors and poses are expressed, empty if none.
        meaning: One sentence for readers.
        table: Table that a column belongs to.
        suffix: File suffix of a blob, with the dot; empty if the artefact's own ``name`` field carries it.
        optional: Whether a column of open width may be left out; its second dimension is zero then.
    """

    role: FieldRole
    dtype: str
    width: int | None
    unit: str
    frame: str
    meaning: str
    table: str
    suffix: str
    optional: bool = False


_KEY = "cellwright"


def column(
    meaning: str,
    *,
    dtype: str = "float64",
    width: int | None = None,
    unit: str = "",
    frame: str = "",
    table: str = "rows",
    optional: bool = False,
) -> Any:
    """Declare an array field with one row an entry, shape ``(rows,)`` or ``(rows, width)``.

    ``dtype="str"`` declares a tuple of strings. An ``optional`` column, of open width only, is given by its name or
    not at all, stands behind the first column of its table, and is neither stored nor digested where it is left out:
    an artefact without it is the one that it was before the column was declared.
    """
    spec = FieldSpec("column", dtype, width, unit, frame, meaning, table, "", optional)
    if not optional:
        return dataclasses.field(metadata={_KEY: spec})
    if width != ANY_WIDTH:
        raise TypeError(f"an optional column has width ANY_WIDTH, not {width}: {meaning}")
    return dataclasses.field(default=None, kw_only=True, metadata={_KEY: spec})


def torque_column(where: str) -> Any:
    """Declare the torques at the states of a motion, (states, joints), left out ``where`` nothing knows them."""
    return column(
        f"Joint torques with what the arm carries, N on slides; left out where {where}",
        width=ANY_WIDTH,
        unit="N m",
        table="states",
        optional=True,
    )


def fact(meaning: str, *, dtype: str = "float64", unit: str = "", default: Any = dataclasses.MISSING) -> Any:
    """Declare a single value: float, int, bool or str; without ``default`` it must be given."""
    spec = FieldSpec("fact", dtype, None, unit, "", meaning, "", "")
    return dataclasses.field(default=default, metadata={_KEY: spec})


def blob(meaning: str, *, suffix: str) -> Any:
    """Declare the bytes of a whole file, stored as that file."""
    return dataclasses.field(metadata={_KEY: FieldSpec("blob", "bytes", None, "", "", meaning, "", suffix)})


def spec_of(field: dataclasses.Field[Any]) -> FieldSpec | None:
    """Return the declaration behind a dataclass field, or ``None`` for an undeclared one."""
    found = field.metadata.get(_KEY)
    return found if isinstance(found, FieldSpec) else None
