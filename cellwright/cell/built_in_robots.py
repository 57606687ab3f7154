"""Robots that come with cellwright: their URDF, collision meshes and acceleration limits by name."""

from __future__ import annotations

import difflib
import hashlib
from dataclasses import dataclass
from importlib import resources

from cellwright.cell.bodies import Body
from cellwright.cell.robot import Robot
from cellwright.cell.urdf_geometry import collision_bodies
from cellwright.errors import InvalidInputError


@dataclass(frozen=True)
class BuiltIn:
    """What a URDF does not hold of a built-in robot.

    Attributes:
        name: Name in cell files and of its folder.
        joint_names: The moving joints, base to flange.
        max_acceleration: Joint acceleration limits in rad/s^2.
        home: A configuration out of the way, rad.
    """

    name: str
    joint_names: tuple[str, ...]
    max_acceleration: tuple[float, ...]
    home: tuple[float, ...]


BUILT_IN = (
    # accelerations: half of what the published torques leave without load in the worst of 3000 random poses,
    # at most speed / 0.15 s; the maker publishes none
    BuiltIn(
        "ur10e",
        (
            "shoulder_pan_joint",
            "shoulder_lift_joint",
            "elbow_joint",
            "wrist_1_joint",
            "wrist_2_joint",
            "wrist_3_joint",
        ),
        (12.48, 8.08, 19.75, 20.94, 20.94, 20.94),
        (0.0, -1.5707963267948966, 1.5707963267948966, -1.5707963267948966, -1.5707963267948966, 0.0),
    ),
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
    """Return a built-in robot.

    Raises:
        InvalidInputError: If there is none of that name.
    """
    entry = built_in(name)
    return Robot.from_urdf(built_in_urdf(name), max_acceleration=entry.max_acceleration, name=entry.name)


def built_in_bodies(name: str, robot: Robot | None = None) -> tuple[Body, ...]:
    """Return the collision bodies of a built-in robot.

    ``robot`` is the robot made of its URDF with other base or flange links, if there is such a one.

    Raises:
        InvalidInputError: If there is none of that name.
    """
    entry = built_in(name)
    return collision_bodies(robot or built_in_robot(name), lambda filename: _read(entry.name, filename))


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
