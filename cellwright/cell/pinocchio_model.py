"""The pinocchio model of an arm's chain: for dynamics, and as the peer that our kinematics are tested against."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from cellwright.arrays import FloatArray

if TYPE_CHECKING:
    from cellwright.cell.robot import Robot
    from cellwright.cell.urdf_tree import UrdfTree


def pinocchio_model(robot: Robot) -> Any:
    """Return a ``pinocchio.Model`` whose universe is the base link and whose joints are the arm's."""
    chain = robot.chain
    return chain_model(
        robot.urdf,
        robot.name,
        robot.tree,
        robot.base_link,
        robot.joint_names,
        chain.lower,
        chain.upper,
        chain.max_velocity,
    )


def chain_model(
    urdf: str,
    name: str,
    tree: UrdfTree,
    base_link: str,
    joint_names: tuple[str, ...],
    lower: FloatArray,
    upper: FloatArray,
    max_velocity: FloatArray,
) -> Any:
    """Return a ``pinocchio.Model`` whose universe is ``base_link`` and whose joints are those named.

    The URDF is cut to the part below the base link, every other joint is fixed at zero, geometry and transmissions
    are left out. Limits (joints,) in rad or m, rad/s or m/s replace those of the URDF.
    """
    import pinocchio

    source = ElementTree.fromstring(urdf.strip())
    below = {base_link}
    pending = [base_link]
    children: dict[str, list[str]] = {}
    for child, joint in tree.joint_above.items():
        children.setdefault(joint.parent, []).append(child)
    while pending:
        for child in children.get(pending.pop(), []):
            below.add(child)
            pending.append(child)
    cut = ElementTree.Element("robot", {"name": name})
    for element in source.findall("link"):
        if element.get("name") in below:
            for part in [*element.findall("visual"), *element.findall("collision")]:
                element.remove(part)
            cut.append(element)
    for element in source.findall("joint"):
        child_element = element.find("child")
        link = "" if child_element is None else child_element.get("link", "")
        if link in below and link != base_link:
            _adopt(element, joint_names, lower, upper, max_velocity)
            cut.append(element)
    model = pinocchio.buildModelFromXML(ElementTree.tostring(cut, encoding="unicode"))
    model.velocityLimit = max_velocity.copy()
    return model


def _adopt(
    element: ElementTree.Element,
    joint_names: tuple[str, ...],
    lower: FloatArray,
    upper: FloatArray,
    max_velocity: FloatArray,
) -> None:
    """Give a joint of the chain our limits and make it revolute unless it is prismatic; fix it if it is off the chain.

    Pinocchio would store a continuous joint as cosine and sine, so that its q were not ours.
    """
    name = element.get("name", "")
    if name not in joint_names:
        element.set("type", "fixed")
        return
    row = joint_names.index(name)
    limit = element.find("limit")
    if limit is None:
        limit = ElementTree.SubElement(element, "limit")
    if element.get("type") != "prismatic":
        element.set("type", "revolute")
    limit.set("lower", repr(float(lower[row])))
    limit.set("upper", repr(float(upper[row])))
    limit.set("velocity", repr(float(max_velocity[row])))
    limit.set("effort", limit.get("effort", "0"))
