"""The fastest rates of a path parameter under velocity and acceleration limits, from rest to rest or in passing.

TOPP-RA (Pham and Pham 2018): with x the square of the parameter's rate and u its acceleration, limits at a grid point
are half-planes in (u, x). Backwards over the grid the largest x is found from which the end can still be reached,
then forwards the largest u that stays below it. Acceleration limits are kept at both ends of each grid interval.
Rest is always possible, so every half-plane holds the origin and the intervals of x begin at 0. Each step is a linear
program of two variables, solved by cutting from above: about a microsecond.
"""

from __future__ import annotations

import numba
import numpy as np

from cellwright.arrays import FloatArray

_STEEP = 1e-12
"""A half-plane whose share of u is less bounds x alone."""
_CUTS = 200
"""Cuts of one program; each lands on the corner of two half-planes, so a handful ends it."""


@numba.njit(cache=True, nogil=True)
def fastest_rates(
    first: FloatArray,
    second: FloatArray,
    grid: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    from_rest: bool = True,
    to_rest: bool = True,
) -> FloatArray:
    """Return the largest rates (grid,) from 0 to 0; not a number where there is no timing.

    An end that is not at rest is passed as fast as the limits allow.

    Args:
        first, second: Derivatives of the path on the grid, (grid, coordinates).
        grid: Rising parameters, (grid,).
        velocity, acceleration: Limits of the coordinates, (coordinates,).
    """
    n, n_coordinates = first.shape
    highest = np.empty(n)
    for i in range(n):
        highest[i] = np.inf
        for j in range(n_coordinates):
            if first[i, j] != 0.0:
                highest[i] = min(highest[i], (velocity[j] / first[i, j]) ** 2)
    if to_rest or not np.isfinite(highest[n - 1]):
        highest[n - 1] = 0.0
    planes = np.empty((4 * n_coordinates + 2, 3))  # a u + b x <= c
    for i in range(n - 2, -1, -1):
        count = _planes_into(first, second, grid, acceleration, highest, i, planes)
        highest[i] = _largest_square(planes, count, highest[i])
    square = np.zeros(n)
    if not from_rest:
        square[0] = highest[0]
    for i in range(n - 1):
        count = _planes_into(first, second, grid, acceleration, highest, i, planes)
        _, most = _bounds_of_change(planes, count, square[i])
        following = square[i] + 2.0 * (grid[i + 1] - grid[i]) * most
        square[i + 1] = min(max(following, 0.0), highest[i + 1])
    return np.sqrt(square)


@numba.njit(cache=True, nogil=True)
def _planes_into(
    first: FloatArray,
    second: FloatArray,
    grid: FloatArray,
    acceleration: FloatArray,
    highest: FloatArray,
    i: int,
    planes: FloatArray,
) -> int:
    """Write the half-planes of the interval behind grid point ``i`` to ``planes`` and return their number."""
    step = 2.0 * (grid[i + 1] - grid[i])
    count = 0
    for j in range(first.shape[1]):
        for sign in (-1.0, 1.0):
            planes[count, 0], planes[count, 1] = sign * first[i, j], sign * second[i, j]
            planes[count, 2] = acceleration[j]
            count += 1
            planes[count, 0] = sign * (first[i + 1, j] + step * second[i + 1, j])
            planes[count, 1], planes[count, 2] = sign * second[i + 1, j], acceleration[j]
            count += 1
    # the square at the next grid point is between 0 and what the end can be reached from
    planes[count, 0], planes[count, 1], planes[count, 2] = step, 1.0, highest[i + 1]
    planes[count + 1, 0], planes[count + 1, 1], planes[count + 1, 2] = -step, -1.0, 0.0
    return count + 2


@numba.njit(cache=True, nogil=True)
def _bounds_of_change(planes: FloatArray, count: int, x: float) -> tuple[int, float]:
    """Return the half-plane that bounds u from above at ``x``, and that bound."""
    row, most = -1, np.inf
    for k in range(count):
        if planes[k, 0] > _STEEP:
            u = (planes[k, 2] - planes[k, 1] * x) / planes[k, 0]
            if u < most:
                row, most = k, u
    return row, most


@numba.njit(cache=True, nogil=True)
def _largest_square(planes: FloatArray, count: int, highest: float) -> float:
    """Return the largest x up to ``highest`` for which some u is within all half-planes."""
    x = highest
    for k in range(count):
        if abs(planes[k, 0]) <= _STEEP and planes[k, 1] > 0.0:
            x = min(x, planes[k, 2] / planes[k, 1])
    if not np.isfinite(x):
        x = 1e18  # nothing moves here; the next half-planes bound it
    for _ in range(_CUTS):
        upper, most = _bounds_of_change(planes, count, x)
        lower, least = -1, -np.inf
        for k in range(count):
            if planes[k, 0] < -_STEEP:
                u = (planes[k, 2] - planes[k, 1] * x) / planes[k, 0]
                if u > least:
                    lower, least = k, u
        if least <= most or upper < 0 or lower < 0:
            return x
        # the two half-planes exclude everything above the corner in which they meet
        slope = planes[lower, 1] / planes[lower, 0] - planes[upper, 1] / planes[upper, 0]
        corner = (planes[lower, 2] / planes[lower, 0] - planes[upper, 2] / planes[upper, 0]) / slope
        if not corner < x:  # rounding: it is there already
            return x
        x = max(corner, 0.0)
    return x
