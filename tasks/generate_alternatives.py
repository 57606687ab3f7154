"""Find all ways to perform each task: inverse-kinematics branches, free turns of the tool, windings of the joints.

Method in `cellwright.solvers.pose_tasks.alternatives`. Ways are checked for collisions with the exact bodies, at the
task and along the stroke; of a task that is left without any the message says what is in its way.
"""

from __future__ import annotations

import math

from pydantic import Field

from cellwright.errors import InfeasibleError
from schemas.params import Params
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage
from schemas.tasks import TaskAlternatives, TaskList

MOST_SHOWN = 5


class AlternativeParams(Params):
    """Settings of the alternatives."""

    max_alternatives: int = Field(
        default=24, ge=1, le=1000, description="Alternatives kept of each task, those nearest to the start."
    )
    max_in_all: int = Field(
        default=4000, ge=1, le=20_000, description="Alternatives of all tasks together: their pairs fill a table."
    )
    same_rad: float = Field(
        default=math.radians(1.0), ge=0, description="Alternatives that differ by less in every joint are one."
    )
    clearance_m: float = Field(default=0.0, ge=0, le=0.5, description="Distance to keep between bodies.")
    touches: tuple[tuple[str, str], ...] = Field(
        default=(), description="Pairs of bodies that may touch while a task is worked on."
    )


@stage(version=2)
def generate_alternatives(
    cell: CellModel, tasks: TaskList, *, params: AlternativeParams, progress: Progress = no_progress
) -> TaskAlternatives:
    """Find the collision-free alternatives of all tasks.

    Raises:
        InfeasibleError: If a task has none; it names the tasks and what is in their way.
        InvalidInputError: If ``touches`` names no body.
    """
    import numpy as np

    from cellwright.cell.scene import Scene
    from cellwright.solvers.pose_tasks.alternatives import AlternativeSettings, task_alternatives
    from schemas.cell_objects import build_cell
    from schemas.task_objects import at_work, pose_tasks

    built, listed_tasks = build_cell(cell), pose_tasks(tasks)
    most = max(1, min(params.max_alternatives, params.max_in_all // len(listed_tasks)))
    found, tallies = task_alternatives(
        built,
        listed_tasks,
        Scene(at_work(built, params.touches), params.clearance_m),
        Scene(built, params.clearance_m),
        AlternativeSettings(most, params.same_rad),
        params.clearance_m,
        progress,
    )
    hopeless = [
        f"{task.name!r}: {tally.reason(task, params.clearance_m)}"
        for task, tally in zip(listed_tasks, tallies, strict=True)
        if not tally.n_kept
    ]
    if hopeless:
        raise InfeasibleError(_hopeless_words(hopeless, len(listed_tasks)))
    n_joints = built.robot.n_joints
    return TaskAlternatives(
        task=np.array([each.task for each in found], np.int32),
        rotation_rad=np.array([each.rotation for each in found], float),
        branch=np.array([each.branch for each in found], np.int8),
        position_rad=np.array([each.q_task for each in found], float).reshape(-1, n_joints),
        entry_rad=np.array([each.q_entry for each in found], float).reshape(-1, n_joints),
        stroke_s=np.array([each.stroke for each in found], float),
        n_reached=np.array([tally.n_reached for tally in tallies], np.int32),
        n_solutions=np.array([tally.n_solutions for tally in tallies], np.int32),
        n_within_limits=np.array([tally.n_within_limits for tally in tallies], np.int32),
        n_blocked=np.array([sum(tally.blocked.values()) for tally in tallies], np.int32),
        n_left_out=np.array([tally.n_left_out for tally in tallies], np.int32),
    )


def _hopeless_words(hopeless: list[str], n_tasks: int) -> str:
    if len(hopeless) == 1:
        return f"cannot do task {hopeless[0]}"
    more = [f"  and {len(hopeless) - MOST_SHOWN} more"] if len(hopeless) > MOST_SHOWN else []
    lines = [f"  {line}" for line in hopeless[:MOST_SHOWN]]
    return "\n".join([f"{len(hopeless)} of {n_tasks} tasks cannot be performed:", *lines, *more])
