"""The set-cover problem as solvers take it, and the solution as they return it.

A zero-one matrix has one row for each thing to cover (sample) and one column for each choice (view). It is kept
twice, by columns and by rows, because every method walks it both ways.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np

from cellwright.arrays import AnyArray, BoolArray, FloatArray, Int32Array, IntArray
from cellwright.errors import InvalidInputError

TOLERANCE = 1e-6
"""Slack when a bound is rounded up to the next whole cost: far above rounding errors, far below one."""


@dataclass(frozen=True, eq=False)
class CoverMatrix:
    """A zero-one matrix by columns and by rows, with the costs of the columns.

    Attributes:
        column_starts: Begin of each column in ``column_rows``, (columns + 1,).
        column_rows: Rows of the columns one after the other, ascending in each, (entries,).
        row_starts: Begin of each row in ``row_columns``, (rows + 1,).
        row_columns: Columns of the rows one after the other, ascending in each, (entries,).
        costs: Cost of each column, > 0, (columns,).
    """

    column_starts: IntArray
    column_rows: Int32Array
    row_starts: IntArray
    row_columns: Int32Array
    costs: FloatArray

    @property
    def n_rows(self) -> int:
        """Return the number of rows."""
        return len(self.row_starts) - 1

    @property
    def n_columns(self) -> int:
        """Return the number of columns."""
        return len(self.column_starts) - 1

    @property
    def column_sizes(self) -> IntArray:
        """Return how many rows each column covers, (columns,)."""
        return np.diff(self.column_starts)

    @property
    def row_sizes(self) -> IntArray:
        """Return how many columns cover each row, (rows,)."""
        return np.diff(self.row_starts)

    @property
    def whole_costs(self) -> bool:
        """Return whether all costs are whole numbers, so that a bound may be rounded up."""
        return bool(np.all(self.costs == np.rint(self.costs)))

    def rows_of(self, column: int) -> Int32Array:
        """Return the rows that a column covers, ascending."""
        return self.column_rows[self.column_starts[column] : self.column_starts[column + 1]]

    def columns_of(self, row: int) -> Int32Array:
        """Return the columns that cover a row, ascending."""
        return self.row_columns[self.row_starts[row] : self.row_starts[row + 1]]

    def times_covered(self, columns: IntArray) -> IntArray:
        """Return by how many of the given columns each row is covered, (rows,)."""
        parts = [self.rows_of(int(column)) for column in columns]
        return np.bincount(np.concatenate([*parts, np.empty(0, np.int32)]), minlength=self.n_rows)

    def entry_columns(self) -> Int32Array:
        """Return the column of every entry of ``column_rows``, (entries,)."""
        return np.repeat(np.arange(self.n_columns, dtype=np.int32), self.column_sizes)

    def select(self, rows: BoolArray, columns: BoolArray) -> CoverMatrix:
        """Return the matrix that is left of the rows and columns marked true, renumbered."""
        of = self.entry_columns()
        kept = rows[self.column_rows] & columns[of]
        new_row = np.cumsum(rows) - 1
        new_column = np.cumsum(columns) - 1
        return _from_entries(
            new_row[self.column_rows[kept]], new_column[of[kept]], int(rows.sum()), self.costs[columns]
        )

    def reduced_costs(self, duals: FloatArray) -> FloatArray:
        """Return cost minus the duals (rows,) of the covered rows for each column, (columns,)."""
        sums = np.concatenate([[0.0], np.cumsum(duals[self.column_rows])])
        return np.asarray(self.costs - (sums[self.column_starts[1:]] - sums[self.column_starts[:-1]]))

    def bound(self, duals: FloatArray, n_needed: int | None = None) -> float:
        """Return the Lagrangian bound of duals >= 0, (rows,): valid for any of them.

        With ``n_needed`` rows to cover, the cheapest so many duals count.
        """
        priced = duals if n_needed is None else np.sort(duals)[:n_needed]
        return float(priced.sum() + np.minimum(self.reduced_costs(duals), 0.0).sum())

    def round_up(self, bound: float) -> float:
        """Return the least cost that a cover can have if none is below ``bound``."""
        return float(math.ceil(bound - TOLERANCE)) if self.whole_costs else bound


@dataclass(frozen=True, eq=False)
class Cover:
    """A cover with what is known about how good it is.

    Attributes:
        columns: Chosen columns, ascending; greedy covers are in the order of choice in ``order``.
        order: The same columns in the order in which they were chosen.
        cost: Sum of their costs.
        lower_bound: No cover costs less; proven, not rounded.
        proven: Whether no cheaper cover exists.
        stopped_by: ``optimality``, ``nodes`` (the work budget) or ``time`` (the guard; not reproducible).
        method: ``greedy``, ``search``, ``tree`` or ``integer-program``: what found the columns.
    """

    columns: IntArray
    order: IntArray
    cost: float
    lower_bound: float
    proven: bool
    stopped_by: str
    method: str

    @property
    def gap(self) -> float:
        """Return the share of the cost that might be saved: 0 if proven smallest."""
        if self.proven or self.cost <= 0:
            return 0.0
        return max(0.0, (self.cost - self.lower_bound) / self.cost)


def cover_matrix(matrix: Any, costs: Any = None) -> CoverMatrix:
    """Return the matrix in the form that the solvers use.

    Args:
        matrix: A `CoverMatrix`, a SciPy sparse matrix or array, a dense zero-one array (rows, columns), or
            ``(column_starts, rows)`` or ``(column_starts, rows, n_rows)``. Only the pattern counts; entries that are
            given twice count once.
        costs: Cost of each column, > 0; ones if left out.

    Raises:
        InvalidInputError: If the arrays do not describe a matrix, or a cost is not positive and finite.
    """
    if isinstance(matrix, CoverMatrix):
        given = matrix.costs if costs is None else costs
        return replace(matrix, costs=_checked_costs(given, matrix.n_columns))
    if isinstance(matrix, tuple):
        row, column, n_rows, n_columns = _entries_of_tuple(*matrix)
    else:
        found = matrix.tocoo() if hasattr(matrix, "tocoo") else np.asarray(matrix)
        if len(found.shape) != 2:
            raise InvalidInputError(f"the cover matrix has shape {found.shape}: give rows x columns")
        n_rows, n_columns = (int(size) for size in found.shape)
        if isinstance(found, np.ndarray):
            row, column = np.nonzero(found)
        else:
            kept = np.asarray(found.data) != 0
            row, column = np.asarray(found.row)[kept], np.asarray(found.col)[kept]
    return _from_entries(row, column, n_rows, _checked_costs(costs, n_columns))


def _entries_of_tuple(column_starts: Any, rows: Any, n_rows: int | None = None) -> tuple[IntArray, IntArray, int, int]:
    starts, row = np.asarray(column_starts, np.int64), np.asarray(rows, np.int64)
    if starts.ndim != 1 or len(starts) == 0 or starts[0] != 0 or starts[-1] != len(row) or np.any(np.diff(starts) < 0):
        raise InvalidInputError(
            f"column starts do not fit {len(row)} entries: begin with 0, never fall, and end with the number of entries"
        )
    least = int(row.max()) + 1 if len(row) else 0
    wanted = least if n_rows is None else int(n_rows)
    if len(row) and (int(row.min()) < 0 or wanted < least):
        raise InvalidInputError(f"rows run from {row.min()} to {row.max()} but the matrix has {wanted} rows")
    return row, np.repeat(np.arange(len(starts) - 1), np.diff(starts)), wanted, len(starts) - 1


def _checked_costs(costs: Any, n_columns: int) -> FloatArray:
    if costs is None:
        return np.ones(n_columns)
    checked = np.array(costs, dtype=np.float64)
    if checked.shape != (n_columns,):
        raise InvalidInputError(f"{checked.size} costs for {n_columns} columns: give one for each")
    if not np.all(np.isfinite(checked) & (checked > 0)):
        wrong = int(np.flatnonzero(~(np.isfinite(checked) & (checked > 0)))[0])
        raise InvalidInputError(f"column {wrong} costs {checked[wrong]}: costs must be positive and finite")
    return checked


def _from_entries(row: AnyArray, column: AnyArray, n_rows: int, costs: FloatArray) -> CoverMatrix:
    """Build both orders from entries in any order by counting sorts; entries given twice count once."""
    column_starts, column_rows, row_starts, row_columns = _sort_entries(
        np.asarray(row, np.int32), np.asarray(column, np.int32), n_rows, len(costs)
    )
    return CoverMatrix(column_starts, column_rows, row_starts, row_columns, np.array(costs, np.float64))


@numba.njit(cache=True, nogil=True)
def _sort_entries(row, column, n_rows, n_columns):  # type: ignore[no-untyped-def]
    row_starts = np.zeros(n_rows + 1, np.int64)
    for i in row:
        row_starts[i + 1] += 1
    for i in range(n_rows):
        row_starts[i + 1] += row_starts[i]
    spot = row_starts.copy()
    of_row = np.empty(len(row), np.int32)
    for t in range(len(row)):
        of_row[spot[row[t]]] = column[t]
        spot[row[t]] += 1
    column_starts = np.zeros(n_columns + 1, np.int64)
    last = np.full(n_columns, -1, np.int64)
    kept = 0
    begin = 0
    for i in range(n_rows):
        end = row_starts[i + 1]
        for t in range(begin, end):
            if last[of_row[t]] != i:
                last[of_row[t]] = i
                column_starts[of_row[t] + 1] += 1
                of_row[kept] = of_row[t]
                kept += 1
        begin = end
        row_starts[i + 1] = kept
    for j in range(n_columns):
        column_starts[j + 1] += column_starts[j]
    place = column_starts.copy()
    column_rows = np.empty(kept, np.int32)
    for i in range(n_rows):
        for t in range(row_starts[i], row_starts[i + 1]):
            j = of_row[t]
            column_rows[place[j]] = i
            place[j] += 1
    row_columns = np.empty(kept, np.int32)
    spot[:] = row_starts
    for j in range(n_columns):
        for t in range(column_starts[j], column_starts[j + 1]):
            i = column_rows[t]
            row_columns[spot[i]] = j
            spot[i] += 1
    return column_starts, column_rows, row_starts, row_columns
