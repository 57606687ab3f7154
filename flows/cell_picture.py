"""Draw the cell that a cell file describes, without planning: to see whether everything stands where it was meant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cellwright.cell.bodies import WORLD, Body, Mesh
from cellwright.cell.part import resting_pose, top_height
from cellwright.errors import InvalidInputError, listed
from schemas.poses import Pose

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from cellwright.cell.cell import Cell
    from flows.requests import InspectionRequest
    from schemas.cell_file import CellFile
    from schemas.part import PartMesh
    from schemas.sources import SourceFile


def placed_part(request: InspectionRequest, vertices: FloatArray, bodies: Sequence[Body]) -> Pose:
    """Return where the part, vertices (n, 3) in m, stands: as written, or resting on the body the cell file names.

    Raises:
        InvalidInputError: If no such body stands in the world.
    """
    if request.rests_on is None:
        return request.part_pose
    standing = {body.name: body for body in bodies if body.parent == WORLD}
    if request.rests_on not in standing:
        raise InvalidInputError(
            f"the part rests on {request.rests_on!r}, which does not stand in the cell: use one of {listed(standing)}"
        )
    support = standing[request.rests_on]
    stated = request.part_pose.matrix()
    top = top_height(support.shape, support.T_parent_body)
    return Pose.of(resting_pose(vertices, stated[:3, :3], (stated[0, 3], stated[1, 3]), top))


@dataclass(frozen=True, eq=False)
class _Described:
    """A cell as it is described, nothing checked yet."""

    files: tuple[SourceFile, ...]
    cell: Cell
    mesh: PartMesh
    T_world_part: Pose


def _described(request: InspectionRequest) -> _Described:
    from tasks.assemble_cell import unchecked_cell
    from tasks.preprocess_mesh import preprocess_mesh
    from tasks.read_source import read_source

    files = tuple(read_source(params=source) for source in request.cell_files)
    cell = unchecked_cell(files, request.cell)
    mesh: PartMesh = preprocess_mesh(read_source(params=request.part), params=request.mesh)
    return _Described(files, cell, mesh, placed_part(request, mesh.vertices_m, cell.bodies))


def _drawn(described: _Described, request: InspectionRequest) -> bytes:
    from cellwright.figures.cell_view import cell_picture

    shape = Mesh(described.mesh.vertices_m, described.mesh.faces)
    cell = described.cell.with_part(shape, described.T_world_part.matrix())
    return cell_picture(cell, request.sensing.scanner.scanner())


def picture_of(request: InspectionRequest) -> bytes:
    """Draw a request's cell as PNG bytes, whether or not its bodies collide; some two seconds.

    Raises:
        InvalidInputError: If part, robot or a body cannot be read or built.
    """
    return _drawn(_described(request), request)


def _wrong(described: _Described, request: InspectionRequest) -> list[str]:
    """Say which bodies collide at the start, or else which stand in one another."""
    from tasks.assemble_cell import assemble_cell
    from tasks.find_overlaps import find_overlaps

    try:
        model = assemble_cell(described.files, params=request.cell)
    except InvalidInputError as error:
        return [str(error)]
    placed = request.overlaps.model_copy(update={"T_world_part": described.T_world_part})
    return list(find_overlaps(model, described.mesh, params=placed).finding)


def draw_cell(cell: CellFile, file: Path) -> list[str]:
    """Draw a cell file's cell into a PNG file; return what is wrong with where its bodies stand, in words.

    Raises:
        InvalidInputError: If the name does not end in .png, the file cannot be written, or the cell cannot be built.
    """
    from flows.requests import request_from

    if file.suffix.lower() != ".png":
        raise InvalidInputError(f"--picture {file}: pictures are PNG files: let the name end in .png")
    if not file.parent.is_dir():
        raise InvalidInputError(f"--picture {file}: there is no folder {file.parent}: make it first")
    request = request_from(cell)
    described = _described(request)
    try:
        file.write_bytes(_drawn(described, request))
    except OSError as error:
        raise InvalidInputError(f"cannot write {file}: {error.strerror or error}: choose another --picture") from error
    return _wrong(described, request)
