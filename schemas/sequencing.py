"""The artefact of the sequencing stage: the sequence of sweeps that was found, its motion, and what others take."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from cellwright.arrays import BoolArray, FloatArray, Int8Array, Int32Array
from schemas.artefact import Artefact
from schemas.columns import ANY_WIDTH, blob, column, fact, torque_column

MOTION_COLUMNS = (
    "time_s", "position_rad", "velocity_rad_s", "acceleration_rad_s2", "torque_nm", "segment", "travel_m", "kind",
    "view", "branch", "direction", "start_s", "end_s", "via",
)  # fmt: skip
"""What a sequence and a trajectory have in common."""


@dataclass(frozen=True, eq=False, repr=False)
class SweepSequence(Artefact):
    """The plan through all executed sweeps under a cost, beside the greedy and the stitched one.

    Where no cheaper plan than the stitched one was found there are no states and no segments.
    """

    KIND: ClassVar[str] = "sweep-sequence"

    plan: tuple[str, ...] = column("greedy, exact, ..., sequence: plans that are compared", dtype="str", table="plans")
    duration_s: FloatArray = column("Duration of the whole plan", unit="s", table="plans")
    effort_n2m2s: FloatArray = column("Integral of squared joint torques; NaN without dynamics", table="plans")
    work_j: FloatArray = column(
        "Mechanical work without feedback: integral of abs(torque * speed); NaN without dynamics",
        unit="J",
        table="plans",
    )
    cost: FloatArray = column("What it costs, as asked", table="plans")
    torque_share: FloatArray = column("Greatest share of a torque limit; NaN without dynamics", table="plans")
    taken: BoolArray = column("Whether it is the plan", dtype="bool", table="plans")
    time_s: FloatArray = column("Time since the start", unit="s", table="states")
    position_rad: FloatArray = column("Joint positions", width=ANY_WIDTH, unit="rad", table="states")
    velocity_rad_s: FloatArray = column("Joint velocities", width=ANY_WIDTH, unit="rad/s", table="states")
    acceleration_rad_s2: FloatArray = column("Joint accelerations", width=ANY_WIDTH, unit="rad/s^2", table="states")
    torque_nm: FloatArray = torque_column("only time counts")
    segment: Int32Array = column("Segment that the state belongs to", dtype="int32", table="states")
    travel_m: FloatArray = column("Travel along the sweep; NaN on a connection", unit="m", table="states")
    kind: tuple[str, ...] = column("sweep or connection", dtype="str", table="segments")
    view: Int32Array = column("View of a sweep; -1 on a connection", dtype="int32", table="segments")
    branch: Int8Array = column("Branch of a sweep; -1 on a connection", dtype="int8", table="segments")
    direction: Int8Array = column("1 or -1 on a sweep, 0 on a connection", dtype="int8", table="segments")
    start_s: FloatArray = column("Time at which the segment begins", unit="s", table="segments")
    end_s: FloatArray = column("Time at which it ends", unit="s", table="segments")
    via: tuple[str, ...] = column(
        "How a connection was found: direct, roadmap or optimal control", dtype="str", table="segments"
    )
    stitched_torque_nm: FloatArray = column(
        "Joint torques at the states of the stitched plan, N on slides; no row where only time counts",
        width=ANY_WIDTH,
        unit="N m",
        table="stitched",
    )
    cost_kind: str = fact("time or optimal_control", dtype="str")
    name: str = fact("What the sequenced plan is called among the plans", dtype="str")
    is_taken: bool = fact("Whether the sequence is cheaper than the stitched plan", dtype="bool")
    reason: str = fact("What was found, in words", dtype="str")
    lower_bound: float = fact("No sequence over the motions found costs less")
    proven: bool = fact("Whether no sequence over the motions found is cheaper: that is proven", dtype="bool")
    n_evaluated: int = fact("Motions between sweeps that were found", dtype="int64")
    n_motions: int = fact("Motions that there are", dtype="int64")
    n_joined: int = fact("Motions of the sequence that join sweeps without a stop", dtype="int64")
    n_stopped: int = fact("Motions of the sequence with stops, as no joining one was found", dtype="int64")
    greedy_before_s: float = fact("Greedy plan in the cell file's placement; NaN where nothing moved", unit="s")
    picture: bytes = blob("Power over time of the stitched plan and of the sequence; may be empty", suffix=".png")


def sequencing_figures(found: SweepSequence) -> dict[str, Any]:
    """Return what the summary of a plan says of its sequencing, as plain JSON values with units in the names."""
    plans = {
        name: {
            "duration_s": float(found.duration_s[row]),
            "effort_n2m2s": _plain(found.effort_n2m2s[row]),
            "work_j": _plain(found.work_j[row]),
            "cost": float(found.cost[row]),
            "torque_share": _plain(found.torque_share[row]),
        }
        for row, name in enumerate(found.plan)
    }
    stitched = [name for name in found.plan if name != found.name]
    return {
        "cost": found.cost_kind,
        "name": found.name,
        "stitched": stitched[-1] if stitched else "",
        "taken": found.is_taken,
        "reason": found.reason,
        "plans": plans,
        "lower_bound": _plain(found.lower_bound),
        "proven": found.proven,
        "motions_evaluated": found.n_evaluated,
        "motions": found.n_motions,
        "motions_joined": found.n_joined,
        "motions_with_stops": found.n_stopped,
        "greedy_before_s": _plain(found.greedy_before_s),
    }


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
