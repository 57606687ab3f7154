"""Sweeps as an arm follows them: the useful interval with its margin, cut into poses a step apart."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import FloatArray, Int32Array, IntArray
from cellwright.cell.cell import Cell
from cellwright.cell.transforms import inverse
from cellwright.errors import InvalidInputError


@dataclass(frozen=True)
class FollowSettings:
    """How sweeps are followed; SI units.

    Attributes:
        margin: Lead-in and run-out beyond the useful interval.
        step: Largest distance of poses.
        scan_speed: Speed along the sweep.
        shortest: Least length of a piece.
        clearance: Least distance between bodies.
        link_overshoot, tool_overshoot, field_spacing: Fineness of the collision filter, see `sphere_filter`.
        max_exact_checks: Most states that the exact engine is asked about.
        worthwhile_gain: Share of more samples that a sweep's best piece must be able to gain for that.
    """

    margin: float = 0.03
    step: float = 0.005
    scan_speed: float = 0.1
    shortest: float = 0.05
    clearance: float = 0.005
    link_overshoot: float = 0.018
    tool_overshoot: float = 0.010
    field_spacing: float = 0.008
    max_exact_checks: int = 20_000
    worthwhile_gain: float = 0.1


@dataclass(frozen=True, eq=False)
class CandidateSweeps:
    """Sweeps to follow, and the samples that they measure.

    Attributes:
        T_world_scanner: Pose of the laser-emitter frame at travel 0, (sweeps, 4, 4).
        start, end: Travel along its x axis at which the sweep measures its first and last sample, (sweeps,) in
            m; NaN if it measures none.
        sample_sweep: Sweep of each sample measured, ascending, (entries,).
        sample_travel: Travel at which it is measured in m, (entries,).
    """

    T_world_scanner: FloatArray
    start: FloatArray
    end: FloatArray
    sample_sweep: Int32Array
    sample_travel: FloatArray


@dataclass(frozen=True, eq=False)
class SweepPoses:
    """The poses of all sweeps that measure something.

    Attributes:
        sweep: Row of the sweeps, (m,).
        T_base_flange: Flange pose at the first pose, (m, 4, 4).
        direction: Unit vector of the travel in the base, (m, 3).
        n_poses, step, first_travel: Poses, their distance in m, the travel of the first, (m,).
        useful: First and last pose at or within the useful interval, (m, 2).
        entry: First sample of each sweep and the end, (m, 2).
    """

    sweep: IntArray
    T_base_flange: FloatArray
    direction: FloatArray
    n_poses: IntArray
    step: FloatArray
    first_travel: FloatArray
    useful: IntArray
    entry: IntArray


def sweep_poses(cell: Cell, sweeps: CandidateSweeps, settings: FollowSettings) -> SweepPoses:
    """Cut the useful intervals with their margins into poses at most a step apart.

    Raises:
        InvalidInputError: If an interval ends before it starts.
    """
    sweep = np.flatnonzero(np.isfinite(sweeps.start))
    start, end = sweeps.start[sweep], sweeps.end[sweep]
    if not (end >= start).all():
        worst = int(sweep[np.argmin(np.where(end >= start, 0.0, -1.0))])
        raise InvalidInputError(
            f"view {worst} measures from {sweeps.start[worst]:.6g} m to {sweeps.end[worst]:.6g} m: "
            "the end must not lie before the start"
        )
    length = end - start + 2.0 * settings.margin
    # at least two poses, so that every sweep has a direction in joint space
    intervals = np.maximum(np.ceil(length / settings.step - 1e-9), 1.0).astype(np.int64)
    step = length / intervals
    first_travel = start - settings.margin
    T_world_scanner = sweeps.T_world_scanner[sweep]
    T = inverse(cell.T_world_base) @ T_world_scanner
    direction = np.ascontiguousarray(T[:, :3, 0])
    T[:, :3, 3] += first_travel[:, None] * direction
    safe = np.where(step > 0.0, step, 1.0)
    useful = np.stack([np.floor(settings.margin / safe + 1e-9), np.ceil((end - first_travel) / safe - 1e-9)], -1)
    entry = np.searchsorted(sweeps.sample_sweep, np.stack([sweep, sweep + 1], -1))
    return SweepPoses(
        sweep,
        T @ inverse(cell.T_flange_scanner),
        direction,
        intervals + 1,
        step,
        first_travel,
        np.clip(useful.astype(np.int64), 0, intervals[:, None]),
        entry.astype(np.int64),
    )


@numba.njit(cache=True, nogil=True)
def spread_poses(
    T_first: FloatArray, direction: FloatArray, step: FloatArray, rows: IntArray, first: IntArray, out: FloatArray
) -> None:
    """Write the flange poses of some sweeps one after the other to ``out`` (poses, 4, 4)."""
    for place in range(len(rows)):
        row = rows[place]
        for k in range(first[place + 1] - first[place]):
            T = out[first[place] + k]
            T[:] = T_first[row]
            for axis in range(3):
                T[axis, 3] += k * step[row] * direction[row, axis]


@numba.njit(cache=True, nogil=True, _nrt=False)
def sort_within(first: IntArray, values: FloatArray) -> None:
    """Sort values in place, each run from one of ``first`` (runs + 1,) to the next (Shell 1959; gaps: Ciura 2001).

    The runs are short and many: that takes an eighth of the time of sorting all values by run and value.
    """
    for run in range(len(first) - 1):
        begin, end = first[run], first[run + 1]
        for gap in (701, 301, 132, 57, 23, 10, 4, 1):
            for place in range(begin + gap, end):
                value, to = values[place], place
                while to >= begin + gap and values[to - gap] > value:
                    values[to] = values[to - gap]
                    to -= gap
                values[to] = value
