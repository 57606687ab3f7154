"""Mesh files as sources of stages: those that a URDF names, and how long one unit of a file is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cellwright.cell.part import METRES_PER_UNIT
from cellwright.cell.urdf_geometry import mesh_references, resolve_mesh
from cellwright.errors import InvalidInputError
from tasks.read_source import SourceParams

_OWN_UNIT = (".step", ".stp", ".3mf")


def carries_unit(file: Path) -> bool:
    """Return whether a mesh file says itself in which unit it is."""
    return file.suffix.lower() in _OWN_UNIT


def metres_per_unit(file: Path, unit: str | None) -> float:
    """Return the metres of one unit of a mesh file; of one that carries none it is ``unit``, mm if left out."""
    return 1.0 if carries_unit(file) else METRES_PER_UNIT[unit or "mm"]


@dataclass(frozen=True)
class RobotMeshes:
    """The meshes that a URDF names.

    Attributes:
        sources: Those that are there, each once.
        missing: What is wrong with each of the others: where it was looked for, and how to mend it.
    """

    sources: tuple[SourceParams, ...]
    missing: tuple[str, ...]


def robot_meshes(urdf: Path, packages: Mapping[str, Path]) -> RobotMeshes:
    """Return the meshes that a URDF names as collision geometry.

    Raises:
        InvalidInputError: If the URDF or a mesh cannot be read, the URDF is malformed, or two different meshes share a
            name.
    """
    sources: dict[str, SourceParams] = {}
    missing: list[str] = []
    for reference in _references(urdf):
        try:
            path = resolve_mesh(reference, urdf.parent, packages)
        except InvalidInputError as error:
            missing.append(str(error))
            continue
        mesh = SourceParams.of(path)
        if sources.setdefault(mesh.name, mesh).sha256 != mesh.sha256:
            raise InvalidInputError(f"{urdf} names two different meshes called {mesh.name}: rename one of them")
    return RobotMeshes(tuple(sources.values()), tuple(missing))


def all_robot_meshes(urdf: Path, packages: Mapping[str, Path], mend: str) -> tuple[SourceParams, ...]:
    """Return the meshes that a URDF names, of which none may be missing.

    Raises:
        InvalidInputError: As `robot_meshes`; or if one is missing: which, and ``mend`` as another way out.
    """
    found = robot_meshes(urdf, packages)
    if found.missing:
        raise InvalidInputError(f"{urdf}: {found.missing[0]}; {mend}")
    return found.sources


def _references(urdf: Path) -> tuple[str, ...]:
    try:
        return mesh_references(urdf.read_text("utf-8"))
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{urdf} is not a URDF: it is not text in UTF-8: save it so") from error
    except OSError as error:
        raise InvalidInputError(f"{urdf} cannot be read ({error.strerror or error}): check the path") from error
    except InvalidInputError as error:
        raise InvalidInputError(f"{urdf}: {error}") from error
