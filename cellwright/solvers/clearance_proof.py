"""Prove how near bodies come on a motion, between its states too: branch and bound over pairs of bodies and time.

The distance of two bodies changes by no more than one moves as seen from the other. So over a stretch of which both
ends have been measured it is at least the mean of the two distances less half that motion, and the stretch that could
hold the smallest distance is cut where that bound is least (Piyavskii 1972, Shubert 1972), until the smallest found
is proven to within a share of it. Spheres around the bodies spare most pairs a first measurement.

The motion of a body within a step is bounded by that of the corners of a box around it (see `motion_steps`): by their
chord and, for the bend of their paths, by what the joints' peak speeds and accelerations on the curve permit.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.cell import Cell
from cellwright.cell.transforms import apply, inverse
from cellwright.solvers.hermite import peak_acceleration, peak_velocity, states_at
from cellwright.solvers.motion_steps import Motion, chords, corners_of, link_poses_of

CONTACT = 1e-6
"""Bodies this close (m) count as touching: nothing nearer can be told apart from contact."""
TOLERANCE = 0.01
"""The smallest distance is searched until it is known to this share of it."""
MEASUREMENTS = 3000
"""Distances measured for that at most. Freedom from contact is proven however many it takes."""
_CUTS_PER_REPORT = 16
_FINEST = 2.0**-12
"""Share of a step that is not cut further."""


class PairChecker(Protocol):
    """What the proof asks of a collision engine."""

    @property
    def pairs(self) -> IntArray:
        """Pairs of rows of the cell's bodies that are checked, (pairs, 2)."""
        ...

    @property
    def spheres(self) -> tuple[FloatArray, FloatArray]:
        """Centres (bodies, 3) in the bodies' frames and radii (bodies,) in m of spheres around them."""
        ...

    def pair_distance(self, pair: int, q: FloatArray, /) -> float:
        """Return the distance in m of a pair at ``q`` (joints,) in rad; 0 if it touches."""
        ...


@dataclass(frozen=True)
class Clearance:
    """How near bodies come on a motion.

    Attributes:
        found: Smallest distance measured in m, inf without pairs.
        proven: Bodies come nowhere nearer than this, m.
        bodies: Names of the two that come nearest.
        time: When they do, s.
        n_measured: Distances measured.
    """

    found: float
    proven: float
    bodies: tuple[str, str]
    time: float
    n_measured: int


def prove_clearance(
    motion: Motion,
    time: FloatArray,
    cell: Cell,
    checker: PairChecker,
    *,
    tolerance: float = TOLERANCE,
    measurements: int = MEASUREMENTS,
    progress: Callable[[float], None] = lambda share: None,
) -> Clearance:
    """Bound the smallest distance of bodies on the curve through ``motion``, searched from the times ``time`` (n,).

    Args:
        motion: The states that the curve goes through.
        time: All times of the motion and more, so that the steps between them are short.
        cell: The cell.
        checker: The engine that measures distances.
        tolerance: Share of the smallest distance to which it is to be known.
        measurements: After so many distances freedom from contact is still proven, and no more.
        progress: Hears now and then how far the search is, from 0 to 1, by its bound or by the distances measured.
    """
    stretches = _Stretches(motion, time, cell, checker)
    best, best_pair, best_at = math.inf, -1, 0.0
    heap = stretches.whole()
    told = _Told(progress, heap[0][0] if heap else 0.0, measurements)
    while heap and not heap[0][0] >= best - max(tolerance * best, CONTACT):
        least, pair, a, b, d_a, d_b = heap[0]
        if best <= CONTACT or b - a <= _FINEST or (stretches.n_measured >= measurements and least > CONTACT):
            break
        told.of(least, best, stretches.n_measured)
        heapq.heappop(heap)
        if math.isnan(d_a):  # a pair that only spheres have spoken of
            parts = stretches.measured(pair, best)
        else:
            middle = stretches.cut(pair, a, b, d_a, d_b)
            d = stretches.distance(pair, middle)
            parts = [(a, middle, d_a, d), (middle, b, d, d_b)]
        for part in parts:
            heapq.heappush(heap, (stretches.bound(pair, *part), pair, *part))
            for at, d in (part[::2], part[1::2]):
                if d < best:
                    best, best_pair, best_at = d, pair, at
    proven = min([best, *(entry[0] for entry in heap[:1])])
    names = ("", "")
    if best_pair >= 0:
        row, other = checker.pairs[best_pair]
        names = cell.bodies[row].name, cell.bodies[other].name
    at = float(np.interp(best_at, np.arange(len(time)), time))
    return Clearance(best, proven, names, at, stretches.n_measured)


class _Told:
    """Tells how far the search is: never less than before, although the bound and what it must reach both move."""

    def __init__(self, progress: Callable[[float], None], first: float, measurements: int) -> None:
        self._progress, self._first, self._measurements = progress, first, measurements
        self._share, self._n_cuts = 0.0, 0

    def of(self, least: float, best: float, n_measured: int) -> None:
        """Take the least bound, the smallest distance found and the number of distances; report now and then."""
        closed = (least - self._first) / (best - self._first) if self._first < best < math.inf else 0.0
        self._share = min(1.0, max(self._share, closed, n_measured / self._measurements))
        if self._n_cuts % _CUTS_PER_REPORT == 0:
            self._progress(self._share)
        self._n_cuts += 1


Stretch = tuple[float, float, float, float]
"""First and last fractional row of the times, and the distances there."""


class _Stretches:
    """Bounds and distances of pairs on stretches of a motion."""

    def __init__(self, motion: Motion, time: FloatArray, cell: Cell, checker: PairChecker) -> None:
        self._motion, self._time, self._cell, self._checker = motion, time, cell, checker
        self._q, _ = states_at(motion.time, motion.position, motion.velocity, time)
        self._T_base_link = link_poses_of(cell.robot.chain, self._q)  # (times, links, 4, 4)
        self._T_base_world = inverse(cell.T_world_base)
        steps = np.clip(np.searchsorted(motion.time, time[:-1], side="right") - 1, 0, len(motion.time) - 2)
        curve = (motion.time, motion.position, motion.velocity)
        lasts = np.diff(time)[:, None]
        self._turn = peak_velocity(*curve)[steps] * lasts  # furthest turn of the joints in each step, (steps, joints)
        self._bend = 0.5 * peak_acceleration(*curve)[steps] * lasts**2
        self._travelled: dict[int, FloatArray] = {}
        self.n_measured = 0

    def whole(self) -> list[tuple[float, int, float, float, float, float]]:
        """Return a heap of all pairs on the whole motion, with what spheres say of their distances."""
        end = float(len(self._time) - 1)
        heap = [
            (float(self._apart(pair).min()), pair, 0.0, end, math.nan, math.nan)
            for pair in range(len(self._checker.pairs))
        ]
        heapq.heapify(heap)
        return heap

    def measured(self, pair: int, best: float) -> list[Stretch]:
        """Return the stretches on which spheres do not prove that the pair stays further apart than ``best``."""
        close = np.concatenate([[False], self._apart(pair) < best, [False]])
        first, end = (
            np.flatnonzero(np.diff(close.astype(np.int8)) == 1),
            np.flatnonzero(np.diff(close.astype(np.int8)) == -1),
        )
        return [
            (a, b, self.distance(pair, a), self.distance(pair, b))
            for a, b in zip(first.astype(float).tolist(), end.astype(float).tolist())
        ]

    def distance(self, pair: int, at: float) -> float:
        """Measure the distance of a pair."""
        self.n_measured += 1
        row = int(at)
        if row == at:
            return self._checker.pair_distance(pair, self._q[row])
        time = np.interp([at], (row, row + 1), self._time[row : row + 2])
        q, _ = states_at(self._motion.time, self._motion.position, self._motion.velocity, time)
        return self._checker.pair_distance(pair, q[0])

    def bound(self, pair: int, a: float, b: float, d_a: float, d_b: float) -> float:
        """Return the least distance that the pair can have on a stretch."""
        s_a, s_b = np.interp((a, b), np.arange(len(self._time)), self._motion_of(pair))
        return 0.5 * (d_a + d_b - float(s_b - s_a))

    def cut(self, pair: int, a: float, b: float, d_a: float, d_b: float) -> float:
        """Return where that least distance would be, at a state if one lies inside."""
        first, last = math.floor(a) + 1, math.ceil(b) - 1
        if first > last:
            return 0.5 * (a + b)
        s = self._motion_of(pair)
        s_a, s_b = np.interp((a, b), np.arange(len(s)), s)
        return float(np.clip(np.searchsorted(s, 0.5 * (s_a + s_b + d_a - d_b)), first, last))

    def _apart(self, pair: int) -> FloatArray:
        """Return the least distance of the spheres around a pair in each step, (steps,) in m."""
        centre, radius = self._checker.spheres
        a, b = self._checker.pairs[pair].tolist()
        between = np.zeros((len(self._time), 3))
        for row, sign in ((a, 1.0), (b, -1.0)):
            T, point = self._seen_from(0, row, centre[row : row + 1])
            between += sign * (T[:, :3, :3] @ point[0] + T[:, :3, 3])
        gap = np.linalg.norm(between, axis=1) - radius[a] - radius[b]
        low, high = self._links(pair)
        lever = min(self._lever(low, high, row) for row in (a, b))
        return np.asarray(np.minimum(gap[:-1], gap[1:]) - 0.5 * lever * self._turn[:, low:high].sum(axis=1))

    def _motion_of(self, pair: int) -> FloatArray:
        """Return how far the two bodies of a pair have moved as seen from each other since the start, (times,) in m."""
        if pair not in self._travelled:
            a, b = self._checker.pairs[pair].tolist()
            low, high = self._links(pair)
            bodies = self._cell.bodies
            # the curve leaves the chord by what its acceleration bends it: of the joints, and of turning in a circle
            turn = self._turn[:, low:high].sum(axis=1)
            bend = self._bend[:, low:high].sum(axis=1) + 0.5 * turn**2
            ways = []
            for row, peer in ((a, b), (b, a)):
                way = chords(*self._seen_from(max(bodies[peer].parent, 0), row, corners_of(bodies[row].shape)))
                ways.append(way + self._lever(low, high, row) * bend)
            self._travelled[pair] = np.concatenate([[0.0], np.cumsum(np.minimum(*ways))])
        return self._travelled[pair]

    def _links(self, pair: int) -> tuple[int, int]:
        """Return the first and the end of the joints that move a pair's bodies against each other."""
        parents = [max(self._cell.bodies[row].parent, 0) for row in self._checker.pairs[pair].tolist()]
        return min(parents), max(parents)

    def _lever(self, low: int, high: int, row: int) -> float:
        """Return how far a point of a body can be from the axes of the joints ``low`` to ``high``, in m."""
        body, offsets = self._cell.bodies[row], self._cell.robot.chain.T_parent_joint[:, :3, 3]
        corners = apply(body.T_parent_body, corners_of(body.shape))
        if body.parent < 0:
            corners = apply(self._T_base_world, corners)
        # seen from its own link the origins of the joints are at most the links between away
        between = offsets[low + 1 : high] if max(body.parent, 0) == high else offsets[low:high]
        return float(np.linalg.norm(corners, axis=1).max() + np.linalg.norm(between, axis=1).sum())

    def _seen_from(self, link: int, row: int, p_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return poses (times, 4, 4) in a link's frame, 0 the base, and points (n, 3) of a body that they carry."""
        body = self._cell.bodies[row]
        p_carrier = apply(body.T_parent_body, p_body)
        if body.parent < 0:
            p_carrier = apply(self._T_base_world, p_carrier)
        T = self._T_base_link[:, max(body.parent, 0)]
        return np.ascontiguousarray(inverse(self._T_base_link[:, link]) @ T if link > 0 else T), p_carrier
