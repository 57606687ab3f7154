"""Collision tests of single states of an arm: kernels of `cellwright.solvers.sweeps.states`.

What the last link carries stands at each pose of a sweep wherever the arm is, so it is tested once a pose. Pairs of
bodies are tested again only when they may have come close since the last test, and the pair and ball that blocked the
last state are tried first.
"""

from __future__ import annotations

import numba
import numpy as np

from cellwright.arrays import AnyArray, Float32Array, FloatArray, Int8Array, Int32Array, IntArray
from cellwright.cell.convex_gap import convex_gap
from cellwright.cell.sphere_filter import (
    BLOCKED,
    BY_HULL,
    BY_NONE,
    FREE,
    OPEN,
    ball_bounds,
    bounding_gap,
    centres_into,
    compare_bodies,
    relative_into,
)

UNREACHED, BEYOND_LIMITS, COLLIDING, UNDECIDED, CLEAR = range(5)
"""States in the order of the tests: no solution, outside the joint limits, blocked, left to the exact engine, free."""

BETWEEN_POSES = 0.6
"""Share of the way between two poses that a point may be away from the nearer one."""

FilterArrays = tuple[AnyArray, ...]
"""`SphereFilter.arrays`. Unpacked once a sweep: taking them from the tuple costs more than a test does."""


@numba.njit(cache=True, nogil=True)
def tool_states(
    f: FilterArrays,
    last: int,
    T_base_last: FloatArray,
    step: float,
    clearance: float,
    status: Int8Array,
    blocker: Int32Array,
) -> None:
    """Test what the last link carries against what stands still, at each pose (n, 4, 4) of the last link."""
    node, child, carrier, real, whole, lower, upper, hull_points, hull_edge, hull_real, hull_whole, pair, _ = f
    n_pairs = len(pair)
    reserve, direction, simplex = np.full(n_pairs, -1.0), np.zeros((n_pairs, 5)), np.empty((7, 4))
    # all bodies are placed as if the last link carried them; only its own are looked at
    links, centres = np.empty((last + 1, 4, 4)), np.empty((len(carrier), 3))
    wanted = max(clearance, BETWEEN_POSES * step)
    for k in range(len(T_base_last)):
        status[k], blocker[k] = CLEAR, -1
        for p in range(n_pairs):
            reserve[p] -= step
        links[:] = T_base_last[k]
        centres_into(node, carrier, links, centres)
        for p in range(n_pairs):
            if carrier[pair[p, 0]] != last or pair[p, 2] != 0 or reserve[p] >= wanted:
                continue
            reserve[p] = bounding_gap(node, real, whole, pair, p, centres)
            if reserve[p] >= wanted:
                continue
            found, reserve[p], _ = compare_bodies(
                node,
                child,
                real,
                whole,
                lower,
                upper,
                hull_points,
                hull_edge,
                hull_real,
                hull_whole,
                pair,
                p,
                T_base_last[k],
                wanted,
                clearance,
                direction,
                simplex,
            )
            if found != FREE:
                status[k], blocker[k] = COLLIDING if found == BLOCKED else UNDECIDED, pair[p, 4]
            if found == BLOCKED:
                break


@numba.njit(cache=True, nogil=True, _nrt=False)
def witnessed(
    node: FloatArray,
    carrier: IntArray,
    real: FloatArray,
    whole: IntArray,
    lower: Float32Array,
    upper: Float32Array,
    hull_points: FloatArray,
    hull_edge: IntArray,
    hull_real: FloatArray,
    hull_whole: IntArray,
    pair: IntArray,
    links: FloatArray,
    clearance: float,
    witness: IntArray,
    relative: FloatArray,
    direction: FloatArray,
    simplex: FloatArray,
) -> bool:
    """Tell whether the pair and ball (2,) that blocked a state before block this one too."""
    p, ball = witness[0], witness[1]
    if ball == BY_NONE:
        return False
    relative_into(links, pair[p, 2], carrier[pair[p, 0]], relative)
    if ball == BY_HULL:
        _, most = convex_gap(
            hull_points,
            hull_edge,
            hull_real,
            hull_whole,
            pair[p, 1],
            pair[p, 5],
            relative,
            clearance,
            clearance,
            direction[p],
            simplex,
        )
        return bool(most < clearance)
    _, high = ball_bounds(node, real, whole, lower, upper, ball, pair[p, 1], relative)
    return bool(high - node[ball, 4] < clearance)


@numba.njit(cache=True, nogil=True, _nrt=False)
def arm_state(
    node: FloatArray,
    child: IntArray,
    carrier: IntArray,
    real: FloatArray,
    whole: IntArray,
    lower: Float32Array,
    upper: Float32Array,
    hull_points: FloatArray,
    hull_edge: IntArray,
    hull_real: FloatArray,
    hull_whole: IntArray,
    pair: IntArray,
    last: int,
    links: FloatArray,
    shift: FloatArray,
    clearance: float,
    reserve: FloatArray,
    witness: IntArray,
    relative: FloatArray,
    centres: FloatArray,
    direction: FloatArray,
    simplex: FloatArray,
) -> tuple[int, int]:
    """Test one state, but for what the last link carries against what stands still.

    Returns the state and the row of the body in the way: the standing one, or that on the earlier link. The pair
    that blocked last is tried first; ``witness`` (2,) receives the pair and the ball that block.
    """
    n_pairs = len(pair)
    status, blocker = CLEAR, -1
    centres_into(node, carrier, links, centres)
    for turn in range(n_pairs):
        p = witness[0] + turn
        if p >= n_pairs:
            p -= n_pairs
        wanted = max(clearance, BETWEEN_POSES * shift[p])
        link, carried = pair[p, 2], carrier[pair[p, 0]]
        if reserve[p] >= wanted or (link == 0 and carried == last):
            continue
        reserve[p] = bounding_gap(node, real, whole, pair, p, centres)
        if reserve[p] >= wanted:
            continue
        relative_into(links, link, carried, relative)
        found, reserve[p], ball = compare_bodies(
            node,
            child,
            real,
            whole,
            lower,
            upper,
            hull_points,
            hull_edge,
            hull_real,
            hull_whole,
            pair,
            p,
            relative,
            wanted,
            clearance,
            direction,
            simplex,
        )
        if found == BLOCKED:
            witness[0], witness[1] = p, ball
            return COLLIDING, pair[p, 4]
        if found == OPEN:
            status, blocker = UNDECIDED, pair[p, 4]
    return status, blocker
