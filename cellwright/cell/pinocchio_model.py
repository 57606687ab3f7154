"""The pinocchio model of an arm's chain: for dynamics, and as the peer that our kinematics are tested against."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

if TYPE_CHECKING:
    from cellwright.cell.robot import Robot


def pinocchio_model(robot: Robot) -> Any:
    """Return a ``pinocchio.Model`` whose universe is the base link and whose joints are the arm's.

    The URDF is cut to the part below the base link, every joint off the chain is fixed at zero, geometry and
    transmissions are left out.
    """
    import pinocchio

    source = ElementTree.fromstring(robot.urdf.strip())
    below = {robot.base_link}
    pending = [robot.base_link]
    children: dict[str, list[str]] = {}
    for child, joint in robot.tree.joint_above.items():
        children.setdefault(joint.parent, []).append(child)
    while pending:
        for child in children.get(pending.pop(), []):
            below.add(child)
            pending.append(child)
    cut = ElementTree.Element("robot", {"name": robot.name})
    for element in source.findall("link"):
        if element.get("name") in below:
            for part in [*element.findall("visual"), *element.findall("collision")]:
                element.remove(part)
            cut.append(element)
    for element in source.findall("joint"):
        child_element = element.find("child")
        link = "" if child_element is None else child_element.get("link", "")
        if link in below and link != robot.base_link:
            _adopt(element, robot)
            cut.append(element)
    model = pinocchio.buildModelFromXML(ElementTree.tostring(cut, encoding="unicode"))
    model.velocityLimit = robot.chain.max_velocity.copy()
    return model


def _adopt(element: ElementTree.Element, robot: Robot) -> None:
    """Make a joint revolute with the robot's own limits, or fixed if it is off the chain.

    Pinocchio would store a continuous joint as cosine and sine, so that its q were not ours.
    """
    name = element.get("name", "")
    if name not in robot.joint_names:
        element.set("type", "fixed")
        return
    row = robot.joint_names.index(name)
    limit = element.find("limit")
    if limit is None:
        limit = ElementTree.SubElement(element, "limit")
    element.set("type", "revolute")
    limit.set("lower", repr(float(robot.chain.lower[row])))
    limit.set("upper", repr(float(robot.chain.upper[row])))
    limit.set("velocity", repr(float(robot.chain.max_velocity[row])))
    limit.set("effort", limit.get("effort", "0"))
