"""Check a cell file's robot against its URDF before anything is computed: links, joints, limits, names."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from cellwright.cell.built_in_robots import built_in, built_in_urdf
from cellwright.cell.robot import Robot, arm_joints, reach_fault
from cellwright.cell.urdf_geometry import body_names, check_geometry
from cellwright.cell.urdf_tree import UrdfTree, parse_urdf
from cellwright.errors import InvalidInputError
from schemas.cell_file_document import Location
from schemas.cell_file_messages import did_you_mean

if TYPE_CHECKING:
    from schemas.cell_file import RobotSection

PLANNED_JOINTS = 6
"""Joints of the arms that can be planned: inverse kinematics finds every branch of six-axis arms alone."""

_OVERRIDES = ("lower", "upper", "max_velocity", "max_acceleration")
_BLAMED = {
    "lower limit": ("lower", "upper"),
    "may turn": ("lower", "upper"),
    "velocity limit": ("max_velocity",),
    "acceleration limit": ("max_acceleration",),
}
"""The keys that may have given the limit that a message is about."""
_STATED = re.compile(r"\b(lower|upper|max_velocity|max_acceleration)_rad(?:_s2?)?\b")

Faults = list[tuple[Location, str]]


def robot_faults(
    section: RobotSection, bodies: Sequence[tuple[Location, str]], may_touch: Sequence[tuple[str, str]]
) -> Faults:
    """Find what a run would refuse of the robot.

    Args:
        section: The cell file's `robot`.
        bodies: Location and name of the standing bodies and of the scanner's housing.
        may_touch: Pairs of names.
    """
    try:
        text = _urdf_text(section)
        tree = parse_urdf(text)
        check_geometry(tree)
    except InvalidInputError as error:
        return [(("robot", "model"), _of_file(section, str(error)))]
    faults = _name_faults(tree, bodies, may_touch)
    faults += _link_faults(section, tree) or _arm_faults(section, tree, text)
    return faults


def _urdf_text(section: RobotSection) -> str:
    if section.urdf is None:
        return built_in_urdf(section.model)
    try:
        return section.urdf.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidInputError("is not a URDF: it is not text in UTF-8: save it so") from error
    except OSError as error:
        raise InvalidInputError(f"cannot be read ({error.strerror or error}): check the file") from error


def _of_file(section: RobotSection, message: str) -> str:
    message = _STATED.sub(r"robot.\1", message)
    if section.urdf is None:
        return f"{section.model}: {message}"
    return f"{section.urdf.name}{' ' if message.startswith(('is ', 'cannot ')) else ': '}{message}"


def _link_faults(section: RobotSection, tree: UrdfTree) -> Faults:
    return [
        (("robot", key), f"{link!r} is no link of {_shown(section)}: {did_you_mean(link, tree.links)}")
        for key, link in (("base_link", section.base_link), ("flange_link", section.flange_link))
        if link is not None and link not in tree.links
    ]


def _arm_faults(section: RobotSection, tree: UrdfTree, text: str) -> Faults:
    try:
        _, _, joints = arm_joints(tree, section.base_link, section.flange_link)
    except InvalidInputError as error:
        named = [key for key in ("flange_link", "base_link") if getattr(section, key) is not None]
        return [(("robot", named[0] if named else "model"), _of_file(section, str(error)))]
    names = [joint.name for joint in joints]
    faults = _count_faults(section, len(names))
    if len(names) != PLANNED_JOINTS:
        faults.append(
            (
                ("robot", "model"),
                f"the arm has {len(names)} joints between base and flange, but only arms of {PLANNED_JOINTS} can be "
                "planned: choose another robot, base_link or flange_link",
            )
        )
    if faults:
        return faults
    entry = built_in(section.model) if section.urdf is None else None
    acceleration = section.max_acceleration_rad_s2
    if entry is not None and acceleration is None:
        acceleration = entry.max_acceleration
    try:
        robot = Robot.from_urdf(
            text,
            base_link=section.base_link,
            flange_link=section.flange_link,
            lower=section.lower_rad,
            upper=section.upper_rad,
            max_velocity=section.max_velocity_rad_s,
            max_acceleration=acceleration if entry is None or len(acceleration or ()) in (1, len(names)) else None,
        )
    except InvalidInputError as error:
        return [_limit_fault(section, str(error))]
    fault = reach_fault(robot) or _singular_fault(section, robot)
    if fault is not None:
        return [(("robot", "model"), _of_file(section, fault))]
    return list(_start_faults(section, robot, None if entry is None else entry.home))


def _singular_fault(section: RobotSection, robot: Robot) -> str | None:
    if section.urdf is None:
        return None  # known to be none of those, which saves loading a compiler
    from cellwright.cell.dependent_axes import singular_fault

    return singular_fault(robot.chain)


def _count_faults(section: RobotSection, n_joints: int) -> Faults:
    return [
        (("robot", key), f"has {len(values)} entries but {_shown(section)} has {n_joints} joints: write one each")
        for key, values, may_be_one in (
            ("start", section.start_rad, False),
            *((key, getattr(section, _field(key)), True) for key in _OVERRIDES),
        )
        if values is not None and len(values) != n_joints and not (may_be_one and len(values) == 1)
    ]


def _field(key: str) -> str:
    return {"max_velocity": "max_velocity_rad_s", "max_acceleration": "max_acceleration_rad_s2"}.get(key, f"{key}_rad")


def _limit_fault(section: RobotSection, message: str) -> tuple[Location, str]:
    for words, keys in _BLAMED.items():
        given = [key for key in keys if getattr(section, _field(key)) is not None]
        if words in message and given:
            return ("robot", given[0]), _STATED.sub(r"robot.\1", message)
    return ("robot", "model"), _of_file(section, message)


def _start_faults(
    section: RobotSection, robot: Robot, home: tuple[float, ...] | None
) -> Iterator[tuple[Location, str]]:
    start = section.start_rad if section.start_rad is not None else home
    if start is None:
        yield ("robot", "start"), f"is missing, and {_shown(section)} has none of its own: write one angle each joint"
        return
    chain = robot.chain
    for name, value, low, high in zip(robot.joint_names, start, chain.lower.tolist(), chain.upper.tolist()):
        if not low <= value <= high:
            yield (
                ("robot", "start"),
                f"the start configuration breaks joint limits: {name} {math.degrees(value):.6g} deg is outside "
                f"{math.degrees(low):.6g} to {math.degrees(high):.6g} deg: move it inside",
            )


def _name_faults(
    tree: UrdfTree, bodies: Sequence[tuple[Location, str]], may_touch: Sequence[tuple[str, str]]
) -> Faults:
    links = body_names(tree)
    faults: Faults = [
        ((*location, "name"), f"{name!r} names a link of the robot too: choose another")
        for location, name in bodies
        if name in links
    ]
    named = [*links, *(name for _, name in bodies)]
    # several bodies of a link are `link.1`, `link.2`, and `link` means them all
    stems = {stem for stem, _, number in (name.rpartition(".") for name in named) if number.isdigit()}
    known = dict.fromkeys((*named, *sorted(stems)))
    for row, pair in enumerate(may_touch):
        faults += [
            (("may_touch", row), f"{name!r} is no body and no link with a shape: {did_you_mean(name, known)}")
            for name in dict.fromkeys(pair)
            if name not in known
        ]
    return faults


def _shown(section: RobotSection) -> str:
    return section.model if section.urdf is None else section.urdf.name
