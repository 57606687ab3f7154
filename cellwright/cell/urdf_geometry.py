"""The collision bodies of a URDF: boxes, cylinders, spheres, capsules and meshes, each on the link that moves it.

A link fixed to a moving link is merged with it: its bodies carry that joint's number as parent. ``<capsule
radius="" length="">``, which many simulators know though the URDF specification does not, is taken as a capsule
about z whose length does not count the caps. Visual geometry is not looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Body, Box, Capsule, Cylinder, Shape, Sphere
from cellwright.cell.mesh_files import mesh_from_bytes
from cellwright.cell.robot import LONGEST_REACH_M, Robot
from cellwright.cell.urdf_tree import UrdfTree, numbers_of, origin_of, parse_urdf
from cellwright.errors import InvalidInputError, listed

ReadMesh = Callable[[str], bytes]
"""Gives the bytes of a mesh by its ``filename`` in the URDF; raises `InvalidInputError` if there is none."""


def collision_bodies(robot: Robot, read_mesh: ReadMesh) -> tuple[Body, ...]:
    """Return the collision bodies of all links, named after them (``link``, or ``link.1``, ``link.2``, ...).

    Raises:
        InvalidInputError: If geometry is malformed or a mesh is missing or unreadable; the link is named.
    """
    attached = robot.tree.attachments(robot.base_link, robot.joints)
    bodies: list[Body] = []
    for link, element in robot.tree.links.items():
        number, T_parent_link = attached[link]
        collisions = element.findall("collision")
        for name, collision in zip(_names(link, len(collisions)), collisions):
            subject = _subject(link)
            shape = collision_shape(collision, subject, read_mesh)
            _check_size(subject, origin_of(collision, subject), shape)
            bodies.append(Body(name, shape, number, T_parent_link @ origin_of(collision, subject)))
    return tuple(bodies)


def body_names(tree: UrdfTree) -> list[str]:
    """Return the names that `collision_bodies` gives."""
    return [name for link, each in tree.links.items() for name in _names(link, len(each.findall("collision")))]


def check_geometry(tree: UrdfTree) -> None:
    """Check all collision geometry but the meshes' files.

    Raises:
        InvalidInputError: If some is malformed or longer than any arm; the link is named.
    """
    for link, element in tree.links.items():
        for collision in element.findall("collision"):
            subject = _subject(link)
            origin = origin_of(collision, subject)
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                _check_size(subject, origin, collision_shape(collision, subject, meshes_among({})))
            else:
                _mesh_name(mesh, subject)
                _check_size(subject, origin, None)


def _check_size(subject: str, origin: FloatArray, shape: Shape | None) -> None:
    size = max(math.hypot(*origin[:3, 3].tolist()), *(() if shape is None else _extents(shape)), 0.0)
    if size > LONGEST_REACH_M:
        raise InvalidInputError(
            f"{subject} has a length or offset of {size:.6g} m, but {LONGEST_REACH_M:g} m is the most that can be "
            "planned: is it in mm? A URDF's lengths are in m, and its meshes are scaled to m by `scale`"
        )


def _extents(shape: Shape) -> tuple[float, ...]:
    match shape:
        case Box(size):
            return size
        case Cylinder(radius, length) | Capsule(radius, length):
            return 2.0 * radius, length
        case Sphere(radius):
            return (2.0 * radius,)
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    return tuple((high - low).tolist())


def _names(link: str, count: int) -> list[str]:
    return [link] if count == 1 else [f"{link}.{number}" for number in range(1, count + 1)]


def _subject(link: str) -> str:
    return f"collision geometry of link {link!r}"


def mesh_references(urdf_text: str) -> tuple[str, ...]:
    """Return the file names of all collision meshes as the URDF writes them, each once, in order.

    Raises:
        InvalidInputError: If the URDF is malformed.
    """
    return tuple(dict.fromkeys(filename for _, filename in _mesh_files(parse_urdf(urdf_text))))


def _mesh_files(tree: UrdfTree) -> list[tuple[str, str]]:
    return [
        (link, mesh.get("filename", ""))
        for link, element in tree.links.items()
        for mesh in element.iterfind("collision/geometry/mesh")
    ]


def resolve_mesh(filename: str, folder: Path, packages: Mapping[str, Path] | None = None) -> Path:
    """Return the path of a mesh that a URDF in ``folder`` names.

    Tried in order: the path itself if absolute or ``file://``; for ``package://name/rest`` the folder that
    ``packages`` gives for it, then a folder ``name`` at or above ``folder``; then ``folder`` followed by the
    path, and by the path less its first, second, ... folder, so that a URDF still works beside its meshes when
    the package around it is gone.

    Raises:
        InvalidInputError: If none exists, with the paths that were tried.
    """
    scheme, _, rest = filename.rpartition("://")
    tried: list[Path] = []
    if scheme in ("", "file") and Path(rest).is_absolute():
        tried.append(Path(rest))
    parts = [part for part in PurePosixPath(rest).parts if part != "/"]
    if scheme in ("package", "model") and len(parts) > 1:
        if packages is not None and parts[0] in packages:
            tried.append(packages[parts[0]] / PurePosixPath(*parts[1:]))
        for above in (folder, *folder.parents):
            tried.append(above / PurePosixPath(*parts))
            if above.name == parts[0]:
                tried.append(above / PurePosixPath(*parts[1:]))
    tried += [folder / PurePosixPath(*parts[start:]) for start in range(len(parts))]
    for path in tried:
        if path.is_file():
            return path
    raise InvalidInputError(
        f"mesh {filename!r} was not found: tried {listed(dict.fromkeys(map(str, reversed(tried))))}; "
        "put the file beside the URDF"
    )


def meshes_in(folder: Path, packages: Mapping[str, Path] | None = None) -> ReadMesh:
    """Return a reader of the meshes of a URDF that lies in ``folder`` (see `resolve_mesh`)."""

    def read(filename: str) -> bytes:
        return resolve_mesh(filename, folder, packages).read_bytes()

    return read


def meshes_among(files: Mapping[str, bytes]) -> ReadMesh:
    """Return a reader that finds meshes by their file name without folders among given files."""

    def read(filename: str) -> bytes:
        name = PurePosixPath(filename).name
        if name not in files:
            raise InvalidInputError(f"mesh {filename!r} is not among the given files ({listed(files)}): add {name!r}")
        return files[name]

    return read


def collision_shape(collision: ElementTree.Element, subject: str, read_mesh: ReadMesh) -> Shape:
    """Return the shape of a ``<collision>`` element; ``subject`` names it in errors.

    Raises:
        InvalidInputError: If it is malformed, or its mesh is missing or unreadable.
    """
    geometry = collision.find("geometry")
    shapes = [] if geometry is None else list(geometry)
    if len(shapes) != 1:
        raise InvalidInputError(f"{subject} has {len(shapes)} shapes in <geometry>: give one")
    element = shapes[0]
    match element.tag:
        case "box":
            x, y, z = _positive(numbers_of(element, "size", 3, f"<box> of {subject}"), "size", subject)
            return Box((x, y, z))
        case "sphere":
            return Sphere(_length(element, "radius", subject))
        case "cylinder":
            return Cylinder(_length(element, "radius", subject), _length(element, "length", subject))
        case "capsule":
            return Capsule(_length(element, "radius", subject), _length(element, "length", subject))
        case "mesh":
            filename = _mesh_name(element, subject)
            scale = numbers_of(element, "scale", 3, f"<mesh> of {subject}") if element.get("scale") else np.ones(3)
            try:
                return mesh_from_bytes(PurePosixPath(filename).name, read_mesh(filename), scale)
            except InvalidInputError as failure:
                raise InvalidInputError(f"{subject}: {failure}") from failure
    raise InvalidInputError(f"{subject} is a <{element.tag}>: use box, cylinder, sphere, capsule or mesh")


def _mesh_name(element: ElementTree.Element, subject: str) -> str:
    filename = element.get("filename", "")
    if not filename:
        raise InvalidInputError(f"<mesh> of {subject} has no filename: add it")
    return filename


def _length(element: ElementTree.Element, key: str, subject: str) -> float:
    values = numbers_of(element, key, 1, f"<{element.tag}> of {subject}")
    return _positive(values, key, subject)[0]


def _positive(values: FloatArray, key: str, subject: str) -> list[float]:
    if not (values > 0.0).all():
        raise InvalidInputError(f"{subject} has {key} {values.tolist()}: it must be positive")
    return [float(value) for value in values]
