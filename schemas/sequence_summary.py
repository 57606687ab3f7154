"""The figures of a sequence, gathered from its artefacts: for the report and the command line."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from schemas.motion import Verification
from schemas.tasks import TaskAlternatives, TaskList, TaskSequence

MOTION = "motion"
OPTIMAL = "optimal control"
"""How motions of optimal control were found."""

SEQUENCE_METRICS = frozenset(
    {
        "tasks",
        "alternatives",
        "alternatives_fewest",
        "alternatives_most",
        "alternatives_left_out",
        "cost",
        "lower_bound",
        "gap",
        "likely_bound",
        "likely_gap",
        "least_ratio",
        "motions_guessed",
        "motions_planned",
        "motions_possible",
        "duration_s",
        "moving_s",
        "strokes_s",
        "dwell_s",
        "direct_motions",
        "detours",
        "optimal_motions",
        "verified_states",
        "least_distance_m",
        "proven_distance_m",
        "weighted_cost",
        "weighted_travel",
        "weighted_work",
        "weighted_strokes",
        "weighted_holding",
        "weighted_time",
        "weighted_torque",
        "weighted_speed",
        "torque_share",
        "acceleration_share",
    }
)
"""Figures of a sequence that studies may show."""


def summarise_sequence(
    tasks: TaskList, alternatives: TaskAlternatives, sequence: TaskSequence, verification: Verification
) -> dict[str, Any]:
    """Return the figures of a sequence as plain JSON values, units in the names."""
    lengths = sequence.end_s - sequence.start_s
    motion = np.array([kind == MOTION for kind in sequence.kind], bool)
    dwell = float((sequence.leave_s - sequence.arrive_s).sum())
    per_task = np.bincount(alternatives.task, minlength=len(tasks.name))
    likely = sequence.likely_bound if math.isfinite(sequence.likely_bound) else None
    return {
        "tasks": len(tasks.name),
        "alternatives": len(alternatives.task),
        "alternatives_fewest": int(per_task.min()),
        "alternatives_most": int(per_task.max()),
        "alternatives_left_out": int(alternatives.n_left_out.sum()),
        "tasks_left_out": int((alternatives.n_left_out > 0).sum()),
        "cost_of": sequence.cost_name,
        "unit": sequence.unit,
        "cost": sequence.cost,
        "cost_is_cycle": _is_cycle(sequence),
        "lower_bound": sequence.lower_bound,
        "gap": _gap(sequence.cost, sequence.lower_bound),
        "likely_bound": likely,
        "likely_gap": None if likely is None else _gap(sequence.cost, likely),
        "least_ratio": None if likely is None else sequence.least_ratio,
        "motions_guessed": sequence.n_guessed,
        "proven": sequence.proven,
        "stopped_by": sequence.stopped_by,
        "motions_planned": sequence.n_evaluated,
        "motions_possible": sequence.n_motions,
        "orders": {
            name: cost if math.isfinite(cost) else None
            for name, cost in zip(sequence.order, sequence.order_cost.tolist(), strict=True)
        },
        "duration_s": float(sequence.time_s[-1]),
        "moving_s": float(lengths[motion].sum()),
        "strokes_s": float(lengths[~motion].sum()) - dwell,
        "dwell_s": dwell,
        "direct_motions": sum(via == "direct" for via in sequence.via),
        "detours": sum(via not in ("direct", OPTIMAL, "") for via in sequence.via),
        "optimal_motions": sum(via == OPTIMAL for via in sequence.via),
        "sequence": [tasks.name[row] for row in sequence.task],
        "arrivals_s": sequence.arrive_s.tolist(),
        "verified_states": verification.n_states,
        "verified_by": verification.engine,
        "least_distance_m": verification.least_distance_m if math.isfinite(verification.least_distance_m) else None,
        "proven_distance_m": verification.proven_distance_m if math.isfinite(verification.proven_distance_m) else None,
        "nearest_bodies": list(verification.nearest_bodies),
        "nearest_s": verification.nearest_s,
        "acceleration_share": sequence.acceleration_share if math.isfinite(sequence.acceleration_share) else None,
        "keeps_accelerations": sequence.keeps_accelerations,
        "keeps_torques": sequence.keeps_torques,
        "attention": _attention(sequence),
        **_weighted(sequence),
    }


def _is_cycle(sequence: TaskSequence) -> bool:
    """Tell whether the cost is the time that the sequence takes, and not another time by which it was ordered."""
    return sequence.unit == "s" and math.isclose(sequence.cost, float(sequence.time_s[-1]), rel_tol=1e-6)


def _attention(sequence: TaskSequence) -> list[str]:
    """Return what the sequence asks of the arm beyond limits that it was not planned by, and what mends it."""
    if sequence.keeps_torques or sequence.torque_share <= 1.0:
        return []
    return [
        f"the largest torque is {sequence.torque_share:.1%} of its limit, since motions in time keep speeds and "
        "accelerations alone: set planner.motions or planner.cost to optimal_control, lower robot.max_acceleration, or "
        "carry less"
    ]


def _gap(cost: float, bound: float) -> float:
    return 0.0 if cost <= 0 else max(0.0, 1.0 - bound / cost)


def _weighted(sequence: TaskSequence) -> dict[str, Any]:
    """Return what the sequence costs in time, torque and speed, and where; none where dynamics do not count."""
    time, effort, velocity = sequence.weight_time, sequence.weight_torque, sequence.weight_speed
    if time <= 0.0:
        return {}
    motion = np.array([kind == MOTION for kind in sequence.kind], bool)
    parts = np.stack(
        [
            time * (sequence.end_s - sequence.start_s),
            effort * sequence.torque_squared_n2m2s,
            velocity * sequence.speed_squared_rad2_s,
        ]
    )  # (parts, segments)
    stays = sequence.leave_s - sequence.arrive_s
    holding = float((time * stays + effort * sequence.holding_n2m2s).sum())
    work = float(parts[:, ~motion].sum())
    return {
        "weighted_cost": float(parts.sum()),
        "weighted_travel": float(parts[:, motion].sum()),
        "weighted_work": work,
        "weighted_strokes": max(0.0, work - holding),
        "weighted_holding": holding,
        "weighted_time": float(parts[0].sum()),
        "weighted_torque": float(parts[1].sum()),
        "weighted_speed": float(parts[2].sum()),
        "torque_share": sequence.torque_share,
    }


def distance_words(figures: dict[str, Any]) -> str:
    """Say how near bodies come; a proven least distance is rounded down."""
    if figures["least_distance_m"] is None:
        return "–"
    at_least = math.floor(1e5 * figures["proven_distance_m"]) / 100
    between = " and ".join(figures["nearest_bodies"])
    return f"{1e3 * figures['least_distance_m']:.2f} mm (proven {at_least:.2f}), {between}"


def alternatives_words(figures: dict[str, Any]) -> str:
    """Say how many alternatives there are, and how many ways were left out."""
    kept = f"{figures['alternatives']:,}"
    if not figures["alternatives_left_out"]:
        return kept
    tasks = figures["tasks_left_out"]
    return (
        f"{kept} kept, at most {figures['alternatives_most']} a task (planner.max_alternatives); "
        f"{figures['alternatives_left_out']:,} further ways of {tasks} task{'s' * (tasks != 1)} left out untried"
    )


def acceleration_words(figures: dict[str, Any]) -> str:
    """Say how far motions exceed acceleration limits that they do not keep, and what they keep; or nothing."""
    if figures["acceleration_share"] is None or figures["keeps_accelerations"]:
        return ""
    return (
        f"{figures['acceleration_share']:.3g} times its stated limit; motions keep torque limits instead, see "
        "planner.keep_accelerations"
    )


def cost_label(figures: dict[str, Any]) -> str:
    """Return what the cost is called: where it is a time, but not the cycle's, so that nobody takes it for that."""
    return "ordering cost" if figures["unit"] == "s" and not figures["cost_is_cycle"] else "cost"


def ordering_words(figures: dict[str, Any]) -> str:
    """Say what the tasks were ordered by where that is a time other than the cycle's; or nothing."""
    if cost_label(figures) == "cost":
        return ""
    by = {"velocity bound": "the slowest joint at full speed", "timed path": "the time of motions planned in time"}
    taken = "motions of optimal control" if figures["keeps_torques"] else "timed motions"
    return f"{by.get(figures['cost_of'], figures['cost_of'])}; not the cycle time, which is that of {taken}"


def bound_words(figures: dict[str, Any]) -> str:
    """Say what is proven of the sequence, and what is likely where guesses were measured."""
    unit = figures["unit"]
    bound = f"{figures['lower_bound']:.2f} {unit}".strip()
    if figures["proven"]:
        return f"{bound} (proven: no other sequence over the motions found is cheaper)"
    gap = f"(gap {figures['gap']:.1%}, stopped by {figures['stopped_by']})"
    if figures.get("likely_bound") is None:
        return f"{bound} {gap}"
    likely = f"{figures['likely_bound']:.2f} {unit}".strip()
    return (
        f"{bound} proven {gap}; {likely} (gap {figures['likely_gap']:.1%}) if no motion is cheaper than "
        f"{figures['least_ratio']:.2f} of its guess, as none was of the {figures['motions_guessed']:,} that were "
        "planned, other orders included"
    )
