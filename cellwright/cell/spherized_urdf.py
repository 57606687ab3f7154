"""A URDF whose collision geometry is spheres, and an SRDF with the pairs of links that need no check.

Everything but the ``<collision>`` elements stays as it was. Numbers are written so that reading them gives the same
floats. `cellwright.solvers.spheres.robots` fits the spheres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Mesh, Shape, Sphere
from cellwright.cell.enclosing_mesh import enclosing_mesh
from cellwright.cell.ignored_pairs import Reason
from cellwright.cell.transforms import apply
from cellwright.cell.urdf_geometry import ReadMesh, collision_shape
from cellwright.cell.urdf_tree import UrdfTree, origin_of, parse_urdf
from cellwright.errors import InvalidInputError, listed

SRDF_REASONS = {
    Reason.SAME_PARENT: "Adjacent",
    Reason.NEIGHBOURS: "Adjacent",
    Reason.ALWAYS_TOUCHING: "Always",
    Reason.NEVER_TOUCHING: "Never",
    Reason.DECLARED: "User",
}
"""How MoveIt writes why a pair is not checked."""


def link_shapes(tree: UrdfTree, read_mesh: ReadMesh) -> dict[str, list[tuple[Shape, FloatArray]]]:
    """Return the collision shapes of each link that has any, with their poses ``T_link_shape`` (4, 4).

    Raises:
        InvalidInputError: If geometry is malformed or a mesh is missing or unreadable; the link is named.
    """
    found: dict[str, list[tuple[Shape, FloatArray]]] = {}
    for link, element in tree.links.items():
        subject = f"collision geometry of link {link!r}"
        for collision in element.findall("collision"):
            shape = collision_shape(collision, subject, read_mesh)
            found.setdefault(link, []).append((shape, origin_of(collision, subject)))
    return found


def spheres_among(shapes: Sequence[tuple[Shape, FloatArray]]) -> tuple[FloatArray, FloatArray] | None:
    """Return centres (k, 3) and radii (k,) in m if all shapes of a link are spheres, else ``None``."""
    if not all(isinstance(shape, Sphere) for shape, _ in shapes):
        return None
    radii = np.array([shape.radius for shape, _ in shapes if isinstance(shape, Sphere)])
    return np.array([T[:3, 3] for _, T in shapes]).reshape(-1, 3), radii


def merged_mesh(shapes: Sequence[tuple[Shape, FloatArray]]) -> Mesh:
    """Return one mesh in the link's frame that contains all shapes of a link."""
    vertices, faces, n = [], [], 0
    for shape, T_link_shape in shapes:
        mesh = enclosing_mesh(shape)
        vertices.append(apply(T_link_shape, np.asarray(mesh.vertices, float)))
        faces.append(np.asarray(mesh.faces, np.int32) + n)
        n += len(mesh.vertices)
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.int32))


def spherized_urdf(urdf_text: str, spheres: Mapping[str, tuple[FloatArray, FloatArray]]) -> str:
    """Return the URDF with the collision geometry of the given links replaced by spheres.

    Args:
        urdf_text: The URDF.
        spheres: Centres (k, 3) and radii (k,) in m in the link's frame, by link.

    Raises:
        InvalidInputError: If the URDF is malformed or has no such link.
    """
    tree = parse_urdf(urdf_text)
    unknown = [link for link in spheres if link not in tree.links]
    if unknown:
        raise InvalidInputError(f"URDF {tree.name!r} has no link {listed(unknown)}: it has {listed(tree.links, 12)}")
    robot = ElementTree.fromstring(
        urdf_text.strip(), ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    )
    for element in robot.findall("link"):
        if element.get("name") not in spheres:
            continue
        for collision in element.findall("collision"):
            element.remove(collision)
        for centre, radius in zip(*spheres[element.get("name", "")]):
            collision = ElementTree.SubElement(element, "collision")
            xyz = " ".join(repr(float(value)) for value in centre)
            ElementTree.SubElement(collision, "origin", {"xyz": xyz, "rpy": "0 0 0"})
            ElementTree.SubElement(
                ElementTree.SubElement(collision, "geometry"), "sphere", {"radius": repr(float(radius))}
            )
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def srdf_text(name: str, pairs: Sequence[tuple[str, str, Reason]]) -> str:
    """Return an SRDF that lists pairs of links that are not checked against each other."""
    robot = ElementTree.Element("robot", {"name": name})
    for one, other, reason in pairs:
        ElementTree.SubElement(
            robot, "disable_collisions", {"link1": one, "link2": other, "reason": SRDF_REASONS[reason]}
        )
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def rigid_groups(tree: UrdfTree) -> tuple[dict[str, int], set[tuple[int, int]]]:
    """Return which links are fixed to each other (a number each), and which groups a moving joint connects."""
    group: dict[str, int] = {}

    def number(link: str) -> int:
        if link not in group:
            joint = tree.joint_above.get(link)
            fixed = joint is not None and joint.kind == "fixed"
            group[link] = number(joint.parent) if joint is not None and fixed else 1 + max(group.values(), default=-1)
        return group[link]

    for link in tree.links:
        number(link)
    joined = {(group[joint.parent], group[link]) for link, joint in tree.joint_above.items() if joint.kind != "fixed"}
    return group, joined


def sampled_link_poses(tree: UrdfTree, n_samples: int, generator: np.random.Generator) -> dict[str, FloatArray]:
    """Return poses (samples, 4, 4) of all links in the root link, joints drawn evenly between their limits.

    Turning joints without limits take a full turn, sliding ones half a metre each way; planar and floating joints stand
    still. Joints that mimic another are drawn on their own, which reaches more than the robot can.
    """
    poses = {tree.root: np.broadcast_to(np.eye(4), (n_samples, 4, 4))}
    for link in tree.links:
        pending = []
        above = link
        while above not in poses:
            pending.append(tree.joint_above[above])
            above = pending[-1].parent
        for joint in reversed(pending):
            T = poses[joint.parent] @ joint.T_parent_joint
            motion = np.tile(np.eye(4), (n_samples, 1, 1))
            widest = 0.5 if joint.kind == "prismatic" else np.pi
            low, high = joint.limits.get("lower", -widest), joint.limits.get("upper", widest)
            if joint.kind == "continuous":
                low, high = -np.pi, np.pi
            q = generator.uniform(low, max(low, high), n_samples)
            if joint.kind in ("revolute", "continuous"):
                motion[:, :3, :3] = _turns(joint.axis, q)
            elif joint.kind == "prismatic":
                motion[:, :3, 3] = q[:, None] * joint.axis
            poses[joint.child] = T @ motion
    return poses


def _turns(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Return rotations about a unit axis (3,) by angles (n,), (n, 3, 3): Rodrigues' formula."""
    x, y, z = axis.tolist()
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle)[:, None, None] * K + (1.0 - np.cos(angle))[:, None, None] * (K @ K))
