"""Which points each sweep measures: field of view, incidence, uncertainty and both lines of sight.

A sweep keeps its orientation and moves along its x axis, so it lights a point at exactly one travel: where the point
lies in the plane of the fan. There the sensor model of Kaiser 2021, section 3.2, decides: the point lies in the fan
between the working distances, emitter and detector see its front within the permitted incidence, the predicted
uncertainty is permitted, and no face stands between the point and emitter or detector.

All tests run fused for each pair, cheapest first, so that only pairs that pass cost a ray. Results do not depend on
the number of threads. Cost: about 15 ns a pair and 0.2 us a ray on one core.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numba
import numpy as np

from cellwright.arrays import BoolArray, Float32Array, FloatArray, Int8Array, Int32Array
from cellwright.causes import Cause
from cellwright.cell.bounding_volumes import MISS
from cellwright.cell.occlusion import Occluder, trace_segments
from cellwright.cell.scanner import Scanner
from cellwright.threads import map_slices

LENGTH_SLACK = 1e-9
"""Standoffs at the very limits of the working range stay inside despite rounding, m."""
RATIO_SLACK = 1e-9
"""The same for cosines and, relative, for uncertainties."""
_PAIRS_AT_ONCE = 1 << 17

_INCIDENCE = np.int8(Cause.INCIDENCE)
_UNCERTAINTY = np.int8(Cause.UNCERTAINTY)
_EMITTER_OCCLUDED = np.int8(Cause.EMITTER_OCCLUDED)
_DETECTOR_OCCLUDED = np.int8(Cause.DETECTOR_OCCLUDED)


@dataclass(frozen=True, eq=False)
class Sweeps:
    """Sweeps as kernels take them.

    Attributes:
        position: Origin of the laser-emitter frame at travel 0, (sweeps, 3) in m.
        rotation: Axes of the laser-emitter frame as columns, (sweeps, 3, 3).
        start, end: Travel between which the sweep runs, (sweeps,) in m; infinite if it is not trimmed.
    """

    position: FloatArray
    rotation: FloatArray
    start: FloatArray
    end: FloatArray

    @classmethod
    def untrimmed(cls, position: FloatArray, rotation: FloatArray) -> Sweeps:
        """Make sweeps of unlimited travel."""
        return cls(position, rotation, np.full(len(position), -np.inf), np.full(len(position), np.inf))

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, eq=False)
class Measurements:
    """The pairs of sweep and point that measure, by sweep, then by point.

    Attributes:
        sweep, point: Rows, (entries,).
        uncertainty: Predicted measurement uncertainty, (entries,) in m.
        travel: Travel at which the sweep measures the point, (entries,) in m.
        cause: For each point 0 if some sweep measures it, else the furthest test that it reached, (points,).
    """

    sweep: Int32Array
    point: Int32Array
    uncertainty: Float32Array
    travel: FloatArray
    cause: Int8Array

    def travel_range(self, n_sweeps: int) -> tuple[FloatArray, FloatArray]:
        """Return the first and last travel at which each sweep measures a point, NaN if it measures none."""
        first, last = np.full(n_sweeps, np.inf), np.full(n_sweeps, -np.inf)
        np.minimum.at(first, self.sweep, self.travel)
        np.maximum.at(last, self.sweep, self.travel)
        none = first > last
        return np.where(none, np.nan, first), np.where(none, np.nan, last)


def measure_pairs(
    scanner: Scanner,
    max_uncertainty: float,
    occluder: Occluder,
    points: FloatArray,
    normals: FloatArray,
    sweeps: Sweeps,
    *,
    n_threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Measurements:
    """Measure every point by every sweep.

    Args:
        scanner: The sensor model.
        max_uncertainty: Largest permitted uncertainty, m.
        occluder: What can stand in the way, in the frame of the points.
        points: (points, 3) in m.
        normals: Outward unit normals, (points, 3).
        sweeps: The sweeps; a point outside a sweep's travel counts as outside its field of view.
        n_threads: Threads; ``None`` takes the cores that the process may use.
        progress: Called with the share done.
    """
    n_points, n_sweeps = len(points), len(sweeps)
    # own copies: numba would compile the kernel again for read-only arrays
    points, normals = np.array(points, float, order="C"), np.array(normals, float, order="C")
    position, rotation = np.array(sweeps.position, float, order="C"), np.array(sweeps.rotation, float, order="C")
    sweeps = Sweeps(position, rotation, np.array(sweeps.start, float), np.array(sweeps.end, float))
    work = partial(_measure_slice, sensor_limits(scanner, max_uncertainty), occluder, points, normals, sweeps)
    size = max(1, _PAIRS_AT_ONCE // max(n_points, 1))
    cause = np.full(n_points, Cause.FIELD_OF_VIEW, np.int8)
    measured = np.zeros(n_points, bool)
    parts: list[Measurements] = []
    done = 0
    for part in map_slices(work, n_sweeps, size, n_threads=n_threads):
        np.maximum(cause, part.cause, out=cause)
        measured[part.point] = True
        parts.append(part)
        done = min(done + size, n_sweeps)
        if progress is not None:
            progress(done / n_sweeps)
    cause[measured] = Cause.NONE
    return Measurements(
        sweep=np.concatenate([np.empty(0, np.int32), *(part.sweep for part in parts)]),
        point=np.concatenate([np.empty(0, np.int32), *(part.point for part in parts)]),
        uncertainty=np.concatenate([np.empty(0, np.float32), *(part.uncertainty for part in parts)]),
        travel=np.concatenate([np.empty(0), *(part.travel for part in parts)]),
        cause=cause,
    )


def measured_by_any(
    scanner: Scanner,
    max_uncertainty: float,
    occluder: Occluder,
    points: FloatArray,
    normals: FloatArray,
    sweeps: Sweeps,
    *,
    n_threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> BoolArray:
    """Tell for each point whether some sweep measures it, (points,); points drop out as soon as one does."""
    measured = np.zeros(len(points), bool)
    open_rows = np.arange(len(points))
    begin, size = 0, 64
    while begin < len(sweeps) and len(open_rows):
        rows = slice(begin, min(begin + size, len(sweeps)))
        some = Sweeps(sweeps.position[rows], sweeps.rotation[rows], sweeps.start[rows], sweeps.end[rows])
        found = measure_pairs(
            scanner, max_uncertainty, occluder, points[open_rows], normals[open_rows], some, n_threads=n_threads
        )
        measured[open_rows[found.cause == Cause.NONE]] = True
        open_rows = open_rows[found.cause != Cause.NONE]
        begin, size = rows.stop, 2 * size
        if progress is not None:
            progress(begin / len(sweeps))
    return measured


def sensor_limits(scanner: Scanner, max_uncertainty: float) -> tuple[float, ...]:
    """Return the sensor model as kernels take it, slack included: see their first lines."""
    return (
        scanner.min_standoff - LENGTH_SLACK,
        scanner.max_standoff + LENGTH_SLACK,
        math.tan(scanner.aperture / 2),
        math.cos(scanner.max_incidence) - RATIO_SLACK,
        scanner.uncertainty_constant,
        scanner.uncertainty_quadratic,
        max_uncertainty * (1 + RATIO_SLACK),
        scanner.emitter_detector_distance,
    )


def _measure_slice(
    limits: tuple[float, ...],
    occluder: Occluder,
    points: FloatArray,
    normals: FloatArray,
    sweeps: Sweeps,
    rows: slice,
) -> Measurements:
    n_pairs = (rows.stop - rows.start) * len(points)
    sweep, point = np.empty(n_pairs, np.int32), np.empty(n_pairs, np.int32)
    uncertainty, travel = np.empty(n_pairs, np.float32), np.empty(n_pairs)
    cause = np.zeros(len(points), np.int8)
    n = _measure_kernel(
        limits,
        occluder.tree,
        occluder.contact,
        points,
        normals,
        sweeps.position,
        sweeps.rotation,
        sweeps.start,
        sweeps.end,
        rows.start,
        rows.stop,
        sweep,
        point,
        uncertainty,
        travel,
        cause,
    )
    return Measurements(sweep[:n].copy(), point[:n].copy(), uncertainty[:n].copy(), travel[:n].copy(), cause)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _measure_kernel(  # type: ignore[no-untyped-def]
    limits,
    tree,
    contact,
    points,
    normals,
    position,
    rotation,
    first_travel,
    last_travel,
    begin,
    end,
    out_sweep,
    out_point,
    out_uncertainty,
    out_travel,
    cause,
):
    """Measure all points by the sweeps ``begin`` to ``end``; returns how many entries were written."""
    z_min, z_max, tan_half, cos_min, constant, quadratic, u_max, baseline = limits
    n_points = len(points)
    inside, pair = np.empty(n_points, np.int64), np.empty((n_points, 2))  # travel, uncertainty
    starts, along = np.empty((n_points, 3)), np.empty((n_points, 3))
    near, far, hit = np.empty(n_points), np.empty(n_points), np.empty(n_points, np.int32)
    n = 0
    for v in range(begin, end):
        ox, oy, oz = position[v, 0], position[v, 1], position[v, 2]
        xx, xy, xz = rotation[v, 0, 0], rotation[v, 1, 0], rotation[v, 2, 0]
        yx, yy, yz = rotation[v, 0, 1], rotation[v, 1, 1], rotation[v, 2, 1]
        zx, zy, zz = rotation[v, 0, 2], rotation[v, 1, 2], rotation[v, 2, 2]
        first, last = first_travel[v], last_travel[v]
        n_inside = 0
        for p in range(n_points):  # without branches: most points fall outside, in no order
            dx, dy, dz = points[p, 0] - ox, points[p, 1] - oy, points[p, 2] - oz
            z = dx * zx + dy * zy + dz * zz
            y = dx * yx + dy * yy + dz * yz
            s = dx * xx + dy * xy + dz * xz
            inside[n_inside] = p
            n_inside += (
                (z >= z_min) & (z <= z_max) & (abs(y) <= z * tan_half + LENGTH_SLACK) & (s >= first) & (s <= last)
            )
        n_rays = 0
        for p in inside[:n_inside]:
            dx, dy, dz = points[p, 0] - ox, points[p, 1] - oy, points[p, 2] - oz
            z = dx * zx + dy * zy + dz * zz
            y = dx * yx + dy * yy + dz * yz
            nx, ny, nz = normals[p, 0], normals[p, 1], normals[p, 2]
            # minus the components of both rays along the normal
            facing = -(y * (nx * yx + ny * yy + nz * yz) + z * (nx * zx + ny * zy + nz * zz))
            facing_detector = facing - baseline * (nx * xx + ny * xy + nz * xz)
            squared = y * y + z * z
            cos_emitter = facing / math.sqrt(squared)
            if not (cos_emitter >= cos_min and facing_detector >= cos_min * math.sqrt(squared + baseline * baseline)):
                cause[p] = max(cause[p], _INCIDENCE)
                continue
            uncertainty = (constant + quadratic * z * z) / cos_emitter
            if uncertainty > u_max:
                cause[p] = max(cause[p], _UNCERTAINTY)
                continue
            inside[n_rays] = p
            pair[n_rays] = (dx * xx + dy * xy + dz * xz, uncertainty)
            starts[n_rays] = points[p]
            along[n_rays] = (-y * yx - z * zx, -y * yy - z * zy, -y * yz - z * zz)
            n_rays += 1
        trace_segments(tree, contact, n_rays, starts, along, near, far, hit)
        n_lit = 0
        for i in range(n_rays):
            if hit[i] != MISS:
                cause[inside[i]] = max(cause[inside[i]], _EMITTER_OCCLUDED)
                continue
            inside[n_lit], pair[n_lit], starts[n_lit] = inside[i], pair[i], starts[i]
            along[n_lit] = (along[i, 0] - baseline * xx, along[i, 1] - baseline * xy, along[i, 2] - baseline * xz)
            n_lit += 1
        trace_segments(tree, contact, n_lit, starts, along, near, far, hit)
        for i in range(n_lit):
            if hit[i] != MISS:
                cause[inside[i]] = max(cause[inside[i]], _DETECTOR_OCCLUDED)
                continue
            out_sweep[n], out_point[n], out_travel[n], out_uncertainty[n] = v, inside[i], pair[i, 0], pair[i, 1]
            n += 1
    return n
