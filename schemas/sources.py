"""Artefacts that hold what a user brought: files by their bytes, and the robot as it was described."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellwright.arrays import FloatArray, Int8Array, Int32Array
from schemas.artefact import Artefact
from schemas.columns import blob, column, fact


@dataclass(frozen=True, eq=False, repr=False)
class SourceFile(Artefact):
    """A user's file, byte for byte, so that a plan can be rerun when the file on disk has moved."""

    KIND: ClassVar[str] = "source-file"

    name: str = fact("File name with its suffix, without folder", dtype="str")
    content: bytes = blob("The file's bytes", suffix=".source")


@dataclass(frozen=True, eq=False, repr=False)
class CellModel(Artefact):
    """The cell without the part: robot, tool, table, obstacles, and the pairs of bodies that may touch.

    `schemas.cell_objects.build_cell` turns it into the library's `cellwright.cell.cell.Cell`.
    """

    KIND: ClassVar[str] = "cell-model"

    urdf: str = fact("The robot's URDF text", dtype="str")
    base_link: str = fact("URDF link that is the frame `base`", dtype="str")
    flange_link: str = fact("URDF link that is the frame `flange`", dtype="str")
    T_world_base: FloatArray = column(
        "Pose of the robot's base in the world, rows of a 4x4 matrix", width=4, frame="world", table="base"
    )
    T_flange_scanner: FloatArray = column(
        "Pose of the scanner (laser-emitter frame) on the flange, rows of a 4x4 matrix",
        width=4,
        frame="flange",
        table="mount",
    )
    joint: tuple[str, ...] = column("Joint names, base to flange", dtype="str", table="joints")
    lower_rad: FloatArray = column("Lower joint limits", unit="rad", table="joints")
    upper_rad: FloatArray = column("Upper joint limits", unit="rad", table="joints")
    max_velocity_rad_s: FloatArray = column("Joint speed limits", unit="rad/s", table="joints")
    max_acceleration_rad_s2: FloatArray = column("Joint acceleration limits", unit="rad/s^2", table="joints")
    start_rad: FloatArray = column("Start configuration", unit="rad", table="joints")
    body: tuple[str, ...] = column("Body names", dtype="str", table="bodies")
    parent: Int32Array = column(
        "What moves the body: -1 the world, 0 the robot's base, i the link behind joint i (the tool: last)",
        dtype="int32",
        table="bodies",
    )
    shape: tuple[str, ...] = column("box, cylinder, sphere, capsule or mesh", dtype="str", table="bodies")
    size_m: FloatArray = column(
        "Box: edge lengths; cylinder and capsule: radius, length, 0; sphere: radius, 0, 0; mesh: zeros",
        width=3,
        unit="m",
        table="bodies",
    )
    T_parent_body: FloatArray = column(
        "Pose of the body on its parent, a 4x4 matrix row by row", width=16, frame="parent", table="bodies"
    )
    first_vertex: Int32Array = column("First vertex of a mesh body", dtype="int32", table="bodies")
    n_vertices: Int32Array = column("Vertices of a mesh body", dtype="int32", table="bodies")
    first_face: Int32Array = column("First face of a mesh body", dtype="int32", table="bodies")
    n_faces: Int32Array = column("Faces of a mesh body", dtype="int32", table="bodies")
    vertices_m: FloatArray = column("Mesh vertices of all bodies", width=3, unit="m", frame="body", table="vertices")
    faces: Int32Array = column(
        "Triangles of all bodies, counted from the body's first vertex", dtype="int32", width=3, table="faces"
    )
    ignored_pair: Int32Array = column(
        "Pairs of body rows that are not checked against each other", dtype="int32", width=2, table="pairs"
    )
    ignored_reason: Int8Array = column(
        "0 same parent, 1 neighbours, 2 always touching, 3 never touching in sampling, 4 declared",
        dtype="int8",
        table="pairs",
    )
