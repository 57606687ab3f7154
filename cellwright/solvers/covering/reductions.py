"""Shrink a set-cover problem without losing an optimum: dominated columns, dominated rows, essential columns.

A column is dominated if another one that costs no more covers all its rows; a row is dominated if whatever covers
another row covers it too; a column is essential if it alone covers a row. The three are applied until none applies
(Caprara, Toth and Fischetti 2000, section 2). Subset tests run on 64-bit words and only against the columns of the
column's rarest row, which makes them cheap even for 23,000 columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import AnyArray, BoolArray, FloatArray, IntArray
from cellwright.solvers.covering.matrix import CoverMatrix


@dataclass(frozen=True, eq=False)
class ReducedCover:
    """What is left of a problem: solve ``matrix`` and add the ``essential`` columns.

    Attributes:
        matrix: The remaining matrix.
        rows: Original rows that are left, ascending.
        columns: Original columns that are left, ascending.
        essential: Original columns that every optimum may be taken to contain, ascending.
    """

    matrix: CoverMatrix
    rows: IntArray
    columns: IntArray
    essential: IntArray

    def restore(self, chosen: IntArray) -> IntArray:
        """Return the original columns of columns chosen in ``matrix``, with the essential ones, ascending."""
        return np.sort(np.concatenate([self.essential, self.columns[chosen]])).astype(np.int64)


def reduce_cover(matrix: CoverMatrix, tie: FloatArray | None = None, *, columns_only: bool = False) -> ReducedCover:
    """Remove dominated columns and rows and take out essential columns until nothing changes.

    Of equal columns the one of lower ``tie`` (columns,) stays, then the one of lower index. ``columns_only`` leaves
    all rows in place, as partial covers need it. Rows that no column covers are dropped.

    Raises:
        InvalidInputError: Never; the matrix has been checked.
    """
    rows, columns = np.arange(matrix.n_rows), np.arange(matrix.n_columns)
    essential: list[int] = []
    ties = np.zeros(matrix.n_columns) if tie is None else np.asarray(tie, np.float64)
    left, kept_rows = matrix, matrix.row_sizes > 0
    while True:
        kept_columns = np.ones(left.n_columns, bool)
        if not columns_only:
            single = left.row_sizes == 1
            taken = np.unique(left.row_columns[left.row_starts[:-1][single]])
            essential += columns[taken].tolist()
            kept_rows &= left.times_covered(taken) == 0
            kept_columns[taken] = False
        if not (kept_rows.all() and kept_columns.all()):
            left, rows, columns = left.select(kept_rows, kept_columns), rows[kept_rows], columns[kept_columns]
        kept = _undominated_columns(left, ties[columns])
        left, columns = left.select(np.ones(left.n_rows, bool), kept), columns[kept]
        kept_rows = np.ones(left.n_rows, bool) if columns_only else _undominated_rows(left)
        # taking rows away shrinks columns, which can make new dominated or essential ones
        if kept_rows.all() and (columns_only or not np.any(left.row_sizes == 1)):
            return ReducedCover(left, rows, columns, np.array(sorted(essential), np.int64))


def _undominated_columns(matrix: CoverMatrix, tie: FloatArray) -> BoolArray:
    if matrix.n_columns == 0 or matrix.n_rows == 0:
        return np.zeros(matrix.n_columns, bool)
    rank = np.empty(matrix.n_columns, np.int64)  # better columns first
    rank[np.lexsort((np.arange(matrix.n_columns), tie, matrix.costs))] = np.arange(matrix.n_columns)
    words = _packed(matrix.column_rows, matrix.entry_columns(), matrix.n_columns, matrix.n_rows)
    return np.asarray(
        _keep_undominated(
            words, matrix.column_starts, matrix.column_rows, matrix.row_starts, matrix.row_columns, matrix.costs, rank
        )
    )


def _undominated_rows(matrix: CoverMatrix) -> BoolArray:
    row = np.repeat(np.arange(matrix.n_rows), matrix.row_sizes)
    words = _packed(matrix.row_columns, row, matrix.n_rows, matrix.n_columns)
    order = np.lexsort((np.arange(matrix.n_rows), matrix.row_sizes))
    return np.asarray(_keep_minimal(words, order))


def _packed(member: AnyArray, owner: AnyArray, n_owners: int, n_members: int) -> AnyArray:
    """Return membership as bits, (owners, words) of uint64."""
    bits = np.zeros((n_owners, -(-max(n_members, 1) // 64) * 64), bool)
    bits[owner, member] = True
    return np.packbits(bits, axis=1).view(np.uint64)


@numba.njit(cache=True, nogil=True)
def _keep_undominated(words, starts, rows, row_starts, row_columns, costs, rank):  # type: ignore[no-untyped-def]
    n = len(starts) - 1
    keep = np.ones(n, np.bool_)
    for j in range(n):
        size = starts[j + 1] - starts[j]
        if size == 0:
            keep[j] = False
            continue
        rarest = rows[starts[j]]
        for t in range(starts[j] + 1, starts[j + 1]):
            i = rows[t]
            if row_starts[i + 1] - row_starts[i] < row_starts[rarest + 1] - row_starts[rarest]:
                rarest = i
        for t in range(row_starts[rarest], row_starts[rarest + 1]):
            k = row_columns[t]
            other = starts[k + 1] - starts[k]
            # a dropped k need not be asked: what dominates k dominates j too and stands in the same list
            if k == j or not keep[k] or other < size or costs[k] > costs[j] or (other == size and rank[k] > rank[j]):
                continue
            inside = True
            for w in range(words.shape[1]):
                if words[j, w] & ~words[k, w]:
                    inside = False
                    break
            if inside:
                keep[j] = False
                break
    return keep


@numba.njit(cache=True, nogil=True)
def _keep_minimal(words, order):  # type: ignore[no-untyped-def]
    n = len(order)
    keep = np.ones(n, np.bool_)
    for a in range(n):
        i = order[a]
        if not keep[i]:
            continue
        for b in range(a + 1, n):
            k = order[b]
            if not keep[k]:
                continue
            inside = True
            for w in range(words.shape[1]):
                if words[i, w] & ~words[k, w]:
                    inside = False
                    break
            if inside:
                keep[k] = False
    return keep
