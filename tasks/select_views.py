"""Select few sweeps that together measure the part: set cover (Kaiser 2021, section 4.3).

The default looks for a smallest selection and proves it where a fixed amount of work suffices; where it does not, the
gap to a proven lower bound stands beside the selection. The paper's greedy selection is always computed for
comparison. Among equally small selections sweeps of low uncertainty are preferred.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from schemas.motion import Trajectory
from schemas.params import Params
from schemas.stage import Progress, no_progress, stage
from schemas.views import Measurability, ViewSelection

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray, IntArray
    from cellwright.solvers.set_cover import Cover, CoverMatrix


_APPLIES = {
    "best": frozenset({"node_limit", "max_work", "seed"}),
    "greedy": frozenset[str](),
    "exact": frozenset({"node_limit", "time_limit_s", "seed"}),
}
"""Which settings each method reads."""
_EXACT_NODES = 1000
"""Nodes that HiGHS may open where no limit is given: most parts need a few dozen."""


class SetCoverParams(Params):
    """Settings of the selection; those that the method does not read take their defaults: no key hangs on them."""

    method: Literal["best", "greedy", "exact"] = Field(
        default="best",
        description="best: own search and branch and bound, no clock; greedy: as in the paper; exact: HiGHS.",
    )
    min_coverage: float = Field(
        default=1.0, gt=0, le=1, description="Share of the coverable samples that the selection has to measure."
    )
    node_limit: int | None = Field(
        default=None,
        ge=1,
        description="Most nodes of the branch and bound; if left out unlimited for `best`, for `exact` 1000 unless it "
        "has a time limit.",
    )
    time_limit_s: float | None = Field(
        default=None, gt=0, description="Time that HiGHS may take, only for `exact`; the result then depends on it."
    )
    max_work: float = Field(
        default=6e9, gt=0, description="Matrix entries that `best` may visit, about one nanosecond each."
    )
    seed: int = Field(default=0, ge=0, description="Seed of the local search.")

    @model_validator(mode="after")
    def _only_what_applies(self) -> Self:
        for name in {"node_limit", "time_limit_s", "max_work", "seed"} - _APPLIES[self.method]:
            object.__setattr__(self, name, type(self).model_fields[name].default)  # frozen for everybody else
        if self.method == "exact" and self.node_limit is None and self.time_limit_s is None:
            object.__setattr__(self, "node_limit", _EXACT_NODES)
        return self


@stage(version=2)
def select_views(
    measurability: Measurability,
    earlier: Trajectory | None = None,
    *,
    params: SetCoverParams,
    progress: Progress = no_progress,
) -> ViewSelection:
    """Select views until ``min_coverage`` of the coverable samples is measured.

    A sample that no view measures is a finding and keeps its cause; it does not count for the coverage. Views that an
    ``earlier`` trajectory leaves out or replaces are not selected: what only they measure counts as not connected, and
    bound and proof hold for the problem without them.

    Raises:
        InvalidInputError: If an entry names a view or a sample that does not exist, or an uncertainty is not finite.
        InfeasibleError: If no view measures any sample.
    """
    import numpy as np

    from cellwright.causes import Cause
    from cellwright.solvers.set_cover import cover_greedily, exchange_columns
    from schemas.plan_objects import unconnected_views

    left_out = {} if earlier is None else unconnected_views(earlier)
    matrix, uncertainty = _matrix(measurability, left_out)
    tie = np.full(matrix.n_columns, np.inf)  # a view that measures nothing is never taken
    used = matrix.column_sizes > 0
    tie[used] = np.maximum.reduceat(uncertainty, matrix.column_starts[:-1][used])
    greedy = cover_greedily(matrix, tie=tie, min_coverage=params.min_coverage)
    found = greedy if params.method == "greedy" else _small_cover(matrix, tie, params, progress)
    bound = _stronger_bound(matrix, greedy, params) if params.method == "greedy" else found.lower_bound
    views = found.columns if params.method == "greedy" else exchange_columns(matrix, found.columns, uncertainty)
    times = matrix.times_covered(views)
    cause = measurability.cause.copy()
    cause[np.setdiff1d(measurability.sample, np.flatnonzero(matrix.row_sizes))] = Cause.NOT_CONNECTED
    cause[(times == 0) & (matrix.row_sizes > 0)] = Cause.NOT_SELECTED
    cause[times > 0] = Cause.NONE
    least = matrix.round_up(bound)
    return ViewSelection(
        view=views.astype(np.int32),
        n_samples=matrix.column_sizes[views].astype(np.int32),
        n_only=np.array([(times[matrix.rows_of(int(view))] == 1).sum() for view in views], np.int32),
        max_uncertainty_m=_worst_assigned(matrix, views, uncertainty),
        cause=cause,
        greedy_view=greedy.order.astype(np.int32),
        method="search" if found.method == "greedy" and not np.array_equal(views, greedy.columns) else found.method,
        lower_bound=bound,
        gap=max(0.0, (len(views) - least) / len(views)),
        proven=len(views) <= least,
        stopped_by=found.stopped_by,
        n_excluded=len(left_out),
    )


def _small_cover(matrix: CoverMatrix, tie: FloatArray, params: SetCoverParams, progress: Progress) -> Cover:
    import numpy as np

    from cellwright.solvers.set_cover import cover_best, cover_exactly

    if params.method == "exact":
        return cover_exactly(
            matrix,
            tie=tie,
            min_coverage=params.min_coverage,
            time_limit_s=np.inf if params.time_limit_s is None else params.time_limit_s,
            node_limit=params.node_limit,
            seed=params.seed,
        )
    return cover_best(
        matrix,
        tie=tie,
        min_coverage=params.min_coverage,
        max_work=params.max_work,
        node_limit=params.node_limit,
        seed=params.seed,
        progress=progress,
    )


def _stronger_bound(matrix: CoverMatrix, greedy: Cover, params: SetCoverParams) -> float:
    """Return the better of the guarantee and the Lagrangian bound."""
    from cellwright.solvers.set_cover import lower_bound, rows_needed

    priced = lower_bound(matrix, upper_bound=greedy.cost, n_needed=rows_needed(matrix, params.min_coverage))
    return max(greedy.lower_bound, priced.value)


def _matrix(measurability: Measurability, left_out: dict[int, str]) -> tuple[CoverMatrix, FloatArray]:
    """Return the samples x views matrix without ``left_out`` views, and the uncertainty of its entries by column."""
    import numpy as np

    from cellwright.causes import Cause
    from cellwright.errors import InfeasibleError, InvalidInputError, listed
    from cellwright.solvers.set_cover import cover_matrix

    n_views, n_samples = len(measurability.start_m), len(measurability.cause)
    view, sample = measurability.view.astype(np.int64), measurability.sample.astype(np.int64)
    for name, index, count in (("view", view, n_views), ("sample", sample, n_samples)):
        wrong = index[(index < 0) | (index >= count)]
        if len(wrong):
            raise InvalidInputError(
                f"measurability names {name} {wrong[0]} but has {count} of them: run measure_samples again"
            )
    if not np.isfinite(measurability.uncertainty_m).all():
        raise InvalidInputError("measurability holds uncertainties that are not finite: run measure_samples again")
    kept = ~np.isin(view, list(left_out))
    if not kept.any():
        reasons = listed(f"view {view}: {reason}" for view, reason in left_out.items())
        values, counts = np.unique(measurability.cause, return_counts=True)
        causes = sorted(zip(counts.tolist(), values.tolist()), reverse=True)
        raise InfeasibleError(
            f"none of {n_views} views measures any of {n_samples} samples"
            + (f", {len(left_out)} aside that cannot be executed or connected ({reasons}) " if left_out else " ")
            + f"({listed(f'{count} {Cause(value).label}' for count, value in causes)}): {_advice(causes)}"
        )
    view, sample, uncertainty = view[kept], sample[kept], measurability.uncertainty_m[kept]
    key = view * n_samples + sample
    if not (key[1:] > key[:-1]).all():  # entries as they are measured are in order, and none is there twice
        order = np.lexsort((uncertainty, key))
        first = order[np.concatenate([[True], np.diff(key[order]) > 0])]  # of entries given twice the least uncertain
        view, sample, uncertainty = view[first], sample[first], uncertainty[first]
    starts = np.searchsorted(view, np.arange(n_views + 1))
    return cover_matrix((starts, sample, n_samples)), uncertainty.astype(np.float64)


def _advice(causes: list[tuple[int, int]]) -> str:
    """Return what mends the causes that stopped a tenth of the samples or more, from (count, cause), most first."""
    from cellwright.causes import Cause

    tilts, standoffs = "add tilts (theta_tilt_rad, psi_tilt_rad)", "standoffs (standoff_m)"
    occluded = f"{tilts} or move the part (T_world_part) free of what stands around it"
    mends = {
        Cause.FIELD_OF_VIEW: f"add {standoffs}",
        Cause.INCIDENCE: tilts,
        Cause.UNCERTAINTY: f"{tilts} or {standoffs}, or raise max_uncertainty_m",
        Cause.EMITTER_OCCLUDED: occluded,
        Cause.DETECTOR_OCCLUDED: occluded,
        Cause.OUT_OF_REACH: "move the part (T_world_part) into the robot's reach",
        Cause.JOINT_LIMIT: "move the part (T_world_part) or widen the joint limits (lower_rad, upper_rad)",
        Cause.COLLISION: f"move the part (T_world_part) away from what the robot collides with, or add {standoffs}",
        Cause.JOINT_SPEED: "lower scan_speed_m_s",
        Cause.TOO_SHORT: "lower shortest_m",
    }
    total = sum(count for count, _ in causes)
    leading = [mends[Cause(value)] for count, value in causes if Cause(value) in mends and 10 * count >= total]
    return "; ".join(dict.fromkeys(leading)) or "move the part (T_world_part)"


def _worst_assigned(matrix: CoverMatrix, views: IntArray, uncertainty: FloatArray) -> FloatArray:
    """Return each view's worst uncertainty over the samples it measures best; ties go to the lower view, (views,).

    Not a number for a view that measures no sample best.
    """
    import numpy as np

    smallest = np.full(matrix.n_rows, np.inf)
    assigned = np.full(matrix.n_rows, -1)
    for at, view in enumerate(views):
        rows = matrix.rows_of(int(view))
        value = uncertainty[matrix.column_starts[view] : matrix.column_starts[view + 1]]
        better = value < smallest[rows]
        assigned[rows[better]] = at
        smallest[rows[better]] = value[better]
    worst = np.full(len(views), -np.inf)
    np.maximum.at(worst, assigned[assigned >= 0], smallest[assigned >= 0])
    return np.where(np.isfinite(worst), worst, np.nan)
