"""Go on from the best placements that were tried, along the gradient between certified hulls, and try what is found.

A step along the gradient of a whole plan (`cellwright.solvers.layout.placement_refinement`) knows neither the tests of
the judge nor the way around the workpiece. So it is kept short, shorter where the judge refuses what it leads to, and
only a true plan with a shorter cycle counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from cellwright.solvers.layout.bodies import Spheres
from cellwright.solvers.layout.placement import PlacementJudge
from cellwright.solvers.layout.placement_refinement import refine_design
from cellwright.solvers.layout.placement_trial import Trial, TrialSettings, overlap_depths, try_design

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
    depths = overlap_depths(judge.problem.cell, settings) if first else {}
    found: list[Trial] = []
    for number, trial in enumerate(first):
        for trust in TRUST:
            refined = refine_design(judge.problem, hulls, trial.plan, trial.values, trust=trust)
            if refined is None:
                continue
            bound = judge.judge(refined.values).cycle
            if bound < best - gain:
                found.append(try_design(judge.problem, refined.values, bound, settings, depths, GRADIENT))
                best = min(best, found[-1].cycle)
                break
        progress((number + 1) / len(first))
    progress(1.0)
    return found
