"""Prove that spheres cover a triangle mesh, to the last point of it, or find where they do not.

A triangle whose three corners lie in one ball lies in it as a whole, for a ball is convex. A triangle that no single
ball holds is cut in two at the middle of its longest edge, and the halves are asked again, down to pieces of size
``leaf``. If every piece lies in some ball, the union of the balls contains the mesh: no samples are involved. The test
errs to one side only: what it cannot prove at that size it reports as uncovered.

Why rounding cannot make a proof wrong: a middle is rounded once, by at most 1 ulp of the coordinates, and at most
`MOST_CUTS` cuts lie behind a piece, so a computed piece lies within 100 ulp of the real one; a computed distance is
right to 8 ulp of distance and coordinates. Together that is below 1e-13 of the mesh's extent. All balls are tested
with radii that are smaller by ``margin``, which is at least 1e-9 of the extent (the fit takes 1e-6): ten thousand
times as much. With the fit's margin a hull stays proven when it is written in single precision.

Cost: 10 to 100 ms for 20 balls; the pieces gather along the circles where balls meet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import FloatArray

MOST_CUTS = 400
"""Pieces waiting at most; two cuts halve a triangle's longest edge at the latest, so some 100 reach any float."""
LEAST_MARGIN = 1e-9
"""Of the mesh's extent: far above rounding."""
_MOST_WITNESSES = 4096


@dataclass(frozen=True, eq=False)
class SurfaceProof:
    """What the test found.

    Attributes:
        covered: Whether every point of every triangle is proven to lie in a ball.
        witnesses: Middles of the pieces that could not be proven, at most 4096, (n, 3) in m.
        gaps: By how much the nearest ball misses the far corner of each of these pieces, (n,) in m.
        n_pieces: Pieces that were looked at.
    """

    covered: bool
    witnesses: FloatArray
    gaps: FloatArray
    n_pieces: int


def prove_surface(
    triangles: FloatArray, centres: FloatArray, radii: FloatArray, *, leaf: float, margin: float
) -> SurfaceProof:
    """Test whether every point of the triangles (n, 3, 3) lies in a ball about ``centres`` (k, 3) with ``radii`` (k,).

    Args:
        triangles: Corners in m.
        centres: Of the balls, in m.
        radii: In m.
        leaf: Longest edge of a piece that is not cut further, m.
        margin: By how much smaller the balls are taken, m; at least 1e-9 of the extent is used.
    """
    corners, centred = _centred(triangles, centres)
    margin = max(margin, LEAST_MARGIN * float(np.abs(corners).max(initial=0.0)))
    found, n_found, n_pieces = _walk(corners, centred, radii.astype(np.float64), leaf, margin, False)
    kept = found[: min(n_found, _MOST_WITNESSES)]
    middle = _middle(triangles)
    return SurfaceProof(n_found == 0, kept[:, :3] + middle, kept[:, 3], n_pieces)


def grow_over_surface(
    triangles: FloatArray, centres: FloatArray, radii: FloatArray, *, leaf: float, margin: float
) -> FloatArray:
    """Return radii (k,) that cover the triangles: each piece that no ball holds grows the ball that gains least volume.

    Arguments as in `prove_surface`, which holds for the result at the same or a smaller ``leaf``.
    """
    corners, centred = _centred(triangles, centres)
    margin = max(margin, LEAST_MARGIN * float(np.abs(corners).max(initial=0.0)))
    grown = radii.astype(np.float64)
    # a little more than is tested for later, so that the same sums rounded elsewhere still hold
    _walk(corners, centred, grown, leaf, margin * (1.0 + 1e-3), True)
    return grown


def _middle(triangles: FloatArray) -> FloatArray:
    points = triangles.reshape(-1, 3)
    return np.asarray(0.5 * (points.min(axis=0) + points.max(axis=0)))


def _centred(triangles: FloatArray, centres: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return corners (n, 9) and centres about the middle of the mesh, so that rounding is that of its size."""
    middle = _middle(triangles)
    corners = np.ascontiguousarray((triangles - middle).reshape(-1, 9), np.float64)
    return corners, np.ascontiguousarray(centres - middle, np.float64)


@numba.njit(cache=True, nogil=True)
def _need(piece, row, centres, ball):  # type: ignore[no-untyped-def]
    """Return the squared radius that a ball needs to hold a piece: the distance of its furthest corner."""
    most = 0.0
    for k in range(3):
        dx = piece[row, 3 * k] - centres[ball, 0]
        dy = piece[row, 3 * k + 1] - centres[ball, 1]
        dz = piece[row, 3 * k + 2] - centres[ball, 2]
        most = max(most, dx * dx + dy * dy + dz * dz)
    return most


@numba.njit(cache=True, nogil=True)
def _longest(piece, row):  # type: ignore[no-untyped-def]
    """Return the squared length of a piece's longest edge and the corner that it begins at."""
    longest, side = -1.0, 0
    for k in range(3):
        a, b = 3 * k, 3 * ((k + 1) % 3)
        dx = piece[row, a] - piece[row, b]
        dy = piece[row, a + 1] - piece[row, b + 1]
        dz = piece[row, a + 2] - piece[row, b + 2]
        length = dx * dx + dy * dy + dz * dz
        if length > longest:
            longest, side = length, k
    return longest, side


@numba.njit(cache=True, nogil=True)
def _walk(triangles, centres, radii, leaf, margin, grow):  # type: ignore[no-untyped-def]
    """Cut and test all triangles; ``radii`` grow in place if asked. Returns unproven pieces, their number, pieces."""
    found = np.empty((_MOST_WITNESSES, 4))
    piece = np.empty((MOST_CUTS, 9))
    n_found, n_pieces, last = 0, 0, 0
    n_balls = len(centres)
    for row in range(len(triangles)):
        piece[0] = triangles[row]
        n = 1
        while n > 0:
            n -= 1
            n_pieces += 1
            held = False
            for turn in range(n_balls):  # the ball that held the last piece first: neighbours share it
                ball = (last + turn) % n_balls
                reach = radii[ball] - margin
                if reach > 0.0 and _need(piece, n, centres, ball) <= reach * reach:
                    held, last = True, ball
                    break
            if held:
                continue
            longest, side = _longest(piece, n)
            if longest > leaf * leaf and n + 2 < MOST_CUTS:
                a, b = 3 * side, 3 * ((side + 1) % 3)
                for k in range(9):
                    piece[n + 1, k] = piece[n, k]
                for k in range(3):
                    middle = 0.5 * (piece[n, a + k] + piece[n, b + k])
                    piece[n, b + k] = middle
                    piece[n + 1, a + k] = middle
                n += 2
                continue
            cheapest, cost, gap = 0, np.inf, np.inf
            for ball in range(n_balls):
                need = math.sqrt(_need(piece, n, centres, ball)) + margin
                price = need**3 - radii[ball] ** 3
                gap = min(gap, need - radii[ball])
                if price < cost:
                    cheapest, cost = ball, price
            if grow:
                need = math.sqrt(_need(piece, n, centres, cheapest)) + margin
                radii[cheapest] = max(radii[cheapest], need * (1.0 + 1e-12))
            elif n_found < _MOST_WITNESSES:
                for k in range(3):
                    found[n_found, k] = (piece[n, k] + piece[n, 3 + k] + piece[n, 6 + k]) / 3.0
                found[n_found, 3] = gap
            n_found += 1
    return found, n_found, n_pieces
