"""The layout problem as Baumgaertner 2025 states it: stations on harnesses, approaches, transitions, hulls of spheres.

This module holds what every layout solver is given (`LayoutProblem`); `cellwright.solvers.layout.solution` what every
one returns, `cellwright.solvers.layout.geometry` the distances that both sides measure. A design is one number a
design joint: first those of the robot's base, then those of the stations in order.

All poses are in the world. The robot visits approaches one after the other; a transition leads from the last pose of
one approach to the first pose of the next. An approach itself is free of collisions with its own station by
definition, as in the paper, and is held clear of everything else.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.harness import Harness
from cellwright.cell.serial_arm import SerialArm
from cellwright.errors import InvalidInputError, listed
from cellwright.solvers.layout.bodies import (
    RobotSpheres,
    Spheres,
    Wall,
    end_effector_point,
    frozen,
    workspace_walls,
)

__all__ = [
    "HOME",
    "Approach",
    "LayoutCost",
    "LayoutProblem",
    "RobotSpheres",
    "Spheres",
    "Station",
    "TargetKind",
    "Visit",
    "Wall",
    "end_effector_point",
    "workspace_walls",
]


class TargetKind(Enum):
    """What of a tool pose must be met."""

    POSE = "pose"
    """Position and orientation."""
    AXIS = "axis"
    """Position and the direction of the tool's z; it may turn about it freely."""
    POSITION = "position"
    """Position alone."""


@dataclass(frozen=True, eq=False)
class Approach:
    """Tool poses relative to a station that the robot passes in order, in straight lines between them.

    Attributes:
        T_station_tool: (n, 4, 4); a single pose is one interaction point.
        target: What of the poses must be met.
        durations_s: Time from each pose to the next, (n - 1,), which counts in the cycle and which the joints must be
            able to follow; None: the approach's time is not counted (as in the paper), only its continuity.
        name: For messages.
    """

    T_station_tool: FloatArray
    target: TargetKind = TargetKind.POSE
    durations_s: FloatArray | None = None
    name: str = ""

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            InvalidInputError: If there is no pose, a duration is not positive, or the shapes do not fit.
        """
        poses = frozen(self.T_station_tool, (-1, 4, 4), f"approach {self.name!r}")
        if not len(poses):
            raise InvalidInputError(f"approach {self.name!r} has no pose: give at least one")
        object.__setattr__(self, "T_station_tool", poses)
        if self.durations_s is not None:
            durations = frozen(self.durations_s, (len(poses) - 1,), f"the durations of approach {self.name!r}")
            if len(durations) and durations.min() <= 0.0:
                raise InvalidInputError(
                    f"approach {self.name!r} takes {durations.min():.6g} s between two poses: it must be positive"
                )
            object.__setattr__(self, "durations_s", durations)

    @property
    def n_poses(self) -> int:
        """The number of poses."""
        return len(self.T_station_tool)

    @property
    def duration_s(self) -> float:
        """The time of the approach that counts in the cycle."""
        return 0.0 if self.durations_s is None else float(self.durations_s.sum())

    @classmethod
    def along(
        cls,
        T_station_tool: FloatArray,
        *,
        speed_m_s: float | None = None,
        turn_rad_s: float = 1.0,
        target: TargetKind = TargetKind.POSE,
        name: str = "",
    ) -> Approach:
        """Return an approach along given poses (a line, a polyline, a recorded path) at a constant speed.

        With ``speed_m_s`` each piece takes as long as its length at that speed, or its turn at ``turn_rad_s`` if that
        is longer.

        Raises:
            InvalidInputError: If a speed is not positive or two poses in a row are the same.
        """
        poses = np.asarray(T_station_tool, float)
        if speed_m_s is None:
            return cls(poses, target, None, name)
        if not (speed_m_s > 0.0 and turn_rad_s > 0.0):
            raise InvalidInputError(f"approach {name!r} has the speed {speed_m_s:.6g} m/s: it must be positive")
        lengths = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        turns = np.einsum("nij,nij->n", poses[:-1, :3, :3], poses[1:, :3, :3])
        angles = np.arccos(np.clip((turns - 1.0) / 2.0, -1.0, 1.0))
        return cls(poses, target, np.maximum(lengths / speed_m_s, angles / turn_rad_s), name)


@dataclass(frozen=True, eq=False)
class Station:
    """Something the robot visits, or merely has to avoid (no approach): a workstation, a workpiece, an obstacle.

    Attributes:
        name: Unique in the problem.
        harness: How it may move; without joints it is fixed.
        hull: Spheres in the station's frame.
        approaches: What the robot does at it.
    """

    name: str
    harness: Harness
    hull: Spheres = field(default_factory=Spheres)
    approaches: tuple[Approach, ...] = ()


@dataclass(frozen=True)
class Visit:
    """One approach of one station; station -1 is the robot's home configuration."""

    station: int
    approach: int = 0


HOME = Visit(-1)


@dataclass(frozen=True)
class LayoutCost:
    """The paper's extra cost L, in the same unit as the cycle time (s).

    Attributes:
        manipulability: Seconds that one unit of mean manipulability sqrt(det(J J^T)) is worth; it is maximised.
        repeatability: Seconds a metre of the mean position error at the tool costs.
        joint_deviation: Standard deviation of each joint's position in rad or m, (joints,), for repeatability.
        worst_case: Add the joints' errors up (worst case of three deviations each) instead of their variances.
        along_path: L is the mean over the time of the cycle, transitions and timed approaches, instead of the mean over
            the approaches' knots.
    """

    manipulability: float = 0.0
    repeatability: float = 0.0
    joint_deviation: tuple[float, ...] = ()
    worst_case: bool = False
    along_path: bool = False

    @property
    def counts(self) -> bool:
        """Whether there is any extra cost."""
        return self.manipulability != 0.0 or self.repeatability != 0.0


@dataclass(frozen=True, eq=False)
class LayoutProblem:
    """Everything a layout solver is given.

    Attributes:
        arm: The robot.
        stations: Workstations and obstacles.
        visits: The order of approaches; by default every approach of every station in order.
        cyclic: Whether the robot returns from the last visit to the first.
        base: Harness of the robot's base; its carried pose is ``T_world_base``.
        T_flange_tool: (4, 4).
        robot_spheres: What of the robot must not collide; empty as in the paper's Fig. 5 means nothing.
        walls: Half spaces that hold stations and robot.
        home_q: The configuration of a `HOME` visit, (joints,).
        clearance_m: Distance kept between bodies, and between the moving robot and walls; what stands may touch a wall,
            and the robot's links each other.
        cost: Extra cost L.
    """

    arm: SerialArm
    stations: tuple[Station, ...]
    visits: tuple[Visit, ...] = ()
    cyclic: bool = True
    base: Harness = field(default_factory=Harness)
    T_flange_tool: FloatArray = field(default_factory=lambda: np.eye(4))
    robot_spheres: RobotSpheres = field(default_factory=RobotSpheres)
    walls: tuple[Wall, ...] = ()
    home_q: FloatArray | None = None
    clearance_m: float = 0.0
    cost: LayoutCost = field(default_factory=LayoutCost)

    def __post_init__(self) -> None:
        """Check that the parts fit together.

        Raises:
            InvalidInputError: If names repeat, a visit names nothing, or a shape does not fit the arm.
        """
        names = [station.name for station in self.stations]
        if len(set(names)) != len(names):
            raise InvalidInputError(f"stations are named {listed(names, 12)}: give each its own name")
        object.__setattr__(self, "T_flange_tool", frozen(self.T_flange_tool, (4, 4), "T_flange_tool"))
        if not self.visits:
            order = [Visit(s, a) for s, station in enumerate(self.stations) for a in range(len(station.approaches))]
            object.__setattr__(self, "visits", tuple(order))
        if len(self.visits) < 2:
            raise InvalidInputError(f"the robot makes {len(self.visits)} visits: a transition needs at least two")
        for visit in self.visits:
            if visit.station == -1:
                if self.home_q is None:
                    raise InvalidInputError("the sequence visits home, but no home configuration is given")
            elif not 0 <= visit.station < len(self.stations):
                raise InvalidInputError(f"a visit names station {visit.station}, but there are {len(self.stations)}")
            elif not 0 <= visit.approach < len(self.stations[visit.station].approaches):
                raise InvalidInputError(
                    f"a visit names approach {visit.approach} of station {names[visit.station]!r}, "
                    f"which has {len(self.stations[visit.station].approaches)}"
                )
        n_joints = self.arm.n_joints
        if self.home_q is not None:
            home = frozen(self.home_q, (n_joints,), "the home configuration")
            if (home < self.arm.lower).any() or (home > self.arm.upper).any():
                raise InvalidInputError("the home configuration lies outside the joint limits: choose another")
            object.__setattr__(self, "home_q", home)
        if len(self.robot_spheres) and self.robot_spheres.link.max() > n_joints:
            raise InvalidInputError(f"a robot sphere is on link {self.robot_spheres.link.max()} of {n_joints}")
        if self.cost.repeatability != 0.0 and len(self.cost.joint_deviation) != n_joints:
            raise InvalidInputError(
                f"repeatability needs {n_joints} joint deviations, but {len(self.cost.joint_deviation)} are given"
            )
        if not self.clearance_m >= 0.0:
            raise InvalidInputError(f"the clearance is {self.clearance_m:.6g} m: it must not be negative")

    @property
    def harnesses(self) -> tuple[Harness, ...]:
        """The base's harness, then the stations'."""
        return (self.base, *(station.harness for station in self.stations))

    @property
    def n_design(self) -> int:
        """The number of design joints."""
        return sum(harness.n_joints for harness in self.harnesses)

    @property
    def design_names(self) -> tuple[str, ...]:
        """``station.joint``; the base's joints are ``base.joint``."""
        owners = ("base", *(station.name for station in self.stations))
        return tuple(f"{owner}.{name}" for owner, harness in zip(owners, self.harnesses) for name in harness.names)

    @property
    def lower(self) -> FloatArray:
        """Lower limits of the design, (n_design,)."""
        return np.concatenate([harness.lower for harness in self.harnesses])

    @property
    def upper(self) -> FloatArray:
        """Upper limits of the design, (n_design,)."""
        return np.concatenate([harness.upper for harness in self.harnesses])

    @property
    def transitions(self) -> tuple[tuple[int, int], ...]:
        """Pairs of visits (rows of `visits`) between which the robot moves freely."""
        n = len(self.visits)
        pairs = [(visit, visit + 1) for visit in range(n - 1)]
        return (*pairs, (n - 1, 0)) if self.cyclic else tuple(pairs)

    def design_slices(self) -> tuple[slice, ...]:
        """Return which part of the design belongs to the base and to each station."""
        ends = np.cumsum([harness.n_joints for harness in self.harnesses]).tolist()
        return tuple(slice(end - harness.n_joints, end) for end, harness in zip(ends, self.harnesses))

    def base_pose(self, design: FloatArray) -> FloatArray:
        """Return ``T_world_base`` (..., 4, 4) of designs (..., n_design)."""
        return self.base.poses(np.asarray(design, float)[..., self.design_slices()[0]])

    def station_poses(self, design: FloatArray) -> FloatArray:
        """Return ``T_world_station`` (..., stations, 4, 4) of designs (..., n_design)."""
        values = np.asarray(design, float)
        poses = [
            station.harness.poses(values[..., part]) for station, part in zip(self.stations, self.design_slices()[1:])
        ]
        return np.stack(poses, axis=-3)

    def approach_of(self, visit: int) -> Approach | None:
        """Return the approach of a visit (row of `visits`); None at home."""
        where = self.visits[visit]
        return None if where.station < 0 else self.stations[where.station].approaches[where.approach]

    def visit_name(self, visit: int) -> str:
        """Return what people call a visit."""
        where = self.visits[visit]
        if where.station < 0:
            return "home"
        station = self.stations[where.station]
        approach = station.approaches[where.approach]
        return f"{station.name} {approach.name}" if approach.name else station.name

    def with_design(self, design: FloatArray) -> LayoutProblem:
        """Return the same problem with everything fixed where ``design`` (n_design,) puts it."""
        parts = self.design_slices()
        values = np.asarray(design, float)
        stations = tuple(
            replace(station, harness=station.harness.fixed_at(values[part]))
            for station, part in zip(self.stations, parts[1:])
        )
        return replace(self, stations=stations, base=self.base.fixed_at(values[parts[0]]))
