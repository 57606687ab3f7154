"""List the tasks of a station: those written in the cell file, and those of a table, all in the world."""

from __future__ import annotations

import math

from pydantic import Field

from cellwright.errors import InvalidInputError
from schemas.params import Params
from schemas.poses import Pose
from schemas.sources import SourceFile
from schemas.stage import stage
from schemas.tasks import MOST_ROTATIONS, MOST_TASKS, TaskList

FARTHEST = 1000.0
"""Metres from the frame of the tasks: beyond stands no task of an arm, but a wrong unit."""


class TaskParams(Params):
    """One task; what is left out is taken from the list's own settings."""

    name: str = Field(min_length=1, description="Name of the task.")
    position_m: tuple[float, float, float] = Field(description="Position of the tool point.")
    direction: tuple[float, float, float] | None = Field(
        default=None, description="Direction of the tool's z axis, of any length."
    )
    quaternion: tuple[float, float, float, float] | None = Field(
        default=None, description="Orientation (w, x, y, z) of the tool, in place of a direction."
    )
    n_rotations: int | None = Field(default=None, ge=1, le=MOST_ROTATIONS, description="Turns about the tool's axis.")
    dwell_s: float | None = Field(default=None, ge=0, description="Time at the pose.")
    approach_m: float | None = Field(default=None, ge=0, description="Way along the tool's axis.")
    after: tuple[str, ...] = Field(default=(), description="Tasks that come before it.")


class TaskListParams(Params):
    """The tasks and what they share."""

    tasks: tuple[TaskParams, ...] = Field(default=(), description="Tasks that are written out.")
    T_world_tasks: Pose = Field(default=Pose(), description="Pose in the world of the frame in which tasks are given.")
    metres_per_unit: float = Field(default=1e-3, gt=0, description="Unit of the lengths of a table, in m.")
    n_rotations: int = Field(
        default=12, ge=1, le=MOST_ROTATIONS, description="Turns about the axis of a task that is given by a direction."
    )
    dwell_s: float = Field(default=0.0, ge=0, description="Time at the pose.")
    approach_m: float = Field(default=0.0, ge=0, description="Way along the tool's axis.")


@stage(version=2)
def list_tasks(source: SourceFile | None, *, params: TaskListParams) -> TaskList:
    """List all tasks, those of the table ``source`` behind the written ones.

    Raises:
        InvalidInputError: If the table is malformed, there is no task, names are not unique, or what comes before what
            contradicts itself.
    """
    import numpy as np

    from cellwright.cell.task_tables import read_task_table
    from cellwright.cell.transforms import pose, rotation_from_quaternion
    from cellwright.solvers.pose_tasks.task import facing
    from schemas.task_order import task_order

    rows = list(params.tasks)
    places = [f"task {number} ({row.name})" for number, row in enumerate(rows, 1)]
    if source is not None:
        table = read_task_table(source.name, source.content)
        rows += [
            TaskParams(
                name=row.name,
                position_m=row.position(params.metres_per_unit),
                direction=row.direction,
                dwell_s=row.dwell,
                after=row.after,
            )
            for row in table
        ]
        places += [f"{source.name}, line {row.line}" for row in table]
    if not rows:
        raise InvalidInputError("there are no tasks: write at least one, or name a table of them")
    if len(rows) > MOST_TASKS:
        raise InvalidInputError(f"there are {len(rows)} tasks, but at most {MOST_TASKS} can be ordered: split them")
    T_world_tasks = params.T_world_tasks.matrix()
    T_world_tool = []
    for row, place in zip(rows, places, strict=True):
        position = np.array(row.position_m)
        if float(np.abs(position).max()) > FARTHEST:
            raise InvalidInputError(
                f"{place}: task {row.name!r} is {float(np.abs(position).max()):.3g} m away: correct it, or the unit of "
                "the table"
            )
        if row.direction is not None and math.hypot(*row.direction) > 1e-9:
            T = facing(position, np.array(row.direction))
        elif row.quaternion is not None:
            T = pose(position, rotation_from_quaternion(np.array(row.quaternion)))
        else:
            raise InvalidInputError(f"task {row.name!r} has no direction: give one, or an orientation")
        T_world_tool.append((T_world_tasks @ T).ravel())
    rotations = [
        (params.n_rotations if row.quaternion is None else 1) if row.n_rotations is None else row.n_rotations
        for row in rows
    ]
    return TaskList(
        name=tuple(row.name for row in rows),
        T_world_tool=np.array(T_world_tool),
        n_rotations=np.array(rotations, np.int32),
        dwell_s=np.array([params.dwell_s if row.dwell_s is None else row.dwell_s for row in rows]),
        approach_m=np.array([params.approach_m if row.approach_m is None else row.approach_m for row in rows]),
        before=np.array(task_order([(row.name, row.after) for row in rows], places), np.int32).reshape(-1, 2),
    )
