"""The library's shape of a body given as stage parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from cellwright.errors import InvalidInputError, listed
from schemas.body_params import BodyParams, BoxBody, CapsuleBody, CylinderBody, MeshBody, SphereBody

if TYPE_CHECKING:
    from cellwright.cell.bodies import Shape


def shape_of(params: BodyParams, contents: Mapping[str, bytes]) -> Shape:
    """Return the shape; a mesh is read from ``contents``, bytes by file name.

    Raises:
        InvalidInputError: If the mesh is missing or malformed.
    """
    from cellwright.cell import bodies
    from cellwright.cell.mesh_files import mesh_from_bytes

    match params:
        case BoxBody(size_m=size):
            return bodies.Box(size)
        case CylinderBody(radius_m=radius, length_m=length):
            return bodies.Cylinder(radius, length)
        case SphereBody(radius_m=radius):
            return bodies.Sphere(radius)
        case CapsuleBody(radius_m=radius, length_m=length):
            return bodies.Capsule(radius, length)
        case MeshBody(file=file, scale=scale):
            if file not in contents:
                raise InvalidInputError(f"mesh {file!r} is not among the given files ({listed(contents)}): add it")
            return mesh_from_bytes(file, contents[file], np.array(scale))
