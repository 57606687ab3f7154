"""Which configuration to take at each visit so that a cycle's steps cost least: shortest walks, closed or open.

Exact for both. With c candidates a visit and t transitions a layout costs t c^2 sums for an open sequence and t c^3
for a closed one, compiled and over as many threads as there are cores.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.threads import map_slices

_ROWS = 20
"""Layouts a call: the slices, not the threads, fix what is computed together."""


@dataclass(frozen=True, eq=False)
class StepMetric:
    """What a step between two configurations costs.

    Attributes:
        weight: Factor on each joint's travel, (joints,).
        circular: Joints that may turn on by whole turns and so take the short way round, (joints,).
        slowest: The largest weighted travel of a joint counts; else the length of the step in joint space.
    """

    weight: FloatArray
    circular: BoolArray
    slowest: bool

    def steps(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """Return the cost (...,) from ``before`` to ``after`` (..., joints); infinite if one is not a number."""
        travel = after - before
        short = travel - 2.0 * math.pi * np.round(travel / (2.0 * math.pi))
        travel = np.abs(np.where(self.circular, short, travel)) * self.weight
        cost = travel.max(axis=-1) if self.slowest else np.sqrt((travel * travel).sum(axis=-1))
        return np.where(np.isnan(cost), np.inf, cost)


def cheapest_sums(
    metric: StepMetric, first: FloatArray, last: FloatArray, transitions: Sequence[tuple[int, int]], *, cyclic: bool
) -> FloatArray:
    """Return the least sum of steps (n,) over the candidates of n layouts.

    Args:
        metric: What a step costs.
        first, last: Configurations in which a visit begins and ends, (n, visits, candidates, joints), NaN rows for
            candidates that are none. A visit without any is left out with the transitions from and to it.
        transitions: Pairs of visits, each the end of one step and the start of the next; if ``cyclic`` the last leads
            back to the first visit.
        cyclic: Whether the walk must end in the candidate that it began with.
    """
    pairs = np.array(transitions, np.int64)
    begin, end = np.ascontiguousarray(first), np.ascontiguousarray(last)

    def work(rows: slice) -> FloatArray:
        sums: FloatArray = _cheapest(
            begin[rows], end[rows], pairs, metric.weight, metric.circular, metric.slowest, cyclic
        )
        return sums

    return np.concatenate(list(map_slices(work, len(begin), _ROWS)))


@numba.njit(cache=True, nogil=True)
def _step(before: FloatArray, after: FloatArray, weight: FloatArray, circular: BoolArray, slowest: bool) -> float:
    turn, cost = 2.0 * math.pi, 0.0
    for joint in range(len(before)):
        travel = after[joint] - before[joint]
        if circular[joint]:
            travel -= turn * np.round(travel / turn)
        travel = abs(travel) * weight[joint]
        if slowest:
            cost = max(cost, travel)
        else:
            cost += travel * travel
    return cost if slowest else math.sqrt(cost)


@numba.njit(cache=True, nogil=True)
def _cheapest(
    first: FloatArray,
    last: FloatArray,
    transitions: IntArray,
    weight: FloatArray,
    circular: BoolArray,
    slowest: bool,
    cyclic: bool,
) -> FloatArray:
    n, n_visits, n_candidates = first.shape[:3]
    n_steps = len(transitions)
    sums = np.empty(n)
    candidate = np.empty((n_visits, n_candidates), np.int64)
    count = np.empty(n_visits, np.int64)
    cost = np.empty((n_steps, n_candidates, n_candidates))
    reach, ahead = np.empty(n_candidates), np.empty(n_candidates)
    for row in range(n):
        for visit in range(n_visits):
            count[visit] = 0
            for each in range(n_candidates):
                if not math.isnan(first[row, visit, each, 0]):
                    candidate[visit, count[visit]] = each
                    count[visit] += 1
        for step in range(n_steps):
            start, end = transitions[step]
            for a in range(max(count[start], 1)):
                for b in range(max(count[end], 1)):
                    if count[start] == 0 or count[end] == 0:
                        cost[step, a, b] = 0.0
                    else:
                        before = last[row, start, candidate[start, a]]
                        after = first[row, end, candidate[end, b]]
                        cost[step, a, b] = _step(before, after, weight, circular, slowest)
        best = np.inf
        n_origins = max(count[transitions[0, 0]], 1)
        for origin in range(n_origins if cyclic else 1):
            for a in range(n_origins):
                reach[a] = 0.0 if not cyclic or a == origin else np.inf
            for step in range(n_steps):
                start, end = transitions[step]
                n_start, n_end = max(count[start], 1), max(count[end], 1)
                lowest = np.inf
                for b in range(n_end):
                    ahead[b] = np.inf
                for a in range(n_start):
                    if reach[a] < best:
                        for b in range(n_end):
                            ahead[b] = min(ahead[b], reach[a] + cost[step, a, b])
                for b in range(n_end):
                    reach[b] = ahead[b]
                    lowest = min(lowest, ahead[b])
                if lowest >= best:
                    break
            if lowest < best:
                best = min(best, reach[origin]) if cyclic else lowest
        sums[row] = best
    return sums


def cheapest_walk(
    metric: StepMetric, first: FloatArray, last: FloatArray, transitions: Sequence[tuple[int, int]], *, cyclic: bool
) -> tuple[IntArray, float]:
    """Return the candidate at each visit and the sum for one layout, (visits, candidates, joints).

    Ties go to the lower candidate; a visit without any is left out and gets candidate 0.
    """
    n_candidates = first.shape[1]
    missing = np.asarray(np.isnan(first[:, :, 0]).all(axis=1))
    steps: list[FloatArray] = []
    for start, end in transitions:
        cost = metric.steps(last[start, :, None], first[end, None])
        if missing[start] or missing[end]:
            usable = ~np.isnan(np.stack([last[start, :, 0], first[end, :, 0]]))
            usable[0] |= missing[start] & (np.arange(n_candidates) == 0)
            usable[1] |= missing[end] & (np.arange(n_candidates) == 0)
            cost = np.where(usable[0][:, None] & usable[1], 0.0, np.inf)
        steps.append(cost)
    (walk, total), *_ = cheapest_walks(steps, 1, cyclic=cyclic)
    return walk, total


def cheapest_walks(steps: Sequence[FloatArray], most: int, *, cyclic: bool) -> list[tuple[IntArray, float]]:
    """Return the candidate at each visit and the sum of up to ``most`` walks that begin differently, cheapest first.

    Each is the cheapest that begins with its candidate. ``steps`` holds what each step costs, (candidates before,
    candidates after); if ``cyclic`` the last leads back to the first visit. Ties go to the lower candidate.
    """
    inner = list(steps[:-1] if cyclic else steps)
    # costs from each first candidate to each candidate of a visit, (first, candidates) a visit
    reached = [np.where(np.eye(len(steps[0]), dtype=bool), 0.0, np.inf)]
    for step in inner:
        backwards = np.ascontiguousarray(step.T)
        # one first candidate at a time stays within the processor's cache
        reached.append(np.stack([(costs + backwards).min(axis=1) for costs in reached[-1]]))
    ending = reached[-1] + steps[-1].T if cyclic else reached[-1]
    found = []
    for first in np.argsort(ending.min(axis=1), kind="stable")[:most].tolist():
        last = int(np.argmin(ending[first]))
        walk = [last]
        for before, step in zip(reversed(reached[:-1]), reversed(inner)):
            walk.append(int(np.argmin(before[first] + step[:, walk[-1]])))
        found.append((np.array(walk[::-1]), float(ending[first, last])))
    return found
