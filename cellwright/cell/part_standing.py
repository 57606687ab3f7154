"""What the part stands on, and whether it would tip: its centre of mass against the hull of where it is supported.

A part stands where triangles of it and of a body below cover each other, seen from above, at the same height. The
corners of these regions are exact: corners of either triangle over the other one, and crossings of their edges. A rigid
part under gravity alone stays as it is if its centre of mass lies over their convex hull; friction and clamps are not
in it. Heights count as equal within ``resting``, so a region that ends because surfaces curve away from each other is
cut at the triangles' corners. Cost: one comparison of boxes a pair of triangles near each other, milliseconds for a
table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.bodies import BASE, WORLD, Body, Mesh
from cellwright.cell.cell import Cell
from cellwright.cell.standing_overlaps import RESTING
from cellwright.cell.tessellation import triangles_of
from cellwright.cell.transforms import apply
from cellwright.cell.verification_scene import VerificationScene

_BLOCK = 1 << 20
"""Pairs of triangles that are looked at together."""
_SECTIONS = 96
"""Sides of round bodies, which takes at most 0.6 thousandths of their radius from them."""
_FLAT = 1e-6
"""A triangle whose normal rises by less than this is upright: nothing stands on it."""


@dataclass(frozen=True)
class PartStanding:
    """How the part, the last body of a cell, stands.

    Attributes:
        supports: Bodies that carry it from below.
        others: Bodies that touch it in another way, as a clamp does.
        margin: How far its centre of mass lies inside of the hull of its supports, m; negative outside, NaN without.
        overhang: How far its foot reaches beyond that hull, m; 0 without supports.
        gap: Distance to the nearest standing body where it touches none, m; else NaN.
        nearest: That body, else empty.
    """

    supports: tuple[str, ...]
    others: tuple[str, ...]
    margin: float
    overhang: float
    gap: float
    nearest: str


def part_standing(cell: Cell, *, resting: float = RESTING) -> PartStanding:
    """Look how the last body of a cell stands on and among the bodies that do not move."""
    part = len(cell.bodies) - 1
    corners = _world_triangles(cell, cell.bodies[part])
    standing = [row for row, body in enumerate(cell.bodies[:part]) if body.parent <= BASE]
    closed = _is_closed(cell.bodies[part])
    foot_side = _looking_down(corners) if closed else corners  # what presses on it from above carries nothing
    contacts = {row: contact_points(foot_side, _world_triangles(cell, cell.bodies[row]), resting) for row in standing}
    supports = [row for row in standing if len(contacts[row])]
    apart = _distances(cell, [row for row in standing if row not in supports], part)
    others = tuple(cell.bodies[row].name for row, distance in apart.items() if distance <= resting)
    names = tuple(cell.bodies[row].name for row in supports)
    if not supports:
        nearest = min(apart, key=lambda row: apart[row], default=None)
        if others or nearest is None:
            return PartStanding((), others, math.nan, 0.0, math.nan, "")
        return PartStanding((), (), math.nan, 0.0, apart[nearest], cell.bodies[nearest].name)
    points = np.concatenate([contacts[row] for row in supports])
    region = convex_hull(points[:, :2])
    low = float(corners[:, :, 2].min())
    foot = np.zeros((0, 3))
    if points[:, 2].min() <= low + 2.0 * resting:  # else it hangs by a shoulder, and what is below carries nothing
        foot = corners.reshape(-1, 3)
        foot = foot[foot[:, 2] <= low + resting]
    overhang = max((-inside_by(point, region) for point in convex_hull(foot[:, :2])), default=0.0)
    centre = mass_centre(corners, closed=closed)
    return PartStanding(names, others, inside_by(centre[:2], region), max(0.0, overhang), math.nan, "")


def contact_points(upper: FloatArray, lower: FloatArray, resting: float) -> FloatArray:
    """Return corners of the regions where triangles (n, 3, 3) and (m, 3, 3) lie upon each other, (k, 3) in m.

    ``resting``: heights count as the same within this, m.
    """
    upper, lower = _not_upright(upper), _not_upright(lower)
    found = [np.zeros((0, 3))]
    if not len(upper) or not len(lower):
        return found[0]
    slack = np.array([0.0, 0.0, resting])
    low, high = lower.min(axis=1) - slack, lower.max(axis=1) + slack
    near = ((upper.max(axis=1) >= low.min(axis=0)) & (upper.min(axis=1) <= high.max(axis=0))).all(axis=1)
    upper = upper[near]
    rows = max(1, _BLOCK // len(lower))
    for first in range(0, len(upper), rows):
        block = upper[first : first + rows]
        meet = (block.max(axis=1)[:, None] >= low) & (block.min(axis=1)[:, None] <= high)
        one, other = np.nonzero(meet.all(axis=2))
        for start in range(0, len(one), _BLOCK // 16):
            part = slice(start, start + _BLOCK // 16)
            found.append(_region_corners(block[one[part]], lower[other[part]], resting))
    return np.concatenate(found)


def mass_centre(corners: FloatArray, *, closed: bool) -> FloatArray:
    """Return the centre (3,) of the volume that triangles (n, 3, 3) enclose, else that of their area, m."""
    middle = corners.mean(axis=1)
    if closed:
        origin = corners.reshape(-1, 3).mean(axis=0)  # near by, so that little cancels
        a, b, c = np.moveaxis(corners - origin, 1, 0)
        volumes = np.einsum("ni,ni->n", a, np.cross(b, c)) / 6.0
        whole = float(volumes.sum())
        if abs(whole) > 1e-12 * float(np.abs(volumes).sum()):
            return np.asarray(origin + volumes @ (a + b + c) / 4.0 / whole)
    areas = np.linalg.norm(_normals(corners), axis=1)
    return np.asarray(areas @ middle / areas.sum() if areas.sum() > 0.0 else middle.mean(axis=0))


def convex_hull(points: FloatArray) -> FloatArray:
    """Return the corners of the convex hull of points (n, 2), counter-clockwise, (k, 2); Andrew 1979."""
    ordered = np.unique(np.asarray(points, float), axis=0)
    if len(ordered) < 3:
        return ordered
    chains = []
    for run in (ordered, ordered[::-1]):
        chain: list[FloatArray] = []
        for point in run:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0.0:
                chain.pop()
            chain.append(point)
        chains += chain[:-1]
    return np.array(chains)


def inside_by(point: FloatArray, hull: FloatArray) -> float:
    """Return how far a point (2,) lies inside of a hull (k, 2) from `convex_hull`, negative outside; m."""
    start, along = hull, np.roll(hull, -1, axis=0) - hull
    length = np.maximum(np.einsum("ni,ni->n", along, along), 1e-300)
    share = np.clip(np.einsum("ni,ni->n", point - start, along) / length, 0.0, 1.0)
    away = float(np.linalg.norm(start + share[:, None] * along - point, axis=1).min())
    to_left = along[:, 0] * (point - start)[:, 1] - along[:, 1] * (point - start)[:, 0]
    return away if len(hull) > 2 and (to_left >= 0.0).all() else -away


def _region_corners(upper: FloatArray, lower: FloatArray, resting: float) -> FloatArray:
    """Return the corners of the common regions of pairs of triangles (n, 3, 3) that are at the same height."""
    found = [_over(upper, lower, resting), _over(lower, upper, resting)]
    for i in range(3):
        p, d = upper[:, i], upper[:, (i + 1) % 3] - upper[:, i]
        for j in range(3):
            q, e = lower[:, j], lower[:, (j + 1) % 3] - lower[:, j]
            turn = d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]
            crossing = np.where(turn == 0.0, 1.0, turn)
            s = ((q - p)[:, 0] * e[:, 1] - (q - p)[:, 1] * e[:, 0]) / crossing
            t = ((q - p)[:, 0] * d[:, 1] - (q - p)[:, 1] * d[:, 0]) / crossing
            at, at_lower = p + s[:, None] * d, q + t[:, None] * e
            meets = (turn != 0.0) & (np.minimum(s, t) >= 0.0) & (np.maximum(s, t) <= 1.0)
            found.append(at[meets & (np.abs(at[:, 2] - at_lower[:, 2]) <= resting)])
    return np.concatenate(found)


def _over(points: FloatArray, triangles: FloatArray, resting: float) -> FloatArray:
    """Return those corners of the first triangles that lie over the second ones (n, 3, 3) at their height."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    u, v = b - a, c - a
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]  # never 0, as no triangle is upright
    found = []
    for k in range(3):
        w = points[:, k] - a
        s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / twice
        t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / twice
        within = (np.minimum(s, t) >= 0.0) & (s + t <= 1.0)
        height = a[:, 2] + s * u[:, 2] + t * v[:, 2]
        found.append(points[within & (np.abs(points[:, k, 2] - height) <= resting), k])
    return np.concatenate(found)


def _distances(cell: Cell, rows: list[int], part: int) -> dict[int, float]:
    """Return the part's distance to bodies, 0 to those that it collides with."""
    if not rows:
        return {}
    pairs: IntArray = np.array([(row, part) for row in rows], np.int64)
    scene = VerificationScene(cell, pairs)
    hit = {a for a, _ in scene.colliding_pairs(cell.start)}
    return {row: 0.0 if row in hit else scene.pair_distance(at, cell.start) for at, row in enumerate(rows)}


def _world_triangles(cell: Cell, body: Body) -> FloatArray:
    vertices, faces = triangles_of(body.shape, _SECTIONS)
    T = body.T_parent_body if body.parent == WORLD else cell.T_world_base @ body.T_parent_body
    return np.asarray(apply(T, vertices)[faces])


def _is_closed(body: Body) -> bool:
    from cellwright.cell.containment import closed_mesh

    return not isinstance(body.shape, Mesh) or closed_mesh(body.shape) is not None


def _looking_down(corners: FloatArray) -> FloatArray:
    """Return the triangles (n, 3, 3) of a closed mesh, however it is oriented, that look down."""
    normals = _normals(corners)
    outward = 1.0 if np.einsum("ni,ni->", normals, corners.mean(axis=1)) >= 0.0 else -1.0
    return corners[outward * normals[:, 2] < 0.0]


def _not_upright(corners: FloatArray) -> FloatArray:
    normals = _normals(corners)
    rises = np.abs(normals[:, 2]) > _FLAT * np.linalg.norm(normals, axis=1)
    return np.asarray(corners[rises])


def _normals(corners: FloatArray) -> FloatArray:
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _turn(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
