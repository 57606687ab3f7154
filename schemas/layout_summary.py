"""The figures of a layout, and in words why it is none."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cellwright.errors import listed
from cellwright.solvers.layout.solution import ITSELF
from schemas.layout import Layout

LAYOUT_METRICS = frozenset(
    {
        "cycle_s",
        "transition_s",
        "approach_s",
        "extra_cost_s",
        "before_cycle_s",
        "starts",
        "starts_passed",
        "median_cycle_s",
        "worst_cycle_s",
        "tracking_m",
        "penetration_m",
        "iterations",
    }
)
"""Figures of a layout that studies may show."""


def summary_of(layout: Layout) -> dict[str, Any]:
    """Return a layout's figures as plain values; units in the names."""
    passed = layout.trial_cycle_s[layout.trial_converged]
    return {
        "method": layout.method,
        "accelerations_limited": limits_accelerations(layout),
        "converged": layout.converged,
        "blocking": layout.blocking,
        "cycle_s": layout.cycle_s,
        "transition_s": layout.transition_s,
        "approach_s": layout.approach_s,
        "extra_cost_s": layout.extra_cost_s,
        "before_cycle_s": layout.before_cycle_s if math.isfinite(layout.before_cycle_s) else None,
        "starts": len(layout.trial_cycle_s),
        "starts_passed": len(passed),
        "median_cycle_s": float(np.median(passed)) if len(passed) else None,
        "worst_cycle_s": float(passed.max()) if len(passed) else None,
        "tracking_m": float(layout.trial_endpoint_m[layout.best_start]),
        "penetration_m": float(layout.trial_penetration_m[layout.best_start]),
        "iterations": int(layout.trial_iterations.sum()),
        "design": dict(zip(layout.design, layout.value.tolist())),
        "before": dict(zip(layout.design, layout.before.tolist())),
        "T_world_body": {name: matrix.reshape(4, 4).tolist() for name, matrix in zip(layout.body, layout.T_world_body)},
        "cycle_s_of_starts": layout.trial_cycle_s.tolist(),
        "relaxation": [
            {"requirement": what, "excess": excess, "unit": unit}
            for what, excess, unit in zip(layout.requirement, layout.excess.tolist(), layout.excess_unit)
        ],
    }


def limits_accelerations(layout: Layout) -> bool:
    """Return whether the motions keep acceleration limits; those of the other solvers keep speed limits alone."""
    return layout.method == "second_order"


def refusal_of(layout: Layout, *, sought: bool) -> str:
    """Say why a layout that has not converged is no result: what blocks, and the smallest relaxation found.

    ``sought`` says whether one was looked for.
    """
    n_starts = len(layout.trial_converged)
    tried = "the start missed its gate" if n_starts == 1 else f"none of {n_starts} starts passed its gate"
    if not sought:
        return (
            f"no layout was found: {tried}; the best of them is blocked: {layout.blocking}; what would have to give "
            "was not looked for: set solver.extras to true to have the smallest relaxation named"
        )
    if not layout.requirement:
        return (
            f"no layout was found: {tried}; the best of them is blocked: {layout.blocking}; every station can be "
            "reached where it may stand and nothing has to overlap there, so more starts (solver.starts) or another "
            f"seed may find a way{', and so may slower approaches' if layout.approach_s > 0.0 else ''}"
        )
    reliefs = listed(
        f"{what} (relax it by {_amount(excess, unit)})"
        for what, excess, unit in zip(layout.requirement, layout.excess.tolist(), layout.excess_unit)
    )
    mend = "move or free what is named, or widen its limits"
    if any(f"touches {ITSELF}," in what for what in layout.requirement):
        mend += (
            "; spheres of the robot's own links overlap, and few of them are much larger than what they hold: "
            "cover it with more (robot.hull.spheres)"
        )
    return f"no layout was found: {tried}; the smallest relaxation found that makes it feasible: {reliefs}: {mend}"


def _amount(excess: float, unit: str) -> str:
    if unit == "m":
        return f"{1e3 * excess:.4g} mm"
    return f"{math.degrees(excess):.4g} deg" if unit == "rad" else f"{excess:.4g} {unit}"
