"""What sweeps still measure once they are cut to the pieces that the arm can execute."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int8Array, Int32Array, IntArray
from cellwright.causes import Cause

_ON_END = 1e-9
"""Metres by which rounding may put a sample beyond the end of a piece."""


@dataclass(frozen=True, eq=False)
class Trimmed:
    """What is left of the measured entries.

    Attributes:
        kept: Whether an entry is still measured, (entries,).
        start, end: First and last travel at which a sweep measures a sample, (sweeps,) in m; NaN if none.
        cause: Why no sweep measures a sample any more, `Cause`, (samples,); 0 if one does.
    """

    kept: BoolArray
    start: FloatArray
    end: FloatArray
    cause: Int8Array


def trim_entries(
    sweep: Int32Array | IntArray,
    sample: Int32Array | IntArray,
    travel: FloatArray,
    *,
    piece_start: FloatArray,
    piece_end: FloatArray,
    outcome: Int8Array,
    cause: Int8Array,
) -> Trimmed:
    """Keep the entries whose travel lies within their sweep's piece.

    A sample that loses all its sweeps gets the furthest cause among them: the sweep's ``outcome`` if it has no
    piece, `Cause.TOO_SHORT` if its piece ends before the sample.

    Args:
        sweep, sample, travel: The measured entries, (entries,); travel in m.
        piece_start, piece_end: The piece of each sweep in m, (sweeps,); NaN if it has none.
        outcome: `Cause` of each sweep without a piece, (sweeps,).
        cause: `Cause` of each sample before, (samples,).
    """
    # comparisons with NaN are false: no piece, nothing kept
    kept = (travel >= piece_start[sweep] - _ON_END) & (travel <= piece_end[sweep] + _ON_END)
    n_sweeps = len(piece_start)
    start, end = np.full(n_sweeps, np.inf), np.full(n_sweeps, -np.inf)
    np.minimum.at(start, sweep[kept], travel[kept])
    np.maximum.at(end, sweep[kept], travel[kept])
    none = ~np.isfinite(start)
    start[none] = end[none] = np.nan
    lost_to = np.where(np.isfinite(piece_start), np.int8(Cause.TOO_SHORT), outcome).astype(np.int8)
    furthest = np.zeros(len(cause), np.int8)
    np.maximum.at(furthest, sample[~kept], lost_to[sweep[~kept]])
    covered = np.zeros(len(cause), bool)
    covered[sample[kept]] = True
    return Trimmed(kept, start, end, np.where(covered, np.int8(0), np.maximum(cause, furthest)).astype(np.int8))
