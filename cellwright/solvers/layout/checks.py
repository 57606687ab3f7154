"""Lazy collision constraints: measure a point densely as numbers, and name the checks that its program lacks.

Of thousands of possible checks (samples x robot spheres x hull spheres) a solution touches a few dozen. A program
is solved with those known so far, its solution is measured at every sample, and what it violates is added, until
nothing is violated. The programs stay small and the outcome is that of the program with all checks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import AnyArray, FloatArray, IntArray
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.mesh import HULL, SELF, WALL, Checks, Mesh
from cellwright.solvers.layout.nlp import LayoutPoint

_LEAST_SAMPLES = 48
"""Samples of a transition, at least."""
_SAGITTA_M = 3e-4
"""How much deeper a sphere may pass another between two samples, well below what the checks' margin leaves the gate."""
_SHORTEST_STEP_M = 5e-3
"""Samples are no closer than this, however small the spheres."""
TOLERATED_M = 1e-6
"""Penetration that is not worth a check."""
_WINDOW_M = 0.003
"""Around a violation also the samples with so little gap are checked, so that the path does not slip by between."""
MOST_A_PAIR = 10
"""Checks added a round for one robot sphere against one station, wall or other robot sphere in one transition."""
_MOST_LAYOUT = 6
"""Layout checks added a round for one pair of bodies."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Configurations of a cycle between its rows.

    Attributes:
        before, after: Rows they lie between, (n,).
        share: Where between them, (n,).
        transition: Number of the transition, -1 along an approach, (n,).
        own: Station whose hull is left out: that of the approach, -1 along transitions, (n,).
        q: (n, joints).
    """

    before: IntArray
    after: IntArray
    share: FloatArray
    transition: IntArray
    own: IntArray
    q: FloatArray


def samples_of(geometry: LayoutGeometry, mesh: Mesh, point: LayoutPoint, *, transitions: bool = True) -> Samples:
    """Return the samples of a point: rows and places between them, and the knots of approaches.

    On transitions they are so dense that no sphere of the robot slips by between two of them. Without ``transitions``
    only their ends are sampled.
    """
    problem = geometry.problem
    counts = _samples_per_segment(geometry, mesh, point) if transitions else []
    columns: list[list[AnyArray]] = [[], [], [], [], []]
    for number, rows in enumerate(mesh.transition_rows):
        if transitions:
            each = counts[number]
            segment = np.repeat(np.arange(len(rows) - 1), each)
            share = np.concatenate([np.arange(count) / count for count in each.tolist()])
            # the end belongs to the last segment
            segment, share = np.append(segment, len(rows) - 2), np.append(share, 1.0)
        else:
            segment, share = np.array([0, len(rows) - 2]), np.array([0.0, 1.0])
        n = len(segment)
        for column, values in zip(
            columns, (rows[segment], rows[segment + 1], share, np.full(n, number), np.full(n, -1))
        ):
            column.append(values)
    for visit, rows in enumerate(mesh.visit_rows):
        if len(rows) > 1:
            n = len(rows)
            own = problem.visits[visit].station
            for column, values in zip(columns, (rows, rows, np.zeros(n), np.full(n, -1), np.full(n, own))):
                column.append(values)
    before, after, transition, own_station = (np.concatenate(columns[i]).astype(np.int64) for i in (0, 1, 3, 4))
    share = np.concatenate(columns[2]).astype(float)
    q = (1.0 - share)[:, None] * point.q[before] + share[:, None] * point.q[after]
    if point.velocity.size:
        moving = transition >= 0
        which = np.array([rows[0] for rows in mesh.segment_time])[transition]
        part = np.array([shares[0] for shares in mesh.segment_share])[transition]
        h = np.where(moving, point.times[which] * part, 0.0)
        bend = 0.5 * h * share * (1.0 - share)
        speed = problem.arm.max_velocity
        q = q + bend[:, None] * speed * (point.velocity[before] - point.velocity[after])
    return Samples(before, after, share, transition, own_station, q)


def _samples_per_segment(geometry: LayoutGeometry, mesh: Mesh, point: LayoutPoint) -> list[IntArray]:
    """Return how many samples the segments of each transition get, (segments,) a transition.

    A sphere that covers s between two samples enters one at whose surface both lie, with radii of r together, by
    ``s^2 / (8 r)``. Counts are doubled until s is small enough, so that samples of one round stay those of the next.
    """
    least = max(1, -(-_LEAST_SAMPLES // mesh.n_segments))
    step = geometry.sample_step(_SAGITTA_M, _SHORTEST_STEP_M)
    if not np.isfinite(step):
        return [np.full(len(rows) - 1, least) for rows in mesh.transition_rows]
    spheres = geometry.robot_world(geometry.problem.base_pose(point.design), point.q)[:, geometry.moving_spheres]
    counts = []
    for rows in mesh.transition_rows:
        travel = np.linalg.norm(np.diff(spheres[rows], axis=0), axis=2).max(axis=1)
        doublings = np.ceil(np.log2(np.maximum(travel / (least * step), 1.0)))
        counts.append((least * 2**doublings).astype(np.int64))
    return counts


def missing_checks(
    geometry: LayoutGeometry,
    point: LayoutPoint,
    samples: Samples,
    *,
    tolerated_m: float = TOLERATED_M,
    motion_only: bool = False,
    most_a_pair: int = MOST_A_PAIR,
) -> tuple[Checks, float]:
    """Return the checks that a point violates, and the deepest penetration in m (0 if none).

    With a negative ``tolerated_m`` also those that it comes so near to; ``most_a_pair`` bounds the checks of one robot
    sphere against one body in one transition.
    """
    motion, share, deepest = _missing_motion(geometry, point, samples, tolerated_m, most_a_pair)
    if motion_only:
        return Checks(motion, share), deepest
    layout, deepest_layout = _missing_layout(geometry, point.design, tolerated_m)
    return Checks(motion, share, layout), max(deepest, deepest_layout)


def all_layout_checks(geometry: LayoutGeometry) -> Checks:
    """Return every layout check: cheap, since no configuration enters."""
    rows = [
        np.column_stack([np.full(len(each), family), np.arange(len(each))])
        for family, each in enumerate(geometry.pair_families)
    ]
    return Checks(layout=np.concatenate(rows).astype(np.int64))


def all_checks_at_rows(geometry: LayoutGeometry, mesh: Mesh) -> Checks:
    """Return every motion check at every configuration of every transition, and every layout check.

    As equation (4) of the paper has it: all constraints at all points in time, at once.
    """
    problem, moving = geometry.problem, geometry.moving_spheres.tolist()
    others = [(HULL, m, k) for m in moving for k in range(len(geometry.hull_radii))]
    others += [(WALL, m, w) for m in moving for w, wall in enumerate(problem.walls) if wall.holds_robot]
    others += [(SELF, m, k) for m, k in problem.robot_spheres.self_pairs.tolist()]
    pairs = np.array(others, np.int64).reshape(-1, 3)
    begun = {start for start, _ in problem.transitions}
    rows = []
    for number, path in enumerate(mesh.transition_rows):
        end = problem.transitions[number][1]
        # the last configuration is the first of the next transition, if there is one and the approach a single pose
        shared = end in begun and len(mesh.visit_rows[end]) == 1
        for row in path[: -1 if shared else None].tolist():
            head = np.tile([row, row, number], (len(pairs), 1))
            rows.append(np.concatenate([head, pairs], axis=1))
    motion = np.concatenate(rows) if rows else np.zeros((0, 6), np.int64)
    return Checks(motion, np.zeros(len(motion)), all_layout_checks(geometry).layout)


def _missing_motion(
    geometry: LayoutGeometry, point: LayoutPoint, samples: Samples, tolerated_m: float, most_a_pair: int
) -> tuple[IntArray, FloatArray, float]:
    problem = geometry.problem
    if not len(problem.robot_spheres):
        return np.zeros((0, 6), np.int64), np.zeros(0), 0.0
    robot = geometry.robot_world(problem.base_pose(point.design), samples.q)
    moving = geometry.moving_spheres
    pairs = problem.robot_spheres.self_pairs
    rows: list[IntArray] = []
    deepest = 0.0
    families: list[tuple[int, FloatArray, IntArray, IntArray]] = []
    if len(geometry.hull_radii) and len(moving):
        gaps = geometry.hull_gaps(robot, geometry.hull_world(point.design))
        gaps[(samples.own[:, None] == geometry.hull_station)[:, None, :].repeat(len(moving), axis=1)] = np.inf
        for station in np.unique(geometry.hull_station).tolist():
            # of neighbouring spheres of one hull the nearest at each sample stands for all
            own = np.flatnonzero(geometry.hull_station == station)
            nearest = np.argmin(gaps[:, :, own], axis=2)
            families.append((HULL, gaps[:, :, own].min(axis=2), moving, own[nearest]))
    if len(problem.walls) and len(moving):
        walls = geometry.wall_gaps(robot)
        families += [
            (WALL, walls[:, :, wall], moving, np.full(walls.shape[:2], wall)) for wall in range(len(problem.walls))
        ]
    if len(pairs):
        families.append((SELF, geometry.self_gaps(robot), pairs[:, 0], np.tile(pairs[:, 1], (len(robot), 1))))
    numbers = [(number, np.flatnonzero(samples.transition == number)) for number in np.unique(samples.transition)]
    for kind, gaps, one, other in families:
        deepest = max(deepest, -float(gaps.min()))
        for _, own in numbers:
            for column in np.flatnonzero(gaps[own].min(axis=0) < -tolerated_m).tolist():
                near = own[_spread(gaps[own, column], max(_WINDOW_M, -tolerated_m), most_a_pair)]
                head = np.column_stack([np.full(len(near), kind), np.full(len(near), one[column]), other[near, column]])
                rows.append(np.column_stack([near, head]))
    if not rows:
        return np.zeros((0, 6), np.int64), np.zeros(0), max(deepest, 0.0)
    found = np.concatenate(rows)
    sample = found[:, 0]
    motion = np.column_stack([samples.before[sample], samples.after[sample], samples.transition[sample], found[:, 1:]])
    return motion.astype(np.int64), samples.share[sample], deepest


def _spread(profile: FloatArray, window_m: float, most: int) -> IntArray:
    """Return the samples to check of one pair's gaps along a transition: the deepest, and some around it."""
    near = np.flatnonzero(profile < window_m)
    if len(near) > most:
        near = near[np.round(np.linspace(0, len(near) - 1, most)).astype(int)]
    return np.unique(np.append(near, np.argmin(profile)))


def _missing_layout(geometry: LayoutGeometry, design: FloatArray, tolerated_m: float) -> tuple[IntArray, float]:
    owner, base = geometry.hull_station, np.full(len(geometry.problem.robot_spheres), -1)
    walls, all_gaps = np.arange(len(geometry.problem.walls)), geometry.layout_gaps(design)
    rows: list[IntArray] = []
    deepest = 0.0
    # the bodies behind both columns of each family's pairs
    owners = ((owner, owner), (base, owner), (walls, owner), (walls, base))
    for family, (pairs, (first, second)) in enumerate(zip(geometry.pair_families, owners)):
        gaps = all_gaps[family]
        if not len(gaps):
            continue
        deepest = max(deepest, -float(gaps.min()))
        touching = np.flatnonzero(gaps < -tolerated_m)
        body = np.column_stack([first[pairs[:, 0]], second[pairs[:, 1]]])
        for pair in np.unique(body[touching], axis=0):
            inside = touching[(body[touching] == pair).all(axis=1)]
            chosen = inside[np.argsort(gaps[inside], kind="stable")[:_MOST_LAYOUT]]
            rows.append(np.column_stack([np.full(len(chosen), family), chosen]))
    layout = np.concatenate(rows).astype(np.int64) if rows else np.zeros((0, 2), np.int64)
    return layout, max(deepest, 0.0)
