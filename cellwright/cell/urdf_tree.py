"""Read a URDF text into a checked tree of links and joints, with rest poses; no geometry, no kinematics library.

Follows the URDF specification (wiki.ros.org/urdf/XML): missing origins are the identity, a missing axis is x.
Joints that are not on the arm's chain (grippers, camera pans) stand still at zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from xml.etree import ElementTree

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.transforms import inverse, pose, rotation_from_rpy
from cellwright.errors import InvalidInputError, listed

MOVING_TYPES = ("revolute", "continuous", "prismatic", "planar", "floating")


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint as written: its name, type, the links it joins, its pose on the parent link, axis and limits.

    ``limits`` holds what the file states of ``lower``, ``upper``, ``velocity``.
    """

    name: str
    kind: str
    parent: str
    child: str
    T_parent_joint: FloatArray
    axis: FloatArray
    limits: dict[str, float]
    mimics: str


@dataclass(frozen=True, eq=False)
class UrdfTree:
    """A URDF whose joints are known to form one tree.

    Attributes:
        name: The robot's name in the file.
        root: The link without parent.
        links: Every link's XML element by its name, in file order.
        joint_above: The joint whose child a link is, by the link's name; the root has none.
    """

    name: str
    root: str
    links: dict[str, ElementTree.Element]
    joint_above: dict[str, UrdfJoint] = field(repr=False)

    def path(self, base: str, tip: str) -> list[UrdfJoint]:
        """Return the joints from link ``base`` down to link ``tip``.

        Raises:
            InvalidInputError: If a link does not exist or ``tip`` does not hang on ``base``.
        """
        for link in (base, tip):
            if link not in self.links:
                raise InvalidInputError(f"URDF {self.name!r} has no link {link!r}: it has {listed(self.links, 12)}")
        joints: list[UrdfJoint] = []
        link = tip
        while link != base:
            if link not in self.joint_above:
                raise InvalidInputError(
                    f"link {tip!r} of URDF {self.name!r} does not hang on link {base!r}: name another base or flange"
                )
            joints.append(self.joint_above[link])
            link = joints[-1].parent
        return joints[::-1]

    def rest_poses(self) -> dict[str, FloatArray]:
        """Return each link's pose in the root link with all joints at zero."""
        poses = {self.root: np.eye(4)}
        for link in self.links:
            pending: list[UrdfJoint] = []
            above = link
            while above not in poses:
                pending.append(self.joint_above[above])
                above = pending[-1].parent
            for joint in reversed(pending):
                poses[joint.child] = poses[joint.parent] @ joint.T_parent_joint
        return poses

    def attachments(self, base: str, chain_joints: list[UrdfJoint]) -> dict[str, tuple[int, FloatArray]]:
        """Return what carries each link: 0 the base, i the link behind chain joint i, and its pose on it (4, 4).

        Everything that does not move with the chain, also links above ``base``, is carried by the base.
        """
        carrier = {joint.child: number for number, joint in enumerate(chain_joints, 1)}
        rest = self.rest_poses()
        attached: dict[str, tuple[int, FloatArray]] = {}
        for link in self.links:
            above = link
            while above not in carrier and above in self.joint_above:
                above = self.joint_above[above].parent
            number = carrier.get(above, 0)
            origin = chain_joints[number - 1].child if number else base
            attached[link] = (number, inverse(rest[origin]) @ rest[link])
        return attached


def parse_urdf(text: str) -> UrdfTree:
    """Parse a URDF.

    Raises:
        InvalidInputError: If the text is no XML, no URDF, an unexpanded xacro, or its joints form no single tree.
    """
    try:
        robot = ElementTree.fromstring(text.strip())
    except (ElementTree.ParseError, ValueError) as failure:
        raise InvalidInputError(f"the URDF is not valid XML ({failure}): check the file") from failure
    if robot.tag != "robot":
        raise InvalidInputError(f"the URDF's outermost element is <{robot.tag}>, not <robot>: check the file")
    if any("xacro" in element.tag for element in robot.iter()):
        raise InvalidInputError("the file is an unexpanded xacro: run `xacro file.xacro > file.urdf` first")
    name = robot.get("name", "robot")
    links: dict[str, ElementTree.Element] = {}
    for element in robot.findall("link"):
        link = _attribute(element, "name", "a link")
        if link in links:
            raise InvalidInputError(f"URDF {name!r} has two links named {link!r}: rename one")
        links[link] = element
    joints = [_joint(element) for element in robot.findall("joint")]
    return _tree(name, links, joints)


def _tree(name: str, links: dict[str, ElementTree.Element], joints: list[UrdfJoint]) -> UrdfTree:
    joint_above: dict[str, UrdfJoint] = {}
    names: set[str] = set()
    for joint in joints:
        if joint.name in names:
            raise InvalidInputError(f"URDF {name!r} has two joints named {joint.name!r}: rename one")
        names.add(joint.name)
        for end in (joint.parent, joint.child):
            if end not in links:
                raise InvalidInputError(
                    f"joint {joint.name!r} names link {end!r}, which the URDF does not have: add it"
                )
        if joint.child in joint_above:
            raise InvalidInputError(
                f"link {joint.child!r} has two parents, by joints {joint_above[joint.child].name!r} "
                f"and {joint.name!r}: a URDF must be a tree"
            )
        joint_above[joint.child] = joint
    roots = [link for link in links if link not in joint_above]
    if len(roots) != 1:
        found = f"{len(roots)} links without a parent ({listed(roots)})" if links else "no link"
        raise InvalidInputError(f"URDF {name!r} has {found}: it must be one tree with one root")
    tree = UrdfTree(name, roots[0], links, joint_above)
    for link in links:
        above, steps = link, 0
        while above in joint_above:
            above, steps = joint_above[above].parent, steps + 1
            if steps > len(links):
                raise InvalidInputError(f"the joints above link {link!r} run in a circle: a URDF must be a tree")
    return tree


def _joint(element: ElementTree.Element) -> UrdfJoint:
    name = _attribute(element, "name", "a joint")
    subject = f"joint {name!r}"
    kind = _attribute(element, "type", subject)
    if kind != "fixed" and kind not in MOVING_TYPES:
        raise InvalidInputError(f"{subject} has type {kind!r}: write one of fixed, {', '.join(MOVING_TYPES)}")
    ends = {}
    for end in ("parent", "child"):
        found = element.find(end)
        if found is None:
            raise InvalidInputError(f'{subject} has no <{end}>: add <{end} link="..."/>')
        ends[end] = _attribute(found, "link", f"<{end}> of {subject}")
    axis_element = element.find("axis")
    axis = np.array([1.0, 0.0, 0.0])
    if axis_element is not None:
        axis = _numbers(axis_element, "xyz", 3, f"<axis> of {subject}", (1.0, 0.0, 0.0))
    length = math.hypot(*axis)
    if kind in ("revolute", "continuous", "prismatic") and length < 1e-9:
        raise InvalidInputError(f"{subject} has the axis {axis.tolist()}: give it a direction")
    limit = element.find("limit")
    limits: dict[str, float] = {}
    for key in ("lower", "upper", "velocity"):
        if limit is not None and limit.get(key) is not None:
            limits[key] = float(_numbers(limit, key, 1, f"<limit> of {subject}", (0.0,))[0])
    mimic = element.find("mimic")
    return UrdfJoint(
        name,
        kind,
        ends["parent"],
        ends["child"],
        origin_of(element, subject),
        axis / length if length > 0 else axis,
        limits,
        "" if mimic is None else mimic.get("joint", ""),
    )


def origin_of(element: ElementTree.Element, subject: str) -> FloatArray:
    """Return the pose (4, 4) that the element's ``<origin>`` states; ``subject`` names it in errors.

    Raises:
        InvalidInputError: If its numbers cannot be read.
    """
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    where = f"<origin> of {subject}"
    xyz = _numbers(origin, "xyz", 3, where, (0.0, 0.0, 0.0))
    roll, pitch, yaw = _numbers(origin, "rpy", 3, where, (0.0, 0.0, 0.0)).tolist()
    return pose(xyz, rotation_from_rpy(roll, pitch, yaw))


def numbers_of(element: ElementTree.Element, key: str, count: int, subject: str) -> FloatArray:
    """Return the ``count`` numbers of a required attribute.

    Raises:
        InvalidInputError: If the attribute is missing or holds anything else.
    """
    _attribute(element, key, subject)
    return _numbers(element, key, count, subject, ())


def _numbers(
    element: ElementTree.Element, key: str, count: int, subject: str, default: tuple[float, ...]
) -> FloatArray:
    text = element.get(key)
    if text is None:
        return np.array(default)
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise InvalidInputError(f"{subject} has {key}={text!r}: write {count} finite numbers")
    return np.array(values)


def _attribute(element: ElementTree.Element, key: str, subject: str) -> str:
    value = element.get(key)
    if not value:
        raise InvalidInputError(f"{subject} of the URDF has no {key}: add it")
    return value
