"""What a placement truly comes to: the cell is moved, its sweeps are followed exactly and stitched into one plan.

The same solvers as in planning, on the sweeps alone that the plan executes: whatever they refuse, the plan could not
do, and the cycle is the plan's. Some seconds a placement.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.causes import Cause
from cellwright.cell.motion_filter import FilteredScene
from cellwright.cell.scene import Scene
from cellwright.cell.standing_overlaps import standing_overlaps
from cellwright.solvers.placement.judge import SAME_TRAVEL, PlacementJudge
from cellwright.solvers.placement.problem import PlacementProblem
from cellwright.solvers.placement.refinement import N_POSES, ExecutedSweep
from cellwright.solvers.placement.search import FoundDesigns
from cellwright.solvers.stitched_plan import StitchedPlan, StitchSettings
from cellwright.solvers.stitching import stitch
from cellwright.solvers.sweeps.following import FollowedSweeps, follow_sweeps
from cellwright.solvers.sweeps.planned import ExecutablePiece, PlannedSweep


@dataclass(frozen=True)
class TrialSettings:
    """How a placement is tried.

    Attributes:
        stitch: How the sweeps are connected.
        method: Which orders, see `stitch`.
        seed: Seed of roadmap and shortening.
    """

    stitch: StitchSettings
    method: str
    seed: int


@dataclass(frozen=True, eq=False)
class Trial:
    """What one placement came to.

    Attributes:
        values: Design joints, (joints,).
        estimate: What its cycle was estimated to be, s.
        bound: What no plan there undercuts, s.
        cycle: The plan's cycle in s; infinite if it cannot be executed in full.
        reason: Why not; empty if it can.
        plan: The sweeps as it executes them, in order.
        method: How the design was found: search, or gradient.
    """

    values: FloatArray
    estimate: float
    bound: float
    cycle: float
    reason: str
    plan: tuple[ExecutedSweep, ...] = ()
    method: str = "search"


def try_designs(
    judge: PlacementJudge,
    found: FoundDesigns,
    settings: TrialSettings,
    *,
    cycle_now: float,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Trial]:
    """Try designs in the order of their estimates, but for those that provably cannot beat the best one before them.

    ``cycle_now`` is the cycle of the present placement in s.
    """
    depths = overlap_depths(judge.problem, np.zeros(judge.problem.harness.n_joints))
    trials: list[Trial] = []
    best = cycle_now
    for number, (values, estimate) in enumerate(zip(found.values, found.estimate.tolist())):
        bound = judge.bound(values)
        if bound < best:
            trials.append(try_design(judge.problem, Promise(values, estimate, bound), settings, depths))
            best = min(best, trials[-1].cycle)
        progress((number + 1) / len(found.values))
    progress(1.0)
    return trials


@dataclass(frozen=True, eq=False)
class Promise:
    """A design, what its cycle is estimated to be and what no plan there undercuts in s, and how it was found."""

    values: FloatArray
    estimate: float
    bound: float
    method: str = "search"


def try_design(
    problem: PlacementProblem, promise: Promise, settings: TrialSettings, depths: Mapping[tuple[str, str], float]
) -> Trial:
    """Return what a design truly comes to.

    ``depths`` is how deep bodies stand in one another in the present placement.
    """
    values = promise.values

    def tried(cycle: float, reason: str = "", plan: tuple[ExecutedSweep, ...] = ()) -> Trial:
        return Trial(values, promise.estimate, promise.bound, cycle, reason, plan, promise.method)

    def refused(reason: str) -> Trial:
        return tried(np.inf, reason)

    cell, sweeps = problem.moved_cell(values), problem.moved_sweeps(values)
    for (body, other), depth in overlap_depths(problem, values).items():
        if depth > depths.get((body, other), 0.0) + problem.resting:
            return refused(f"{body} and {other} would stand in one another, by at least {1e3 * depth:.1f} mm")
    scene = Scene(cell, problem.follow.clearance)
    touching = scene.colliding_pair(problem.cell.start)
    if touching is not None:
        return refused(f"the start configuration brings {touching[0]} and {touching[1]} too close")
    followed = follow_sweeps(cell, sweeps, settings=problem.follow, exact=scene.collides)
    planned, lost = _planned(problem, sweeps.T_world_scanner, followed)
    if lost:
        return refused(lost)
    plan = stitch(
        cell,
        FilteredScene(scene),
        planned,
        settings=settings.stitch,
        method="best" if settings.method == "exact" else settings.method,
        rng=np.random.default_rng(settings.seed),
        sweep_checker=FilteredScene(scene.with_clearance(settings.stitch.sweep_clearance)),
    )
    if plan.left_out:
        first = plan.left_out[0]
        return refused(f"{problem.names[first.sweep]}: {first.reason}")
    return tried(_duration(plan), plan=_executed(problem, plan))


def _duration(plan: StitchedPlan) -> float:
    return float(sum(segment.motion.duration for segment in plan.segments))


def _executed(problem: PlacementProblem, plan: StitchedPlan) -> tuple[ExecutedSweep, ...]:
    """Return the sweeps of a plan in order, each by configurations at evenly spaced travels."""
    found = []
    for segment in plan.segments:
        if segment.sweep >= 0:
            states = segment.motion.position  # the last column is the travel
            done = np.abs(states[:, -1] - states[0, -1])
            at = np.linspace(0.0, done[-1], N_POSES)
            q = np.stack([np.interp(at, done, column) for column in states[:, :-1].T], axis=1)
            found.append(ExecutedSweep(problem.names[segment.sweep], q))
    return tuple(found)


def overlap_depths(problem: PlacementProblem, values: FloatArray) -> dict[tuple[str, str], float]:
    """Return how deep standing bodies stand in one another at a design, in m by their names, rest not counted."""
    cell = problem.moved_cell(values)
    overlaps, _ = standing_overlaps(cell, resting=problem.resting, permitted=problem.permitted)
    return {(overlap.body, overlap.other): overlap.depth for overlap in overlaps}


def _planned(
    problem: PlacementProblem, T_world_scanner: FloatArray, followed: FollowedSweeps
) -> tuple[list[PlannedSweep], str]:
    """Return what must be executed, or why a sweep can no longer be executed in full."""
    planned = []
    for number, name in enumerate(problem.names):
        rows = np.flatnonzero(followed.sweep == number)
        if len(rows) == 0:
            return [], f"{name} cannot be executed: {Cause(int(followed.outcome[number])).label}"
        start, end = float(followed.start[rows[0]]), float(followed.end[rows[0]])
        least = problem.required[number]
        if start > least[0] + SAME_TRAVEL or end < least[1] - SAME_TRAVEL:
            lost = max(start - least[0], 0.0) + max(least[1] - end, 0.0)
            return [], f"{name} would be {1e3 * lost:.0f} mm shorter"
        pieces = tuple(
            ExecutablePiece(int(followed.branch[row]), followed.start[row], followed.end[row], followed.q_start[row])
            for row in rows
            if followed.start[row] <= start + SAME_TRAVEL and followed.end[row] >= end - SAME_TRAVEL
        )
        planned.append(PlannedSweep(name, T_world_scanner[number], (start, end), pieces))
    return planned, ""
