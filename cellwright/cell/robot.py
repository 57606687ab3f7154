"""A serial arm: its URDF, its limits, its chain as plain arrays for kernels, and its pinocchio model.

The chain is read off the URDF by our own parser and agrees with pinocchio to 1e-12; pinocchio itself is loaded
only when `Robot.model` is asked for. Arms of revolute joints only; other joints of the URDF stand still at zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.urdf_tree import UrdfJoint, UrdfTree, parse_urdf
from cellwright.errors import InvalidInputError, listed

ACCELERATION_TIME = 0.15
"""Seconds in which a joint without stated acceleration limit reaches full speed: URDF has no such field.

Close to what published torques and inertias of collaborative arms allow with a light tool.
"""
BASE_NAMES = ("base_link",)
FLANGE_NAMES = ("tool0", "fanuc_flange", "flange")
"""By ROS-Industrial's convention z of `tool0` (FANUC: `fanuc_flange`) points out of the flange; of `flange` it is x."""

SHORTEST_REACH_M, LONGEST_REACH_M = 0.01, 50.0
"""No arm is shorter or longer, base to flange, stretched; outside, its URDF is in other units than m."""

JointValues = Mapping[str, float] | Sequence[float] | FloatArray
"""One number a joint in joint order, a single one for all joints, or numbers by joint name for some of them."""


@dataclass(frozen=True, eq=False)
class Chain:
    """A serial chain of revolute joints as plain arrays, for numba kernels and inverse kinematics.

    The pose of link ``i`` (behind joint ``i``, ``i`` from 1) in the base is the product over joints of
    ``T_parent_joint[k] @ rotation(axis[k], q[k])``; the flange is ``link_n @ T_last_flange``.

    Attributes:
        T_parent_joint: Fixed pose of each joint frame on the link before it, (joints, 4, 4).
        axis: Unit rotation axes in the joint frames, (joints, 3).
        T_last_flange: Pose of the flange on the last link, (4, 4).
        lower, upper: Joint limits in rad, (joints,).
        max_velocity: Joint speed limits in rad/s, (joints,).
        max_acceleration: Joint acceleration limits in rad/s^2, (joints,).
    """

    T_parent_joint: FloatArray
    axis: FloatArray
    T_last_flange: FloatArray
    lower: FloatArray
    upper: FloatArray
    max_velocity: FloatArray
    max_acceleration: FloatArray

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            # own copies, left writeable: numba would compile every kernel again for read-only arrays
            object.__setattr__(self, name, np.array(getattr(self, name), np.float64, order="C"))

    @property
    def n_joints(self) -> int:
        """The number of joints."""
        return len(self.axis)


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A serial arm of revolute joints from ``base_link`` to ``flange_link``; make it by `from_urdf`.

    Attributes:
        name: For people.
        urdf: The URDF text.
        base_link, flange_link: The URDF links whose frames are `base` and `flange`.
        joint_names: Names of the moving joints, base to flange.
        chain: Kinematics and limits as arrays.
        tree: The parsed URDF.
    """

    name: str
    urdf: str
    base_link: str
    flange_link: str
    joint_names: tuple[str, ...]
    chain: Chain
    tree: UrdfTree

    @classmethod
    def from_urdf(
        cls,
        urdf_text: str,
        *,
        base_link: str | None = None,
        flange_link: str | None = None,
        lower: JointValues | None = None,
        upper: JointValues | None = None,
        max_velocity: JointValues | None = None,
        max_acceleration: JointValues | None = None,
        name: str = "",
    ) -> Robot:
        """Read an arm from a URDF text; geometry is not touched (see `cellwright.cell.urdf_geometry`).

        Without ``base_link`` it is the link `base_link` if there is one, else the root. Without ``flange_link``
        it is `tool0`, else `fanuc_flange`, else `flange` (also behind a prefix, if only one link ends so), else
        the link behind the last joint of the chain with most moving joints. A continuous joint without limits
        gets -2 pi to 2 pi.
        Limits given here (rad, rad/s, rad/s^2; in joint order, or by name for some joints) replace those of
        the URDF. Accelerations that are not given are the joint's speed limit over 0.15 s.

        Raises:
            InvalidInputError: If the URDF is malformed, the chain has a joint that is not revolute or mimics
                another, or a limit is missing or makes no sense.
        """
        tree = parse_urdf(urdf_text)
        base, flange, joints = arm_joints(tree, base_link, flange_link)
        path = tree.path(base, flange)
        names = tuple(joint.name for joint in joints)
        speed = _limits(joints, "velocity", _values("max_velocity", max_velocity, names))
        given = _values("max_acceleration", max_acceleration, names)
        low = _limits(joints, "lower", _values("lower", lower, names))
        high = _limits(joints, "upper", _values("upper", upper, names))
        acceleration = np.where(np.isnan(given), speed / ACCELERATION_TIME, given)
        _check_limits(names, low, high, speed, acceleration)
        fixed, T_last_flange = fixed_poses(path)
        axis = np.array([joint.axis for joint in joints])
        chain = Chain(fixed, axis, T_last_flange, low, high, speed, acceleration)
        return cls(name or tree.name, urdf_text, base, flange, names, chain, tree)

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, {self.base_link!r} to {self.flange_link!r}, {self.n_joints} joints)"

    @property
    def n_joints(self) -> int:
        """The number of joints."""
        return len(self.joint_names)

    @property
    def joints(self) -> list[UrdfJoint]:
        """The moving joints as the URDF states them, base to flange."""
        return [joint for joint in self.tree.path(self.base_link, self.flange_link) if joint.name in self.joint_names]

    @cached_property
    def model(self) -> Any:
        """The pinocchio model of the chain, rooted at ``base_link``, all other joints fixed at zero."""
        from cellwright.cell.pinocchio_model import pinocchio_model

        return pinocchio_model(self)

    def flange_pose(self, q: FloatArray) -> FloatArray:
        """Return ``T_base_flange`` (4, 4) at joint positions ``q`` (joints,) in rad."""
        from cellwright.cell.chain_kinematics import flange_pose

        T: FloatArray = flange_pose(self.chain.T_parent_joint, self.chain.axis, self.chain.T_last_flange, _row(q))
        return T

    def link_poses(self, q: FloatArray) -> FloatArray:
        """Return the poses of base (row 0, identity) and of the links behind each joint in the base.

        ``q`` (joints,) in rad; result (joints + 1, 4, 4). Row ``i`` carries the bodies with parent ``i``.
        """
        from cellwright.cell.chain_kinematics import link_poses

        T: FloatArray = link_poses(self.chain.T_parent_joint, self.chain.axis, _row(q))
        return T

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Return the geometric Jacobian (6, joints) of the flange in the base frame, linear rows first."""
        from cellwright.cell.chain_kinematics import jacobian

        J: FloatArray = jacobian(self.chain.T_parent_joint, self.chain.axis, self.chain.T_last_flange, _row(q))
        return J


def arm_joints(tree: UrdfTree, base_link: str | None, flange_link: str | None) -> tuple[str, str, list[UrdfJoint]]:
    """Return an arm's base link, flange link and moving joints; links that are not given are found.

    Raises:
        InvalidInputError: If a link does not exist, or not all moving joints between them are plain revolute ones.
    """
    base = base_link or _base_link(tree)
    tree.path(base, base)
    flange = flange_link or _flange_link(tree, base)
    return base, flange, _moving(tree.path(base, flange), base, flange)


def reach_fault(robot: Robot) -> str | None:
    """Say what is wrong with an arm's size, or ``None`` if it is plausible; a URDF in mm is the usual slip."""
    lengths = [math.hypot(*T[:3, 3].tolist()) for T in (*robot.chain.T_parent_joint, robot.chain.T_last_flange)]
    reach = sum(lengths)
    if reach > LONGEST_REACH_M:
        return (
            f"the arm reaches {reach:.6g} m, but {LONGEST_REACH_M:g} m is the most that can be planned: are its "
            "lengths in mm? A URDF's are in m"
        )
    if robot.n_joints > 2 and reach < SHORTEST_REACH_M:  # a turntable has no length
        return (
            f"the arm reaches {reach * 1e3:.6g} mm, but {SHORTEST_REACH_M * 1e3:g} mm is the least that can be "
            "planned: are its lengths in km, or its joints without <origin>? A URDF's lengths are in m"
        )
    return None


def _row(q: FloatArray) -> FloatArray:
    return np.ascontiguousarray(q, np.float64)


def _base_link(tree: UrdfTree) -> str:
    return next((name for name in BASE_NAMES if name in tree.links), tree.root)


def _flange_link(tree: UrdfTree, base: str) -> str:
    hanging = {link: _n_moving(tree, base, link) for link in tree.links}
    for name in FLANGE_NAMES:
        if hanging.get(name, 0) > 0:
            return name
        prefixed = [link for link, count in hanging.items() if link.endswith(name) and count > 0]
        if len(prefixed) == 1:
            return prefixed[0]
    most = max(hanging.values())
    if most < 1:
        raise InvalidInputError(f"no moving joint hangs on link {base!r} of URDF {tree.name!r}: name another base link")
    return next(
        link
        for link, count in hanging.items()
        if count == most and link in tree.joint_above and tree.joint_above[link].kind != "fixed"
    )


def _n_moving(tree: UrdfTree, base: str, link: str) -> int:
    count = 0
    while link != base:
        if link not in tree.joint_above:
            return -1
        count += tree.joint_above[link].kind != "fixed"
        link = tree.joint_above[link].parent
    return count


def _moving(path: list[UrdfJoint], base: str, flange: str) -> list[UrdfJoint]:
    joints = moving_joints(path, base, flange)
    for joint in joints:
        if joint.kind not in ("revolute", "continuous"):
            raise InvalidInputError(
                f"joint {joint.name!r} is {joint.kind}: only arms of revolute joints can be planned; "
                "choose base and flange links so that it lies outside the chain, or make it fixed"
            )
    return joints


def moving_joints(path: list[UrdfJoint], base: str, flange: str) -> list[UrdfJoint]:
    """Return the joints of a path that move on their own.

    Raises:
        InvalidInputError: If there is none, or one mimics another.
    """
    joints = [joint for joint in path if joint.kind != "fixed"]
    if not joints:
        raise InvalidInputError(
            f"no moving joint lies between {base!r} and {flange!r}: name other base or flange links"
        )
    for joint in joints:
        if joint.mimics:
            raise InvalidInputError(
                f"joint {joint.name!r} mimics {joint.mimics!r}: coupled joints on the arm's chain are not supported"
            )
    return joints


def fixed_poses(path: list[UrdfJoint]) -> tuple[FloatArray, FloatArray]:
    """Merge fixed joints into the moving joint behind them: (joints, 4, 4), and the rest up to the flange (4, 4)."""
    fixed: list[FloatArray] = []
    T = np.eye(4)
    for joint in path:
        T = T @ joint.T_parent_joint
        if joint.kind != "fixed":
            fixed.append(T)
            T = np.eye(4)
    return np.array(fixed).reshape(-1, 4, 4), T


def _values(what: str, given: JointValues | None, names: tuple[str, ...]) -> FloatArray:
    """Return one number a joint, NaN where none is given."""
    values = np.full(len(names), np.nan)
    if given is None:
        return values
    if isinstance(given, Mapping):
        unknown = [name for name in given if name not in names]
        if unknown:
            raise InvalidInputError(f"{what} names {listed(unknown)}, but the arm's joints are {listed(names, 12)}")
        for row, name in enumerate(names):
            values[row] = given.get(name, np.nan)
        return values
    row_values = np.asarray(given, float)
    if row_values.shape not in ((len(names),), (1,)):
        raise InvalidInputError(
            f"{what} has {row_values.size} values, but the arm has {len(names)} joints: "
            f"give {len(names)}, or one for all"
        )
    return np.array(np.broadcast_to(row_values, len(names)))


_OVERRIDES = {"lower": "lower_rad", "upper": "upper_rad", "velocity": "max_velocity_rad_s"}
"""What stands in place of a URDF's limits."""


def _limits(joints: list[UrdfJoint], field: str, given: FloatArray) -> FloatArray:
    values = given.copy()
    unlimited = {"lower": -2.0 * math.pi, "upper": 2.0 * math.pi}
    for row, joint in enumerate(joints):
        if not math.isnan(values[row]):
            continue
        if joint.kind == "continuous" and field in unlimited:
            values[row] = unlimited[field]
        elif field in joint.limits:
            values[row] = joint.limits[field]
        else:
            raise InvalidInputError(
                f"joint {joint.name!r} has no {field} limit in the URDF: "
                f'add {field}="..." to its <limit> or state {_OVERRIDES[field]}'
            )
    return values


def _check_limits(
    names: tuple[str, ...], lower: FloatArray, upper: FloatArray, speed: FloatArray, acceleration: FloatArray
) -> None:
    for row, name in enumerate(names):
        if not lower[row] < upper[row]:
            raise InvalidInputError(
                f"joint {name!r} has lower limit {lower[row]:.6g} and upper limit {upper[row]:.6g} rad: "
                "lower must be less than upper"
            )
        if upper[row] - lower[row] > 200.0 * math.pi:
            raise InvalidInputError(
                f"joint {name!r} may turn {upper[row] - lower[row]:.6g} rad: limit it to 100 turns at most"
            )
        for what, value in (("velocity", speed[row]), ("acceleration", acceleration[row])):
            if not (value > 0.0 and math.isfinite(value)):
                raise InvalidInputError(f"joint {name!r} has {what} limit {value:.6g}: it must be positive and finite")
