"""The sequence file: a robot with a tool, what stands around it, and tasks whose order is to be found.

It is written as a cell file is: quantities with units, faults with file, line, key, value and mend.
`docs/sequence-file.md` lists every key.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationError, ValidationInfo, model_validator

from cellwright import quantities
from cellwright.arrays import FloatArray
from cellwright.cell.cell import PART
from cellwright.cell.task_tables import SUFFIXES
from cellwright.errors import InvalidInputError
from schemas.cell_file import FORMAT, RobotSection
from schemas.cell_file_document import Document, Location, apply_overrides, read_document
from schemas.cell_file_fields import (
    Angle,
    BodySection,
    Length,
    NonNegativeLength,
    Number,
    PoseSection,
    Quantity,
    Section,
    SmallAngle,
    TableSection,
    Text,
    Unit,
    WholeNumber,
    existing_file,
    fault,
    resolved,
)
from schemas.cell_file_messages import faults_of, refusal
from schemas.cell_file_robot import robot_faults
from schemas.cell_file_sequencing import Mass, SpeedWeight, Steps, WeightsSection
from schemas.poses import Pose
from schemas.task_order import order_faults
from schemas.tasks import MOST_ROTATIONS, MOST_TASKS

Dwell = Annotated[float, Quantity(quantities.TIME, least=0.0, most=3600.0)]
Rotations = Annotated[WholeNumber, Field(ge=1, le=MOST_ROTATIONS)]


def _one_or_more(value: object) -> object:
    """Take one name as a list of one."""
    return [value] if isinstance(value, str | int | float) and not isinstance(value, bool) else value


def _table_file(value: object, info: ValidationInfo) -> Path:
    return existing_file(resolved(value, info), SUFFIXES)


def _end(value: object) -> object:
    if isinstance(value, str) and value not in ("return", "anywhere"):
        raise fault(f"{value!r} is no end: write return, anywhere, or the joint angles [.. deg, ...]")
    return value


class PayloadSection(Section):
    """What the flange carries, tool included, as a point; it counts where torques do, see `planner.weights`."""

    mass_kg: Mass = Field(alias="mass", description="Its mass.", examples=["60 kg"])
    centre_m: tuple[Length, Length, Length] = Field(
        default=(0.0, 0.0, 0.0), alias="centre", description="Its centre of mass in the frame of the flange link."
    )


class ToolSection(Section):
    """What hangs on the flange, and its working point."""

    tip: PoseSection = Field(
        default=PoseSection(),
        description="Pose of the tool point on the flange link; its z axis points out of the tool, into the work.",
    )
    bodies: tuple[BodySection, ...] = Field(default=(), description="Bodies of the tool, posed on the flange link.")
    touches: tuple[tuple[Text, Text], ...] = Field(
        default=(),
        description="Pairs of bodies or links that may touch while a task is worked on, and never else.",
    )
    payload: PayloadSection | None = Field(default=None, description="What the flange carries, tool included.")


class WorkpieceSection(BodySection):
    """The workpiece: a body whose frame tasks can be given in."""

    name: Text = Field(default="workpiece", description="Name of the body.")


class TaskSection(Section):
    """One task: a pose of the tool point."""

    name: Text = Field(description="Name of the task, unique.")
    position_m: tuple[Length, Length, Length] = Field(
        alias="position", description="Where the tool point has to be.", examples=["[600 mm, 0 mm, 200 mm]"]
    )
    direction: tuple[Number, Number, Number] | None = Field(
        default=None, description="Direction of the tool's z axis, of any length; turns about it are free."
    )
    rotation_rad: tuple[Angle, Angle, Angle] | None = Field(
        default=None, alias="rotation", description="Roll, pitch, yaw of the tool, instead of `direction`."
    )
    quaternion: tuple[Number, Number, Number, Number] | None = Field(
        default=None, description="Orientation (w, x, y, z) of the tool, instead of `direction`."
    )
    rotations: Rotations | None = Field(
        default=None,
        description="Turns about the tool's z axis that are tried; that of `tasks`, 1 with a whole orientation.",
    )
    dwell_s: Dwell | None = Field(default=None, alias="dwell", description="Time at the pose; that of `tasks`.")
    approach_m: NonNegativeLength | None = Field(
        default=None, alias="approach", description="Straight way to the pose and back; that of `tasks`."
    )
    after: Annotated[tuple[Text, ...], BeforeValidator(_one_or_more)] = Field(
        default=(), description="Names of tasks that come before this one."
    )

    @model_validator(mode="after")
    def _one_orientation(self) -> Self:
        given = [name for name in ("direction", "rotation_rad", "quaternion") if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(name.removesuffix("_rad") for name in given) or "no direction"
            raise fault(f"task {self.name!r} has {found}: give it one of direction, rotation, quaternion")
        if self.direction is not None and math.hypot(*self.direction) < 1e-9:
            raise fault(f"the direction of task {self.name!r} has no length: write one like [0, 0, -1]")
        if self.quaternion is not None and abs(math.hypot(*self.quaternion) - 1.0) > 1e-3:
            raise fault(f"quaternion has length {math.hypot(*self.quaternion):.6g}: scale it to 1")
        return self

    def pose(self) -> Pose:
        """Return the pose of a task with a whole orientation."""
        section = PoseSection.model_construct(
            position_m=self.position_m, rotation_rad=self.rotation_rad, quaternion=self.quaternion
        )
        return section.pose()


class TasksSection(Section):
    """The tasks and what they share."""

    frame: Literal["world", "part"] = Field(default="world", description="Frame in which `pose` is given.")
    pose: PoseSection = Field(
        default=PoseSection(), description="Pose, in that frame, of the frame in which tasks are given."
    )
    rotations: Rotations = Field(
        default=12, description="Turns about the tool's z axis that are tried of tasks with a direction."
    )
    dwell_s: Dwell = Field(default=0.0, alias="dwell", description="Time at the pose.")
    approach_m: NonNegativeLength = Field(
        default=0.0, alias="approach", description="Straight way along the tool's z axis to the pose, and back."
    )
    list: tuple[TaskSection, ...] = Field(default=(), max_length=MOST_TASKS, description="The tasks.")
    file: Annotated[Path, BeforeValidator(_table_file)] | None = Field(
        default=None, description="Table of further tasks: CSV (`x,y,z,dx,dy,dz`) or HDF5 (`targets`)."
    )
    unit: Unit = Field(default="mm", description="Unit of the positions in a CSV table; HDF5 holds m.")

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not self.list and self.file is None:
            raise fault("holds no task: write some below `list`, or name a table by `file`")
        if len(self.pose.position_m) != 3:
            raise fault("pose has 2 entries in position but needs 3: write [x, y, z]")
        return self


class TaskWeightsSection(WeightsSection):
    """Weights of the cost, the integral of time + torque u·u + speed q̇·q̇ over joint torques u and joint speeds q̇."""

    speed_s_per_rad2: SpeedWeight = 1.0


class SequencePlannerSection(Section):
    """What is looked for, and how much work goes into it."""

    cost: Literal["time", "velocity", "optimal_control"] = Field(
        default="time",
        description="Time of collision-free, accelerated motions; of the slowest joint at full speed; or time, torque "
        "and speed weighed together.",
    )
    motions: Literal["by_cost", "optimal_control"] = Field(
        default="by_cost",
        description="Motions as the cost has them; or those of optimal control along the sequence that it leads to.",
    )
    weights: TaskWeightsSection | None = Field(
        default=None,
        description="Weights of the cost of optimal control; where they are given, other sequences are priced by them "
        "too.",
    )
    steps: Steps = 20
    keep_accelerations: bool = Field(
        default=False,
        description="Whether motions of optimal control keep acceleration limits beside torque limits.",
    )
    start: Literal["home", "anywhere"] = Field(
        default="home", description="Begin at `robot.start`, or at the first task."
    )
    end: Annotated[Literal["return", "anywhere"] | tuple[Angle, ...], BeforeValidator(_end)] = Field(
        default="return", description="Come back to where it began, end at the last task, or at given joint angles."
    )
    clearance_m: NonNegativeLength = Field(
        default=0.005, alias="clearance", le=0.5, description="Distance that bodies keep, but for pairs that may touch."
    )
    max_alternatives: Annotated[WholeNumber, Field(ge=1, le=1000)] = Field(
        default=24, description="Alternatives kept of each task: those nearest to the start."
    )
    max_motions: Annotated[WholeNumber, Field(ge=1, le=1_000_000)] = Field(
        default=400, description="Motions to plan at most; then the best sequence so far is taken, with its gap."
    )
    target_gap: Annotated[float, Quantity(quantities.SHARE, least=0.0, most=0.99)] = Field(
        default=0.01, description="Share by which the proven bound may stay below the cost when the search ends."
    )
    max_work: Annotated[float, Quantity(quantities.NUMBER, above=0.0)] = Field(
        default=1e10, description="Sums and comparisons of each proof; the default is some seconds' worth."
    )
    roadmap_nodes: Annotated[WholeNumber, Field(ge=10, le=20_000)] = Field(
        default=600, description="Random configurations of the roadmap to begin with."
    )
    neighbours: Annotated[WholeNumber, Field(ge=1, le=200)] = Field(
        default=12, description="Neighbours that a configuration is joined to."
    )
    step_rad: SmallAngle = Field(
        default=math.radians(1.0), alias="step", description="Joint turn between checked states while searching."
    )
    seed: Annotated[WholeNumber, Field(ge=0, le=2**31)] = Field(
        default=0, description="Seed of roadmap, search and shortening."
    )


class SequenceReportSection(Section):
    """Words on the report."""

    title: Text | None = Field(default=None, description="Heading; the cell's name if left out.")
    notes: Text | None = Field(default=None, description="A remark below the heading.")


class SequenceFile(Section):
    """A whole sequence file."""

    _path: Path = PrivateAttr(default=Path())

    version: Literal[1] = Field(alias="cellwright", description="Version of the file: 1.", examples=["1"])
    name: Text = Field(description="Name of the cell; the file's name if left out.")
    robot: RobotSection = Field(default=RobotSection(), description="The arm.")
    tool: ToolSection = Field(default=ToolSection(), description="The tool.")
    part: WorkpieceSection | None = Field(default=None, description="The workpiece.")
    table: TableSection | None = Field(default=None, description="The table.")
    fixture: tuple[BodySection, ...] = Field(default=(), description="Bodies that hold the part.")
    obstacles: tuple[BodySection, ...] = Field(default=(), description="Everything else that stands in the way.")
    may_touch: tuple[tuple[Text, Text], ...] = Field(
        default=(), description="Pairs of bodies or links, by name, that may touch each other at any time."
    )
    tasks: TasksSection = Field(description="The tasks.", examples=["{list: [...]}"])
    planner: SequencePlannerSection = Field(default=SequencePlannerSection(), description="How the planner works.")
    report: SequenceReportSection = Field(default=SequenceReportSection(), description="Words on the report.")

    @property
    def path(self) -> Path:
        """The file that it was read from."""
        return self._path

    def bodies(self) -> tuple[BodySection, ...]:
        """Return all standing bodies: part, table, fixture, obstacles."""
        return tuple(body for where, body in located_bodies(self) if where[0] != "tool")

    def T_world_tasks(self) -> FloatArray:
        """Return the pose of the frame in which tasks are given, (4, 4)."""
        T = self.tasks.pose.matrix()
        return T if self.tasks.frame == "world" or self.part is None else self.part.pose.matrix() @ T


def load_sequence_file(path: Path | str, overrides: Sequence[str] = ()) -> SequenceFile:
    """Read and check a sequence file, with settings (``path.to.field=value``) laid over it.

    Raises:
        InvalidInputError: If anything in it is malformed; up to five faults are shown with line, key and mend.
    """
    document = read_document(Path(path), "sequence file")
    apply_overrides(document, overrides)
    version = document.data.get("cellwright")
    if "cellwright" in document.data and (version != FORMAT or isinstance(version, bool)):
        raise refusal(
            document, [(("cellwright",), f"{version!r} is another version: this release reads cellwright: {FORMAT}")]
        )
    _refuse_other_kinds(document)
    data: dict[str, Any] = {"name": document.path.stem, **document.data}
    try:
        file = SequenceFile.model_validate(data, context={"folder": document.path.parent})
    except ValidationError as error:
        raise refusal(document, faults_of(error, SequenceFile, document)) from error
    file._path = document.path
    faults = _disagreements(file, document)
    if faults:
        raise refusal(document, faults)
    return file


def _refuse_other_kinds(document: Document) -> None:
    if "tasks" in document.data:
        return
    for key, command in (("scanner", "inspect"), ("stations", "layout")):
        if key in document.data:
            raise InvalidInputError(
                f"{document.path} has no tasks but {key!r}: it is a file for `cellwright {command}`; a sequence file "
                "lists `tasks`"
            )


def located_bodies(file: SequenceFile) -> list[tuple[Location, BodySection]]:
    """Return all bodies with where they are written."""
    return [
        *([(("part",), file.part)] if file.part is not None else []),
        *([(("table",), file.table)] if file.table is not None else []),
        *((("fixture", number), body) for number, body in enumerate(file.fixture)),
        *((("obstacles", number), body) for number, body in enumerate(file.obstacles)),
        *((("tool", "bodies", number), body) for number, body in enumerate(file.tool.bodies)),
    ]


def _disagreements(file: SequenceFile, document: Document) -> list[tuple[Location, str]]:
    """Find values that are sound by themselves but do not go together."""
    named = [(location, body.name) for location, body in located_bodies(file)]
    faults = robot_faults(file.robot, named, file.may_touch)
    touches = robot_faults(file.robot, named, file.tool.touches)
    faults += [(("tool", "touches", *where[1:]), words) for where, words in touches if where[0] == "may_touch"]
    for where, pose in ((("robot", "base"), file.robot.base), (("tool", "tip"), file.tool.tip)):
        if len(pose.position_m) != 3:
            faults.append(((*where, "position"), "has 2 entries but needs 3: write [x, y, z]"))
    seen: dict[str, Location] = {}
    for location, body in located_bodies(file):
        if body.name == PART:
            faults.append(((*location, "name"), f"{PART!r} is a reserved name: choose another"))
        elif body.name in seen:
            first = document.origin(seen[body.name])
            faults.append(((*location, "name"), f"{body.name!r} names another body too ({first}): choose another"))
        seen.setdefault(body.name, location)
        if body.mesh is not None and body.mesh.unit and body.mesh.file.suffix.lower() in (".step", ".stp", ".3mf"):
            words = f"{body.mesh.file.name} carries its own unit: remove `unit: {body.mesh.unit}`"
            faults.append(((*location, "mesh", "unit"), words))
    if file.tasks.frame == "part" and file.part is None:
        faults.append((("tasks", "frame"), "is part, but there is no part: add one, or write world"))
    return faults + _task_faults(file) + _end_faults(file)


def _task_faults(file: SequenceFile) -> list[tuple[Location, str]]:
    faults: list[tuple[Location, str]] = []
    if file.tasks.file is None:  # else names may stand in the table, which is read when the run begins
        found = order_faults([(task.name, task.after) for task in file.tasks.list])
        faults += [(("tasks", "list", row, key), words) for row, key, words in found]
    if (
        any(task.after for task in file.tasks.list)
        and file.planner.start == "anywhere"
        and file.planner.end == "return"
    ):
        words = "a round trip that starts anywhere has no first task, so none comes after another"
        faults.append((("planner", "start"), f"{words}: write home, or end: anywhere"))
    return faults


def _end_faults(file: SequenceFile) -> list[tuple[Location, str]]:
    end = file.planner.end
    if isinstance(end, str) or len(end) == 6:
        return []
    return [(("planner", "end"), f"has {len(end)} entries but the robot has 6 joints: write one each")]
