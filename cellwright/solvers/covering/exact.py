"""The set-cover integer program by HiGHS, with everything that is known beforehand: a good cover, a bound, a core.

HiGHS sees only the columns that a better cover may contain (reduced-cost fixing) and starts from the best cover
known. Its node limit is reproducible; its time limit is a guard, reported as ``stopped_by="time"``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import SolverError
from cellwright.solvers.covering.greedy import checked_ties
from cellwright.solvers.covering.matrix import TOLERANCE, Cover
from cellwright.solvers.covering.relaxation import build_program, n_spare_columns
from cellwright.solvers.covering.start import CoverStart, scaled_matrix, start_cover

_STARTING_WORK = 4e9
"""Work for bound and starting cover: a few seconds at most."""


def cover_exactly(
    matrix: Any,
    costs: Any = None,
    *,
    tie: FloatArray | None = None,
    min_coverage: float = 1.0,
    time_limit_s: float = 60.0,
    node_limit: int | None = None,
    seed: int = 0,
) -> Cover:
    """Solve the integer program to optimality or to a limit; the best cover known then comes with its gap.

    Args:
        matrix: The matrix, in any form that `cover_matrix` takes.
        costs: Cost of each column; ones if left out.
        tie: Of equal columns the one of lower ``tie`` is kept, (columns,).
        min_coverage: Share of the coverable rows to cover, in (0, 1].
        time_limit_s: Time that HiGHS may take.
        node_limit: Nodes that HiGHS may open; unlimited if left out.
        seed: Seed of the local search.

    Raises:
        InvalidInputError: If the matrix, costs, ties or share are malformed.
        InfeasibleError: If no column covers any row.
        SolverError: If HiGHS fails.
    """
    given, scale = scaled_matrix(matrix, costs)
    start = start_cover(given, checked_ties(given, tie), min_coverage, max_work=_STARTING_WORK, seed=seed)
    if start.closed:
        return found_cover(start, start.columns, start.cost, True, "optimality", "search", scale)
    columns, bound, stopped_by, better = _run_highs(start, time_limit_s, node_limit)
    if not better:
        columns = start.columns
    cost = float(start.reduced.matrix.costs[columns].sum())
    bound = max(start.bound, min(bound, cost))
    proven = cost <= start.reduced.matrix.round_up(bound) + TOLERANCE
    return found_cover(
        start, columns, cost if proven else bound, proven, stopped_by, "integer-program" if better else "search", scale
    )


def found_cover(
    start: CoverStart,
    columns: Any,
    bound: float,
    proven: bool,
    stopped_by: str,
    method: str,
    scale: float,
) -> Cover:
    """Return columns and bound of the reduced problem as a cover of the given one.

    A cover that is no cheaper than the greedy one but was not found by searching is called greedy.
    """
    chosen = start.reduced.restore(columns)
    if method == "search" and not start.searched:
        method = "greedy"
    return Cover(
        columns=chosen,
        order=chosen,
        cost=float(start.given.costs[chosen].sum()) * scale,
        lower_bound=(bound + start.fixed_cost) * scale,
        proven=proven,
        stopped_by="optimality" if proven else stopped_by,
        method=method,
    )


def _run_highs(start: CoverStart, time_limit_s: float, node_limit: int | None) -> tuple[Any, float, str, bool]:
    """Return columns, bound, what stopped HiGHS, and whether the columns are better than those at the start."""
    import highspy

    left = start.reduced.matrix
    active = start.useful_columns()
    active[start.columns] = True
    names = np.flatnonzero(active)
    solver = build_program(left, active, n_spare=start.n_spare, whole=True)
    solver.setOptionValue("time_limit", float(time_limit_s))
    solver.setOptionValue("mip_rel_gap", 0.0)
    solver.setOptionValue("mip_abs_gap", TOLERANCE)
    if node_limit is not None:
        solver.setOptionValue("mip_max_nodes", int(node_limit))
    n_slack = n_spare_columns(left, start.n_spare)
    known = highspy.HighsSolution()
    slack = (left.times_covered(start.columns) == 0).astype(float)[:n_slack]
    known.col_value = np.concatenate([slack, np.isin(names, start.columns).astype(float)])
    solver.setSolution(known)
    solver.run()
    status = solver.modelStatusToString(solver.getModelStatus())
    reasons = {"Optimal": "optimality", "Time limit reached": "time", "Solution limit reached": "nodes"}
    if status not in reasons:
        raise SolverError(
            f"HiGHS ended with {status!r} on {left.n_rows} rows and {len(names)} columns: use `method` best, "
            "which does not need it"
        )
    value = np.asarray(solver.getSolution().col_value)[n_slack:]
    columns = names[value > 0.5] if len(value) == len(names) else start.columns
    covered = int((left.times_covered(columns) > 0).sum()) >= left.n_rows - start.n_spare
    better = covered and bool(left.costs[columns].sum() < start.cost - TOLERANCE)
    return columns, float(solver.getInfo().mip_dual_bound), reasons[status], better
