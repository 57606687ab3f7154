"""Shorten a collision-free polyline in joint space and round its corners, checking every piece again.

Each corner is replaced by one quintic Bezier curve whose first and last three control points lie evenly on
the two edges, the middle two on the corner itself: it joins the edges with equal direction, speed and zero
curvature, so the path is twice continuously differentiable and stays in the triangle that it cuts. A blend
that collides is halved; what still collides stays a corner, at which the robot stops.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.roadmap import CollisionChecker, travel_time

BLEND_HALVINGS = 3
"""A corner that collides at an eighth of its widest blend is passed at rest: slower blends gain nothing."""
BLEND_STEPS = 10
"""Steps of the timing grid on a blend: its curvature rises and falls once."""
LONGEST_SHARE = 0.49
"""Share of an edge that one corner may use, so that the blends at its two ends never meet."""

SHARPEST_TURN = -0.95
"""Least cosine between the directions before and after a blend: nearly reversed, its speed would vanish inside."""
SHORTEST_EDGE = 1e-9
"""Points of a path closer than this, in rad of every joint, are one."""
_BLEND_PARAMETER = 2.5
"""Parameter length of a blend for a cut of length 1: five times the first control step of one half."""


@dataclass(frozen=True, eq=False)
class SmoothPath:
    """Straight edges and quintic corners over one parameter; twice continuously differentiable.

    Attributes:
        knots: Parameters at which pieces begin, and the end, (pieces + 1,).
        control: Bezier control points of the pieces, (pieces, 6, joints).
    """

    knots: FloatArray
    control: FloatArray

    def grid(self) -> FloatArray:
        """Return the knots and parameters that cut every curved piece into `BLEND_STEPS`: enough to time it by."""
        first, last = self.knots[:-1], self.knots[1:]
        curved = np.abs(np.diff(self.control, n=2, axis=1)).max(axis=(1, 2)) > SHORTEST_EDGE
        cuts = [np.linspace(a, b, BLEND_STEPS + 1)[1:-1] for a, b in zip(first[curved], last[curved], strict=True)]
        return np.sort(np.concatenate([self.knots, *cuts]))

    def __call__(self, s: FloatArray, nu: int = 0) -> FloatArray:
        """Return the ``nu``-th derivative at parameters ``s`` (values,): (values, joints)."""
        piece = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.control) - 1)
        length = (self.knots[piece + 1] - self.knots[piece])[:, None]
        u = ((s - self.knots[piece])[:, None]) / length
        points = self.control[piece]  # (values, 6, joints)
        for degree in range(5, 5 - nu, -1):
            points = degree * np.diff(points, axis=1)
        while points.shape[1] > 1:  # de Casteljau
            points = points[:, :-1] + u[:, :, None] * (points[:, 1:] - points[:, :-1])
        return np.asarray(points[:, 0] / length**nu)


def shorten(
    path: FloatArray,
    speed: FloatArray,
    checker: CollisionChecker,
    rng: np.random.Generator,
    *,
    step: float,
    n_attempts: int,
) -> FloatArray:
    """Return a path (points, joints) with the same ends that is nowhere longer in `travel_time` at ``speed``.

    First every corner that can be left out is; then, ``n_attempts`` times, two random places on the path are
    joined by a straight motion if that is shorter and free at ``step`` rad.
    """
    path = _without_needless_corners(np.asarray(path, float), checker, step)
    for _ in range(n_attempts):
        if len(path) < 3:
            return path
        lengths = travel_time(path[:-1], path[1:], speed)
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        low, high = np.sort(rng.uniform(0.0, along[-1], 2))
        i, j = np.clip(np.searchsorted(along, [low, high], side="right") - 1, 0, len(lengths) - 1)
        if i == j:
            continue
        q_low = path[i] + (low - along[i]) / lengths[i] * (path[i + 1] - path[i])
        q_high = path[j] + (high - along[j]) / lengths[j] * (path[j + 1] - path[j])
        shorter = float(travel_time(q_low, q_high, speed)) < (high - low) * (1.0 - 1e-6)
        if shorter and not checker.motion_collides(q_low, q_high, step):
            path = np.concatenate([path[: i + 1], [q_low, q_high], path[j + 1 :]])
    return _without_needless_corners(path, checker, step)


def round_corners(path: FloatArray, scale: FloatArray, checker: CollisionChecker, *, step: float) -> list[SmoothPath]:
    """Return the pieces of the rounded path between which the robot stops; one if every corner could be rounded.

    Args:
        path: Corners (points, joints), consecutive ones distinct.
        scale: Joint speeds (joints,): path lengths are measured in ``q / scale``.
        checker: Checks states on the blends.
        step: Largest turn of any joint between two checked states, rad.
    """
    scaled = path / scale
    edges = np.diff(scaled, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    directions = edges / lengths[:, None]
    cuts = np.zeros(len(path))
    for corner in range(1, len(path) - 1):
        widest = LONGEST_SHARE * min(lengths[corner - 1], lengths[corner])
        cuts[corner] = _free_cut(scaled[corner], directions[corner - 1 : corner + 1], widest, scale, checker, step)
    stops = [0, *(corner for corner in range(1, len(path) - 1) if cuts[corner] == 0.0), len(path) - 1]
    return [_joined(scaled[a : b + 1], directions[a:b], cuts[a : b + 1], scale) for a, b in itertools.pairwise(stops)]


def _without_needless_corners(path: FloatArray, checker: CollisionChecker, step: float) -> FloatArray:
    kept = [path[0]]
    last = 0
    while last < len(path) - 1:
        skips = range(len(path) - 1, last + 1, -1)
        free = (j for j in skips if not checker.motion_collides(path[last], path[j], step))
        last = next(free, last + 1)
        if np.abs(path[last] - kept[-1]).max() > SHORTEST_EDGE:
            kept.append(path[last])
    if len(kept) == 1:
        return np.stack([path[0], path[-1]])
    kept[-1] = path[-1]
    return np.stack(kept)


def _free_cut(
    corner: FloatArray,
    directions: FloatArray,
    widest: float,
    scale: FloatArray,
    checker: CollisionChecker,
    step: float,
) -> float:
    """Return the widest of the halved cuts whose blend is free, 0 if none is."""
    if float(directions[0] @ directions[1]) < SHARPEST_TURN:
        return 0.0
    for halving in range(BLEND_HALVINGS + 1):
        cut = widest * 0.5**halving
        control = _blend(corner, directions, cut) * scale
        turned = float(np.abs(np.diff(control, axis=0)).max(axis=1).sum())
        shares = np.linspace(0.0, 1.0, max(5, int(np.ceil(turned / step)) + 1))
        if checker.first_colliding(SmoothPath(np.array([0.0, 1.0]), control[None])(shares)) < 0:
            return cut
    return 0.0


def _blend(corner: FloatArray, directions: FloatArray, cut: float) -> FloatArray:
    back, on = directions
    return np.stack(
        [corner - cut * back, corner - 0.5 * cut * back, corner, corner, corner + 0.5 * cut * on, corner + cut * on]
    )


def _joined(scaled: FloatArray, directions: FloatArray, cuts: FloatArray, scale: FloatArray) -> SmoothPath:
    """Build straight edges and blends of one piece; ``cuts`` at its two ends do not count."""
    cuts = np.concatenate([[0.0], cuts[1:-1], [0.0]])
    knots, control = [0.0], []
    for edge, direction in enumerate(directions):
        first, last = scaled[edge] + cuts[edge] * direction, scaled[edge + 1] - cuts[edge + 1] * direction
        knots.append(knots[-1] + float(np.linalg.norm(last - first)))
        control.append(first + np.linspace(0.0, 1.0, 6)[:, None] * (last - first))
        if edge + 1 < len(directions):
            knots.append(knots[-1] + _BLEND_PARAMETER * float(cuts[edge + 1]))
            control.append(_blend(scaled[edge + 1], directions[edge : edge + 2], float(cuts[edge + 1])))
    return SmoothPath(np.array(knots), np.stack(control) * scale)
