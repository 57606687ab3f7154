"""Turn robot and bodies of a file into the parameters of `assemble_cell`, and into the files that a cell is made of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellwright.cell.built_in_robots import built_in_digest
from cellwright.cell.part import METRES_PER_UNIT
from cellwright.cell.urdf_geometry import mesh_references, resolve_mesh
from cellwright.errors import InvalidInputError
from schemas.body_params import BodyParams, BoxBody, CapsuleBody, CylinderBody, MeshBody, SphereBody
from schemas.cell_file import RobotSection
from schemas.cell_file_fields import BodySection
from schemas.poses import Pose
from tasks.assemble_cell import CellModelParams
from tasks.read_source import SourceParams


def cell_params(
    robot: RobotSection,
    T_flange_tool: Pose,
    housing: Sequence[BodySection],
    bodies: Sequence[BodySection],
    may_touch: tuple[tuple[str, str], ...],
) -> tuple[tuple[SourceParams, ...], CellModelParams]:
    """Return the files that a cell is made of, each once, and how it is put together.

    Raises:
        InvalidInputError: If one of the files is malformed or missing, or two meshes have one name.
    """
    sources: dict[str, SourceParams] = {}
    model = robot.model if robot.urdf is None else add_urdf(robot, sources)
    params = CellModelParams(
        robot=model,
        robot_sha256=built_in_digest(model) if robot.urdf is None else "",
        base_link=robot.base_link,
        flange_link=robot.flange_link,
        T_world_base=robot.base.pose(),
        T_flange_scanner=T_flange_tool,
        housing=tuple(body_params(body, sources) for body in housing),
        bodies=tuple(body_params(body, sources) for body in bodies),
        start_rad=robot.start_rad,
        lower_rad=robot.lower_rad,
        upper_rad=robot.upper_rad,
        max_velocity_rad_s=robot.max_velocity_rad_s,
        max_acceleration_rad_s2=robot.max_acceleration_rad_s2,
        ignored_pairs=may_touch,
    )
    return tuple(sources.values()), params


def add_urdf(robot: RobotSection, sources: dict[str, SourceParams]) -> str:
    """Add a robot's URDF and the meshes that it names to the files of a cell; return the URDF's name among them.

    Raises:
        InvalidInputError: If one of them is malformed or missing, or two meshes have one name.
    """
    urdf = Path(robot.model)
    source = SourceParams.of(urdf)
    sources[source.name] = source
    try:
        text = urdf.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{urdf} is not a URDF: it is not text in UTF-8") from error
    try:
        references = mesh_references(text)
        meshes = [resolve_mesh(reference, urdf.parent, robot.packages) for reference in references]
    except InvalidInputError as error:
        raise InvalidInputError(f"{urdf}: {error}") from error
    for path in meshes:
        mesh = SourceParams.of(path)
        known = sources.setdefault(mesh.name, mesh)
        if known.sha256 != mesh.sha256:
            raise InvalidInputError(f"{urdf} names two different meshes called {mesh.name}: rename one of them")
    return source.name


def body_params(body: BodySection, sources: dict[str, SourceParams]) -> BodyParams:
    """Return a body as `assemble_cell` takes it; the file of a mesh is added to those of the cell.

    Raises:
        InvalidInputError: If it has no shape, or its file is missing.
    """
    pose = body.pose.pose()
    if body.box is not None:
        return BoxBody(name=body.name, pose=pose, size_m=body.box.size_m)
    if body.cylinder is not None:
        return CylinderBody(name=body.name, pose=pose, radius_m=body.cylinder.radius_m, length_m=body.cylinder.length_m)
    if body.capsule is not None:
        return CapsuleBody(name=body.name, pose=pose, radius_m=body.capsule.radius_m, length_m=body.capsule.length_m)
    if body.sphere is not None:
        return SphereBody(name=body.name, pose=pose, radius_m=body.sphere.radius_m)
    if body.mesh is None:
        raise InvalidInputError(f"body {body.name!r} has no shape: give it a box, cylinder, sphere, capsule or mesh")
    # named after the body, so that meshes of one name from different folders do not meet
    name = f"{body.name}: {body.mesh.file.name}"
    sources[name] = SourceParams.of(body.mesh.file).model_copy(update={"name": name})
    carries_unit = body.mesh.file.suffix.lower() in (".step", ".stp", ".3mf")
    factor = body.mesh.scale * (1.0 if carries_unit else METRES_PER_UNIT[body.mesh.unit or "mm"])
    return MeshBody(name=body.name, pose=pose, file=name, scale=(factor, factor, factor))
