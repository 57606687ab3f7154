"""Put the cell together: robot, scanner mount, housing and standing bodies, and the pairs that need no check.

The robot is built in (by its name) or comes as a URDF with its meshes among the files. Pairs to leave out of
collision checks are found by sampling (see `cellwright.cell.ignored_pairs`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from pydantic import Field

from cellwright.cell.bodies import WORLD
from cellwright.errors import InvalidInputError, listed
from schemas.body_params import BodyParams, BoxBody, CapsuleBody, CylinderBody, MeshBody, SphereBody
from schemas.params import Params
from schemas.poses import Pose
from schemas.sources import CellModel, SourceFile
from schemas.stage import Progress, no_progress, stage

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from cellwright.cell.bodies import Body, Shape
    from cellwright.cell.cell import Cell
    from cellwright.cell.ignored_pairs import IgnoredPairs
    from cellwright.cell.robot import Robot

JointValues = tuple[float, ...] | dict[str, float]


class CellModelParams(Params):
    """Everything that stands in the cell but the workpiece. Joint values: in joint order, or by joint name."""

    robot: str = Field(min_length=1, description="Name of a built-in robot, or of a URDF file among the files.")
    robot_sha256: str = Field(
        default="", description="Hash of a built-in robot's data, so that a corrected robot makes another cell."
    )
    base_link: str | None = Field(default=None, description="URDF link that is the frame base; found if left out.")
    flange_link: str | None = Field(default=None, description="URDF link that is the frame flange; found if left out.")
    T_world_base: Pose = Field(default=Pose(), description="Pose of the robot's base in the world.")
    T_flange_scanner: Pose = Field(default=Pose(), description="Pose of the laser-emitter frame on the flange.")
    housing: tuple[BodyParams, ...] = Field(default=(), description="Bodies on the flange: scanner, bracket, cables.")
    bodies: tuple[BodyParams, ...] = Field(default=(), description="Bodies that stand in the world.")
    start_rad: JointValues | None = Field(
        default=None, description="Start configuration; a built-in robot has one of its own."
    )
    lower_rad: JointValues | None = Field(default=None, description="Lower joint limits in place of the URDF's.")
    upper_rad: JointValues | None = Field(default=None, description="Upper joint limits in place of the URDF's.")
    max_velocity_rad_s: JointValues | None = Field(default=None, description="Joint speeds in place of the URDF's.")
    max_acceleration_rad_s2: JointValues | None = Field(
        default=None, description="Joint accelerations; a joint without one reaches full speed in 0.15 s."
    )
    ignored_pairs: tuple[tuple[str, str], ...] = Field(
        default=(), description="Pairs of body names that may touch, beside those found by sampling."
    )
    seed: int = Field(default=0, ge=0, description="Seed of the sampling that finds pairs which never touch.")


@stage(version=3)
def assemble_cell(
    files: tuple[SourceFile, ...], *, params: CellModelParams, progress: Progress = no_progress
) -> CellModel:
    """Assemble the cell model; meshes of URDF and bodies are found among the files by their names.

    Raises:
        InvalidInputError: If the robot is unknown or its URDF malformed, a file is missing or unreadable, names
            are not unique, the start is outside the joint limits, or bodies collide there.
    """
    from cellwright.cell.ignored_pairs import N_SAMPLES

    cell, ignored = _with_ignored(files, params, N_SAMPLES, progress)
    _check_start(replace(cell, ignored_pairs=ignored.pairs))
    return _model(cell, ignored)


def quick_cell(files: tuple[SourceFile, ...], params: CellModelParams) -> CellModel:
    """Return the cell without trying which pairs never touch or always do, and without a look at its start.

    What does not collide in it does not in the model of `assemble_cell` either.

    Raises:
        InvalidInputError: As `assemble_cell`, but for collisions.
    """
    return _model(*_with_ignored(files, params, 0, no_progress))


def _with_ignored(
    files: tuple[SourceFile, ...], params: CellModelParams, n_samples: int, progress: Progress
) -> tuple[Cell, IgnoredPairs]:
    import numpy as np

    from cellwright.cell.ignored_pairs import ignored_pairs

    cell, n_links, touching = _unchecked(files, params)
    ignored = ignored_pairs(
        cell,
        range(n_links),
        np.random.default_rng(params.seed),
        declared=_declared((*params.ignored_pairs, *touching), [body.name for body in cell.bodies]),
        n_samples=n_samples,
        progress=progress,
    )
    return cell, ignored


def _model(cell: Cell, ignored: IgnoredPairs) -> CellModel:
    from schemas.cell_objects import packed_bodies

    robot, chain = cell.robot, cell.robot.chain
    return CellModel(
        urdf=robot.urdf,
        base_link=robot.base_link,
        flange_link=robot.flange_link,
        T_world_base=cell.T_world_base,
        T_flange_scanner=cell.T_flange_scanner,
        joint=robot.joint_names,
        lower_rad=chain.lower,
        upper_rad=chain.upper,
        max_velocity_rad_s=chain.max_velocity,
        max_acceleration_rad_s2=chain.max_acceleration,
        start_rad=cell.start,
        ignored_pair=ignored.pairs,
        ignored_reason=ignored.reason,
        **packed_bodies(cell.bodies),
    )


def unchecked_cell(files: tuple[SourceFile, ...], params: CellModelParams) -> Cell:
    """Return the cell as it is described, to be looked at: nobody has asked whether bodies collide at its start.

    Raises:
        InvalidInputError: As `assemble_cell`, but for collisions.
    """
    cell, _, _ = _unchecked(files, params)
    return cell


def _unchecked(files: tuple[SourceFile, ...], params: CellModelParams) -> tuple[Cell, int, tuple[tuple[str, str], ...]]:
    """Return the cell without pairs that may touch, the number of its links' bodies, and links that may touch."""
    import numpy as np

    from cellwright.cell.cell import Cell

    contents = _contents(files)
    robot, links, home, touching = _robot(params, contents)
    bodies = (
        *links,
        *(_body(body, contents, robot.n_joints, robot.chain.T_last_flange) for body in params.housing),
        *(_body(body, contents, WORLD, np.eye(4)) for body in params.bodies),
    )
    _check_names([body.name for body in bodies])
    cell = Cell(
        robot,
        bodies,
        np.empty((0, 2), np.int32),
        params.T_world_base.matrix(),
        params.T_flange_scanner.matrix(),
        _start(params, robot, home),
    )
    return cell, len(links), touching


def _contents(files: Sequence[SourceFile]) -> dict[str, bytes]:
    contents: dict[str, bytes] = {}
    for file in files:
        if contents.setdefault(file.name, file.content) != file.content:
            raise InvalidInputError(f"two different files are named {file.name!r}: rename one of them")
    return contents


def _robot(
    params: CellModelParams, contents: Mapping[str, bytes]
) -> tuple[Robot, tuple[Body, ...], tuple[float, ...] | None, tuple[tuple[str, str], ...]]:
    """Return the robot, its links' bodies, its own start configuration, and links of its that may touch."""
    from cellwright.cell.built_in_robots import built_in, built_in_bodies, built_in_urdf

    if params.robot in contents:
        try:
            return (*_urdf_robot(params, contents), None, ())
        except InvalidInputError as error:
            raise InvalidInputError(f"{params.robot}: {error}") from error
    own = built_in(params.robot)
    acceleration = params.max_acceleration_rad_s2
    if not isinstance(acceleration, tuple):
        acceleration = dict(zip(own.joint_names, own.max_acceleration)) | (acceleration or {})
    robot = _arm(built_in_urdf(own.name), params, acceleration)
    return robot, built_in_bodies(own.name, robot), own.home, own.touching


def _urdf_robot(params: CellModelParams, contents: Mapping[str, bytes]) -> tuple[Robot, tuple[Body, ...]]:
    from cellwright.cell.robot import reach_fault
    from cellwright.cell.urdf_geometry import check_geometry, collision_bodies, meshes_among

    robot = _arm(_text(contents[params.robot]), params, params.max_acceleration_rad_s2)
    fault = reach_fault(robot)
    if fault is not None:
        raise InvalidInputError(fault)
    check_geometry(robot.tree)
    return robot, collision_bodies(robot, meshes_among(contents))


def _arm(urdf: str, params: CellModelParams, acceleration: JointValues | None) -> Robot:
    from cellwright.cell.robot import Robot

    return Robot.from_urdf(
        urdf,
        base_link=params.base_link,
        flange_link=params.flange_link,
        lower=params.lower_rad,
        upper=params.upper_rad,
        max_velocity=params.max_velocity_rad_s,
        max_acceleration=acceleration,
    )


def _text(content: bytes) -> str:
    try:
        return content.decode()
    except UnicodeDecodeError as failure:
        raise InvalidInputError(f"it is not a URDF, for it is not text in UTF-8 ({failure}): save it so") from failure


def _body(params: BodyParams, contents: Mapping[str, bytes], parent: int, T_parent_frame: FloatArray) -> Body:
    from cellwright.cell.bodies import Body

    return Body(params.name, _shape(params, contents), parent, T_parent_frame @ params.pose.matrix())


def _shape(params: BodyParams, contents: Mapping[str, bytes]) -> Shape:
    import numpy as np

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
                raise InvalidInputError(
                    f"mesh {file!r} of body {params.name!r} is not among the given files ({listed(contents)}): add it"
                )
            return mesh_from_bytes(file, contents[file], np.array(scale))


def _check_names(names: Sequence[str]) -> None:
    from cellwright.cell.cell import PART

    doubled = [name for name, count in Counter(names).items() if count > 1]
    if doubled:
        raise InvalidInputError(f"several bodies are named {listed(map(repr, doubled))}: names must be unique")
    if PART in names:
        raise InvalidInputError(f"a body is named {PART!r}: that is the workpiece's name, choose another")


def _start(params: CellModelParams, robot: Robot, home: tuple[float, ...] | None) -> FloatArray:
    import numpy as np

    chain, given = robot.chain, params.start_rad
    if isinstance(given, dict):
        unknown = [name for name in given if name not in robot.joint_names]
        missing = [name for name in robot.joint_names if name not in given]
        if unknown or missing:
            raise InvalidInputError(
                f"start_rad names {listed(given)} but the joints are {listed(robot.joint_names, 12)}: name each once"
            )
        given = tuple(given[name] for name in robot.joint_names)
    if given is None and home is None:
        raise InvalidInputError("the robot comes from a URDF and has no start configuration: state start_rad")
    start = np.array(home if given is None else given, float)
    if len(start) != robot.n_joints:
        raise InvalidInputError(f"start_rad has {len(start)} values, but the robot has {robot.n_joints} joints")
    outside = [
        f"{name} {value:.4g} outside {low:.4g} to {high:.4g}"
        for name, value, low, high in zip(robot.joint_names, start, chain.lower, chain.upper)
        if not low <= value <= high
    ]
    if outside:
        raise InvalidInputError(f"the start configuration breaks joint limits (rad): {listed(outside)}; move it inside")
    return start


def _declared(pairs: Sequence[tuple[str, str]], names: Sequence[str]) -> list[tuple[int, int]]:
    """Return declared pairs as rows; the name of a link with several bodies stands for all of them."""
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        rows.setdefault(name, []).append(row)
        stem, _, number = name.rpartition(".")
        if number.isdigit():
            rows.setdefault(stem, []).append(row)
    unknown = sorted({name for pair in pairs for name in pair if name not in rows})
    if unknown:
        raise InvalidInputError(f"ignored_pairs names {listed(unknown)}, but the bodies are {listed(names, 30)}")
    return [(a, b) for one, other in pairs for a in rows[one] for b in rows[other] if a != b]


def _check_start(cell: Cell) -> None:
    from cellwright.cell.scene import Scene

    touching = Scene(cell).colliding_pair(cell.start)
    if touching is not None:
        raise InvalidInputError(
            f"the start configuration collides: {touching[0]!r} with {touching[1]!r}; "
            "choose another start_rad, move the body, or declare the pair in ignored_pairs if it may touch"
        )
