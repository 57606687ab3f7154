"""Decide most collision questions of an arm by bounds of distances, never wrongly.

Three tests, each only where the one before does not decide:

1. bounding balls, and analytic distances of simple shapes that stand still;
2. the gap between the convex hulls (`cellwright.cell.convex_gap`), which also decides the other way if both bodies
   fill their hulls;
3. else the balls that cover the body on the later link (`cellwright.cell.link_spheres`), gathered into groups, against
   bounds of the other's signed distance (`cellwright.cell.distance_field`).

Two bodies are *free* of each other if they certainly keep the wanted distance, *blocked* if they certainly come closer
than the clearance, and *open* between the two: there the exact engine must be asked. The answer comes with a lower
bound of the distance, so that callers moving in small steps can skip a pair until that reserve is used up.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import AnyArray, Float32Array, FloatArray, IntArray
from cellwright.cell.bodies import BASE, WORLD, Body
from cellwright.cell.cell import Cell
from cellwright.cell.convex_gap import Hull, convex_gap, hull_of, hull_table
from cellwright.cell.distance_field import DistanceTable, distance_bounds, distance_table, outer_distance
from cellwright.cell.link_spheres import cover_shape
from cellwright.cell.transforms import inverse

FREE, OPEN, BLOCKED = range(3)
"""What the filter says of a state: certainly free, not decided, certainly blocked."""

BY_NONE, BY_HULL = -1, -2
"""What `compare_bodies` returns for a ball where none blocks, and where the hulls do."""
_FAR = 1e9
_BALLS_PER_GROUP = 12


@dataclass(frozen=True, eq=False)
class SphereFilter:
    """The balls and distance bounds of a cell as flat arrays for kernels; make it by `sphere_filter`.

    Attributes:
        node: Balls of all trees in m: centre in the frame of the link that carries them (3), radius, core. First
            the bounding balls of the moving bodies, then groups, then balls; (nodes, 5).
        child: First child of a node and the end; equal where there are none; (nodes, 2).
        carrier: Link that carries each moving body, 1 to joints, (moving,).
        distance: Distances, first of the standing bodies, in the frame of the robot's base, then of the moving ones,
            in the frame of their link.
        hull_points, hull_edge, hull_real, hull_whole: Hulls of the same bodies, see `hull_table`.
        pair: Pairs to check: moving body with balls, row of the other's distance and hull, link that carries the
            other (0: it stands still), its moving body (-1: none), its row of the cell's bodies, row of the first
            one's hull, whether both fill their hulls; (pairs, 7).
        lever: How far the first body of a pair can be from each joint's axis in m, 0 for joints that do not move the
            two against each other, (pairs, joints).
    """

    node: FloatArray
    child: IntArray
    carrier: IntArray
    distance: DistanceTable
    hull_points: FloatArray
    hull_edge: IntArray
    hull_real: FloatArray
    hull_whole: IntArray
    pair: IntArray
    lever: FloatArray

    def arrays(self) -> tuple[AnyArray, ...]:
        """Return the arrays in the order in which kernels take them."""
        d = self.distance
        return (
            *(self.node, self.child, self.carrier, d.real, d.whole, d.lower, d.upper),
            *(self.hull_points, self.hull_edge, self.hull_real, self.hull_whole, self.pair, self.lever),
        )


def sphere_filter(
    cell: Cell, *, link_overshoot: float, tool_overshoot: float, field_spacing: float, field_padding: float
) -> SphereFilter:
    """Cover the moving bodies of a cell with balls and tabulate distances; lengths in m.

    ``link_overshoot`` and ``tool_overshoot``: how far balls may stick out of arm links and of what the last
    link carries; ``field_spacing`` and ``field_padding``: grid of the distance field of a mesh.
    """
    n_joints = len(cell.start)
    moving = [row for row, body in enumerate(cell.bodies) if body.parent > BASE]
    standing = [row for row, body in enumerate(cell.bodies) if body.parent <= BASE]
    rows = standing + moving
    shapes, poses = [cell.bodies[row].shape for row in rows], [_pose_in_frame(cell, cell.bodies[row]) for row in rows]
    hulls = [hull_of(shape, T) for shape, T in zip(shapes, poses)]
    pairs = _pairs(cell, standing, moving, hulls)
    # balls and distance fields serve pairs that their hulls cannot decide
    hollow = [pair for pair in pairs if not pair[6]]
    with ThreadPoolExecutor() as pool:
        trees = list(
            pool.map(
                lambda m: _tree(
                    hulls[len(standing) + m],
                    cell.bodies[moving[m]],
                    tool_overshoot if cell.bodies[moving[m]].parent == n_joints else link_overshoot,
                    any(pair[0] == m for pair in hollow),
                ),
                range(len(moving)),
            )
        )
    tabled = [any(pair[1] == row for pair in hollow) for row in range(len(rows))]
    table = distance_table(shapes, poses, tabled, spacing=field_spacing, padding=field_padding)
    node, child = _joined(trees)
    return SphereFilter(
        node,
        child,
        np.array([cell.bodies[row].parent for row in moving], np.int64),
        table,
        *hull_table(hulls),
        np.array(pairs, np.int64).reshape(-1, 7),
        np.array([_levers(cell, hulls[pair[5]], pair[2], moving[pair[0]]) for pair in pairs]).reshape(-1, n_joints),
    )


@dataclass(frozen=True, eq=False)
class _Tree:
    """Balls (n, 5) of one body, sorted by group: bounding ball (5,), groups (g, 5), first ball of each group (g,)."""

    whole: FloatArray
    groups: FloatArray
    first: IntArray
    balls: FloatArray


def _joined(trees: list[_Tree]) -> tuple[FloatArray, IntArray]:
    """Put the trees into one table: bounding balls, groups, balls."""
    n_bodies, n_groups = len(trees), sum(len(tree.groups) for tree in trees)
    node = np.concatenate([np.zeros((0, 5)), *([tree.whole[None] for tree in trees])])
    node = np.concatenate([node, *(tree.groups for tree in trees), *(tree.balls for tree in trees)])
    child = np.zeros((len(node), 2), np.int64)
    group, ball = n_bodies, n_bodies + n_groups
    for body, tree in enumerate(trees):
        child[body] = group, group + len(tree.groups)
        ends = np.append(tree.first, len(tree.balls))[1:]
        child[group : group + len(tree.groups)] = ball + np.stack([tree.first, ends[: len(tree.first)]], -1)
        group, ball = group + len(tree.groups), ball + len(tree.balls)
    return node, child


def _levers(cell: Cell, hull: Hull, link: int, body: int) -> FloatArray:
    """Bound how far a body gets from the axes of the joints between ``link`` and its own, (joints,) in m."""
    carrier, chain = cell.bodies[body].parent, cell.robot.chain
    thick = hull.radius + hull.disc
    levers = np.zeros(chain.n_joints)
    # about its own axis a link's points turn in circles; from earlier axes they are at most the links' lengths away
    levers[carrier - 1] = np.linalg.norm(np.cross(hull.points, chain.axis[carrier - 1]), axis=1).max() + thick
    reach = np.linalg.norm(hull.points, axis=1).max() + thick
    for joint in range(carrier - 2, link - 1, -1):
        reach += np.linalg.norm(chain.T_parent_joint[joint + 1, :3, 3])
        levers[joint] = reach
    return levers


def _pairs(cell: Cell, standing: list[int], moving: list[int], hulls: list[Hull]) -> list[tuple[int, ...]]:
    """Return the rows of `SphereFilter.pair`: the body on the later link comes first."""
    ignored = {(int(min(pair)), int(max(pair))) for pair in cell.ignored_pairs}
    n = len(standing)
    others = [(row, place, 0, -1) for place, row in enumerate(standing)]
    others += [(row, n + k, cell.bodies[row].parent, k) for k, row in enumerate(moving)]
    return [
        (m, place, link, k, row, n + m, int(hulls[place].solid and hulls[n + m].solid))
        for m, body in enumerate(moving)
        for row, place, link, k in others
        if link < cell.bodies[body].parent and (min(row, body), max(row, body)) not in ignored
    ]


def _pose_in_frame(cell: Cell, body: Body) -> FloatArray:
    return inverse(cell.T_world_base) @ body.T_parent_body if body.parent == WORLD else body.T_parent_body


def _tree(hull: Hull, body: Body, overshoot: float, balls: bool) -> _Tree:
    """Bound a body by one ball and, if ``balls``, cover it by balls, gathered into groups that lie far apart."""
    whole = _bounding_ball(hull.points, np.full(len(hull.points), hull.radius + hull.disc))
    if not balls:
        return _Tree(whole, np.zeros((0, 5)), np.zeros(0, np.int64), np.zeros((0, 5)))
    cover, T = cover_shape(body.shape, overshoot), body.T_parent_body
    centres, radii = cover.centres @ T[:3, :3].T + T[:3, 3], cover.radii
    n_groups = math.ceil(len(radii) / _BALLS_PER_GROUP)
    seeds = [int(np.argmax(radii))]
    gap = np.linalg.norm(centres - centres[seeds[0]], axis=1)
    while len(seeds) < n_groups:
        seeds.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(centres - centres[seeds[-1]], axis=1))
    group = np.argmin(np.linalg.norm(centres[:, None] - centres[seeds], axis=2), axis=1)
    group = np.unique(group, return_inverse=True)[1].reshape(-1)
    # within a group the largest ball first: it decides most often
    order = np.lexsort((np.arange(len(radii)), -radii, group))
    group, centres, radii = group[order], centres[order], radii[order]
    first = np.flatnonzero(np.diff(group, prepend=-1))
    ends = [*first[1:].tolist(), len(radii)]
    groups = np.array([_bounding_ball(centres[a:b], radii[a:b]) for a, b in zip(first.tolist(), ends)])
    return _Tree(whole, groups, first, np.column_stack([centres, radii, cover.cores[order]]))


def _bounding_ball(centres: FloatArray, radii: FloatArray) -> FloatArray:
    """Return a ball (5,), without core, about all balls, little more than the least one (Badoiu, Clarkson 2003)."""
    centre = 0.5 * ((centres - radii[:, None]).min(axis=0) + (centres + radii[:, None]).max(axis=0))
    for k in range(200):
        reach = np.linalg.norm(centres - centre, axis=1) + radii
        centre = centre + (centres[np.argmax(reach)] - centre) / (k + 4)
    radius = (np.linalg.norm(centres - centre, axis=1) + radii).max() * (1.0 + 1e-12)
    return np.array([*centre, radius, -math.inf])


@numba.njit(cache=True, nogil=True, _nrt=False)
def greatest_shift(poses: FloatArray, later: FloatArray, link: int, node: FloatArray, body: int) -> float:
    """Return the furthest that a point of a moving body goes when its link goes from one pose to another, in m.

    ``poses`` and ``later``: link poses (joints + 1, 4, 4). The way of the bounding ball's centre plus its radius
    times the chord of the rotation, which is its Frobenius norm over sqrt 2.
    """
    way, turn = 0.0, 0.0
    for row in range(3):
        step = later[link, row, 3] - poses[link, row, 3]
        for k in range(3):
            change = later[link, row, k] - poses[link, row, k]
            step += change * node[body, k]
            turn += change * change
        way += step * step
    return float(math.sqrt(way) + node[body, 3] * math.sqrt(0.5 * turn))


@numba.njit(cache=True, nogil=True, _nrt=False)
def ball_bounds(
    node: FloatArray,
    real: FloatArray,
    whole: IntArray,
    lower: Float32Array,
    upper: Float32Array,
    ball: int,
    d: int,
    F: FloatArray,
) -> tuple[float, float]:
    """Bound the distance in m from body ``d`` to the centre of a ball whose link is at ``F`` (4, 4) in its frame."""
    a, b, c = node[ball, 0], node[ball, 1], node[ball, 2]
    x = F[0, 0] * a + F[0, 1] * b + F[0, 2] * c + F[0, 3]
    y = F[1, 0] * a + F[1, 1] * b + F[1, 2] * c + F[1, 3]
    z = F[2, 0] * a + F[2, 1] * b + F[2, 2] * c + F[2, 3]
    least, most = distance_bounds(real, whole, lower, upper, d, x, y, z)
    return least, most


@numba.njit(cache=True, nogil=True, _nrt=False)
def centres_into(node: FloatArray, carrier: IntArray, links: FloatArray, out: FloatArray) -> None:
    """Write the centres of the bounding balls in the base to ``out`` (moving, 3); link poses (joints + 1, 4, 4)."""
    for m in range(len(carrier)):
        link = carrier[m]
        a, b, c = node[m, 0], node[m, 1], node[m, 2]
        for row in range(3):
            out[m, row] = (
                links[link, row, 0] * a + links[link, row, 1] * b + links[link, row, 2] * c + links[link, row, 3]
            )


@numba.njit(cache=True, nogil=True, _nrt=False)
def bounding_gap(
    node: FloatArray, real: FloatArray, whole: IntArray, pair: IntArray, p: int, centres: FloatArray
) -> float:
    """Return a lower bound of the distance of a pair in m from the bounding balls at ``centres`` (moving, 3)."""
    m, other = pair[p, 0], pair[p, 3]
    x, y, z = centres[m, 0], centres[m, 1], centres[m, 2]
    if other >= 0:
        x, y, z = x - centres[other, 0], y - centres[other, 1], z - centres[other, 2]
        return float(math.sqrt(x * x + y * y + z * z) - node[m, 3] - node[other, 3])
    return float(outer_distance(real, whole, pair[p, 1], x, y, z) - node[m, 3])


@numba.njit(cache=True, nogil=True, _nrt=False)
def compare_bodies(
    node: FloatArray,
    child: IntArray,
    real: FloatArray,
    whole: IntArray,
    lower: Float32Array,
    upper: Float32Array,
    hull_points: FloatArray,
    hull_edge: IntArray,
    hull_real: FloatArray,
    hull_whole: IntArray,
    pair: IntArray,
    p: int,
    F: FloatArray,
    wanted: float,
    clearance: float,
    direction: FloatArray,
    simplex: FloatArray,
) -> tuple[int, float, int]:
    """Tell whether the two bodies of a pair, whose bounding balls do not, keep ``wanted`` m apart.

    ``F`` (4, 4): pose of the link that carries the first body in the frame of the other one: the base, or its link.
    ``direction`` (pairs, 5): where the hulls' gap was last seen, see `convex_gap`, zero at first; ``simplex`` (7, 4):
    room to work.
    Returns `FREE`, `OPEN` or `BLOCKED` (closer than ``clearance``), a lower bound of the distance in m, and the
    ball that blocks, `BY_HULL`, or `BY_NONE`.
    """
    m, d = pair[p, 0], pair[p, 1]
    if direction[p, 0] == 0.0 and direction[p, 1] == 0.0 and direction[p, 2] == 0.0:
        direction[p, 2] = -1.0
    gap, most = convex_gap(
        hull_points, hull_edge, hull_real, hull_whole, d, pair[p, 5], F, wanted, clearance, direction[p], simplex
    )
    if gap >= wanted:
        return FREE, gap, BY_NONE
    if pair[p, 6] == 1:
        return (BLOCKED if most < clearance else OPEN), gap, BY_HULL
    least = _FAR
    for group in range(child[m, 0], child[m, 1]):
        low, _ = ball_bounds(node, real, whole, lower, upper, group, d, F)
        if low - node[group, 3] >= wanted:
            least = min(least, low - node[group, 3])
            continue
        for ball in range(child[group, 0], child[group, 1]):
            low, high = ball_bounds(node, real, whole, lower, upper, ball, d, F)
            if high - node[ball, 4] < clearance:
                return BLOCKED, low - node[ball, 3], ball
            least = min(least, low - node[ball, 3])
    return (FREE if least >= wanted else OPEN), least, BY_NONE


@numba.njit(cache=True, nogil=True, _nrt=False)
def relative_into(poses: FloatArray, link: int, other: int, out: FloatArray) -> None:
    """Write the pose of the link ``other`` as seen from ``link`` to ``out``; ``poses`` (joints + 1, 4, 4)."""
    for row in range(3):
        for column in range(4):
            total = 0.0
            for k in range(3):
                away = poses[link, k, 3] if column == 3 else 0.0
                total += poses[link, k, row] * (poses[other, k, column] - away)
            out[row, column] = total
    out[3, 0] = out[3, 1] = out[3, 2] = 0.0
    out[3, 3] = 1.0
