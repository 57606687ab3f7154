"""Cover a solid body with few balls that provably contain it and hardly stick out of it.

The space about the body is cut into cubes. A ball about a point at depth ``d`` inside the body has the radius
``d + overshoot``: it cannot stick out further than ``overshoot``. Balls are picked greedily, each time the one that
covers most cubes that touch the body and are not covered yet (Chvatal 1979), until all are. A cube counts as covered
only if it lies in a single ball as a whole, so the union contains the body and not merely sampled points of it.

Each ball also knows its core: the ball about the same centre that lies within the body. If the core touches something
the body certainly does; if the whole ball keeps clear the body certainly does too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.cell.bodies import Capsule, Mesh, Shape, Sphere
from cellwright.cell.distance_field import grid_nodes, mesh_field, primitive_code, primitive_distances

_CUBES_PER_OVERSHOOT = 3.0
"""Edge of a cube: the overshoot over this. Half its diagonal is lost in covering, so finer cubes need fewer balls."""
_MOST_CUBES = 250_000
_MOST_CENTRES = 600
"""Candidate centres; more make the cover hardly smaller."""
_BLOCK = 4
"""Deep inside, blocks of so many cubes along an edge are covered as one."""

_CAPSULE_OVERSHOOT = 0.003
"""Metres that are enough for a capsule, whose cover costs few balls however tight."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Balls whose union contains a body.

    Attributes:
        centres: (balls, 3) in m in the body's frame.
        radii: (balls,) in m.
        cores: Radius of the concentric ball inside the body in m, (balls,); negative: the centre lies outside the
            body, at most so far from it.
    """

    centres: FloatArray
    radii: FloatArray
    cores: FloatArray


@dataclass(frozen=True, eq=False)
class _Cubes:
    """A grid of cubes about a body: their edge and centres, bounds of the signed distance at the centres."""

    edge: float
    origin: FloatArray
    lower: FloatArray  # (nx, ny, nz)
    upper: FloatArray


def cover_shape(shape: Shape, overshoot: float) -> Cover:
    """Cover one shape with balls that stick out of it by at most ``overshoot`` m, or two cubes where that is more.

    Bodies too large for cubes of that size get larger cubes and a larger overshoot.
    """
    if isinstance(shape, Sphere):
        return Cover(np.zeros((1, 3)), np.array([shape.radius]), np.array([shape.radius]))
    if isinstance(shape, Capsule):
        return _capsule_cover(shape, min(overshoot, _CAPSULE_OVERSHOOT))
    cubes = _cubes(shape, overshoot / _CUBES_PER_OVERSHOOT)
    overshoot = max(overshoot, cubes.edge * _CUBES_PER_OVERSHOOT)
    points, slack, point_core = _to_cover(cubes)
    # near the surface the sign at a centre is not known, there the depth counts as none
    lower, upper = cubes.lower.ravel(), cubes.upper.ravel()
    depth = np.where(lower < -0.5 * cubes.edge, -lower, np.maximum(-upper, 0.0))
    centres = grid_nodes(cubes.origin, cubes.edge, cubes.lower.shape)
    chosen = _candidates(centres, depth, cubes.edge)
    chosen = chosen[_greedy_cover(points, slack, centres[chosen], depth[chosen] + overshoot)]
    # what no candidate reaches is covered by balls about the cubes themselves
    left = np.flatnonzero(~_covered(points, slack, centres[chosen], depth[chosen] + overshoot))
    own_radii = np.maximum(slack, overshoot)
    left = left[_greedy_cover(points[left], slack[left], points[left], own_radii[left])]
    return Cover(
        np.concatenate([centres[chosen], points[left]]),
        np.concatenate([depth[chosen] + overshoot, own_radii[left]]),
        np.concatenate([-upper[chosen], point_core[left]]),
    )


def _capsule_cover(capsule: Capsule, overshoot: float) -> Cover:
    """Cover a capsule by balls along its axis, as close as the overshoot asks for."""
    gap = 2.0 * math.sqrt(overshoot * (2.0 * capsule.radius + overshoot))
    n_balls = math.ceil(capsule.length / gap) + 1
    centres = np.zeros((n_balls, 3))
    centres[:, 2] = np.linspace(-0.5, 0.5, n_balls) * capsule.length
    return Cover(centres, np.full(n_balls, capsule.radius + overshoot), np.full(n_balls, capsule.radius))


def _cubes(shape: Shape, edge: float) -> _Cubes:
    if isinstance(shape, Mesh):
        field = mesh_field(shape, spacing=edge, padding=edge, most_nodes=_MOST_CUBES)
        return _Cubes(field.spacing, field.origin, np.asarray(field.lower, float), np.asarray(field.upper, float))
    kind, size = primitive_code(shape)
    half = {"Box": size, "Cylinder": (size[0], size[0], size[1])}
    extent = 2.0 * (np.array(half[type(shape).__name__]) + edge)
    edge = max(edge, float((extent.prod() / _MOST_CUBES) ** (1.0 / 3.0)))
    counts = tuple(int(n) for n in np.ceil(extent / edge).astype(int) + 1)
    origin = -0.5 * edge * (np.array(counts) - 1)
    exact = primitive_distances(kind, np.array(size), grid_nodes(origin, edge, counts)).reshape(counts)
    return _Cubes(edge, origin, exact, exact)


def _to_cover(cubes: _Cubes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres (n, 3) of what is to be covered, its half diagonals (n,), and least depths at the centres.

    These are the cubes that touch the body; deep inside, where nothing is gained by fine cubes, whole blocks.
    """
    half_diagonal = 0.5 * math.sqrt(3.0) * cubes.edge
    padded = [(0, -n % _BLOCK) for n in cubes.lower.shape]
    lower = np.pad(cubes.lower, padded, constant_values=np.inf)
    upper = np.pad(cubes.upper, padded, constant_values=np.inf)
    n_blocks = [n // _BLOCK for n in lower.shape]
    blocked = lower.reshape(n_blocks[0], _BLOCK, n_blocks[1], _BLOCK, n_blocks[2], _BLOCK)
    deep = blocked.max(axis=(1, 3, 5)) < -2.0 * _BLOCK * half_diagonal
    in_deep = np.repeat(np.repeat(np.repeat(deep, _BLOCK, 0), _BLOCK, 1), _BLOCK, 2)
    fine = (lower <= half_diagonal) & ~in_deep
    points = grid_nodes(cubes.origin, cubes.edge, lower.shape)[fine.ravel()]
    block_origin = cubes.origin + 0.5 * (_BLOCK - 1) * cubes.edge
    block_points = grid_nodes(block_origin, _BLOCK * cubes.edge, deep.shape)[deep.ravel()]
    least = upper.reshape(blocked.shape).max(axis=(1, 3, 5))[deep] + _BLOCK * half_diagonal
    slack = np.full(len(points) + len(block_points), half_diagonal)
    slack[len(points) :] *= _BLOCK
    return np.concatenate([points, block_points]), slack, np.concatenate([-upper[fine], -least])


def _candidates(nodes: FloatArray, depth: FloatArray, edge: float) -> IntArray:
    """Return rows of nodes that serve as centres: the deepest of each block of cubes."""
    inside = np.flatnonzero(depth > 0.0)
    if not len(inside):
        return inside
    share = 1.0
    while True:
        block = np.floor((nodes[inside] - nodes[0]) / (share * edge) + 1e-6).astype(np.int64)
        code = (block[:, 0] * (block[:, 1].max() + 1) + block[:, 1]) * (block[:, 2].max() + 1) + block[:, 2]
        # one row a block: the deepest, ties to the lower row
        order = np.lexsort((inside, -depth[inside], code))
        first = np.ones(len(order), bool)
        first[1:] = np.diff(code[order]) != 0
        if first.sum() <= _MOST_CENTRES:
            return np.asarray(np.sort(inside[order[first]]))
        share *= max(1.15, (first.sum() / _MOST_CENTRES) ** (1.0 / 3.0))


@numba.njit(cache=True, nogil=True)
def _covers(points: FloatArray, slack: FloatArray, row: int, centre: FloatArray, radius: float) -> bool:
    dx, dy, dz = points[row, 0] - centre[0], points[row, 1] - centre[1], points[row, 2] - centre[2]
    reach = radius - slack[row]
    return bool(reach >= 0.0 and dx * dx + dy * dy + dz * dz <= reach * reach)


@numba.njit(cache=True, nogil=True)
def _covered(points: FloatArray, slack: FloatArray, centres: FloatArray, radii: FloatArray) -> BoolArray:
    covered = np.zeros(len(points), np.bool_)
    for ball in range(len(centres)):
        for row in range(len(points)):
            if not covered[row] and _covers(points, slack, row, centres[ball], radii[ball]):
                covered[row] = True
    return covered


@numba.njit(cache=True, nogil=True)
def _greedy_cover(points: FloatArray, slack: FloatArray, centres: FloatArray, radii: FloatArray) -> IntArray:
    """Return the picked balls in order; lazy greedy: a ball's gain only falls, so old gains are upper bounds."""
    n_balls, n_left = len(centres), len(points)
    left = np.arange(n_left)
    gain = np.full(n_balls, n_left + 1)
    picked = np.empty(n_balls, np.int64)
    n_picked = 0
    while n_left > 0:
        best, best_gain = -1, 0
        while True:
            ball = int(np.argmax(gain))
            if gain[ball] == 0 or ball == best:
                break
            count = 0
            for k in range(n_left):
                if _covers(points, slack, left[k], centres[ball], radii[ball]):
                    count += 1
            gain[ball] = count
            if count > best_gain or (count == best_gain and ball < best):
                best, best_gain = ball, count
        if best < 0:
            break
        picked[n_picked] = best
        n_picked += 1
        gain[best] = 0
        kept = 0
        for k in range(n_left):
            if not _covers(points, slack, left[k], centres[best], radii[best]):
                left[kept] = left[k]
                kept += 1
        n_left = kept
    return picked[:n_picked]
