"""Look at the cell that a cell file describes, without planning: is everything there, and where it was meant?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from cellwright.cell.bodies import WORLD, Body, Mesh
from cellwright.cell.part import resting_pose, top_height
from cellwright.errors import InvalidInputError, listed
from flows.cell_keys import with_keys
from schemas.poses import Pose

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from cellwright.cell.cell import Cell
    from flows.requests import InspectionRequest
    from schemas.cell_file import CellFile
    from schemas.overlaps import StandingOverlaps
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


def _drawn(
    described: _Described, request: InspectionRequest, state: FloatArray | None = None, robot_is: str = "at its start"
) -> bytes:
    from cellwright.figures.cell_view import cell_picture

    shape = Mesh(described.mesh.vertices_m, described.mesh.faces)
    cell = described.cell.with_part(shape, described.T_world_part.matrix())
    if state is not None:
        cell = replace(cell, start=state)
    return cell_picture(cell, request.sensing.scanner.scanner(), robot_is)


def picture_of(request: InspectionRequest, state: FloatArray | None = None, robot_is: str = "at its start") -> bytes:
    """Draw a request's cell as PNG bytes, whether or not its bodies collide; some two seconds.

    Args:
        request: What describes the cell.
        state: Joint positions (joints,) in rad to draw the robot at; the start if left out.
        robot_is: Where that is, for the caption.

    Raises:
        InvalidInputError: If part, robot or a body cannot be read or built.
    """
    return _drawn(_described(request), request, state, robot_is)


def _standing(described: _Described, request: InspectionRequest) -> StandingOverlaps:
    """Look how bodies stand, once the start is known to be free.

    Raises:
        InvalidInputError: If bodies collide at the start, or come closer there than the planner's clearance.
    """
    from cellwright.cell.scene import Scene
    from cellwright.cell.start_check import check_start
    from schemas.cell_objects import build_cell
    from tasks.assemble_cell import assemble_cell, quick_cell
    from tasks.find_overlaps import find_overlaps

    T_world_part, clearance = described.T_world_part.matrix(), request.sweeps.clearance_m
    model = quick_cell(described.files, request.cell)
    built = build_cell(model, described.mesh, T_world_part)
    if Scene(built, clearance).colliding_pair(built.start) is not None:
        model = assemble_cell(described.files, params=request.cell)  # seconds, to see whether the pair may touch
        check_start(Scene(build_cell(model, described.mesh, T_world_part), clearance), clearance)
    placed = request.overlaps.model_copy(update={"T_world_part": described.T_world_part})
    stands: StandingOverlaps = find_overlaps(model, described.mesh, params=placed)
    return stands


def check_cell(cell: CellFile, picture: Path | None = None) -> StandingOverlaps:
    """Read all that a cell file names, look whether the robot may start there and how everything stands.

    Args:
        cell: The cell file.
        picture: PNG file to draw the cell into, also where bodies collide at the start.

    Raises:
        InvalidInputError: If a run would refuse part, robot, a body or the start; if the picture's name does not end
            in .png or it cannot be written.
    """
    from flows.requests import request_from

    if picture is not None:
        check_name(picture)
    request, drawn = request_from(cell), False
    try:
        described = _described(request)
        if picture is not None:
            write_picture(picture, _drawn(described, request))
            drawn = True
        return _standing(described, request)
    except InvalidInputError as error:
        told = with_keys(error, cell)
        if drawn:
            told.add_note(f"the cell is drawn in {picture}")
        raise told from error


def check_name(picture: Path) -> None:
    if picture.suffix.lower() != ".png":
        raise InvalidInputError(f"--picture {picture}: pictures are PNG files: let the name end in .png")
    if not picture.parent.is_dir():
        raise InvalidInputError(f"--picture {picture}: there is no folder {picture.parent}: make it first")


def write_picture(picture: Path, content: bytes) -> None:
    try:
        picture.write_bytes(content)
    except OSError as error:
        fact = error.strerror or error
        raise InvalidInputError(f"cannot write {picture}: {fact}: choose another --picture") from error
