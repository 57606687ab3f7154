"""The cheapest sequence of sweeps, with direction and alternative of each, under a cost of the motions between them.

Bjorkenstam 2014, section 2.1: a generalised travelling-salesman problem whose clusters are the sweeps, whose
alternatives are directions, branches and windings, and whose costs begin as lower bounds; a motion is only found if a
sequence could win by it. A motion between two sweeps either joins them without a stop (`JoiningMotions`) or, where
something is in the way, is the collision-free path with a stop at both ends. What stopping costs counts with the
motion. Ways around what is in the way are dear to find, so they are sought for the motions of the best sequence alone,
and the sequence is sought again with what they cost, until it keeps its motions. Bound and proof are those of the last
search, over the motions as they were found by then; a limit on motions holds for all searches together.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.errors import InfeasibleError
from cellwright.solvers.gtsp.known_costs import KnownCosts
from cellwright.solvers.gtsp.lazy import LazyResult, solve_known
from cellwright.solvers.gtsp.problem import SequencingProblem
from cellwright.solvers.motion_cost import CostedMotion
from cellwright.solvers.optimal_control.joining import JoiningMotions, MovingState
from cellwright.solvers.path_timing import LIMIT_TOLERANCE, TimedMotion
from cellwright.solvers.stitched_plan import StitchedSegment
from cellwright.solvers.sweeps.passing import PASSING, STOPPING, PassedOption

REFINEMENTS = 3
"""Times that a sequence is sought again after its motions were led around what is in their way."""
ROOM = 1.0 - 2.0 * LIMIT_TOLERANCE
"""Share of a bound that is sure: planned motions may exceed speeds by half of this and accelerations by all of it."""


class StoppingMotions(Protocol):
    """Motions from rest to rest, as a cost knows them."""

    def bound(self, q_a: FloatArray, q_b: FloatArray, /) -> FloatArray:
        """Return what no motion from ``q_a`` to ``q_b``, both (..., joints), undercuts: (...)."""
        ...

    def motion(self, q_a: FloatArray, q_b: FloatArray, /) -> CostedMotion | None:
        """Return the motion, or None if there is none."""
        ...


@dataclass(frozen=True, eq=False)
class Leg:
    """A motion between two sweeps, what it costs with the stops that it asks for, and whether it asks for them."""

    cost: float
    motion: CostedMotion
    stops: bool


@dataclass(frozen=True, eq=False)
class SequencedSweeps:
    """A sequence and how good it is.

    Attributes:
        segments: Motions in order.
        cost: What it costs, by the parts that the search knew.
        lower_bound: No sequence of these alternatives over such motions costs less.
        proven: Whether none is cheaper.
        stopped_by: What ended the work.
        n_evaluated, n_motions: Motions found, and those that there are.
        n_joined, n_stopped: Motions of the sequence that join sweeps without a stop, and those with stops.
    """

    segments: tuple[StitchedSegment, ...]
    cost: float
    lower_bound: float
    proven: bool
    stopped_by: str
    n_evaluated: int
    n_motions: int
    n_joined: int
    n_stopped: int


class SweepLegs:
    """The motions between options, between the start and options, and what options cost; rows are the options.

    Row ``start`` stands for the start configuration, row ``end`` for a stop behind the last sweep.
    """

    def __init__(
        self,
        options: Sequence[PassedOption],
        q_start: FloatArray,
        cost_of: Callable[[PassedOption, TimedMotion], float],
        stopping: StoppingMotions,
        joining: JoiningMotions | None,
        is_free: Callable[[PassedOption], bool],
    ) -> None:
        self.options, self._q_start = list(options), q_start
        self._stopping, self._joining, self._is_free = stopping, joining, is_free
        self.start, self.end = len(self.options), len(self.options) + 1
        passing = joining is not None
        self._passes = np.array([passing and option.passes for option in self.options] + [False, False])
        costs = [{ends: cost_of(option, motion) for ends, motion in option.motions.items()} for option in self.options]
        self.service = np.array(
            [own[PASSING if passes else STOPPING] for own, passes in zip(costs, self._passes)] + [0.0, 0.0]
        )
        self._entry_stop = np.array(
            [own[False, True] - own[PASSING] if p else 0.0 for own, p in zip(costs, self._passes)] + [0.0, 0.0]
        )
        self._exit_stop = np.array(
            [own[True, False] - own[PASSING] if p else 0.0 for own, p in zip(costs, self._passes)] + [0.0, 0.0]
        )
        self._free: dict[int, bool] = {}
        self._refined: set[tuple[int, int]] = set()
        self.found: dict[tuple[int, int], Leg | None] = {}

    def bounds(self) -> FloatArray:
        """Return what no leg undercuts, (rows, rows), row to column."""
        exits, entries = self._states(-1), self._states(0)
        stop = self._exit_stop[:, None] + self._entry_stop[None]
        least = np.stack([self._stopping.bound(q, entries.q) for q in exits.q]) * ROOM + stop
        if self._joining is not None:
            joined = np.stack(
                [self._joining.bound(MovingState(q, v), entries) for q, v in zip(exits.q, exits.v)]
            ) * ROOM  # fmt: skip
            least = np.minimum(least, joined)
        least = np.maximum(least, 0.0)
        least[:, self.end] = np.maximum(self._exit_stop, 0.0)
        least[self.end] = 0.0
        return np.asarray(least)

    def evaluate(self, a: int, b: int) -> float:
        """Return the cost of a leg, infinite if there is none."""
        if b == self.end:
            return float(max(self._exit_stop[a], 0.0))
        if a == self.end:  # closing an open sequence costs nothing
            return 0.0
        if (a, b) not in self.found:
            self.found[a, b] = self._leg(a, b)
        leg = self.found[a, b]
        return math.inf if leg is None else leg.cost

    def known_pairs(self) -> list[tuple[int, int]]:
        """Return the pairs of rows whose cost is known: what was found, and the end, to which nothing has to move."""
        return [*self.found, *((row, self.end) for row in range(self.end))]

    def refine(self, nodes: Sequence[int], returns: bool) -> bool:
        """Seek ways around what makes legs of a sequence stop; return whether one is cheaper than stopping."""
        rows = [self.start, *nodes, *([self.start] if returns else [])]
        improved = False
        for a, b in itertools.pairwise(rows):
            leg = self._known(a, b)
            if self._joining is None or not leg.stops or (a, b) in self._refined:
                continue
            self._refined.add((a, b))
            around = self._joining.around(self._state(a, -1), self._state(b, 0))
            if around is not None and around.cost < leg.cost:
                self.found[a, b] = Leg(around.cost, around, False)
                improved = True
        return improved

    def total(self, nodes: Sequence[int], returns: bool) -> float:
        """Return what a sequence of options costs, infinite if a motion is missing."""
        rows = [self.start, *nodes, self.start if returns else self.end]
        own = math.fsum(float(self.service[node]) for node in nodes)
        return own + math.fsum(self.evaluate(a, b) for a, b in itertools.pairwise(rows))

    def segments(self, nodes: Sequence[int], returns: bool) -> tuple[tuple[StitchedSegment, ...], int, int]:
        """Return the segments of a sequence of options, and how many legs join and stop."""
        rows = [self.start, *nodes, *([self.start] if returns else [])]
        legs = [self._known(a, b) for a, b in itertools.pairwise(rows)]
        segments: list[StitchedSegment] = []
        for number, node in enumerate(nodes):
            option = self.options[node]
            coming, going = legs[number], legs[number + 1] if number + 1 < len(legs) else None
            ends = not coming.stops, going is not None and not going.stops
            if not self._passes[node]:
                ends = STOPPING
            motion = option.motions[ends]
            segments += [
                StitchedSegment(coming.motion.motion, -1, -1, 0, coming.motion.via),
                StitchedSegment(motion, option.sweep, option.branch, option.direction, ""),
            ]
        if returns:
            segments.append(StitchedSegment(legs[-1].motion.motion, -1, -1, 0, legs[-1].motion.via))
        n_stopped = sum(leg.stops for leg in legs)
        return tuple(segments), len(legs) - n_stopped, n_stopped

    def _known(self, a: int, b: int) -> Leg:
        self.evaluate(a, b)
        leg = self.found[a, b]
        if leg is None:
            raise InfeasibleError("a motion of the sequence is gone: report this as a fault of the planner")
        return leg

    def _leg(self, a: int, b: int) -> Leg | None:
        if not (self._can(a) and self._can(b)):
            return None
        exit_, entry = self._state(a, -1), self._state(b, 0)
        if self._joining is not None:
            joined = self._joining.direct(exit_, entry)
            if joined is not None:
                return Leg(joined.cost, joined, False)
        stopped = self._stopping.motion(exit_.q, entry.q)
        if stopped is None:
            return None
        return Leg(stopped.cost + float(self._exit_stop[a] + self._entry_stop[b]), stopped, True)

    def _can(self, row: int) -> bool:
        if row >= len(self.options):
            return True
        if row not in self._free:
            self._free[row] = self._is_free(self.options[row])
        return self._free[row]

    def _state(self, row: int, which: int) -> MovingState:
        """Return the first (0) or last (-1) state of an option, at speed if it passes; the start is at rest."""
        if row >= len(self.options):
            return MovingState(self._q_start, np.zeros_like(self._q_start))
        motion = self.options[row].motions[PASSING if self._passes[row] else STOPPING]
        return MovingState(motion.position[which, :-1], motion.velocity[which, :-1])

    def _states(self, which: int) -> MovingState:
        states = [self._state(row, which) for row in range(len(self.options) + 2)]
        return MovingState(np.stack([each.q for each in states]), np.stack([each.v for each in states]))


def sequence_sweeps(
    legs: SweepLegs,
    names: Sequence[str],
    rng: np.random.Generator,
    *,
    returns: bool,
    target_gap: float,
    max_motions: int,
    known: Sequence[int] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> SequencedSweeps:
    """Return the cheapest sequence found from the start through every sweep, of options; never dearer than ``known``.

    At most ``max_motions`` are found, but for those of the first sequence: ``known``, if its motions all exist.

    Raises:
        InfeasibleError: If no sequence is found whose motions all exist.
    """
    problem = _problem(legs, names, returns)

    def evaluate(a: int, b: int) -> float:
        progress(min(1.0, len(legs.found) / max_motions))
        return legs.evaluate(a, b)

    start = None if known is None else _with_ends(legs, known, returns)
    for turn in range(REFINEMENTS + 1):
        costs = KnownCosts(problem, evaluate)
        for a, b in legs.known_pairs():
            if a < len(problem.cost) and b < len(problem.cost):
                costs.put(a, b, legs.evaluate(a, b))
        left = max(0, max_motions - len(legs.found))
        lazy = solve_known(costs, rng, start=start, target_gap=target_gap, max_evaluations=left)
        tour = lazy.result.nodes
        if returns:  # the tour may begin anywhere
            tour = np.roll(tour, -tour.tolist().index(legs.start))
        nodes = [node for node in tour.tolist() if node < legs.start]
        start = _with_ends(legs, nodes, returns)
        if turn == REFINEMENTS or not legs.refine(nodes, returns):  # what is refined is searched again
            break
    return _sequenced(legs, nodes, lazy, returns)


def _with_ends(legs: SweepLegs, nodes: Sequence[int], returns: bool) -> list[int]:
    return [legs.start, *nodes] if returns else [legs.start, *nodes, legs.end]


def _problem(legs: SweepLegs, names: Sequence[str], returns: bool) -> SequencingProblem:
    sweep_of = np.array([option.sweep for option in legs.options])
    clusters: list[Int32Array] = [np.flatnonzero(sweep_of == number).astype(np.int32) for number in range(len(names))]
    bounds, service = legs.bounds(), legs.service
    start, end = len(clusters), None if returns else len(clusters) + 1
    clusters.append(np.array([legs.start], np.int32))
    if returns:
        bounds, service = bounds[: legs.end, : legs.end], service[: legs.end]
    else:
        clusters.append(np.array([legs.end], np.int32))
    return SequencingProblem(
        bounds, tuple(clusters), service, closed=returns, start=start, end=end,
        names=(*names, "the start", *(() if returns else ("the end",))),
    )  # fmt: skip


def _sequenced(legs: SweepLegs, nodes: Sequence[int], lazy: LazyResult, returns: bool) -> SequencedSweeps:
    segments, n_joined, n_stopped = legs.segments(nodes, returns)
    result, cost = lazy.result, legs.total(nodes, returns)
    return SequencedSweeps(
        segments,
        cost,
        min(result.lower_bound, cost),
        result.proven,
        result.stopped_by,
        len(legs.found),
        lazy.n_motions,
        n_joined,
        n_stopped,
    )
