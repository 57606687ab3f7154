"""Robots that come with cellwright: their URDF, collision meshes and acceleration limits by name."""

from __future__ import annotations

import difflib
import hashlib
import math
from dataclasses import dataclass
from importlib import resources

import numpy as np

from cellwright.cell.bodies import Body
from cellwright.cell.robot import Robot
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.urdf_geometry import ReadMesh, collision_bodies
from cellwright.errors import InvalidInputError


@dataclass(frozen=True)
class BuiltIn:
    """What a URDF does not hold of a built-in robot.

    Attributes:
        name: Name in cell files and of its folder.
        joint_names: The moving joints, base to flange.
        max_acceleration: Joint acceleration limits in rad/s^2, of prismatic joints in m/s^2.
        home: A configuration out of the way, rad, of prismatic joints m.
        touching: Pairs of links that are no neighbours and whose shapes overlap though the bodies do not.
    """

    name: str
    joint_names: tuple[str, ...]
    max_acceleration: tuple[float, ...]
    home: tuple[float, ...]
    touching: tuple[tuple[str, str], ...] = ()


_RIGHT = math.pi / 2.0
_HEAVY_RAMPS = (1.15, 1.5, 1.5, 0.45, 0.45, 0.70)
"""Seconds to full speed that the published speeds and accelerations of the KUKA KR 210 R3100 ultra give."""


def _joints(pattern: str, n_joints: int = 6) -> tuple[str, ...]:
    return tuple(pattern.format(number) for number in range(1, n_joints + 1))


def _ramped(*speeds: float) -> tuple[float, ...]:
    """Accelerations of a heavy six-axis arm whose maker publishes none: as its sibling by payload class."""
    return tuple(round(speed / ramp, 4) for speed, ramp in zip(speeds, _HEAVY_RAMPS, strict=True))


_UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
_ABB_TOUCHING = (("link_2", "link_4"), ("link_4", "link_6"))

# All accelerations are estimates: no maker publishes them. Light arms: half of what the published torques leave
# without load in the worst of 3000 random poses, at most speed / 0.15 s. Heavy arms: `_HEAVY_RAMPS`.
BUILT_IN = (
    BuiltIn(
        "ur10e",
        _UR_JOINTS,
        (12.48, 8.08, 19.75, 20.94, 20.94, 20.94),
        (0.0, -_RIGHT, _RIGHT, -_RIGHT, -_RIGHT, 0.0),
    ),
    BuiltIn(
        "ur5",
        _UR_JOINTS,
        (17.25, 11.35, 21.0, 21.33, 21.33, 21.33),
        (0.0, -_RIGHT, _RIGHT, -_RIGHT, -_RIGHT, 0.0),
    ),
    BuiltIn(
        "crx10ia_l",
        _joints("J{}"),
        (12.07, 7.52, 20.94, 20.94, 20.94, 20.94),
        (0.0, 0.3, -0.4, 0.0, -1.0, 0.0),
    ),
    BuiltIn(
        "kr180_r2500_extra",
        _joints("joint_a{}"),
        _ramped(2.146755, 2.007129, 2.094395, 3.124139, 3.00196, 3.822271),
        (0.0, -_RIGHT, _RIGHT, 0.0, _RIGHT, 0.0),
    ),
    BuiltIn(
        "nj290",
        _joints("q{}"),
        _ramped(1.57, 1.919862, 1.919862, 1.919862, 1.919862, 1.919862),
        (0.0, 0.0, -_RIGHT, 0.0, _RIGHT, 0.0),
        (("link4", "link6"),),
    ),
    BuiltIn(
        "irb6640",
        _joints("joint_{}"),
        _ramped(1.7453, 1.5707, 1.5707, 2.9671, 2.4435, 3.3161),
        (0.0, 0.0, 0.0, 0.0, math.pi / 6.0, 0.0),
        _ABB_TOUCHING,
    ),
    BuiltIn(
        "irb6400",
        _joints("joint_{}"),
        _ramped(1.7453, 1.5707, 1.5707, 2.9671, 2.4435, 3.3161),
        (0.0, 0.0, 0.0, 0.0, math.pi / 6.0, 0.0),
        _ABB_TOUCHING,
    ),
    # chosen: speed over 0.5 s, the quill's over 0.25 s
    BuiltIn("scara", _joints("joint_{}", 3), (5.06, 5.06, 4.0), (-1.8, -0.9, 0.0)),
    # chosen, as everything about it
    BuiltIn("pr_robot", ("joint_r", "joint_p"), (6.0, 4.0), (0.0, 0.0)),
)


def built_in(name: str) -> BuiltIn:
    """Look a built-in robot up, in any letter case.

    Raises:
        InvalidInputError: If there is none of that name.
    """
    for entry in BUILT_IN:
        if entry.name == name.lower():
            return entry
    names = [entry.name for entry in BUILT_IN]
    close = difflib.get_close_matches(name.lower(), names, 1, 0.5)
    hint = f"did you mean {close[0]!r}?" if close else f"built in: {', '.join(names)}; or give a URDF file"
    raise InvalidInputError(f"no robot named {name!r} is built in: {hint}")


def built_in_urdf(name: str) -> str:
    """Return the URDF text of a built-in robot.

    Raises:
        InvalidInputError: If there is none of that name.
    """
    entry = built_in(name)
    return _read(entry.name, f"{entry.name}.urdf").decode()


def built_in_robot(name: str) -> Robot:
    """Return a built-in robot of revolute joints.

    Raises:
        InvalidInputError: If there is none of that name, or it has a prismatic joint.
    """
    entry = built_in(name)
    return Robot.from_urdf(built_in_urdf(name), max_acceleration=entry.max_acceleration, name=entry.name)


def built_in_arm(name: str) -> SerialArm:
    """Return a built-in robot, prismatic joints or not, as layout optimisation takes it.

    Raises:
        InvalidInputError: If there is none of that name.
    """
    entry = built_in(name)
    return SerialArm.from_urdf(built_in_urdf(name), max_acceleration=np.array(entry.max_acceleration), name=entry.name)


def built_in_bodies(name: str, robot: Robot | None = None) -> tuple[Body, ...]:
    """Return the collision bodies of a built-in robot.

    ``robot`` is the robot made of its URDF with other base or flange links, if there is such a one.

    Raises:
        InvalidInputError: If there is none of that name.
    """
    entry = built_in(name)
    return collision_bodies(robot or built_in_robot(name), lambda filename: _read(entry.name, filename))


def built_in_meshes(name: str) -> ReadMesh:
    """Return a reader of the collision meshes of a built-in robot, by their names in its URDF.

    Raises:
        InvalidInputError: If there is no robot of that name.
    """
    entry = built_in(name)
    return lambda filename: _read(entry.name, filename)


def built_in_digest(name: str) -> str:
    """Return the SHA-256 (hex) of all that makes a built-in robot: another release may have corrected it.

    Raises:
        InvalidInputError: If there is none of that name.
    """
    entry = built_in(name)
    whole = hashlib.sha256(repr(entry).encode())
    folder = resources.files("cellwright").joinpath("robots", entry.name)
    for file in sorted(folder.iterdir(), key=lambda each: each.name):
        if file.is_file():
            content = file.read_bytes()
            whole.update(f"\0{file.name}\0{len(content)}\0".encode() + content)
    return whole.hexdigest()


def _read(robot: str, filename: str) -> bytes:
    return resources.files("cellwright").joinpath("robots", robot, filename).read_bytes()
