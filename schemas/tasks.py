"""Artefacts of sequencing: the tasks, the ways to perform them, the sequence as a timed motion, its report."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from cellwright.arrays import FloatArray, Int8Array, Int32Array
from schemas.artefact import Artefact
from schemas.columns import ANY_WIDTH, blob, column, fact, torque_column

MOST_TASKS = 2000
"""More than the search can order to some purpose."""
MOST_ROTATIONS = 360
"""Turns about the tool's axis that may be tried of a task."""


@dataclass(frozen=True, eq=False, repr=False)
class TaskList(Artefact):
    """Tasks at poses of the tool, as they are listed."""

    KIND: ClassVar[str] = "task-list"

    name: tuple[str, ...] = column("Name of the task", dtype="str", table="tasks")
    T_world_tool: FloatArray = column(
        "Pose of the tool point at the task, a 4x4 matrix row by row", width=16, frame="world", table="tasks"
    )
    n_rotations: Int32Array = column("Turns about the tool's axis that are free", dtype="int32", table="tasks")
    dwell_s: FloatArray = column("Time at the pose", unit="s", table="tasks")
    approach_m: FloatArray = column("Way along the tool's axis in which it comes and goes", unit="m", table="tasks")
    before: Int32Array = column(
        "Pairs of tasks, the first somewhere before the second", dtype="int32", width=2, table="precedence"
    )


@dataclass(frozen=True, eq=False, repr=False)
class TaskAlternatives(Artefact):
    """Collision-free ways to perform the tasks, task by task."""

    KIND: ClassVar[str] = "task-alternatives"

    task: Int32Array = column("Row of the task", dtype="int32", table="alternatives")
    rotation_rad: FloatArray = column("Turn about the tool's axis", unit="rad", table="alternatives")
    branch: Int8Array = column("Row that inverse kinematics gave it", dtype="int8", table="alternatives")
    position_rad: FloatArray = column("Joint positions at the task", width=ANY_WIDTH, unit="rad", table="alternatives")
    entry_rad: FloatArray = column(
        "Joint positions at the outer end of the approach", width=ANY_WIDTH, unit="rad", table="alternatives"
    )
    stroke_s: FloatArray = column("Time of one stroke along the approach", unit="s", table="alternatives")
    n_reached: Int32Array = column("Turns of a task that the arm reaches", dtype="int32", table="tasks")
    n_solutions: Int32Array = column("Solutions of its inverse kinematics", dtype="int32", table="tasks")
    n_within_limits: Int32Array = column("Solutions within the joint limits", dtype="int32", table="tasks")
    n_blocked: Int32Array = column("Solutions tried that collide", dtype="int32", table="tasks")
    n_left_out: Int32Array = column(
        "Ways within the joint limits not tried, as enough were kept", dtype="int32", table="tasks"
    )


@dataclass(frozen=True, eq=False, repr=False)
class TaskSequence(Artefact):
    """The sequence and its motion; a state at which two segments meet is stored once, as one of the earlier."""

    KIND: ClassVar[str] = "task-sequence"

    time_s: FloatArray = column("Time since the start", unit="s", table="states")
    position_rad: FloatArray = column("Joint positions", width=ANY_WIDTH, unit="rad", table="states")
    velocity_rad_s: FloatArray = column("Joint velocities", width=ANY_WIDTH, unit="rad/s", table="states")
    acceleration_rad_s2: FloatArray = column("Joint accelerations", width=ANY_WIDTH, unit="rad/s^2", table="states")
    torque_nm: FloatArray = torque_column("dynamics do not count")
    segment: Int32Array = column("Segment that the state belongs to", dtype="int32", table="states")
    kind: tuple[str, ...] = column("motion, or work: stroke, dwell and stroke", dtype="str", table="segments")
    stop: Int32Array = column("Stop of the work; -1 on a motion", dtype="int32", table="segments")
    start_s: FloatArray = column("Time at which the segment begins", unit="s", table="segments")
    end_s: FloatArray = column("Time at which it ends", unit="s", table="segments")
    via: tuple[str, ...] = column("How a motion was found; empty on work", dtype="str", table="segments")
    torque_squared_n2m2s: FloatArray = column(
        "Integral of the squared joint torques; NaN where dynamics do not count",
        unit="N^2 m^2 s",
        table="segments",
    )
    speed_squared_rad2_s: FloatArray = column(
        "Integral of the squared joint speeds; NaN where dynamics do not count",
        unit="rad^2/s",
        table="segments",
    )
    task: Int32Array = column("Task of the stop", dtype="int32", table="stops")
    alternative: Int32Array = column("Its alternative", dtype="int32", table="stops")
    arrive_s: FloatArray = column("Time at which the tool is at the task's pose", unit="s", table="stops")
    leave_s: FloatArray = column("Time at which it leaves it", unit="s", table="stops")
    holding_n2m2s: FloatArray = column(
        "Of the segment's squared torques those that hold the arm at the task; NaN where dynamics do not count",
        unit="N^2 m^2 s",
        table="stops",
    )
    order: tuple[str, ...] = column("Orders that were compared", dtype="str", table="orders")
    order_cost: FloatArray = column("Cost of the order, infinite where a way has no motion", table="orders")
    cost_name: str = fact("What was minimised", dtype="str")
    unit: str = fact("Unit of the costs", dtype="str")
    cost: float = fact("Cost of the sequence: motions, strokes and dwells")
    lower_bound: float = fact("No sequence of these alternatives costs less over the motions found")
    proven: bool = fact("Whether none can be cheaper over the motions found", dtype="bool")
    stopped_by: str = fact("What ended the search", dtype="str")
    n_evaluated: int = fact("Motions planned until the sequence was known", dtype="int64")
    n_motions: int = fact("Motions that there are between alternatives", dtype="int64")
    weight_time: float = fact("What a second costs where dynamics count, else 0", unit="1/s")
    weight_torque: float = fact("What squared torques cost", unit="1/(N^2 m^2 s)")
    weight_speed: float = fact("What squared speeds cost", unit="s/rad^2")
    torque_share: float = fact("Largest torque as a share of its limit where dynamics count, else 0")
    likely_bound: float = fact(
        "No sequence costs less if no motion is cheaper than ``least_ratio`` of its guess; not a number where the cost "
        "does not guess",
        default=math.nan,
    )
    least_ratio: float = fact(
        "Least true cost over guess of the motions planned, rounded down to hundredths", default=math.nan
    )
    n_guessed: int = fact("Motions planned that were guessed at before", dtype="int64", default=0)
    acceleration_share: float = fact("Greatest joint acceleration as a share of its limit", default=math.nan)
    keeps_torques: bool = fact("Whether motions keep torque limits", dtype="bool", default=False)
    keeps_accelerations: bool = fact("Whether motions keep acceleration limits", dtype="bool", default=True)


@dataclass(frozen=True, eq=False, repr=False)
class SequenceReport(Artefact):
    """The report of one sequence: self-contained HTML, its figures as PNG, the summary as JSON."""

    KIND: ClassVar[str] = "sequence-report"

    page: bytes = blob("The report, one self-contained page", suffix=".html")
    path_png: bytes = blob("The cell with the way of the tool", suffix=".png")
    orders_png: bytes = blob("Where the time goes, and the orders compared", suffix=".png")
    plan_png: bytes = blob("The sequence over time: joints and segments", suffix=".png")
    summary: str = fact("Figures of the sequence as JSON", dtype="str")
