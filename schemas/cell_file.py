"""The cell file: what stands in the cell, what is to be inspected, and how the planner goes about it.

People write quantities with units; the models hold SI. Every fault is reported with its file, line, key, value and
the way to mend it, several at once. `docs/cell-file.md` lists every key.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, ValidationError, ValidationInfo, model_validator

from cellwright.arrays import FloatArray
from cellwright.cell.built_in_robots import BUILT_IN
from cellwright.cell.cell import PART
from cellwright.errors import InvalidInputError
from schemas.cell_file_document import Document, Location, apply_overrides, read_document
from schemas.cell_file_fields import (
    Angle,
    AngularAcceleration,
    AngularSpeed,
    Aperture,
    BodySection,
    BoxSection,
    Folder,
    Frequency,
    Incidence,
    MeshFile,
    PoseSection,
    PositiveLength,
    Scale,
    Section,
    TableSection,
    Text,
    Uncertainty,
    Unit,
    WholeNumber,
    existing_file,
    fault,
    resolved,
)
from schemas.cell_file_layout import LayoutSection, layout_faults
from schemas.cell_file_messages import did_you_mean, faults_of, refusal
from schemas.cell_file_planner import PlannerSection
from schemas.cell_file_robot import robot_faults
from schemas.cell_file_sequencing import SequencingSection
from schemas.scanner import ScannerParams

FORMAT = 1
"""The version of the cell file that this release reads and writes."""

BUILT_IN_ROBOTS = {robot.name: len(robot.joint_names) for robot in BUILT_IN}
"""Robots that need no URDF, with their number of joints."""


def _one_or_each(value: object) -> object:
    """Take one value as the value of every joint."""
    return [value] if isinstance(value, str | int | float) else value


def _robot_model(value: object, info: ValidationInfo) -> object:
    if not isinstance(value, str) or not value.strip():
        raise fault(f"{value!r} is not a robot: write ur10e or the path of a .urdf file")
    if value in BUILT_IN_ROBOTS:
        return value
    if "/" not in value and "." not in value:
        raise fault(f"{value!r} is not a built-in robot: {did_you_mean(value, BUILT_IN_ROBOTS)} (or a path to a .urdf)")
    return str(existing_file(resolved(value, info), (".urdf", ".xml")))


class RobotSection(Section):
    """The arm and where it stands."""

    model: Annotated[str, BeforeValidator(_robot_model)] = Field(
        default="ur10e",
        description=f"A built-in robot ({', '.join(BUILT_IN_ROBOTS)}) or the path of a URDF file.",
    )
    base: PoseSection = Field(default=PoseSection(), description="Pose of the base link in the world.")
    base_link: Text | None = Field(default=None, description="URDF link at the base; the root link if left out.")
    flange_link: Text | None = Field(default=None, description="URDF link of the flange; the last link if left out.")
    start_rad: tuple[Angle, ...] | None = Field(
        default=None, alias="start", description="Start configuration, base to flange; the robot's own if left out."
    )
    max_velocity_rad_s: Annotated[tuple[AngularSpeed, ...], BeforeValidator(_one_or_each)] | None = Field(
        default=None, alias="max_velocity", description="Joint speed limits, one or one a joint; the robot's own."
    )
    max_acceleration_rad_s2: Annotated[tuple[AngularAcceleration, ...], BeforeValidator(_one_or_each)] | None = Field(
        default=None,
        alias="max_acceleration",
        description="Joint acceleration limits, one or one a joint; the robot's own.",
    )
    lower_rad: Annotated[tuple[Angle, ...], BeforeValidator(_one_or_each)] | None = Field(
        default=None, alias="lower", description="Lower joint limits, one or one a joint; the robot's own."
    )
    upper_rad: Annotated[tuple[Angle, ...], BeforeValidator(_one_or_each)] | None = Field(
        default=None, alias="upper", description="Upper joint limits, one or one a joint; the robot's own."
    )
    packages: dict[str, Folder] = Field(
        default={}, description="Folders of the packages that the URDF names as `package://`."
    )

    @property
    def urdf(self) -> Path | None:
        """Path of the URDF file, ``None`` for a built-in robot."""
        return None if self.model in BUILT_IN_ROBOTS else Path(self.model)


class StandoffSection(Section):
    """Working distances along the viewing axis."""

    min_m: PositiveLength = Field(default=0.127, alias="min", description="Smallest working distance.")
    best_m: PositiveLength = Field(default=0.182, alias="best", description="Best working distance.")
    max_m: PositiveLength = Field(default=0.227, alias="max", description="Largest working distance.")

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if not self.min_m <= self.best_m <= self.max_m or self.min_m == self.max_m:
            given = f"min {self.min_m * 1e3:g} mm, best {self.best_m * 1e3:g} mm, max {self.max_m * 1e3:g} mm"
            raise fault(f"standoffs must rise: {given}: reorder them")
        return self


class UncertaintySection(Section):
    """Measurement uncertainty: constant + quadratic in the standoff, over the cosine of the incidence angle."""

    constant_m: Uncertainty = Field(default=0.0, alias="constant", description="Part that does not depend on distance.")
    at_best_standoff_m: Uncertainty = Field(
        default=40e-6, alias="at_best_standoff", description="Uncertainty at the best standoff, seen head on."
    )

    @model_validator(mode="after")
    def _grows(self) -> Self:
        if self.at_best_standoff_m <= self.constant_m:
            raise fault(
                f"at_best_standoff ({self.at_best_standoff_m * 1e6:g} um) must exceed constant "
                f"({self.constant_m * 1e6:g} um): the uncertainty grows with the distance"
            )
        return self


_T_SCAN_HOUSING = tuple(
    # ready-made values instead of text, so that importing this module parses no quantity
    BodySection.model_construct(
        name=name,
        box=BoxSection.model_construct(size_m=size_m),
        pose=PoseSection.model_construct(position_m=position_m),
    )
    for name, size_m, position_m in (
        ("scanner handle", (0.125, 0.052, 0.058), (0.0, 0.0, 0.083)),
        ("scanner body", (0.185, 0.160, 0.180), (0.155, 0.0, 0.090)),
    )
)
_NO_DEFAULT_FOR_CUSTOM = ("aperture", "standoff", "emitter_detector_distance", "uncertainty", "mount", "housing")


class ScannerSection(Section):
    """The laser line scanner. The defaults are those of `model: zeiss_tscan10`, each may be overridden."""

    model: Literal["zeiss_tscan10", "custom"] = Field(
        default="zeiss_tscan10", description="Where the defaults come from; `custom` has none for its geometry."
    )
    aperture_rad: Aperture = Field(
        default=math.radians(31.0), alias="aperture", description="Opening angle of the laser fan (paper: 31 deg)."
    )
    standoff: StandoffSection = Field(
        default=StandoffSection(), description="Working distances (paper: 127, 182, 227 mm)."
    )
    emitter_detector_distance_m: PositiveLength = Field(
        default=0.076, alias="emitter_detector_distance", description="Emitter to detector, along −x (paper: 76 mm)."
    )
    uncertainty: UncertaintySection = Field(default=UncertaintySection(), description="Uncertainty model.")
    max_incidence_rad: Incidence = Field(
        default=math.radians(75.0),
        alias="max_incidence",
        description="Largest angle between the normal and the ray to emitter or detector.",
    )
    profile_rate_hz: Frequency = Field(default=100.0, alias="profile_rate", description="Laser lines a second.")
    points_per_profile: WholeNumber = Field(default=200, ge=2, le=100_000, description="Points on a laser line.")
    mount: PoseSection = Field(
        default=PoseSection.model_construct(position_m=(0.1665, 0.0, 0.14318)),
        description="Pose of the laser-emitter frame on the flange link.",
    )
    housing: tuple[BodySection, ...] = Field(
        default=_T_SCAN_HOUSING, description="Bodies of the scanner, posed on the flange link."
    )

    @model_validator(mode="after")
    def _custom_is_complete(self) -> Self:
        given = {self.__class__.model_fields[name].alias or name for name in self.model_fields_set}
        missing = [key for key in _NO_DEFAULT_FOR_CUSTOM if key not in given]
        if self.model == "custom" and missing:
            raise fault(f"a custom scanner has no default for {', '.join(missing)}: add them")
        return self

    def params(self) -> ScannerParams:
        """Return the scanner as stages take it."""
        return ScannerParams(
            aperture_rad=self.aperture_rad,
            min_standoff_m=self.standoff.min_m,
            best_standoff_m=self.standoff.best_m,
            max_standoff_m=self.standoff.max_m,
            emitter_detector_distance_m=self.emitter_detector_distance_m,
            uncertainty_constant_m=self.uncertainty.constant_m,
            uncertainty_quadratic_per_m=(self.uncertainty.at_best_standoff_m - self.uncertainty.constant_m)
            / self.standoff.best_m**2,
            max_incidence_rad=self.max_incidence_rad,
            profile_rate_hz=self.profile_rate_hz,
            points_per_profile=self.points_per_profile,
        )


class PartSection(Section):
    """The workpiece."""

    file: MeshFile = Field(description="STL, PLY, OBJ, 3MF or STEP file.", examples=["part.stl"])
    unit: Unit | None = Field(default=None, description="Unit of the file; STEP and 3MF carry their own, else mm.")
    scale: Scale = Field(default=1.0, description="Factor on the size.")
    pose: PoseSection = Field(default=PoseSection(), description="Pose of the part's frame in the world.")
    rests_on: Text | None = Field(
        default=None,
        description="Body that the part stands on; `pose.position` is then [x, y] of the middle of its footprint.",
    )

    def up_part(self) -> tuple[float, float, float]:
        """Return the table's normal (the world's z axis) in the part's frame."""
        x, y, z = (self.pose.matrix()[:3, :3].T @ np.array([0.0, 0.0, 1.0])).tolist()
        return x, y, z


class CellFile(Section):
    """A whole cell file."""

    _path: Path = PrivateAttr(default=Path())

    version: Literal[1] = Field(alias="cellwright", description="Version of the cell file: 1.", examples=["1"])
    name: Text = Field(description="Name of the cell; the file's name if left out.")
    robot: RobotSection = Field(default=RobotSection(), description="The arm.")
    scanner: ScannerSection = Field(default=ScannerSection(), description="The laser line scanner.")
    part: PartSection = Field(description="The workpiece.", examples=["{file: part.stl}"])
    table: TableSection | None = Field(default=None, description="The table.")
    fixture: tuple[BodySection, ...] = Field(default=(), description="Bodies that hold the part.")
    obstacles: tuple[BodySection, ...] = Field(default=(), description="Everything else that stands in the way.")
    may_touch: tuple[tuple[Text, Text], ...] = Field(
        default=(), description="Pairs of bodies or links, by name, that may touch each other."
    )
    layout: LayoutSection | None = Field(
        default=None, description="What may be moved to shorten the cycle; nothing if left out."
    )
    sequencing: SequencingSection | None = Field(
        default=None, description="By which cost the sweeps are sequenced; as they were stitched if left out."
    )
    planner: PlannerSection = Field(default=PlannerSection(), description="How the planner works.")

    @property
    def path(self) -> Path:
        """The file that it was read from."""
        return self._path

    def bodies(self) -> tuple[BodySection, ...]:
        """Return all standing bodies: table, fixture, obstacles."""
        return (*(() if self.table is None else (self.table,)), *self.fixture, *self.obstacles)

    def body(self, name: str) -> BodySection:
        """Return a standing body by its name; `load_cell_file` has checked that `part.rests_on` is one."""
        return next(body for body in self.bodies() if body.name == name)

    def T_world_base(self) -> FloatArray:
        """Return the pose of the robot's base, (4, 4)."""
        return self.robot.base.matrix()


def load_cell_file(path: Path | str, overrides: Sequence[str] = ()) -> CellFile:
    """Read and check a cell file, with settings (``path.to.field=value``) laid over it.

    Relative paths in the file and in settings start at the file's folder.

    Raises:
        InvalidInputError: If anything in it is malformed; up to five faults are shown with line, key and mend.
    """
    document = read_document(Path(path))
    apply_overrides(document, overrides)
    version = document.data.get("cellwright")
    if "cellwright" in document.data and (version != FORMAT or isinstance(version, bool)):
        raise refusal(
            document, [(("cellwright",), f"{version!r} is another version: this release reads cellwright: {FORMAT}")]
        )
    if "tasks" in document.data and "scanner" not in document.data:
        raise InvalidInputError(
            f"{document.path} lists tasks at poses, not an inspection: run cellwright sequence {document.path}, or "
            "write a file without tasks"
        )
    if "stations" in document.data and "part" not in document.data:
        raise InvalidInputError(
            f"{document.path} describes a cell layout, not an inspection: run cellwright layout {document.path}, "
            "or write a file with a part"
        )
    data: dict[str, Any] = {"name": document.path.stem, **document.data}
    try:
        cell = CellFile.model_validate(data, context={"folder": document.path.parent})
    except ValidationError as error:
        raise refusal(document, faults_of(error, CellFile, document)) from error
    cell._path = document.path
    faults = _disagreements(cell, document)
    if faults:
        raise refusal(document, faults)
    return cell


def _disagreements(cell: CellFile, document: Document) -> list[tuple[Location, str]]:
    """Find values that are sound by themselves but do not go together."""
    faults: list[tuple[Location, str]] = []
    bodies = [(location, body.name) for location, body in _located_bodies(cell)]
    faults += robot_faults(cell.robot, bodies, cell.may_touch)
    for where, pose in ((("robot", "base"), cell.robot.base), (("scanner", "mount"), cell.scanner.mount)):
        if len(pose.position_m) != 3:
            faults.append(((*where, "position"), "has 2 entries but needs 3: write [x, y, z]"))
    faults += _part_faults(cell)
    faults += _standoff_faults(cell)
    faults += layout_faults(cell)
    seen: dict[str, Location] = {}
    for location, body in _located_bodies(cell):
        if body.name == PART:
            faults.append(((*location, "name"), f"{PART!r} is the workpiece's own name: choose another"))
        elif body.name in seen:
            first = document.origin(seen[body.name])
            faults.append(((*location, "name"), f"{body.name!r} names another body too ({first}): choose another"))
        seen.setdefault(body.name, location)
    return faults


def _part_faults(cell: CellFile) -> list[tuple[Location, str]]:
    part, faults = cell.part, list[tuple[Location, str]]()
    for location, file, unit in (
        (("part",), part.file, part.unit),
        *(((*where, "mesh"), body.mesh.file, body.mesh.unit) for where, body in _located_bodies(cell) if body.mesh),
    ):
        if unit is not None and file.suffix.lower() in (".step", ".stp", ".3mf"):
            faults.append(((*location, "unit"), f"{file.name} carries its own unit: remove `unit: {unit}`"))
    n_given, names = len(part.pose.position_m), [body.name for body in cell.bodies()]
    if part.rests_on is None and n_given == 2:
        faults.append(
            (("part", "pose", "position"), "has 2 entries but needs 3: write [x, y, z] or add `rests_on: table`")
        )
    if part.rests_on is not None and n_given == 3 and part.pose.position_m[2] != 0.0:
        faults.append((("part", "pose", "position"), "has a height but `rests_on` finds it: write [x, y] or remove it"))
    if part.rests_on is not None and part.rests_on not in names:
        mend = did_you_mean(part.rests_on, names) if names else "add a table"
        faults.append((("part", "rests_on"), f"{part.rests_on!r} is no body of the cell: {mend}"))
    elif part.rests_on is not None and _stands_beside(part, cell.body(part.rests_on)):
        faults.append(
            (
                ("part", "pose", "position"),
                f"the part would stand beside {part.rests_on!r}: write [x, y] of a place above it",
            )
        )
    return faults


def _stands_beside(part: PartSection, support: BodySection) -> bool:
    """Tell whether the middle of the part is off a level box that it is to rest on."""
    T_world_box = support.pose.matrix()
    if support.box is None or abs(T_world_box[2, 2]) < 0.999:
        return False
    middle = T_world_box[:2, :2].T @ (np.array(part.pose.position_m[:2]) - T_world_box[:2, 3])
    return bool((np.abs(middle) > np.array(support.box.size_m[:2]) / 2).any())


def _standoff_faults(cell: CellFile) -> list[tuple[Location, str]]:
    limits = cell.scanner.standoff
    return [
        (
            ("planner", "viewpoints", "standoffs", number),
            f"{standoff * 1e3:g} mm is outside the scanner's {limits.min_m * 1e3:g} to {limits.max_m * 1e3:g} mm: "
            "write one inside",
        )
        for number, standoff in enumerate(cell.planner.viewpoints.standoffs_m(cell.scanner.params()))
        if not limits.min_m <= standoff <= limits.max_m
    ]


def _located_bodies(cell: CellFile) -> list[tuple[Location, BodySection]]:
    return [
        *([(("table",), cell.table)] if cell.table is not None else []),
        *((("fixture", number), body) for number, body in enumerate(cell.fixture)),
        *((("obstacles", number), body) for number, body in enumerate(cell.obstacles)),
        *((("scanner", "housing", number), body) for number, body in enumerate(cell.scanner.housing)),
    ]
