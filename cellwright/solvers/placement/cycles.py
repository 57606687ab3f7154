"""How long is the cycle of given sweeps if nothing but the scanner's limits and the joints hold it up?

Two answers, from the states of each sweep that are not certainly blocked:

- `estimated_cycle`: what a plan would take if every undecided state were free and every straight motion clear. It
  ranks placements and proves nothing: a piece may turn out shorter, another branch may turn out better.
- `least_cycle`: what no plan undercuts. Of each sweep only the part counts that must be executed. A plan may execute
  more of it and so begin nearer to where it comes from; what that could save is allowed for, less the scanning that it
  costs. Between sweeps every joint alone needs its trapezoid, whatever the others do, and may be wound as suits.

Both take the best order of all sweeps and directions. Up to `EXACT_UP_TO` sweeps it is exact; beyond, the estimate is
that of a local search, and the bound that of one-trees.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray, Int32Array, IntArray
from cellwright.cell.robot import Chain
from cellwright.solvers.path_timing import LIMIT_TOLERANCE, trapezoid_time
from cellwright.solvers.placement.kernels import (
    alternatives_into,
    best_piece,
    least_connections,
    straight_times,
    turns_along,
)
from cellwright.solvers.placement.problem import PlacementProblem
from cellwright.solvers.sweeps.order_bound import one_tree_bound
from cellwright.solvers.sweeps.order_kernels import held_karp, improve_sequence

EXACT_UP_TO = 9
"""Sweeps up to which the order is exact: milliseconds."""


@dataclass(frozen=True, eq=False)
class HopefulSweep:
    """A sweep that is not certainly impossible, undecided states taken as free.

    Attributes:
        q: Solutions, a branch continuous where it is linked, (poses, branches, joints).
        pieces: First pose, last pose, samples of each branch's longest piece, (branches, 3).
        needed: First and last pose that every plan executes.
        runs: First and last pose of each branch's run that holds these, and 1; zeros without one; (branches, 3).
        step: Distance of the poses in m.
    """

    q: FloatArray
    pieces: IntArray
    needed: tuple[int, int]
    runs: IntArray
    step: float

    @property
    def span(self) -> tuple[int, int]:
        """First and last pose of the best piece, or of what is needed where that piece does not hold it."""
        best = best_piece(self.pieces)
        begin, end = int(self.pieces[best, 0]), int(self.pieces[best, 1])
        holds = best >= 0 and begin <= self.needed[0] and end >= self.needed[1]
        return (begin, end) if holds else self.needed


def estimated_cycle(problem: PlacementProblem, sweeps: Sequence[HopefulSweep]) -> float:
    """Return what a cycle through all sweeps takes if all that is undecided is free, in s."""
    chain, start = problem.cell.robot.chain, np.array(problem.cell.start, float)
    entries, exits, durations = [], [], []
    for sweep in sweeps:
        (begin, end), most = sweep.span, problem.most_alternatives
        entry, exit_ = np.empty((most, chain.n_joints)), np.empty((most, chain.n_joints))
        count = alternatives_into(
            *(sweep.q, sweep.runs, begin, end, chain.lower, chain.upper, chain.max_velocity, start, entry, exit_)
        )
        # forwards and backwards
        entries.append(np.stack([entry[:count], exit_[:count]], 1).reshape(-1, chain.n_joints))
        exits.append(np.stack([exit_[:count], entry[:count]], 1).reshape(-1, chain.n_joints))
        durations.append(np.full(2 * count, _scanning(problem, sweep, begin, end)))
    cost = straight_times(
        np.concatenate([*exits, start[None]]),
        np.concatenate([*entries, start[None]]),
        chain.max_velocity,
        chain.max_acceleration,
    )
    cost, duration, first = _options(problem, cost, durations)
    return _best_order(cost, duration, first)[0]


def least_cycle(problem: PlacementProblem, sweeps: Sequence[HopefulSweep]) -> float:
    """Return a cycle through all sweeps, in s, that no plan undercuts.

    Limits are widened by the share by which timed motions may exceed them.
    """
    chain = problem.cell.robot.chain
    ends = [_ends(sweep, chain) for sweep in sweeps]
    q = np.concatenate([*(each.q for each in ends), np.tile(problem.cell.start, (1, 2, 1))])
    reach = np.concatenate([*(each.reach for each in ends), np.zeros((1, 2, chain.n_joints))])
    turns = np.concatenate([*(each.turns for each in ends), np.zeros((1, 2, chain.n_joints))])
    cost = least_connections(
        *(q, reach, turns),
        (1.0 + LIMIT_TOLERANCE) * chain.max_velocity,
        (1.0 + LIMIT_TOLERANCE) * chain.max_acceleration,
        problem.follow.scan_speed / problem.scan_speed,
    )
    durations = [np.full(len(each.q), _scanning(problem, sweep, *sweep.needed)) for sweep, each in zip(sweeps, ends)]
    cost, duration, first = _options(problem, cost, durations)
    total, is_exact = _best_order(cost, duration, first)
    return total if is_exact else one_tree_bound(cost, duration, first, total)


@dataclass(frozen=True, eq=False)
class _Ends:
    """Where the options of a sweep begin and end, (options, 2, joints): each branch forwards, then each backwards.

    ``reach``: how far a joint turns at most from there along what a plan may execute besides. ``turns``: the least
    and the most full turns that may be added, the same at both ends.
    """

    q: FloatArray
    reach: FloatArray
    turns: FloatArray


def _ends(sweep: HopefulSweep, chain: Chain) -> _Ends:
    """Return the ends of what must be executed of a sweep on every branch that can."""
    first, last = sweep.needed
    q, reach, turns = [], [], []
    for branch in np.flatnonzero(sweep.runs[:, 2]).tolist():
        begin, end, _ = sweep.runs[branch].tolist()
        path = sweep.q[:, branch]
        before = np.abs(path[begin : first + 1] - path[first]).max(axis=0)
        after = np.abs(path[last : end + 1] - path[last]).max(axis=0)
        q.append((path[first], path[last]))
        reach.append((before, after))
        turns.append(turns_along(np.ascontiguousarray(path[first : last + 1]), chain.lower, chain.upper))
    at, ways = np.array(q), np.array(reach)
    return _Ends(
        np.concatenate([at, at[:, ::-1]]), np.concatenate([ways, ways[:, ::-1]]), np.array([*turns, *turns], float)
    )


def _scanning(problem: PlacementProblem, sweep: HopefulSweep, first: int, last: int) -> float:
    """Return the least time of a sweep between two of its poses, in s."""
    length = np.array((last - first) * sweep.step)
    return float(trapezoid_time(length, problem.scan_speed, problem.tool_acceleration))


def _options(
    problem: PlacementProblem, cost: FloatArray, durations: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, Int32Array]:
    """Return costs, durations and first options of the sweeps as `cellwright.solvers.sweeps.order_kernels` takes them.

    Where the plan need not return its end costs nothing.
    """
    if not problem.returns:
        cost[:, -1] = 0.0
    first = np.array([0, *itertools.accumulate(len(each) for each in durations)], np.int32)
    return cost, np.concatenate(durations), first


def _best_order(cost: FloatArray, duration: FloatArray, first: Int32Array) -> tuple[float, bool]:
    """Return the duration of the best order that was found, and whether there is no better one."""
    if len(first) - 1 <= EXACT_UP_TO:
        totals, _, _ = held_karp(cost, duration, first, np.inf)
        return float(totals.min()), True
    total, _ = improve_sequence(_nearest_next(cost, first), cost, duration, first)
    return float(total), False


def _nearest_next(cost: FloatArray, first: Int32Array) -> Int32Array:
    """Return sweeps in the order in which the nearest option comes next."""
    n = len(first) - 1
    sweep_of, left = np.repeat(np.arange(n), np.diff(first)), np.ones(len(cost) - 1, bool)
    at, sequence = len(cost) - 1, np.empty(n, np.int32)
    for place in range(n):
        at = int(np.argmin(np.where(left, cost[at, :-1], np.inf)))
        sequence[place] = sweep_of[at]
        left &= sweep_of != sweep_of[at]
    return sequence
