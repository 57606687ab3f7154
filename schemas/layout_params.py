"""A layout problem as stage parameters: robot, stations on harnesses, approaches, walls, sequence, cost.

Hulls that have to be fitted come as artefacts; here stand their bodies' names and the poses that they are put at.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from cellwright.cell.harness import DesignJoint, Harness
from schemas.params import Params
from schemas.poses import Pose

Vector = tuple[float, float, float]


class DesignJointParams(Params):
    """A joint of a harness."""

    name: str = Field(min_length=1, description="Unique within its harness.")
    revolute: bool = Field(description="Whether it turns (rad) or slides (m).")
    axis: Vector = Field(description="Axis in the joint's own frame.")
    lower: float = Field(description="Lower limit, rad or m.")
    upper: float = Field(description="Upper limit, rad or m.")
    T_parent_joint: Pose = Field(default=Pose(), description="Pose of the joint on the one before it.")


class HarnessParams(Params):
    """The joints on which something is moved; without joints it stands still."""

    joints: tuple[DesignJointParams, ...] = Field(default=(), description="From the world on.")
    T_last_carried: Pose = Field(default=Pose(), description="Pose of what is carried on the last joint.")

    @classmethod
    def of(cls, harness: Harness) -> HarnessParams:
        """Make the parameters of the library's harness."""
        joints = []
        for joint in harness.joints:
            x, y, z = joint.axis.tolist()
            joints.append(
                DesignJointParams(
                    name=joint.name,
                    revolute=joint.revolute,
                    axis=(x, y, z),
                    lower=joint.lower,
                    upper=joint.upper,
                    T_parent_joint=Pose.of(joint.T_parent_joint),
                )
            )
        return cls(joints=tuple(joints), T_last_carried=Pose.of(harness.T_last_carried))

    def harness(self) -> Harness:
        """Return the library's harness.

        Raises:
            InvalidInputError: If a range is empty or two joints share a name.
        """
        joints = tuple(
            DesignJoint(
                joint.name,
                joint.revolute,
                np.array(joint.axis),
                joint.lower,
                joint.upper,
                joint.T_parent_joint.matrix(),
            )
            for joint in self.joints
        )
        return Harness(joints, self.T_last_carried.matrix())


class ArmParams(Params):
    """The robot."""

    robot: str = Field(min_length=1, description="Name of a built-in robot, or of the URDF file.")
    robot_sha256: str = Field(default="", description="Hash of a built-in robot's data.")
    base_link: str | None = Field(default=None, description="URDF link that is the frame base; found if left out.")
    flange_link: str | None = Field(default=None, description="URDF link that is the frame flange; found if left out.")
    lower: tuple[float, ...] | None = Field(default=None, description="Lower joint limits, rad or m, one or each.")
    upper: tuple[float, ...] | None = Field(default=None, description="Upper joint limits, rad or m, one or each.")
    max_velocity: tuple[float, ...] | None = Field(default=None, description="Joint speeds, rad/s or m/s.")
    max_acceleration: tuple[float, ...] | None = Field(default=None, description="Accelerations, rad/s^2 or m/s^2.")


class ApproachParams(Params):
    """Tool poses relative to a station."""

    name: str = Field(default="", description="For messages.")
    T_station_tool: tuple[Pose, ...] = Field(min_length=1, description="Poses in order.")
    target: Literal["pose", "axis", "position"] = Field(default="pose", description="What must be met.")
    speed_m_s: float | None = Field(default=None, gt=0, description="Speed on the way; none: its time is not counted.")
    turn_rad_s: float = Field(default=1.0, gt=0, description="At which the tool turns at most; with a speed.")


class PlacedHull(Params):
    """A fitted hull and where it is put."""

    body: str = Field(min_length=1, description="Name of the body in the hulls' artefact.")
    T_station_body: Pose = Field(default=Pose(), description="Pose of the body on the station, a tool's on the flange.")


class StationParams(Params):
    """A station or an obstacle."""

    name: str = Field(min_length=1, description="Unique in the cell.")
    harness: HarnessParams = Field(default=HarnessParams(), description="How it may move.")
    hulls: tuple[PlacedHull, ...] = Field(default=(), description="Hulls that are fitted.")
    centre_m: tuple[Vector, ...] = Field(default=(), description="Centres of given spheres on the station.")
    radius_m: tuple[float, ...] = Field(default=(), description="Their radii.")
    approaches: tuple[ApproachParams, ...] = Field(default=(), description="What the robot does at it.")


class WallParams(Params):
    """A half space that holds everything."""

    name: str = Field(min_length=1, description="For messages.")
    normal: Vector = Field(description="Into the room.")
    offset_m: float = Field(description="Distance from the origin along the normal.")
    holds_robot: bool = Field(default=True, description="Whether the robot keeps off it too.")


class LayoutCostParams(Params):
    """The extra cost L."""

    manipulability_s: float = Field(default=0.0, ge=0, description="Seconds that one unit of it is worth.")
    repeatability_s_per_m: float = Field(default=0.0, ge=0, description="Seconds that a metre of error costs.")
    joint_deviation: tuple[float, ...] = Field(default=(), description="Of each joint, rad or m; one or each.")
    worst_case: bool = Field(default=False, description="Whether errors add up.")
    along_path: bool = Field(default=False, description="Whether L is a mean over the time of the cycle.")


class ToolHullParams(Params):
    """A tool that is no part of the URDF; it sits on the flange."""

    hulls: tuple[PlacedHull, ...] = Field(default=(), description="Hulls that are fitted.")
    centre_m: tuple[Vector, ...] = Field(default=(), description="Centres of given spheres on the flange.")
    radius_m: tuple[float, ...] = Field(default=(), description="Their radii.")


class RobotSphereParams(Params):
    """What of the robot must not collide."""

    model: Literal["links", "point"] = Field(default="point", description="Spheres of the links, or the tool's point.")
    self_collision: bool = Field(default=True, description="Whether links keep clear of each other.")
    tool: ToolHullParams = Field(default=ToolHullParams(), description="What is mounted on the flange.")
    tool_radius_m: float = Field(default=0.0, ge=0, description="About the tool's point; 0 with links: none.")
    base_radius_m: float = Field(default=0.0, ge=0, description="About the base, half as high; 0: none.")


class LayoutProblemParams(Params):
    """Everything a layout solver is given but fitted hulls."""

    arm: ArmParams = Field(description="The robot.")
    base: HarnessParams = Field(default=HarnessParams(), description="How its base may move.")
    T_flange_tool: Pose = Field(default=Pose(), description="The tool's point on the flange.")
    spheres: RobotSphereParams = Field(default=RobotSphereParams(), description="What of it must not collide.")
    home_q: tuple[float, ...] | None = Field(default=None, description="The configuration of a visit at home.")
    stations: tuple[StationParams, ...] = Field(description="Stations, then obstacles.")
    visits: tuple[tuple[int, int], ...] = Field(description="Rows of station and approach; -1 is home.")
    cyclic: bool = Field(default=True, description="Whether the robot returns to the first visit.")
    walls: tuple[WallParams, ...] = Field(default=(), description="Walls.")
    clearance_m: float = Field(
        default=0.0, ge=0, description="Distance between bodies, and from the moving robot to walls."
    )
    cost: LayoutCostParams = Field(default=LayoutCostParams(), description="Extra cost.")
