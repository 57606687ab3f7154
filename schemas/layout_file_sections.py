"""The sections of a layout file: robot, stations and their hulls, approaches, walls, cost, solver.

Poses of stations, walls and obstacles are in the world; those of hulls and approaches on their station.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from cellwright import quantities
from cellwright.arrays import FloatArray
from cellwright.cell.built_in_robots import BUILT_IN
from cellwright.errors import InvalidInputError
from schemas.cell_file_fields import (
    Angle,
    AngularSpeed,
    Folder,
    Length,
    NonNegativeLength,
    Number,
    PoseSection,
    Quantity,
    Section,
    Speed,
    Text,
    WholeNumber,
    existing_file,
    fault,
    resolved,
)
from schemas.cell_file_harness import HarnessSection
from schemas.cell_file_messages import did_you_mean
from schemas.layout_file_hulls import HullSection
from schemas.layout_points import read_points

BUILT_IN_ARMS = {robot.name: len(robot.joint_names) for robot in BUILT_IN}
"""Robots that need no URDF, with their number of joints."""

_POINT_FILES = (".csv", ".txt")

JointQuantity = tuple[float, str]
"""A joint's value in SI, and `rad` or `m` (with `/s` or `/s^2` behind it)."""


def _of_joint(turning: quantities.Dimension, sliding: quantities.Dimension, least: float | None = None) -> Any:
    def read(value: object) -> JointQuantity:
        if isinstance(value, tuple):
            return value
        try:
            return Quantity(turning, least=least).read(value), turning.si
        except PydanticCustomError as refused:
            try:
                return Quantity(sliding, least=least).read(value), sliding.si
            except PydanticCustomError:
                raise refused from None

    return read


def _one_or_each(value: object) -> object:
    return [value] if isinstance(value, str | int | float) else value


JointPosition = Annotated[JointQuantity, BeforeValidator(_of_joint(quantities.ANGLE, quantities.LENGTH))]
JointSpeed = Annotated[JointQuantity, BeforeValidator(_of_joint(quantities.ANGULAR_SPEED, quantities.SPEED, 1e-3))]
JointAcceleration = Annotated[
    JointQuantity, BeforeValidator(_of_joint(quantities.ANGULAR_ACCELERATION, quantities.ACCELERATION, 1e-3))
]
_EACH: Any = {"written_as": "list of angles or lengths, one a joint"}


def _robot_model(value: object, info: ValidationInfo) -> object:
    if not isinstance(value, str) or not value.strip():
        raise fault(f"{value!r} is not a robot: write ur10e or the path of a .urdf file")
    if value in BUILT_IN_ARMS:
        return value
    if "/" not in value and "." not in value:
        raise fault(f"{value!r} is not a built-in robot: {did_you_mean(value, BUILT_IN_ARMS)} (or a path to a .urdf)")
    return str(existing_file(resolved(value, info), (".urdf", ".xml")))


class RobotHullSection(Section):
    """What of the robot must not collide."""

    model: Literal["links", "point"] = Field(
        default="links", description="Certified spheres about every link, or the tool's point alone as in the paper."
    )
    spheres: WholeNumber = Field(default=6, ge=1, le=200, description="Spheres of a link on average; with `links`.")
    self_collision: bool = Field(default=True, description="Whether links keep clear of each other too; with `links`.")
    tool_radius_m: NonNegativeLength = Field(
        default=0.0, alias="tool_radius", description="Radius of a sphere about the tool's point."
    )
    base_radius_m: NonNegativeLength = Field(
        default=0.0,
        alias="base_radius",
        description="Radius of a sphere that keeps stations off the robot's base, half as high.",
    )


class LayoutRobotSection(Section):
    """The arm, where it stands, and what of it must not collide."""

    model: Annotated[str, BeforeValidator(_robot_model)] = Field(
        default="ur10e",
        description=f"A built-in robot ({', '.join(BUILT_IN_ARMS)}) or the path of a URDF file.",
    )
    base: PoseSection = Field(default=PoseSection(), description="Pose of the base link in the world.")
    harness: HarnessSection | None = Field(
        default=None, description="How the base may be moved about `base`; it stands still if left out."
    )
    base_link: Text | None = Field(default=None, description="URDF link at the base; the root link if left out.")
    flange_link: Text | None = Field(default=None, description="URDF link of the flange; the last link if left out.")
    packages: dict[str, Folder] = Field(
        default={}, description="Folders of the packages that the URDF names as `package://`."
    )
    tool: PoseSection = Field(default=PoseSection(), description="Pose of the tool's point on the flange.")
    hull: RobotHullSection = Field(default=RobotHullSection(), description="What of it must not collide.")
    tool_hull: tuple[HullSection, ...] = Field(
        default=(), description="Solids on the flange that are no part of the URDF; they must not collide either."
    )
    home: tuple[JointPosition, ...] | None = Field(
        default=None, description="Configuration that `home` in the sequence means.", json_schema_extra=_EACH
    )
    lower: Annotated[tuple[JointPosition, ...] | None, BeforeValidator(_one_or_each)] = Field(
        default=None, description="Lower joint limits; the robot's own.", json_schema_extra=_EACH
    )
    upper: Annotated[tuple[JointPosition, ...] | None, BeforeValidator(_one_or_each)] = Field(
        default=None, description="Upper joint limits; the robot's own.", json_schema_extra=_EACH
    )
    max_velocity: Annotated[tuple[JointSpeed, ...] | None, BeforeValidator(_one_or_each)] = Field(
        default=None,
        description="Joint speed limits, one or one a joint; the robot's own.",
        json_schema_extra={"written_as": "list of speeds"},
    )
    max_acceleration: Annotated[tuple[JointAcceleration, ...] | None, BeforeValidator(_one_or_each)] = Field(
        default=None,
        description="Joint acceleration limits, one or one a joint; the robot's own.",
        json_schema_extra={"written_as": "list of accelerations"},
    )

    @property
    def urdf(self) -> Path | None:
        """Path of the URDF file, ``None`` for a built-in robot."""
        return None if self.model in BUILT_IN_ARMS else Path(self.model)


def _points_file(value: object, info: ValidationInfo) -> Path:
    return existing_file(resolved(value, info), _POINT_FILES)


class PointsSection(Section):
    """Tool poses from a file: a row each, `x, y, z` or `x, y, z, qw, qx, qy, qz`, separated by commas or spaces."""

    file: Annotated[Path, BeforeValidator(_points_file)] = Field(
        description="CSV file; lines that begin with # and a head of names are skipped."
    )
    unit: Literal["um", "mm", "cm", "m", "in", "ft"] = Field(default="mm", description="Unit of x, y, z.")
    rotation_rad: tuple[Angle, Angle, Angle] = Field(
        default=(0.0, 0.0, 0.0), alias="rotation", description="Roll, pitch, yaw of rows without a quaternion."
    )


class ApproachSection(Section):
    """Tool poses on a station, passed in straight lines: one pose, a line, a path, or points from a file."""

    name: Text | None = Field(default=None, description="Name, for the sequence; may be left out.")
    pose: PoseSection | None = Field(default=None, description="A single pose.")
    line: tuple[PoseSection, PoseSection] | None = Field(default=None, description="From one pose to another.")
    path: tuple[PoseSection, ...] | None = Field(
        default=None, min_length=2, max_length=1000, description="Poses one after the other."
    )
    points: PointsSection | None = Field(default=None, description="Poses from a file.")
    back: bool = Field(default=False, description="Whether the way is gone back, to leave as it came.")
    target: Literal["pose", "axis", "position"] = Field(
        default="pose",
        description="What must be met: the full pose; all but the turn about the tool's z; the position alone.",
    )
    speed_m_s: Speed | None = Field(
        default=None,
        alias="speed",
        description="Speed of the tool on the way, whose time then counts in the cycle.",
    )
    turn_speed_rad_s: AngularSpeed | None = Field(
        default=None,
        alias="turn_speed",
        description="How fast the tool turns on a way with a `speed`: each piece takes the longer of both times; "
        "1 rad/s if left out.",
    )

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = ("pose", "line", "path", "points")
        given = [name for name in ways if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "no pose"
            raise fault(f"an approach has {found}: give it one of {', '.join(ways)}")
        if self.pose is not None and (self.back or self.speed_m_s is not None or self.turn_speed_rad_s is not None):
            raise fault("a single pose is no way: remove back, speed and turn_speed, or write a line")
        if self.turn_speed_rad_s is not None and self.speed_m_s is None:
            raise fault("turn_speed is given without speed, so no time counts: add speed, or remove it")
        for section in self._sections():
            if len(section.position_m) != 3:
                raise fault("a pose has 2 entries in position but needs 3: write [x, y, z]")
        poses = self.poses()
        still = np.flatnonzero(np.abs(np.diff(poses, axis=0)).max(axis=(1, 2), initial=0.0) < 1e-9)
        if self.speed_m_s is not None and len(still):
            raise fault(
                f"poses {still[0] + 1} and {still[0] + 2} of the way are the same, so that no time passes between "
                "them: remove one of them, or speed"
            )
        return self

    def _sections(self) -> tuple[PoseSection, ...]:
        return (self.pose,) if self.pose is not None else (self.line or self.path or ())

    def poses(self) -> FloatArray:
        """Return the poses on the station, (n, 4, 4)."""
        if self.points is not None:
            try:
                poses = read_points(self.points.file, self.points.unit, self.points.rotation_rad)
            except InvalidInputError as error:
                raise fault(str(error)) from error
        else:
            poses = np.stack([section.matrix() for section in self._sections()])
        return np.concatenate([poses, poses[-2::-1]]) if self.back else poses


class StationSection(Section):
    """Something that the robot visits: a machine, a table, a workpiece."""

    name: Text = Field(description="Name of the station, unique in the cell.")
    pose: PoseSection = Field(default=PoseSection(), description="Where it stands; its harness moves it from there.")
    harness: HarnessSection | None = Field(default=None, description="How it may be moved; it stands still without.")
    hull: tuple[HullSection, ...] = Field(default=(), description="Solids that must not be touched.")
    approaches: tuple[ApproachSection, ...] = Field(default=(), description="What the robot does at it.")


class WallSection(Section):
    """A wall that everything stays on one side of."""

    name: Text = Field(description="Name of the wall.")
    normal: tuple[Number, Number, Number] = Field(description="Direction from the wall into the room.")
    offset_m: Length = Field(alias="offset", description="Distance of the wall from the origin along `normal`.")
    holds_robot: bool = Field(
        default=True, description="Whether the robot keeps off it too, its base if that may move."
    )

    @model_validator(mode="after")
    def _directed(self) -> Self:
        length = math.hypot(*self.normal)
        if not 1e-9 < length < 1e9:
            raise fault(f"normal {list(self.normal)} of length {length:.3g} has no direction: write one like [1, 0, 0]")
        return self


class WorkspaceSection(Section):
    """A box that everything stays inside of."""

    min_m: tuple[Length, Length, Length] = Field(alias="min", description="Its lowest corner.")
    max_m: tuple[Length, Length, Length] = Field(alias="max", description="Its highest corner.")
    holds_robot: bool = Field(
        default=True, description="Whether the robot stays inside too, its base if that may move."
    )

    @model_validator(mode="after")
    def _not_empty(self) -> Self:
        for axis, low, high in zip("xyz", self.min_m, self.max_m):
            if low >= high:
                raise fault(
                    f"the workspace reaches from {low * 1e3:g} to {high * 1e3:g} mm in {axis}: "
                    f"widen it by more than {(low - high) * 1e3:g} mm"
                )
        return self


class CostSection(Section):
    """What counts beside the cycle time."""

    manipulability_s: Annotated[float, Quantity(quantities.TIME, least=0.0)] = Field(
        default=0.0, alias="manipulability", description="Time that one unit of mean manipulability is worth."
    )
    repeatability: Annotated[float, Quantity(quantities.NUMBER, least=0.0)] = Field(
        default=0.0, description="Seconds that a metre of mean position error at the tool costs."
    )
    joint_deviation: Annotated[tuple[JointPosition, ...] | None, BeforeValidator(_one_or_each)] = Field(
        default=None,
        description="Standard deviation of the joints' positions, one or one a joint; for repeatability.",
        json_schema_extra=_EACH,
    )
    worst_case: bool = Field(default=False, description="Add the joints' errors up instead of their variances.")
    along_path: bool = Field(
        default=False, description="Mean over the time of the cycle, not over the approaches alone."
    )

    @model_validator(mode="after")
    def _deviation_for_repeatability(self) -> Self:
        if self.repeatability > 0.0 and self.joint_deviation is None:
            raise fault("repeatability needs joint_deviation: add it, like joint_deviation: 0.1 mrad")
        return self


class SolverSection(Section):
    """How the layout is looked for."""

    method: Literal["staged", "direct", "second_order", "proxy", "iterative"] = Field(
        default="staged",
        description="Ours; the paper's equation (4); with acceleration limits; a swarm on a proxy; one on cycle times.",
    )
    proxy: Literal["euclidean", "to robot", "joint", "joint time"] = Field(
        default="joint", description="What the proxy is; with `method: proxy`."
    )
    segments: WholeNumber | None = Field(
        default=None, ge=1, le=1000, description="N: pieces of a transition; 100, with acceleration limits 50."
    )
    starts: WholeNumber = Field(default=5, ge=1, le=1000, description="Starts that the best is taken of.")
    seed: WholeNumber = Field(default=0, ge=0, le=2**63 - 1, description="Seed of all random choices.")
    begin: Literal["random", "placed"] = Field(
        default="random", description="Whether the first start is where the file places everything; else random."
    )
    polish: bool = Field(default=True, description="A last program on N pieces; with `staged`.")
    particles: WholeNumber = Field(default=160, ge=1, le=10_000, description="Particles of a swarm.")
    generations: WholeNumber = Field(default=40, ge=1, le=10_000, description="Generations of a swarm.")
    extras: bool = Field(
        default=True,
        description="Time the layout where it began too, and look for the smallest relaxation where none is found; "
        "studies leave both out to time the solver alone.",
    )
    clearance_m: NonNegativeLength = Field(
        default=0.0, alias="clearance", description="Distance between bodies, and from the moving robot to walls."
    )
