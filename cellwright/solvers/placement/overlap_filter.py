"""Which bodies that stand certainly overlap when some of them are shifted? A quick filter for thousands of placements.

Two bodies that fill their hulls stand deeper in one another than rest does if one meets the other shrunk by that
(`cellwright.cell.convex_gap`). Of others points of either surface are looked up in the other's distance bounds
(`cellwright.cell.distance_field`): a point that certainly lies that deep is an overlap. Left out is what overlaps where
it stands now, and what may. What this overlooks finds `cellwright.cell.standing_overlaps`, some milliseconds a pair,
before a placement is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

from cellwright.arrays import Float32Array, FloatArray, IntArray
from cellwright.cell.bodies import WORLD, Body
from cellwright.cell.cell import Cell
from cellwright.cell.convex_gap import Hull, convex_gap, hull_of, hull_table
from cellwright.cell.distance_field import distance_bounds
from cellwright.cell.sphere_filter import SphereFilter
from cellwright.cell.standing_overlaps import standing_pairs
from cellwright.cell.tessellation import triangles_of
from cellwright.cell.transforms import apply, inverse
from cellwright.solvers.placement.problem import PlacementProblem

MOST_POINTS = 600
"""Points of a surface that are looked up."""
EDGES = 12
"""Surfaces are cut into triangles with edges of at most this part of the body's size."""


@dataclass(frozen=True, eq=False)
class StandingPair:
    """A body that stays and one that shifts.

    Attributes:
        fixed, moved: Their rows in the filter's tables of distances.
        resting: Depth in m at which they still only rest on each other.
        hulls: Table of the hulls of both, the fixed one first, one of them shrunk by ``resting``; ``None`` unless both
            fill their hulls and one is thicker than that.
        fixed_points, moved_points: Points of their surfaces in the robot's base where they stand now, (n, 3) in m.
        names: Both, for people.
    """

    fixed: int
    moved: int
    resting: float
    hulls: tuple[FloatArray, IntArray, FloatArray, IntArray] | None
    fixed_points: FloatArray
    moved_points: FloatArray
    names: str

    def overlaps(self, f: SphereFilter, M: FloatArray) -> bool:
        """Whether they certainly stand deeper than resting in one another, the moved one shifted by ``M`` (4, 4)."""
        if self.hulls is not None:
            start, room = np.array([0.0, 0.0, -1.0, 0.0, 0.0]), np.empty((7, 4))
            _, most = convex_gap(*self.hulls, 0, 1, M, 0.0, 0.0, start, room)
            return bool(most <= 0.0)  # hulls without thickness that overlap have 0
        d = f.distance
        table = d.real, d.whole, d.lower, d.upper
        return bool(
            _any_inside(*table, self.fixed, apply(M, self.moved_points), self.resting)
            or _any_inside(*table, self.moved, apply(inverse(M), self.fixed_points), self.resting)
        )


def moving_pairs(problem: PlacementProblem, f: SphereFilter, standing: list[int]) -> list[StandingPair]:
    """Return the pairs of standing bodies of which one shifts and that do not certainly overlap now.

    Pairs that may stand in one another are left out.

    Args:
        problem: What may move.
        f: Filter of its cell.
        standing: Rows of the bodies that stand, in the order of the filter's tables.
    """
    cell, resting = problem.cell, problem.resting
    place = {row: number for number, row in enumerate(standing)}
    points = {row: _surface_points(cell, cell.bodies[row]) for row in standing}
    hulls = {row: hull_of(cell.bodies[row].shape, _pose_in_base(cell, cell.bodies[row])) for row in standing}
    found = []
    for a, b in standing_pairs(cell, problem.permitted).tolist():
        if problem.is_shifted(a) == problem.is_shifted(b):
            continue
        fixed, moved = (a, b) if problem.is_shifted(b) else (b, a)
        names = f"{cell.bodies[moved].name} and {cell.bodies[fixed].name}"
        table = _shrunk_table(hulls[fixed], hulls[moved], resting)
        pair = StandingPair(place[fixed], place[moved], resting, table, points[fixed], points[moved], names)
        if not pair.overlaps(f, np.eye(4)):
            found.append(pair)
    return found


def _shrunk_table(fixed: Hull, moved: Hull, resting: float) -> tuple[FloatArray, IntArray, FloatArray, IntArray] | None:
    """Return the table of two hulls, the thicker one shrunk so that it lies ``resting`` m under its own surface.

    Shrunk about the middle of a ball of radius r within it by the share s = resting / r, each of its points is the
    middle of a ball of radius s r within the body, as bodies that fill their hulls are convex. So what meets the shrunk
    one stands at least ``resting`` deep in the whole one.
    """
    if not (fixed.solid and moved.solid):
        return None
    (c_fixed, r_fixed), (c_moved, r_moved) = _inner_ball(fixed), _inner_ball(moved)
    if max(r_fixed, r_moved) <= resting:
        return None
    if r_fixed >= r_moved:
        fixed = _shrunk(fixed, c_fixed, resting / r_fixed)
    else:
        moved = _shrunk(moved, c_moved, resting / r_moved)
    return hull_table([fixed, moved])


def _shrunk(hull: Hull, centre: FloatArray, share: float) -> Hull:
    keep = 1.0 - share
    points = centre + keep * (hull.points - centre)
    return replace(hull, points=points, radius=keep * hull.radius, disc=keep * hull.disc)


def _inner_ball(hull: Hull) -> tuple[FloatArray, float]:
    """Return middle and radius in m of a ball within a hull, not the largest one of a mesh."""
    from scipy.spatial import ConvexHull

    centre = hull.points.mean(axis=0)
    if hull.radius > 0.0:
        return centre, hull.radius
    if hull.disc > 0.0:
        return centre, min(hull.disc, 0.5 * float(np.ptp(hull.points @ hull.axis)))
    sides = ConvexHull(hull.points).equations
    return centre, max(0.0, float(-(sides[:, :3] @ centre + sides[:, 3]).max()))


def _pose_in_base(cell: Cell, body: Body) -> FloatArray:
    """Return the pose of a standing body in the robot's base, (4, 4)."""
    return inverse(cell.T_world_base) @ body.T_parent_body if body.parent == WORLD else body.T_parent_body


def _surface_points(cell: Cell, body: Body) -> FloatArray:
    """Return points of a standing body's surface in the robot's base, (n, 3) in m."""
    import trimesh

    vertices, faces = triangles_of(body.shape)
    longest = max(float(np.linalg.norm(np.ptp(vertices[faces].reshape(-1, 3), axis=0))) / EDGES, 1e-9)
    corners, _ = trimesh.remesh.subdivide_to_size(vertices, faces, longest, max_iter=40)
    corners = np.unique(corners, axis=0)
    return apply(_pose_in_base(cell, body), corners[:: max(1, -(-len(corners) // MOST_POINTS))])


@numba.njit(cache=True, nogil=True)
def _any_inside(
    real: FloatArray,
    whole: IntArray,
    lower: Float32Array,
    upper: Float32Array,
    body: int,
    points: FloatArray,
    depth: float,
) -> bool:
    """Tell whether one of the points (n, 3) in the base certainly lies more than ``depth`` m under a body's surface."""
    for k in range(len(points)):
        _, most = distance_bounds(real, whole, lower, upper, body, points[k, 0], points[k, 1], points[k, 2])
        if most < -depth:
            return True
    return False
