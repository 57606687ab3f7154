"""Turn a part file into one welded, outward mesh in m, and mark the faces that are to be measured.

Faces turned to the table within the critical angle of its negative normal are not measured (Kaiser 2021, section
4.1). Defects that planning can live with (holes, non-manifold edges) become findings; files that cannot be a part
(no triangles, not finite, 60 m long) are errors. An open sheet is measured on the side that faces up.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field, field_validator

from cellwright.errors import InvalidInputError
from schemas.params import Params
from schemas.part import PartMesh
from schemas.sources import SourceFile
from schemas.stage import stage


class MeshParams(Params):
    """Settings of the mesh preprocessing."""

    unit: Literal["um", "mm", "cm", "m", "in", "ft"] | None = Field(
        default=None, description="Unit of the file; None: what the file states, else mm."
    )
    scale: float = Field(default=1.0, gt=0, description="Factor on the size.")
    up_part: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 1.0), description="The table's normal in the part's frame."
    )
    critical_angle_rad: float = Field(
        default=math.radians(20.0), ge=0, lt=math.pi / 2, description="Faces within it of the table are not measured."
    )
    weld_tolerance_m: float = Field(default=1e-6, ge=0, description="Corners closer than this become one.")
    smallest_m: float = Field(default=1e-3, gt=0, description="A part's longest edge is at least this.")
    largest_m: float = Field(default=5.0, gt=0, description="A part's longest edge is at most this.")

    @field_validator("up_part")
    @classmethod
    def _has_direction(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if math.hypot(*value) < 1e-9:
            raise ValueError(f"up_part {value} has no direction: give the table's normal")
        return value


@stage(version=2)
def preprocess_mesh(source: SourceFile, *, params: MeshParams) -> PartMesh:
    """Preprocess a part.

    Raises:
        InvalidInputError: If the file is no mesh, its size is implausible, or no face is left to measure.
    """
    from cellwright.cell.mesh_repair import repair_mesh
    from cellwright.cell.part import METRES_PER_UNIT, read_mesh, size_fault, used_rows

    raw = read_mesh(source.name, source.content)
    unit = _unit(source.name, raw.unit, params.unit)
    vertices = raw.vertices * (METRES_PER_UNIT[unit] * params.scale)
    used = vertices[used_rows(raw.faces)]
    size = float((used.max(axis=0) - used.min(axis=0)).max())
    fault = size_fault(source.name, size, unit, params.smallest_m, params.largest_m)
    if fault is not None:
        raise InvalidInputError(fault)
    up = np.array(params.up_part) / math.hypot(*params.up_part)
    try:
        mesh = repair_mesh(vertices, raw.faces, up, min(params.weld_tolerance_m, 1e-4 * size))
    except InvalidInputError as error:
        raise InvalidInputError(f"{source.name}: {error}") from error
    # the angle between the normal and the negative table normal must exceed the critical angle
    to_measure = mesh.two_sided | (mesh.normals @ -up < math.cos(params.critical_angle_rad))
    if not to_measure.any():
        raise InvalidInputError(
            f"{source.name}: all {len(mesh.faces)} faces are turned to the table within "
            f"{math.degrees(params.critical_angle_rad):g} deg: check the part's pose"
        )
    return PartMesh(
        vertices_m=mesh.vertices,
        faces=mesh.faces,
        normals=mesh.normals,
        areas_m2=mesh.areas,
        to_measure=to_measure,
        watertight=mesh.watertight,
        two_sided=mesh.two_sided,
        finding=mesh.findings,
    )


def _unit(name: str, stated: str | None, given: str | None) -> str:
    from cellwright.cell.part import METRES_PER_UNIT

    if stated is None:
        return given or "mm"
    if stated not in METRES_PER_UNIT:
        raise InvalidInputError(f"{name} states the unknown unit {stated!r}: export it in mm")
    if given is not None and given != stated:
        raise InvalidInputError(f"{name} carries its own unit: remove unit: {given}, or use scale")
    return stated
