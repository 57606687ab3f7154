"""Any serial arm read from a URDF: revolute, continuous and prismatic joints, with fixed ones between them.

`cellwright.cell.robot.Robot` is the arm of the planners whose kernels know revolute joints only; `SerialArm` is the
arm of layout optimisation, which also takes SCARA arms, gantries and arms on rails. Kinematics are plain numpy over
any number of configurations at once; a test holds them to pinocchio to 1e-12.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cellwright.arrays import BoolArray, FloatArray
from cellwright.cell.robot import ACCELERATION_TIME, Robot, fixed_poses, moving_joints
from cellwright.cell.urdf_tree import UrdfJoint, UrdfTree, parse_urdf
from cellwright.errors import InvalidInputError

_FULL_TURN = 2.0 * math.pi


def motions(revolute: bool, axis: FloatArray, values: FloatArray) -> FloatArray:
    """Return the displacement (..., 4, 4) of one joint: a rotation by rad or a shift by m along the unit ``axis``.

    ``values`` has any shape (...).
    """
    values = np.asarray(values, float)
    T = np.zeros((*values.shape, 4, 4))
    T[..., 3, 3] = 1.0
    if not revolute:
        T[..., [0, 1, 2], [0, 1, 2]] = 1.0
        T[..., :3, 3] = values[..., None] * axis
        return T
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    along = np.outer(axis, axis)
    cosine, sine = np.cos(values)[..., None, None], np.sin(values)[..., None, None]
    T[..., :3, :3] = along + cosine * (np.eye(3) - along) + sine * cross
    return T


def chain_poses(T_parent_joint: FloatArray, axis: FloatArray, revolute: BoolArray, values: FloatArray) -> FloatArray:
    """Return the poses (..., joints + 1, 4, 4) of the root (row 0, identity) and of the frame behind every joint.

    ``T_parent_joint`` (joints, 4, 4), ``axis`` (joints, 3), ``revolute`` (joints,), ``values`` (..., joints).
    """
    values = np.asarray(values, float)
    n_joints = len(axis)
    poses = np.empty((*values.shape[:-1], n_joints + 1, 4, 4))
    poses[..., 0, :, :] = np.eye(4)
    for joint in range(n_joints):
        moved = T_parent_joint[joint] @ motions(bool(revolute[joint]), axis[joint], values[..., joint])
        poses[..., joint + 1, :, :] = poses[..., joint, :, :] @ moved
    return poses


@dataclass(frozen=True, eq=False, repr=False)
class SerialArm:
    """A serial arm from ``base_link`` to ``flange_link``; make it by `from_urdf` or `from_robot`.

    The pose of link ``i`` (behind joint ``i``, from 1) in the base is the product over joints ``k`` of
    ``T_parent_joint[k] @ motion(axis[k], q[k])``; the flange is ``link_n @ T_last_flange``.

    Attributes:
        name: For people.
        urdf: The URDF text.
        base_link, flange_link: The URDF links whose frames are `base` and `flange`.
        joint_names: Names of the moving joints, base to flange.
        revolute: Whether a joint turns (rad) or shifts (m), (joints,).
        T_parent_joint: Fixed pose of each joint frame on the link before it, (joints, 4, 4).
        axis: Unit axes in the joint frames, (joints, 3).
        T_last_flange: Pose of the flange on the last link, (4, 4).
        lower, upper: Joint limits in rad or m, (joints,).
        max_velocity: In rad/s or m/s, (joints,).
        max_acceleration: In rad/s^2 or m/s^2, (joints,).
        max_effort: In N m or N, (joints,); NaN where the URDF states none.
        tree: The parsed URDF.
    """

    name: str
    urdf: str
    base_link: str
    flange_link: str
    joint_names: tuple[str, ...]
    revolute: BoolArray
    T_parent_joint: FloatArray
    axis: FloatArray
    T_last_flange: FloatArray
    lower: FloatArray
    upper: FloatArray
    max_velocity: FloatArray
    max_acceleration: FloatArray
    max_effort: FloatArray
    tree: UrdfTree

    @classmethod
    def from_urdf(
        cls,
        urdf_text: str,
        *,
        base_link: str | None = None,
        flange_link: str | None = None,
        max_velocity: FloatArray | None = None,
        max_acceleration: FloatArray | None = None,
        name: str = "",
    ) -> SerialArm:
        """Read an arm from a URDF text.

        Without ``base_link`` it is the root, without ``flange_link`` the last link of the chain; with several
        tips the flange link must be named. A continuous joint without limits gets -2 pi to 2 pi. Velocities and
        accelerations given here ((joints,), rad or m) replace those of the URDF; accelerations that nobody gives are
        the speed limit over 0.15 s.

        Raises:
            InvalidInputError: If the URDF is malformed, a joint of the chain is of another kind or mimics one, or a
                limit is missing or makes no sense.
        """
        tree = parse_urdf(urdf_text)
        base = base_link or tree.root
        flange = flange_link or _only_tip(tree, base)
        path = tree.path(base, flange)
        joints = _moving(path, base, flange)
        lower = np.array([_limit(joint, "lower") for joint in joints])
        upper = np.array([_limit(joint, "upper") for joint in joints])
        given = np.array([joint.limits.get("velocity", math.nan) for joint in joints])
        velocity = given if max_velocity is None else np.array(max_velocity, float)
        acceleration = velocity / ACCELERATION_TIME if max_acceleration is None else np.array(max_acceleration, float)
        _check_limits(joints, lower, upper, velocity, acceleration)
        T_parent_joint, T_last_flange = fixed_poses(path)
        return cls(
            name or tree.name,
            urdf_text,
            base,
            flange,
            tuple(joint.name for joint in joints),
            np.array([joint.kind != "prismatic" for joint in joints]),
            T_parent_joint,
            np.array([joint.axis for joint in joints]),
            T_last_flange,
            lower,
            upper,
            velocity,
            acceleration,
            _efforts(urdf_text, [joint.name for joint in joints]),
            tree,
        )

    @classmethod
    def from_robot(cls, robot: Robot) -> SerialArm:
        """Return the same arm with the same limits as a `Robot`."""
        chain = robot.chain
        return cls(
            robot.name,
            robot.urdf,
            robot.base_link,
            robot.flange_link,
            robot.joint_names,
            np.ones(robot.n_joints, bool),
            chain.T_parent_joint.copy(),
            chain.axis.copy(),
            chain.T_last_flange.copy(),
            chain.lower.copy(),
            chain.upper.copy(),
            chain.max_velocity.copy(),
            chain.max_acceleration.copy(),
            _efforts(robot.urdf, list(robot.joint_names)),
            robot.tree,
        )

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array.flags.writeable = False

    def __repr__(self) -> str:
        return f"SerialArm({self.name!r}, {self.base_link!r} to {self.flange_link!r}, {self.n_joints} joints)"

    @property
    def n_joints(self) -> int:
        """The number of moving joints."""
        return len(self.joint_names)

    @cached_property
    def model(self) -> Any:
        """The pinocchio model of the chain, rooted at ``base_link``, all other joints fixed at zero."""
        from cellwright.cell.pinocchio_model import chain_model

        return chain_model(
            self.urdf, self.name, self.tree, self.base_link, self.joint_names, self.lower, self.upper, self.max_velocity
        )

    def link_poses(self, q: FloatArray) -> FloatArray:
        """Return the poses (..., joints + 1, 4, 4) of base (row 0, identity) and links at ``q`` (..., joints)."""
        return chain_poses(self.T_parent_joint, self.axis, self.revolute, q)

    def flange_pose(self, q: FloatArray) -> FloatArray:
        """Return ``T_base_flange`` (..., 4, 4) at ``q`` (..., joints)."""
        return np.asarray(self.link_poses(q)[..., -1, :, :] @ self.T_last_flange)

    def jacobian(
        self, q: FloatArray, T_flange_tool: FloatArray | None = None, links: FloatArray | None = None
    ) -> FloatArray:
        """Return the geometric Jacobian (..., 6, joints) of the flange, or of a tool on it, in the base frame.

        Linear rows (m per rad or per m) come first. ``q`` is (..., joints); who has its `link_poses` may give them.
        """
        links = self.link_poses(q) if links is None else links
        T_last_tip = self.T_last_flange if T_flange_tool is None else self.T_last_flange @ T_flange_tool
        tip = (links[..., -1, :, :] @ T_last_tip)[..., :3, 3]
        J = np.zeros((*tip.shape[:-1], 6, self.n_joints))
        for joint in range(self.n_joints):
            # a joint's own motion leaves its axis where it is, so the frame behind it serves as well
            frame = links[..., joint + 1, :, :]
            axis = frame[..., :3, :3] @ self.axis[joint]
            if self.revolute[joint]:
                origin = (links[..., joint, :, :] @ self.T_parent_joint[joint])[..., :3, 3]
                J[..., :3, joint] = np.cross(axis, tip - origin)
                J[..., 3:, joint] = axis
            else:
                J[..., :3, joint] = axis
        return J


def _only_tip(tree: UrdfTree, base: str) -> str:
    tree.path(base, base)
    parents = {joint.parent for joint in tree.joint_above.values()}
    tips = []
    for link in tree.links:
        above = link
        while above != base and above in tree.joint_above:
            above = tree.joint_above[above].parent
        if above == base and link not in parents:
            tips.append(link)
    if len(tips) != 1:
        raise InvalidInputError(
            f"URDF {tree.name!r} has {len(tips)} tips below link {base!r} ({', '.join(tips[:8])}): name the flange link"
        )
    return tips[0]


def _moving(path: list[UrdfJoint], base: str, flange: str) -> list[UrdfJoint]:
    joints = moving_joints(path, base, flange)
    for joint in joints:
        if joint.kind not in ("revolute", "continuous", "prismatic"):
            raise InvalidInputError(f"joint {joint.name!r} is {joint.kind}: use revolute, continuous, prismatic, fixed")
    return joints


def _limit(joint: UrdfJoint, which: str) -> float:
    if which in joint.limits:
        return joint.limits[which]
    if joint.kind == "continuous":
        return -_FULL_TURN if which == "lower" else _FULL_TURN
    return 0.0  # the URDF specification's default


def _check_limits(
    joints: list[UrdfJoint], lower: FloatArray, upper: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> None:
    for what, values in (("max_velocity", velocity), ("max_acceleration", acceleration)):
        if values.shape != (len(joints),):
            raise InvalidInputError(f"{what} has shape {values.shape}, but the arm has {len(joints)} joints")
    for row, joint in enumerate(joints):
        unit = "m" if joint.kind == "prismatic" else "rad"
        if not lower[row] < upper[row]:
            ends = f"lower limit {lower[row]:.6g} and upper limit {upper[row]:.6g} {unit}"
            none = [which for which in ("lower", "upper") if which not in joint.limits]
            if none:
                raise InvalidInputError(
                    f"joint {joint.name!r} has {ends}, as it states no {' and no '.join(none)}: add it to its <limit>"
                )
            raise InvalidInputError(
                f"joint {joint.name!r} has {ends}: lower must be less than upper; move them apart by more than "
                f"{lower[row] - upper[row]:.6g} {unit}"
            )
        if math.isnan(velocity[row]):
            raise InvalidInputError(f"joint {joint.name!r} has no velocity limit: add velocity to its <limit>")
        for what, value in (("velocity", velocity[row]), ("acceleration", acceleration[row])):
            if not (value > 0.0 and math.isfinite(value)):
                raise InvalidInputError(
                    f"joint {joint.name!r} has {what} limit {value:.6g} {unit}: give a positive, finite one"
                )


def _efforts(urdf_text: str, names: list[str]) -> FloatArray:
    efforts = dict.fromkeys(names, math.nan)
    for element in ElementTree.fromstring(urdf_text.strip()).findall("joint"):
        limit = element.find("limit")
        name = element.get("name", "")
        if limit is None or name not in efforts or limit.get("effort") is None:
            continue
        try:
            efforts[name] = float(limit.get("effort", "nan"))
        except ValueError as failure:
            raise InvalidInputError(f"joint {name!r} has effort={limit.get('effort')!r}: write a number") from failure
    return np.array([efforts[name] for name in names])
