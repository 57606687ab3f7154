"""Read part files into triangles, find the size they must have meant, and stand a part on a table.

STL is read here (binary and text), PLY, OBJ and 3MF by trimesh, STEP by OpenCASCADE through cascadio. Files are
given by their bytes. What a reader cannot make sense of is an `InvalidInputError` that names the file and the mend.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from cellwright.arrays import AnyArray, FloatArray, Int32Array, IntArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.quiet_output import quiet_output
from cellwright.cell.text_stl import is_text_stl, text_stl_corners, wide_text
from cellwright.cell.transforms import apply, pose
from cellwright.errors import InvalidInputError

METRES_PER_UNIT = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
"""Units of part files, and their length in m."""

_UNITS_OF_3MF = {"micron": "um", "millimeter": "mm", "centimeter": "cm", "meter": "m", "inch": "in", "foot": "ft"}
_MAX_UNPACKED_BYTES = 2_000_000_000

# What trimesh's readers raise on malformed files: they have no error class of their own.
_READER_FAULTS = (
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    NameError,
    RuntimeError,
    ArithmeticError,
    StopIteration,
    EOFError,
    SyntaxError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)

_OBJ_NOUGHT = re.compile(rb"^[ \t]*f[ \t](?:[^\r\n#]*?[ \t])??0+(?=[/\s]|\Z)", re.M)
_PLY_FACES = re.compile(rb"^element face (\d{1,12})\s*$", re.M)

_STEP_CHORD_SHARE = 2e-4
"""Chord error of a tessellated STEP file as a share of its diagonal: 0.1 mm on a part of half a metre."""
_STEP_CHORD_MM = (0.01, 0.1)
"""The chord error is kept in these bounds: well below the scanner's uncertainty, and not finer than it is worth."""
_STEP_ANGLE_RAD = 0.25
"""Largest angle between neighbouring normals on a curved face."""


@dataclass(frozen=True, eq=False)
class FileMesh:
    """The triangles of a file as they stand in it.

    Attributes:
        vertices: (n, 3) in the file's unit.
        faces: Rows of ``vertices``, (m, 3).
        unit: The unit that the file itself states, ``None`` if it states none.
    """

    vertices: FloatArray
    faces: Int32Array
    unit: str | None


def read_mesh(name: str, content: bytes) -> FileMesh:
    """Read a part file; ``name`` gives its type by the suffix: stl, ply, obj, 3mf, step, stp.

    Raises:
        InvalidInputError: If the file is empty, of unknown type, malformed, holds no triangles, or a vertex that
            a triangle uses is not finite.
    """
    suffix = PurePath(name).suffix.lower()
    if not content:
        raise InvalidInputError(f"{name} is empty (0 bytes): export the part again")
    if suffix == ".stl":
        mesh = _read_stl(name, content)
    elif suffix in (".step", ".stp"):
        mesh = _read_step(name, content)
    elif suffix in (".ply", ".obj", ".3mf"):
        mesh = _read_by_trimesh(name, content, suffix)
    else:
        raise InvalidInputError(f"{name} has the unknown type {suffix!r}: use stl, ply, obj, 3mf, step or stp")
    _check(name, mesh)
    return mesh


def used_rows(faces: AnyArray) -> IntArray:
    """Return the rows of the vertices that faces use, ascending. (`np.unique` takes seconds for a million faces.)"""
    return np.flatnonzero(np.bincount(faces.ravel()))


def size_fault(name: str, size: float, unit: str, smallest: float, largest: float) -> str | None:
    """Say what is wrong with a part's size (longest edge of its box, m), or ``None`` if it is plausible.

    The message guesses the unit that was meant: the first of mm, in, cm, m, ft, um that gives 10 mm to 2 m.
    """
    if smallest <= size <= largest:
        return None
    as_written = size / METRES_PER_UNIT[unit]
    guesses = (other for other in ("mm", "in", "cm", "m", "ft", "um") if other != unit)
    fits = next((other for other in guesses if 0.01 <= as_written * METRES_PER_UNIT[other] <= 2.0), None)
    shown = f"{size:.3g} m" if size >= 1 else f"{size * 1e3:.3g} mm"
    limit = f"at most {largest:g} m" if size > largest else f"at least {smallest * 1e3:g} mm"
    mend = f"is the unit {fits}? Write unit: {fits}" if fits else "check unit and scale"
    return f"{name} is {shown} long as read in {unit}, but a part must be {limit}: {mend}"


def resting_pose(vertices: FloatArray, rotation: FloatArray, xy: tuple[float, float], table_top: float) -> FloatArray:
    """Stand a part on a table: return ``T_world_part`` (4, 4).

    Args:
        vertices: The part's vertices in its own frame, (n, 3) in m.
        rotation: Its orientation in the world, (3, 3).
        xy: Where the middle of its footprint (bounding rectangle along the world's axes) stands, m.
        table_top: Height of the table's top in the world, m.
    """
    turned = vertices @ rotation.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    middle = (low + high) / 2
    return pose(np.array([xy[0] - middle[0], xy[1] - middle[1], table_top - low[2]]), rotation)


def top_height(shape: Shape, T_world_body: FloatArray) -> float:
    """Return the height of the highest point of a body in the world, m."""
    z = T_world_body[2, :3]  # world's z axis in the body frame
    reach: float
    if isinstance(shape, Mesh):
        return float(apply(T_world_body, shape.vertices)[:, 2].max())
    if isinstance(shape, Box):
        reach = float(np.abs(z) @ np.array(shape.size)) / 2
    elif isinstance(shape, Sphere):
        reach = shape.radius
    elif isinstance(shape, Capsule):
        reach = abs(float(z[2])) * shape.length / 2 + shape.radius
    else:
        reach = _cylinder_reach(shape, z)
    return float(T_world_body[2, 3]) + reach


def _cylinder_reach(shape: Cylinder, z: FloatArray) -> float:
    return abs(float(z[2])) * shape.length / 2 + float(np.hypot(z[0], z[1])) * shape.radius


def _read_stl(name: str, content: bytes) -> FileMesh:
    n_said = int.from_bytes(content[80:84], "little") if len(content) >= 84 else 0
    n_there = max(0, len(content) - 84) // 50
    if wide_text(content):
        raise InvalidInputError(f"{name} is text in UTF-16, but an STL is text in ASCII or UTF-8: save it so")
    # some programs begin binary files with the word that marks text
    if len(content) != 84 + 50 * n_said and is_text_stl(content):
        return _soup(text_stl_corners(name, content))
    if len(content) < 84 or n_said > n_there:
        raise InvalidInputError(
            f"{name} is no STL, or is cut off: it says {n_said} faces but holds {n_there}: export the part again"
        )
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.frombuffer(content, record, count=n_said, offset=84)["corners"]
    with np.errstate(invalid="ignore"):  # signalling NaNs; they are refused later, with their number
        return _soup(corners.reshape(-1, 3).astype(np.float64))


def _soup(corners: FloatArray) -> FileMesh:
    return FileMesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3), None)


def _read_step(name: str, content: bytes) -> FileMesh:
    import cascadio

    # asked before OpenCASCADE is, because that one complains on the terminal
    if not content.lstrip()[:13].startswith(b"ISO-10303-21"):
        raise InvalidInputError(f"{name} is no STEP file (it does not begin with ISO-10303-21): export it again")
    if b"END-ISO-10303-21" not in content[-4096:]:
        raise InvalidInputError(f"{name} is cut off (END-ISO-10303-21 is missing): export it again")

    def tessellate(chord_mm: float, angle_rad: float) -> FileMesh:
        with quiet_output() as said:
            binary = cascadio.load(
                content, file_type="step", tol_linear=chord_mm, tol_angular=angle_rad, use_parallel=False
            )
        if not binary:
            words = f" ({said[0]})" if said else ""
            raise InvalidInputError(f"{name} is a malformed STEP file, or holds no shape{words}: export it again")
        return _from_scene(name, binary, ".glb")

    rough = tessellate(1e3, 0.5)
    low, high = rough.vertices.min(axis=0), rough.vertices.max(axis=0)
    chord_mm = float(np.clip(_STEP_CHORD_SHARE * np.linalg.norm(high - low) * 1e3, *_STEP_CHORD_MM))
    fine = tessellate(chord_mm, _STEP_ANGLE_RAD)
    return FileMesh(fine.vertices, fine.faces, "m")  # cascadio converts what the file says into m


def _read_by_trimesh(name: str, content: bytes, suffix: str) -> FileMesh:
    if suffix == ".3mf":
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                unpacked = sum(member.file_size for member in archive.infolist())
        except (*_READER_FAULTS, OSError) as error:
            raise InvalidInputError(f"{name} is no 3MF file (no readable zip archive): export it again") from error
        if unpacked > _MAX_UNPACKED_BYTES:
            raise InvalidInputError(f"{name} unpacks to {unpacked / 1e9:.0f} GB: simplify the part")
    nought = _OBJ_NOUGHT.search(content) if suffix == ".obj" else None
    if nought is not None:  # trimesh takes it as the last vertex
        line = content.count(b"\n", 0, nought.start()) + 1
        raise InvalidInputError(f"{name}, line {line}: a face names vertex 0, but OBJ counts from 1: export it again")
    mesh = _from_scene(name, content, suffix)
    if suffix == ".ply":  # trimesh passes over rows that are not there
        said = _PLY_FACES.search(content[:65536])
        if said is not None and len(mesh.faces) < int(said[1]):
            raise InvalidInputError(
                f"{name} is cut off: it says {int(said[1])} faces but holds {len(mesh.faces)}: export the part again"
            )
    return mesh


def _from_scene(name: str, content: bytes, suffix: str) -> FileMesh:
    import trimesh

    options: dict[str, Any] = {"skip_materials": True} if suffix == ".obj" else {}
    try:
        scene = trimesh.load_scene(io.BytesIO(content), file_type=suffix[1:], process=False, **options)
        meshes = [item for item in scene.dump() if isinstance(item, trimesh.Trimesh) and len(item.faces)]
        stated = str(scene.units).lower().rstrip("s") if suffix == ".3mf" and meshes else None
    except _READER_FAULTS as error:
        said = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        raise InvalidInputError(f"{name} is malformed ({said}): export the part again") from error
    flat = next((mesh for mesh in meshes if np.ndim(mesh.vertices) != 2 or np.shape(mesh.vertices)[1] != 3), None)
    if flat is not None:
        raise InvalidInputError(f"{name} is malformed (some vertices have not three coordinates): export it again")
    if not meshes:
        raise InvalidInputError(f"{name} holds no triangles (a point cloud or an empty scene?): give a mesh")
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return FileMesh(
        np.concatenate([np.asarray(mesh.vertices, np.float64) for mesh in meshes]),
        np.concatenate([np.asarray(mesh.faces, np.int64) + start for mesh, start in zip(meshes, first)]).astype(
            np.int32
        ),
        _UNITS_OF_3MF.get(stated, stated) if stated is not None else None,
    )


def _check(name: str, mesh: FileMesh) -> None:
    if len(mesh.faces) == 0:
        raise InvalidInputError(f"{name} holds no triangles: export the part again, as a mesh")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise InvalidInputError(
            f"{name} has a face with vertex {mesh.faces.max()} but {len(mesh.vertices)} vertices: export it again"
        )
    used = used_rows(mesh.faces)
    with np.errstate(invalid="ignore"):
        sound = np.isfinite(mesh.vertices[used]).all(axis=1) & (np.abs(mesh.vertices[used]) < 1e15).all(axis=1)
    if not sound.all():
        raise InvalidInputError(
            f"{name} has {np.count_nonzero(~sound)} of {len(used)} vertices that are not finite, the first is "
            f"vertex {used[~sound][0]}: export the part again"
        )
