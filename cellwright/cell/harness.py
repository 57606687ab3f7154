"""Kinematic harness: the virtual joints on which a station or the robot's base may be moved in a layout.

After Baumgaertner 2025: what may move, and how, is written as a mechanism of prismatic and revolute design joints with
limits; the layout is their state. A harness without joints stands still. Poses come as numbers for any number of
states at once (`Harness.poses`) and as a CasADi expression (`Harness.symbolic_pose`), tested to be the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cellwright.arrays import BoolArray, FloatArray
from cellwright.cell.serial_arm import chain_poses
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.errors import InvalidInputError

X, Y, Z = np.eye(3)


@dataclass(frozen=True, eq=False)
class DesignJoint:
    """A virtual joint: where it sits on the joint before it, along which axis it moves, and how far.

    Attributes:
        name: Unique within its harness.
        revolute: Turns (rad) or shifts (m).
        axis: Unit vector in the joint's own frame, (3,).
        lower, upper: Limits in rad or m; equal ones hold the joint still.
        T_parent_joint: Pose of the joint's frame on the joint before it, (4, 4).
    """

    name: str
    revolute: bool
    axis: FloatArray
    lower: float
    upper: float
    T_parent_joint: FloatArray = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        """Check and normalise.

        Raises:
            InvalidInputError: If the axis has no direction or the range is empty or not finite.
        """
        axis, T = np.array(self.axis, float), np.array(self.T_parent_joint, float)
        length = float(np.linalg.norm(axis)) if axis.shape == (3,) else 0.0
        unit = "rad" if self.revolute else "m"
        if not (length > 1e-9 and math.isfinite(length)):
            raise InvalidInputError(f"design joint {self.name!r} has the axis {axis.tolist()}: give it a direction")
        if T.shape != (4, 4) or not np.isfinite(T).all():
            raise InvalidInputError(f"design joint {self.name!r} has no finite 4 x 4 pose: check its origin")
        if not (math.isfinite(self.lower) and math.isfinite(self.upper)):
            raise InvalidInputError(
                f"design joint {self.name!r} ranges from {self.lower} to {self.upper} {unit}: give finite limits"
            )
        if self.lower > self.upper:
            raise InvalidInputError(
                f"design joint {self.name!r} has an empty range: lower limit {self.lower:.6g} {unit} lies "
                f"{self.lower - self.upper:.6g} {unit} above upper limit {self.upper:.6g} {unit}: "
                f"lower or raise one of them by at least that"
            )
        axis = axis / length
        axis.flags.writeable = T.flags.writeable = False
        object.__setattr__(self, "axis", axis)
        object.__setattr__(self, "T_parent_joint", T)


@dataclass(frozen=True, eq=False)
class Harness:
    """A chain of design joints from the world to what it carries; without joints it is a fixed pose.

    Attributes:
        joints: From the world on.
        T_last_carried: Pose of what is carried on the last joint (on the world if there is none), (4, 4).
    """

    joints: tuple[DesignJoint, ...] = ()
    T_last_carried: FloatArray = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        """Check.

        Raises:
            InvalidInputError: If two joints share a name or the pose is not 4 x 4.
        """
        names = [joint.name for joint in self.joints]
        if len(set(names)) != len(names):
            raise InvalidInputError(f"a harness has design joints {', '.join(names)}: give each its own name")
        T = np.array(self.T_last_carried, float)
        if T.shape != (4, 4) or not np.isfinite(T).all():
            raise InvalidInputError("a harness carries its station at no finite 4 x 4 pose: check it")
        T.flags.writeable = False
        object.__setattr__(self, "T_last_carried", T)

    @property
    def n_joints(self) -> int:
        """The number of design joints."""
        return len(self.joints)

    @property
    def names(self) -> tuple[str, ...]:
        """The joints' names."""
        return tuple(joint.name for joint in self.joints)

    @property
    def revolute(self) -> BoolArray:
        """Which joints turn, (joints,)."""
        return np.array([joint.revolute for joint in self.joints], bool)

    @property
    def lower(self) -> FloatArray:
        """Lower limits, (joints,)."""
        return np.array([joint.lower for joint in self.joints], float)

    @property
    def upper(self) -> FloatArray:
        """Upper limits, (joints,)."""
        return np.array([joint.upper for joint in self.joints], float)

    @property
    def T_parent_joint(self) -> FloatArray:
        """Poses of the joints on the ones before them, (joints, 4, 4)."""
        return np.array([joint.T_parent_joint for joint in self.joints], float).reshape(-1, 4, 4)

    @property
    def axis(self) -> FloatArray:
        """Unit axes, (joints, 3)."""
        return np.array([joint.axis for joint in self.joints], float).reshape(-1, 3)

    def poses(self, values: FloatArray) -> FloatArray:
        """Return the world poses (..., 4, 4) of what is carried at design joints ``values`` (..., joints)."""
        links = chain_poses(self.T_parent_joint, self.axis, self.revolute, np.asarray(values, float))
        return np.asarray(links[..., -1, :, :] @ self.T_last_carried)

    def symbolic_pose(self, values: Any) -> Any:
        """Return the world pose (4 x 4 CasADi expression) at ``values``, a CasADi column of the joints' length."""
        from cellwright.cell.symbolic_model import chain_expressions, constant

        links = chain_expressions(self.T_parent_joint, self.axis, self.revolute, values)
        return links[-1] @ constant(self.T_last_carried)

    def fixed_at(self, values: FloatArray) -> Harness:
        """Return a harness without joints that stands where this one stands at ``values`` (joints,)."""
        return Harness((), self.poses(values))


def fixed(T_world_carried: FloatArray) -> Harness:
    """Return a harness that stands still at a pose (4, 4)."""
    return Harness((), T_world_carried)


def planar(
    x: tuple[float, float],
    y: tuple[float, float],
    turn: tuple[float, float] = (-math.pi, math.pi),
    z: tuple[float, float] = (0.0, 0.0),
    T_last_carried: FloatArray | None = None,
) -> Harness:
    """Return a station on the floor: x, y (m) in the world, height z (m) if it has a range, rotation about z (rad)."""
    joints = [DesignJoint("x", False, X, *x), DesignJoint("y", False, Y, *y)]
    origin = np.eye(4)
    if z[0] == z[1]:
        origin[2, 3] = z[0]
    else:
        joints.append(DesignJoint("z", False, Z, *z))
    joints.append(DesignJoint("turn", True, Z, *turn, origin))
    return Harness(tuple(joints), np.eye(4) if T_last_carried is None else T_last_carried)


def fixed_distance(
    centre: FloatArray,
    distance: float,
    around: tuple[float, float] = (-math.pi, math.pi),
    turn: tuple[float, float] = (-math.pi, math.pi),
    reach: float = 0.0,
) -> Harness:
    """Return a station on a circle about the vertical through ``centre`` (3,), with its own rotation about z.

    ``around`` ranges the angle about the centre, ``turn`` the station's own rotation relative to facing outwards,
    both in rad. With ``reach`` the distance may grow from ``distance`` to ``distance + reach``, all in m: an annulus.

    Raises:
        InvalidInputError: If the distance is negative or a range is empty.
    """
    if not distance >= 0.0:
        raise InvalidInputError(f"a station stands at the distance {distance:.6g} m: it must not be negative")
    at_centre = pose(np.asarray(centre, float), np.eye(3))
    out = pose(np.array([distance, 0.0, 0.0]), np.eye(3))
    joints = [DesignJoint("around", True, Z, *around, at_centre)]
    if reach != 0.0:
        joints.append(DesignJoint("out", False, X, distance, distance + reach))
        out = np.eye(4)
    joints.append(DesignJoint("turn", True, Z, *turn, out))
    return Harness(tuple(joints))


def wall_following(start: FloatArray, end: FloatArray, from_wall: float = 0.0) -> Harness:
    """Return a station that slides along a wall from ``start`` to ``end`` (3,), its x pointing away from the wall.

    The wall stands upright on the line, the room is on its left seen from ``start`` to ``end``; the station keeps
    ``from_wall`` m off the line.

    Raises:
        InvalidInputError: If start and end stand above each other.
    """
    first, last = np.asarray(start, float), np.asarray(end, float)
    along = last - first
    if math.hypot(along[0], along[1]) < 1e-9:
        raise InvalidInputError(f"a wall runs from {first.tolist()} to {last.tolist()}: give it a horizontal direction")
    heading = math.atan2(along[1], along[0]) + math.pi / 2.0
    origin = pose(first, rotation_from_rpy(0.0, 0.0, heading))
    direction = origin[:3, :3].T @ along
    length = float(np.linalg.norm(along))
    slide = DesignJoint("along", False, direction / length, 0.0, length, origin)
    return Harness((slide,), pose(np.array([from_wall, 0.0, 0.0]), np.eye(3)))
