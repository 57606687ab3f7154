"""Triangle meshes of robots and obstacles from the bytes of their files, welded and in m.

STL, PLY, OBJ, 3MF and STEP are read as parts are (`cellwright.cell.part`); DAE, OFF and GLB, which only robots and
obstacles come as, by trimesh (DAE needs pycollada beside it).
"""

from __future__ import annotations

import importlib
import io
from pathlib import PurePosixPath

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.bodies import Mesh
from cellwright.cell.part import METRES_PER_UNIT, read_mesh
from cellwright.errors import InvalidInputError

READ_AS_PARTS = (".stl", ".ply", ".obj", ".3mf", ".step", ".stp")
READ_BY_TRIMESH = (".dae", ".off", ".glb")

# what trimesh's readers raise on malformed files: they have no error class of their own
_READER_FAULTS = (
    ArithmeticError,
    AttributeError,
    ImportError,
    LookupError,
    EOFError,
    NotImplementedError,
    SyntaxError,
    TypeError,
    ValueError,
)


def mesh_from_bytes(name: str, content: bytes, scale: FloatArray | None = None) -> Mesh:
    """Read a mesh file; equal vertices are welded, triangles that collapse and loose vertices are left out.

    ``scale`` (3,) multiplies the axes, negative factors mirror; a file that states its unit (3MF, STEP) is in m
    before.

    Raises:
        InvalidInputError: If the file is empty, of an unknown kind, garbage, or without finite triangles.
    """
    suffix = PurePosixPath(name).suffix.lower()
    factors = np.ones(3) if scale is None else np.asarray(scale, float)
    if not (np.isfinite(factors).all() and (factors != 0.0).all()):
        raise InvalidInputError(f"mesh file {name!r} is scaled by {factors.tolist()}: give three numbers other than 0")
    if suffix in READ_AS_PARTS:
        read = read_mesh(name, content)
        vertices, faces = read.vertices * METRES_PER_UNIT.get(read.unit or "m", 1.0), read.faces.astype(np.int64)
    elif suffix in READ_BY_TRIMESH:
        vertices, faces = _by_trimesh(name, content, suffix)
    else:
        kinds = ", ".join((*READ_AS_PARTS, *READ_BY_TRIMESH))
        raise InvalidInputError(f"mesh file {name!r} is of no known kind: convert it to one of {kinds}")
    welded, row = np.unique(vertices, axis=0, return_inverse=True)
    faces = row.reshape(-1)[faces].reshape(-1, 3)
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    if not len(faces):
        raise InvalidInputError(f"mesh file {name!r} has only triangles without area: export it again")
    used, row = np.unique(faces, return_inverse=True)
    faces = row.reshape(-1, 3)
    if np.prod(factors) < 0.0:
        faces = faces[:, ::-1]
    return Mesh(np.ascontiguousarray(welded[used] * factors), np.ascontiguousarray(faces, np.int32))


def _by_trimesh(name: str, content: bytes, suffix: str) -> tuple[FloatArray, IntArray]:
    import trimesh

    if not content:
        raise InvalidInputError(f"mesh file {name!r} is empty: export it again")
    faults: tuple[type[Exception], ...] = (*_READER_FAULTS, *_collada_faults())
    try:
        loaded = trimesh.load_mesh(io.BytesIO(content), file_type=suffix[1:], process=False)
        vertices, faces = np.asarray(loaded.vertices, float), np.asarray(loaded.faces, np.int64)
    except faults as failure:
        said = str(failure).splitlines()[0][:100] if str(failure) else type(failure).__name__
        raise InvalidInputError(
            f"mesh file {name!r} cannot be read as {suffix[1:].upper()} ({said}): convert it to STL"
        ) from failure
    if len(faces) and (vertices.ndim != 2 or vertices.shape[1] != 3 or faces.max() >= len(vertices)):
        raise InvalidInputError(f"mesh file {name!r} is malformed (vertices or faces are incomplete): export it again")
    if not len(faces) or not np.isfinite(vertices[faces.ravel()]).all():
        raise InvalidInputError(f"mesh file {name!r} has no triangles, or some that are not finite: export it again")
    return vertices, faces


def _collada_faults() -> tuple[type[Exception], ...]:
    try:
        common = importlib.import_module("collada.common")
    except ImportError:
        return ()
    return (common.DaeError,)
