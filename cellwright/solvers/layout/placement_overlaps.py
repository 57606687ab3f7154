"""Which bodies that stand certainly overlap when some of them are shifted? A quick filter for thousands of placements.

Two bodies that fill their hulls overlap if these do (`cellwright.cell.convex_gap`). Of others points of either surface
are looked up in the other's distance bounds (`cellwright.cell.distance_field`): a point that is certainly inside is an
overlap. What touches where it stands now is left out: sliding on a table is no overlap. What this overlooks finds
`cellwright.cell.standing_overlaps`, some milliseconds a pair, before a placement is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import Float32Array, FloatArray, IntArray
from cellwright.cell.bodies import WORLD, Body
from cellwright.cell.cell import Cell
from cellwright.cell.convex_gap import convex_gap
from cellwright.cell.distance_field import distance_bounds
from cellwright.cell.sphere_filter import SphereFilter
from cellwright.cell.standing_overlaps import standing_pairs
from cellwright.cell.tessellation import triangles_of
from cellwright.cell.transforms import apply, inverse

MOST_POINTS = 600
"""Points of a surface that are looked up."""
EDGES = 12
"""Surfaces are cut into triangles with edges of at most this part of the body's size."""


@dataclass(frozen=True, eq=False)
class StandingPair:
    """A body that stays and one that shifts.

    Attributes:
        fixed, moved: Their rows in the filter's tables of distances and hulls.
        solid: Whether both fill their hulls.
        fixed_points, moved_points: Points of their surfaces in the robot's base where they stand now, (n, 3) in m.
        names: Both, for people.
    """

    fixed: int
    moved: int
    solid: bool
    fixed_points: FloatArray
    moved_points: FloatArray
    names: str

    def overlaps(self, f: SphereFilter, M: FloatArray) -> bool:
        """Whether they certainly overlap with the moved one shifted by ``M`` (4, 4), as the base sees it."""
        if self.solid:
            start, room = np.array([0.0, 0.0, -1.0, 0.0, 0.0]), np.empty((7, 4))
            hulls = f.hull_points, f.hull_edge, f.hull_real, f.hull_whole
            _, most = convex_gap(*hulls, self.fixed, self.moved, M, 0.0, 0.0, start, room)
            return bool(most <= 0.0)  # hulls without thickness that overlap have 0
        d = f.distance
        table = d.real, d.whole, d.lower, d.upper
        return bool(
            _any_inside(*table, self.fixed, apply(M, self.moved_points))
            or _any_inside(*table, self.moved, apply(inverse(M), self.fixed_points))
        )


def moving_pairs(
    cell: Cell, f: SphereFilter, standing: list[int], is_shifted: Callable[[int], bool]
) -> list[StandingPair]:
    """Return the pairs of standing bodies of which one shifts and that do not certainly overlap now.

    Args:
        cell: The cell.
        f: Its filter.
        standing: Rows of the bodies that stand, in the order of the filter's tables.
        is_shifted: Tells which rows shift.
    """
    place = {row: number for number, row in enumerate(standing)}
    points = {row: _surface_points(cell, cell.bodies[row]) for row in standing}
    found = []
    for a, b in standing_pairs(cell).tolist():
        if is_shifted(a) == is_shifted(b):
            continue
        fixed, moved = (a, b) if is_shifted(b) else (b, a)
        solid = bool(f.hull_whole[place[fixed], 2] and f.hull_whole[place[moved], 2])
        names = f"{cell.bodies[moved].name} and {cell.bodies[fixed].name}"
        pair = StandingPair(place[fixed], place[moved], solid, points[fixed], points[moved], names)
        if not pair.overlaps(f, np.eye(4)):
            found.append(pair)
    return found


def _surface_points(cell: Cell, body: Body) -> FloatArray:
    """Return points of a standing body's surface in the robot's base, (n, 3) in m."""
    import trimesh

    vertices, faces = triangles_of(body.shape)
    longest = max(float(np.linalg.norm(np.ptp(vertices[faces].reshape(-1, 3), axis=0))) / EDGES, 1e-9)
    corners, _ = trimesh.remesh.subdivide_to_size(vertices, faces, longest, max_iter=40)
    corners = np.unique(corners, axis=0)
    T = inverse(cell.T_world_base) @ body.T_parent_body if body.parent == WORLD else body.T_parent_body
    return apply(T, corners[:: max(1, -(-len(corners) // MOST_POINTS))])


@numba.njit(cache=True, nogil=True)
def _any_inside(
    real: FloatArray, whole: IntArray, lower: Float32Array, upper: Float32Array, body: int, points: FloatArray
) -> bool:
    """Tell whether one of the points (n, 3) in the base certainly lies inside a body."""
    for k in range(len(points)):
        _, most = distance_bounds(real, whole, lower, upper, body, points[k, 0], points[k, 1], points[k, 2])
        if most < 0.0:
            return True
    return False
