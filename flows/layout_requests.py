"""Turn a layout file into the parameters of every stage: the one place that knows both."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cellwright.cell.built_in_robots import built_in_digest
from cellwright.errors import InvalidInputError, listed
from cellwright.solvers.layout.bodies import box_hull, workspace_walls
from flows.mesh_sources import all_robot_meshes, metres_per_unit, robot_meshes
from schemas.body_params import BodyParams, BoxBody, CapsuleBody, CylinderBody, MeshBody, SphereBody
from schemas.cell_file_fields import MeshSection
from schemas.layout_file import TOOL, LayoutFile
from schemas.layout_file_hulls import HullSection, LayoutObstacleSection
from schemas.layout_file_sections import ApproachSection, JointQuantity, StationSection
from schemas.layout_params import (
    ApproachParams,
    ArmParams,
    HarnessParams,
    LayoutCostParams,
    LayoutProblemParams,
    PlacedHull,
    RobotSphereParams,
    StationParams,
    ToolHullParams,
    Vector,
    WallParams,
)
from schemas.poses import Pose
from tasks.cover_bodies import CoveredBody, CoverParams
from tasks.optimise_layout import LayoutParams
from tasks.read_source import SourceParams
from tasks.record_layout import LayoutRecordingParams, ShownBody
from tasks.spherize_robot import RobotHullParams
from tasks.write_layout_report import LayoutReportParams, template_digest

_SEGMENTS = {"second_order": 50}
"""N where the file gives none and the solver has its own."""


class LayoutRequest(BaseModel):
    """Everything that decides a layout, stage by stage."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(description="Name of the cell.")
    urdf: SourceParams | None = Field(default=None, description="The robot's URDF, unless it is built in.")
    robot_files: tuple[SourceParams, ...] = Field(default=(), description="Its meshes.")
    body_files: tuple[SourceParams, ...] = Field(default=(), description="Meshes of stations and obstacles.")
    robot_hull: RobotHullParams | None = Field(default=None, description="Spheres of its links, if they count.")
    cover: CoverParams | None = Field(default=None, description="Spheres of stations and obstacles, if any is fitted.")
    layout: LayoutParams
    recording: LayoutRecordingParams
    report: LayoutReportParams
    notes: tuple[str, ...] = Field(default=(), description="What the person should know beforehand.")


def layout_request(file: LayoutFile) -> LayoutRequest:
    """Return the request that a layout file makes.

    Raises:
        InvalidInputError: If a file that it names is malformed or missing, or a stage does not take a value.
    """
    try:
        return _request(file)
    except ValidationError as error:  # a stage is stricter than the file
        faults = [
            f"{'.'.join(map(str, fault['loc']))}: {fault['msg']} (got {fault['input']!r})" for fault in error.errors()
        ]
        raise InvalidInputError(
            f"{file.path}: {error.title} does not take {listed(faults)}: change the value"
        ) from error


def _request(file: LayoutFile) -> LayoutRequest:
    bodies = _Bodies()
    problem = _problem(file, bodies)
    urdf = None if file.robot.urdf is None else SourceParams.of(file.robot.urdf)
    links = file.robot.hull.model == "links"
    robot_files, notes = _robot_files(file)
    solver = file.solver
    hull = None
    if links:
        hull = RobotHullParams(
            robot=problem.arm.robot, robot_sha256=problem.arm.robot_sha256, n_spheres=file.robot.hull.spheres
        )
    return LayoutRequest(
        name=file.name,
        urdf=urdf,
        robot_files=robot_files,
        body_files=tuple(bodies.sources.values()),
        robot_hull=hull,
        cover=CoverParams(bodies=tuple(bodies.covered)) if bodies.covered else None,
        layout=LayoutParams(
            problem=problem,
            method=solver.method,
            proxy=solver.proxy,
            n_segments=solver.segments or _SEGMENTS.get(solver.method, 100),
            polish=solver.polish,
            n_particles=solver.particles,
            n_generations=solver.generations,
            n_starts=solver.starts,
            placed=solver.begin == "placed",
            extras=solver.extras,
            seed=solver.seed,
        ),
        recording=LayoutRecordingParams(problem=problem, bodies=tuple(bodies.shown), show_robot=not notes),
        report=LayoutReportParams(problem=problem, title=file.name, template_sha256=template_digest()),
        notes=notes,
    )


def _problem(file: LayoutFile, bodies: _Bodies) -> LayoutProblemParams:
    robot = file.robot
    base = robot.base.matrix()
    hull = robot.hull
    return LayoutProblemParams(
        arm=_arm(file),
        base=(
            HarnessParams(T_last_carried=Pose.of(base))
            if robot.harness is None
            else HarnessParams.of(robot.harness.harness(base))
        ),
        T_flange_tool=robot.tool.pose(),
        spheres=RobotSphereParams(
            model=hull.model,
            self_collision=hull.self_collision,
            tool=_tool(robot.tool_hull, bodies),
            tool_radius_m=hull.tool_radius_m,
            base_radius_m=hull.base_radius_m,
        ),
        home_q=_values(robot.home),
        stations=(
            *(_station(station, bodies) for station in file.stations),
            *(_obstacle(obstacle, bodies) for obstacle in file.obstacles),
        ),
        visits=tuple(file.visits()),
        cyclic=file.cyclic,
        walls=tuple(_walls(file)),
        clearance_m=file.solver.clearance_m,
        cost=LayoutCostParams(
            manipulability_s=file.cost.manipulability_s,
            repeatability_s_per_m=file.cost.repeatability,
            joint_deviation=_values(file.cost.joint_deviation) or (),
            worst_case=file.cost.worst_case,
            along_path=file.cost.along_path,
        ),
    )


def _arm(file: LayoutFile) -> ArmParams:
    robot = file.robot
    return ArmParams(
        robot=robot.model if robot.urdf is None else robot.urdf.name,
        robot_sha256=built_in_digest(robot.model) if robot.urdf is None else "",
        base_link=robot.base_link,
        flange_link=robot.flange_link,
        lower=_values(robot.lower),
        upper=_values(robot.upper),
        max_velocity=_values(robot.max_velocity),
        max_acceleration=_values(robot.max_acceleration),
    )


def _values(given: tuple[JointQuantity, ...] | None) -> tuple[float, ...] | None:
    return None if given is None else tuple(value for value, _ in given)


def _walls(file: LayoutFile) -> list[WallParams]:
    walls = [
        WallParams(name=wall.name, normal=wall.normal, offset_m=wall.offset_m, holds_robot=wall.holds_robot)
        for wall in file.walls
    ]
    box = file.workspace
    if box is None:
        return walls
    for wall in workspace_walls(np.array(box.min_m), np.array(box.max_m), holds_robot=box.holds_robot):
        x, y, z = wall.normal.tolist()
        walls.append(WallParams(name=wall.name, normal=(x, y, z), offset_m=wall.offset_m, holds_robot=wall.holds_robot))
    return walls


class _Bodies:
    """Gathers bodies to be covered and shown, and the files of their meshes."""

    def __init__(self) -> None:
        self.sources: dict[str, SourceParams] = {}
        self.covered: list[CoveredBody] = []
        self.shown: list[ShownBody] = []

    def body(self, name: str, shape: HullSection | LayoutObstacleSection, pose: Pose) -> BodyParams:
        """Return a shape as a stage's body; the file of a mesh is kept."""
        if shape.box is not None:
            return BoxBody(name=name, pose=pose, size_m=shape.box.size_m)
        if shape.cylinder is not None:
            return CylinderBody(
                name=name, pose=pose, radius_m=shape.cylinder.radius_m, length_m=shape.cylinder.length_m
            )
        if shape.capsule is not None:
            return CapsuleBody(name=name, pose=pose, radius_m=shape.capsule.radius_m, length_m=shape.capsule.length_m)
        if shape.sphere is not None:
            return SphereBody(name=name, pose=pose, radius_m=shape.sphere.radius_m)
        if shape.mesh is None:
            raise InvalidInputError(f"{name} has no shape")
        return self._mesh(name, shape.mesh, pose)

    def _mesh(self, name: str, mesh: MeshSection, pose: Pose) -> MeshBody:
        # named after the body, so that meshes of one name from different folders do not meet
        file = f"{name}: {mesh.file.name}"
        self.sources[file] = SourceParams.of(mesh.file).model_copy(update={"name": file})
        factor = mesh.scale * metres_per_unit(mesh.file, mesh.unit)
        return MeshBody(name=name, pose=pose, file=file, scale=(factor, factor, factor))

    def cover(self, body: BodyParams, n_spheres: int) -> PlacedHull:
        """Ask for a body's hull and return where it is put; equal bodies are covered once."""
        wanted = body.model_copy(update={"pose": Pose()})
        for each in self.covered:
            same = each.body.model_copy(update={"name": body.name})
            if same == wanted and each.n_spheres == n_spheres:
                return PlacedHull(body=each.body.name, T_station_body=body.pose)
        self.covered.append(CoveredBody(body=wanted, n_spheres=n_spheres))
        return PlacedHull(body=body.name, T_station_body=body.pose)


def _station(station: StationSection, bodies: _Bodies) -> StationParams:
    T = station.pose.matrix()
    hulls, centres, radii = _hulls(station.name, station.name, station.hull, bodies)
    return StationParams(
        name=station.name,
        harness=(
            HarnessParams(T_last_carried=Pose.of(T))
            if station.harness is None
            else HarnessParams.of(station.harness.harness(T))
        ),
        hulls=hulls,
        centre_m=centres,
        radius_m=radii,
        approaches=tuple(_approach(each) for each in station.approaches),
    )


def _approach(approach: ApproachSection) -> ApproachParams:
    turn = {} if approach.turn_speed_rad_s is None else {"turn_rad_s": approach.turn_speed_rad_s}
    return ApproachParams(
        name=approach.name or "",
        T_station_tool=tuple(Pose.of(pose) for pose in approach.poses()),
        target=approach.target,
        speed_m_s=approach.speed_m_s,
        **turn,
    )


def _tool(sections: Sequence[HullSection], bodies: _Bodies) -> ToolHullParams:
    hulls, centres, radii = _hulls(TOOL, None, sections, bodies)
    return ToolHullParams(hulls=hulls, centre_m=centres, radius_m=radii)


def _hulls(
    owner: str, station: str | None, sections: Sequence[HullSection], bodies: _Bodies
) -> tuple[tuple[PlacedHull, ...], tuple[Vector, ...], tuple[float, ...]]:
    """Return the hulls to be fitted, and centres and radii of the spheres that are given; ``station`` carries them."""
    hulls: list[PlacedHull] = []
    centres: list[Vector] = []
    radii: list[float] = []
    for number, hull in enumerate(sections, 1):
        name = owner if len(sections) == 1 else f"{owner} {number}"
        if hull.spheres is not None:
            balls = [(ball.centre_m, ball.radius_m) for ball in hull.spheres]
            _put(balls, hull, centres, radii)
            continue
        body = bodies.body(name, hull, hull.pose.pose())
        bodies.shown.append(ShownBody(station=station, body=body))
        if hull.sphere is not None:
            _put([((0.0, 0.0, 0.0), hull.sphere.radius_m)], hull, centres, radii)
        elif hull.cells is not None and hull.box is not None:
            cells = box_hull(hull.box.size_m, hull.cells, np.zeros(3))
            _put(list(zip(cells.centres.tolist(), cells.radii.tolist())), hull, centres, radii)
        else:
            hulls.append(bodies.cover(body, hull.count))
    return tuple(hulls), tuple(centres), tuple(radii)


def _put(balls: Sequence[tuple[Any, float]], hull: HullSection, centres: list[Vector], radii: list[float]) -> None:
    """Add spheres of a hull's frame to those of what carries it."""
    T = hull.pose.matrix()
    for centre, radius in balls:
        x, y, z = (T[:3, :3] @ centre + T[:3, 3]).tolist()
        centres.append((x, y, z))
        radii.append(radius)


def _obstacle(obstacle: LayoutObstacleSection, bodies: _Bodies) -> StationParams:
    body = bodies.body(obstacle.name, obstacle, Pose())
    bodies.shown.append(ShownBody(station=obstacle.name, body=body))
    harness = HarnessParams(T_last_carried=obstacle.pose.pose())
    if obstacle.sphere is not None:
        radius = (obstacle.sphere.radius_m,)
        return StationParams(name=obstacle.name, harness=harness, centre_m=((0.0, 0.0, 0.0),), radius_m=radius)
    return StationParams(name=obstacle.name, harness=harness, hulls=(bodies.cover(body, obstacle.count),))


def _robot_files(file: LayoutFile) -> tuple[tuple[SourceParams, ...], tuple[str, ...]]:
    """Return the meshes of the robot's URDF, and what the person should know of those that are missing.

    With the tool's point alone no solver needs them: where one is missing the recording goes without the robot.
    """
    robot = file.robot
    if robot.urdf is None:
        return (), ()
    if robot.hull.model == "links":
        mend = "or write robot.hull: {model: point}, which needs no meshes"
        return all_robot_meshes(robot.urdf, robot.packages, mend), ()
    found = robot_meshes(robot.urdf, robot.packages)
    if not found.missing:
        return found.sources, ()
    more = f" and {len(found.missing) - 1} more" if len(found.missing) > 1 else ""
    return (), (f"the recording is without the robot: {robot.urdf.name}: {found.missing[0]}{more}",)
