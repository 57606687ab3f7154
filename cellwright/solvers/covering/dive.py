"""A good cover of many columns by diving: fix what the linear program nearly chose, solve it again, repeat.

Strong where the linear relaxation is tight and covers are large (timetables, crews), where a local search over whole
covers is weak. Deterministic; the work is that of the linear programs.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.solvers.covering.matrix import CoverMatrix
from cellwright.solvers.covering.reductions import reduce_cover
from cellwright.solvers.covering.relaxation import solve_relaxation


def dive_cover(
    matrix: CoverMatrix, duals: FloatArray, *, threshold: float, max_cost: float, max_work: float
) -> tuple[IntArray | None, float]:
    """Dive for a cover that costs less than ``max_cost``; all rows have to be covered.

    Args:
        matrix: The matrix.
        duals: Prices of the rows, >= 0, (rows,).
        threshold: Columns of a greater share in the linear program are fixed, at least the largest one.
        max_cost: Give up as soon as the bound says that the cover will not be cheaper.
        max_work: Matrix entries to visit at most.

    Returns:
        The columns, ascending, or ``None`` if the dive was given up; the entries visited.

    Raises:
        InvalidInputError: Never; the matrix has been checked.
    """
    names, taken, spent, work, left = np.arange(matrix.n_columns), np.empty(0, np.int64), 0.0, 0.0, matrix
    while left.n_rows > 0:
        reduced = reduce_cover(left)
        work += 2.0 * len(left.column_rows)
        taken = np.concatenate([taken, names[reduced.essential]])
        spent = float(matrix.costs[taken].sum())
        names, duals, left = names[reduced.columns], duals[reduced.rows], reduced.matrix
        if left.n_rows == 0:
            break
        relaxed = solve_relaxation(left, duals, max_work=max_work - work)
        work += relaxed.work
        if not relaxed.solved or matrix.round_up(spent + relaxed.value) >= max_cost:
            return None, work
        fixed = relaxed.share > threshold
        fixed[np.argmax(relaxed.share)] = True
        taken = np.concatenate([taken, names[fixed]])
        uncovered = left.times_covered(np.flatnonzero(fixed)) == 0
        left, names, duals = left.select(uncovered, ~fixed), names[~fixed], relaxed.duals[uncovered]
    cover = np.sort(taken)
    return (cover, work) if matrix.costs[cover].sum() < max_cost else (None, work)
