"""Artefacts of the workpiece: its preprocessed mesh and samples of its surface, in the frame `part`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from schemas.artefact import Artefact
from schemas.columns import column, fact


@dataclass(frozen=True, eq=False, repr=False)
class PartMesh(Artefact):
    """The workpiece as one welded, consistently oriented triangle mesh, with what was found wrong in it."""

    KIND: ClassVar[str] = "part-mesh"

    vertices_m: FloatArray = column("Vertices", width=3, unit="m", frame="part", table="vertices")
    faces: Int32Array = column("Triangles, outward by the right-hand rule", dtype="int32", width=3, table="faces")
    normals: FloatArray = column("Outward unit normals of the faces", width=3, frame="part", table="faces")
    areas_m2: FloatArray = column("Face areas", unit="m^2", table="faces")
    to_measure: BoolArray = column(
        "Whether the face is to be measured: not turned to the table within the critical angle",
        dtype="bool",
        table="faces",
    )
    watertight: bool = fact("Whether the mesh encloses a volume", dtype="bool")
    two_sided: bool = fact(
        "Whether both sides of every face count as surface: an open shell without a volume", dtype="bool"
    )
    finding: tuple[str, ...] = column("What was found and mended, in words", dtype="str", table="findings")


@dataclass(frozen=True, eq=False, repr=False)
class Surroundings(Artefact):
    """What stands still around the part and can block the scanner's sight, as triangles where the part is placed.

    It is seen from the part: a cell that is moved as a whole has the same surroundings.
    """

    KIND: ClassVar[str] = "surroundings"

    vertices_m: FloatArray = column("Vertices", width=3, unit="m", frame="part", table="vertices")
    faces: Int32Array = column("Triangles", dtype="int32", width=3, table="faces")


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSamples(Artefact):
    """Points on the faces to be measured, with the normals of their faces."""

    KIND: ClassVar[str] = "surface-samples"

    points_m: FloatArray = column("Positions", width=3, unit="m", frame="part", table="samples")
    normals: FloatArray = column("Outward unit normals", width=3, frame="part", table="samples")
    face: Int32Array = column("Face of the part mesh", dtype="int32", table="samples")
    method: str = fact("random or blue-noise", dtype="str")
    density_per_m2: float = fact("Density asked for", unit="1/m^2")
    area_m2: float = fact("Area that was sampled", unit="m^2")
