"""Go on from the best placements that were tried, along the gradient between certified hulls, and try what is found.

A step along the gradient of a whole plan (`cellwright.solvers.placement.refinement`) knows neither the tests of
the judge nor the way around the workpiece. So it is kept short, shorter where the judge refuses what it leads to, and
only a true plan with a shorter cycle counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from cellwright.solvers.layout.bodies import Spheres
from cellwright.solvers.placement.judge import PlacementJudge
from cellwright.solvers.placement.refinement import refine_design
from cellwright.solvers.placement.trial import Promise, Trial, TrialSettings, overlap_depths, try_design

TRUST = (0.1, 0.03)
"""Shares of the design joints' ranges that a step may change, tried in turn."""
GRADIENT = "gradient"
"""Method of the trials made here."""


def refine_trials(
    judge: PlacementJudge,
    trials: Sequence[Trial],
    hulls: Mapping[str, Spheres],
    settings: TrialSettings,
    *,
    most: int,
    gain: float,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Trial]:
    """Return the further trials, at most one for each of the ``most`` best ones.

    Args:
        judge: Of the problem.
        trials: What was tried; those that can be executed are gone on from, shortest cycle first.
        hulls: Certified spheres of bodies by name.
        settings: How placements are tried.
        most: Trials that are gone on from.
        gain: Seconds by which a design must promise to shorten the best cycle to be tried.
        progress: Hears the share done.
    """
    first = sorted((trial for trial in trials if np.isfinite(trial.cycle)), key=lambda trial: trial.cycle)[:most]
    best = min((trial.cycle for trial in first), default=np.inf)
    depths = overlap_depths(judge.problem, np.zeros(judge.problem.harness.n_joints)) if first else {}
    found: list[Trial] = []
    for number, trial in enumerate(first):
        promise = _promise(judge, trial, hulls, best - gain)
        if promise is not None:
            found.append(try_design(judge.problem, promise, settings, depths))
            best = min(best, found[-1].cycle)
        progress((number + 1) / len(first))
    progress(1.0)
    return found


def _promise(judge: PlacementJudge, trial: Trial, hulls: Mapping[str, Spheres], below: float) -> Promise | None:
    """Return what the gradient leads to from a trial, ``None`` if that provably takes no less than ``below`` s.

    The furthest step that is estimated to take less, else the one with the least estimate.
    """
    promises = []
    for trust in TRUST:
        refined = refine_design(judge.problem, hulls, trial.plan, trial.values, trust=trust)
        if refined is None:
            continue
        promise = Promise(refined.values, judge.judge(refined.values).estimate, judge.bound(refined.values), GRADIENT)
        if promise.estimate < below:
            return promise
        if promise.bound < below:
            promises.append(promise)
    return min(promises, key=lambda promise: promise.estimate, default=None)
