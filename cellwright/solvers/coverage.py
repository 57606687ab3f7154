"""What a scan covers, and why it misses the rest, judged on points that no planner has seen.

A point counts as measured if the scan has a point within a radius whose surface looks the same way. For the others the
candidates are asked: could an executable one have measured it, and if not, which test stopped the one that came
furthest. Memory stays bounded: points are taken in blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from cellwright.arrays import BoolArray, Float32Array, FloatArray, Int8Array, Int32Array, IntArray
from cellwright.causes import Cause
from cellwright.cell.occlusion import Occluder
from cellwright.cell.scanner import Scanner
from cellwright.solvers.measurability import Measurements, Sweeps, measure_pairs, measured_by_any
from cellwright.threads import slices_of

LARGEST_ANGLE_COSINE = 0.5
"""Surfaces turned less than 60 degrees against each other look the same way: no mix-up of a thin wall's two sides."""
_NEIGHBOURS_AT_ONCE = 1 << 21
_PAIRS_AT_ONCE = 20_000_000


@dataclass(frozen=True, eq=False)
class CandidatePieces:
    """Executable pieces of candidate sweeps and why others have none.

    Attributes:
        sweeps: All candidates, unlimited.
        view: Candidate of each piece, ascending, the best piece of a candidate first, (pieces,).
        start, end: Travel of each piece, (pieces,) in m.
        outcome: 0 if a candidate has a piece, else the `Cause`, (candidates,).
        blocked_by: Body that stopped a candidate, -1 none, (candidates,).
        selected: Whether a candidate's best piece is executed, (candidates,).
        connected: Whether a candidate could be executed in a plan: no attempt to connect it failed, (candidates,).
    """

    sweeps: Sweeps
    view: Int32Array
    start: FloatArray
    end: FloatArray
    outcome: Int8Array
    blocked_by: Int32Array
    selected: BoolArray
    connected: BoolArray

    def as_sweeps(self, rows: IntArray) -> Sweeps:
        """Return pieces, ``rows`` of them, as sweeps of limited travel."""
        view = self.view[rows]
        return Sweeps(self.sweeps.position[view], self.sweeps.rotation[view], self.start[rows], self.end[rows])


@dataclass(frozen=True, eq=False)
class Misses:
    """Why points were not measured.

    Attributes:
        coverable: Whether an executable piece measures the point, connected or not, (points,).
        cause: (points,).
        blocked_by: For collisions the body that stopped the most candidates, -1 none, (points,).
    """

    coverable: BoolArray
    cause: Int8Array
    blocked_by: Int32Array


def match_points(
    points: FloatArray,
    normals: FloatArray,
    scanned: FloatArray,
    scanned_normals: FloatArray,
    uncertainty: Float32Array,
    radius: float,
) -> Float32Array:
    """Return the smallest uncertainty of the scan points that measure each point, NaN where none does, (points,).

    Args:
        points, normals: Points to be measured and their unit normals, (points, 3), m.
        scanned, scanned_normals: The scan and the unit normals of the surface that it hit, (scanned, 3), m.
        uncertainty: Of the scan points, (scanned,) in m.
        radius: Largest distance of a match, m.
    """
    from scipy.spatial import cKDTree

    best = np.full(len(points), np.inf, np.float32)
    if len(scanned) and len(points):
        tree = cKDTree(scanned)
        counts = tree.query_ball_point(points, radius, return_length=True, workers=-1)
        for rows in _blocks(counts):
            found = tree.query_ball_point(points[rows], radius, workers=-1)
            point = np.repeat(np.arange(rows.start, rows.stop), counts[rows])
            match = np.concatenate([np.empty(0, np.int64), *(np.asarray(some, np.int64) for some in found)])
            agrees = np.einsum("ij,ij->i", normals[point], scanned_normals[match]) > LARGEST_ANGLE_COSINE
            np.minimum.at(best, point[agrees], uncertainty[match[agrees]])
    return np.where(np.isinf(best), np.float32(np.nan), best)


def explain_misses(
    scanner: Scanner,
    max_uncertainty: float,
    occluder: Occluder,
    points: FloatArray,
    normals: FloatArray,
    pieces: CandidatePieces,
    *,
    n_threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Misses:
    """Find out why points (points, 3) with unit normals (points, 3) were not measured.

    A point on the best piece of a selected candidate, which is what a plan executes, was not scanned, one on any
    other piece not selected; where only pieces of unconnected candidates measure it, it is not connected. For the rest
    all candidates are asked, whatever their travel: if none measures the point, the cause is the furthest test of the
    sensor model that it reached; else the furthest that one of the measuring candidates came (its outcome, or too short
    if its pieces end before the point).
    """
    cause = np.full(len(points), Cause.NOT_SELECTED, np.int8)
    blocked_by = np.full(len(points), -1, np.int32)
    tell = progress or (lambda share: None)
    ask = partial(measured_by_any, scanner, max_uncertainty, occluder, n_threads=n_threads)
    best = np.unique(pieces.view, return_index=True)[1]
    executed = best[pieces.selected[pieces.view[best]]]
    planned = ask(points, normals, pieces.as_sweeps(executed), progress=lambda share: tell(0.1 * share))
    cause[planned] = Cause.NOT_SCANNED
    others = np.flatnonzero(~planned)
    coverable = planned.copy()
    is_connected = pieces.connected[pieces.view]
    every = pieces.as_sweeps(np.flatnonzero(is_connected))
    coverable[others] = ask(points[others], normals[others], every, progress=lambda share: tell(0.1 + 0.3 * share))
    others = np.flatnonzero(~coverable)
    alone = pieces.as_sweeps(np.flatnonzero(~is_connected))
    coverable[others] = ask(points[others], normals[others], alone, progress=lambda share: tell(0.4 + 0.1 * share))
    cause[others[coverable[others]]] = Cause.NOT_CONNECTED
    rest = np.flatnonzero(~coverable)
    for block in slices_of(len(rest), max(1, _PAIRS_AT_ONCE // max(len(pieces.sweeps), 1))):
        rows = rest[block]

        def within(share: float, block: slice = block) -> None:
            done = block.start + share * (min(block.stop, len(rest)) - block.start)
            tell(0.5 + 0.5 * done / len(rest))

        found = measure_pairs(
            scanner,
            max_uncertainty,
            occluder,
            points[rows],
            normals[rows],
            pieces.sweeps,
            n_threads=n_threads,
            progress=within,
        )
        entry_cause = _entry_causes(found, pieces)
        furthest = found.cause.copy()
        np.maximum.at(furthest, found.point, entry_cause)
        cause[rows], blocked_by[rows] = furthest, _most_blocking(found, pieces, entry_cause, furthest)
    return Misses(coverable, cause, blocked_by)


def _entry_causes(found: Measurements, pieces: CandidatePieces) -> Int8Array:
    """Return what stopped each candidate that measures a point but on none of its pieces, (entries,)."""
    outcome = pieces.outcome[found.sweep]
    # a candidate without a piece and without an outcome was never tried: nothing is known to reach it
    never_tried = np.where(outcome == Cause.NONE, Cause.OUT_OF_REACH, outcome)
    has_piece = np.isin(found.sweep, pieces.view)
    return np.where(has_piece, Cause.TOO_SHORT, never_tried).astype(np.int8)


def _most_blocking(
    found: Measurements, pieces: CandidatePieces, entry_cause: Int8Array, furthest: Int8Array
) -> Int32Array:
    """Return the body that stopped the most candidates of each point whose cause is a collision, else -1."""
    body = pieces.blocked_by[found.sweep]
    counted = (furthest[found.point] == Cause.COLLISION) & (entry_cause == Cause.COLLISION) & (body >= 0)
    n_bodies = int(pieces.blocked_by.max(initial=-1)) + 1
    votes = np.zeros((len(furthest), max(n_bodies, 1)), np.int64)
    np.add.at(votes, (found.point[counted], body[counted]), 1)
    return np.where(votes.any(axis=1), votes.argmax(axis=1), -1).astype(np.int32)


def _blocks(counts: IntArray) -> Iterator[slice]:
    """Cut rows into slices of about `_NEIGHBOURS_AT_ONCE` neighbours."""
    begin = 0
    total = np.cumsum(counts)
    while begin < len(counts):
        before = int(total[begin - 1]) if begin else 0
        end = int(np.searchsorted(total, before + _NEIGHBOURS_AT_ONCE, side="right"))
        end = min(max(end, begin + 1), len(counts))
        yield slice(begin, end)
        begin = end
