"""Between layout parameters, hulls and the library's `LayoutProblem`; and a `Layout` as pictures take it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.built_in_robots import built_in, built_in_urdf
from cellwright.cell.robot import moving_joints
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import apply
from cellwright.errors import InvalidInputError
from cellwright.solvers.layout.problem import (
    Approach,
    LayoutCost,
    LayoutProblem,
    RobotSpheres,
    Spheres,
    Station,
    TargetKind,
    Visit,
    Wall,
)
from cellwright.solvers.layout.solution import Transition
from schemas.layout import Layout, RobotHull
from schemas.layout_params import ArmParams, LayoutProblemParams, StationParams
from schemas.sources import SourceFile
from schemas.sphere_hull import SphereHull


def build_arm(params: ArmParams, urdf: SourceFile | None) -> SerialArm:
    """Return the robot, its limits laid over those of its URDF.

    Raises:
        InvalidInputError: If the URDF is malformed, or a limit makes no sense.
    """
    text = built_in_urdf(params.robot) if urdf is None else _text(urdf)
    own = None
    if urdf is None and params.base_link is None and params.flange_link is None:
        own = np.array(built_in(params.robot).max_acceleration)
    arm = SerialArm.from_urdf(
        text, base_link=params.base_link, flange_link=params.flange_link, max_acceleration=own, name=params.robot
    )
    velocity = _over(arm.max_velocity, params.max_velocity)
    acceleration = _over(arm.max_acceleration, params.max_acceleration)
    if params.max_acceleration is None and own is None:
        acceleration = arm.max_acceleration * (velocity / arm.max_velocity)  # as fast to full speed as before
    return replace(
        arm,
        lower=_over(arm.lower, params.lower),
        upper=_over(arm.upper, params.upper),
        max_velocity=velocity,
        max_acceleration=acceleration,
    )


def _text(urdf: SourceFile) -> str:
    try:
        return urdf.content.decode()
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{urdf.name} is not a URDF: it is not text in UTF-8: save it so") from error


def _over(own: FloatArray, given: tuple[float, ...] | None) -> FloatArray:
    return own.copy() if given is None else np.broadcast_to(np.array(given, float), own.shape).copy()


def build_problem(
    params: LayoutProblemParams, urdf: SourceFile | None, robot: RobotHull | None, hulls: SphereHull | None
) -> LayoutProblem:
    """Return the problem that parameters and fitted hulls describe.

    Raises:
        InvalidInputError: If they contradict each other.
    """
    arm = build_arm(params.arm, urdf)
    T_flange_tool = params.T_flange_tool.matrix()
    cost, n = params.cost, arm.n_joints
    deviation = cost.joint_deviation * n if len(cost.joint_deviation) == 1 else cost.joint_deviation
    return LayoutProblem(
        arm,
        tuple(_station(station, hulls) for station in params.stations),
        tuple(Visit(station, approach) for station, approach in params.visits),
        params.cyclic,
        params.base.harness(),
        T_flange_tool,
        _robot_spheres(params, arm, T_flange_tool, robot),
        tuple(Wall(wall.name, np.array(wall.normal), wall.offset_m, wall.holds_robot) for wall in params.walls),
        None if params.home_q is None else np.array(params.home_q),
        params.clearance_m,
        LayoutCost(cost.manipulability_s, cost.repeatability_s_per_m, deviation, cost.worst_case, cost.along_path),
    )


def _station(params: StationParams, hulls: SphereHull | None) -> Station:
    centres, radii = [np.array(params.centre_m, float).reshape(-1, 3)], [np.array(params.radius_m, float)]
    for placed in params.hulls:
        if hulls is None or placed.body not in hulls.body:
            raise InvalidInputError(f"station {params.name!r} needs a hull of {placed.body!r}, but there is none")
        row = hulls.body.index(placed.body)
        part = slice(int(hulls.first_sphere[row]), int(hulls.first_sphere[row] + hulls.n_spheres[row]))
        centres.append(apply(placed.T_station_body.matrix(), hulls.centre_m[part]))
        radii.append(hulls.radius_m[part])
    approaches = tuple(
        Approach.along(
            np.stack([pose.matrix() for pose in each.T_station_tool]),
            speed_m_s=each.speed_m_s,
            target=TargetKind(each.target),
            name=each.name,
        )
        for each in params.approaches
    )
    return Station(
        params.name, params.harness.harness(), Spheres(np.concatenate(centres), np.concatenate(radii)), approaches
    )


def _robot_spheres(
    params: LayoutProblemParams, arm: SerialArm, T_flange_tool: FloatArray, robot: RobotHull | None
) -> RobotSpheres:
    wanted = params.spheres
    if wanted.model == "links":
        if robot is None:
            raise InvalidInputError("the robot's links need a hull, but there is none")
        return link_spheres(arm, robot, self_collision=wanted.self_collision)
    tip = (arm.T_last_flange @ T_flange_tool)[:3, 3]
    link, centres, radii = [arm.n_joints], [tip], [wanted.tool_radius_m]
    if wanted.base_radius_m > 0.0:
        link.insert(0, 0)
        centres.insert(0, np.array([0.0, 0.0, 0.5 * wanted.base_radius_m]))
        radii.insert(0, wanted.base_radius_m)
    return RobotSpheres(np.array(link), np.stack(centres), np.array(radii))


def link_spheres(arm: SerialArm, robot: RobotHull, *, self_collision: bool) -> RobotSpheres:
    """Return a robot's hull on the links of an arm: the spheres of links that are fixed to one are its own."""
    joints = [joint for joint in arm.tree.path(arm.base_link, arm.flange_link) if joint.name in arm.joint_names]
    attached = arm.tree.attachments(arm.base_link, moving_joints(joints, arm.base_link, arm.flange_link))
    link, centres = [], []
    for row, name in enumerate(robot.link):
        number, T_parent_link = attached[name]
        part = slice(int(robot.first_sphere[row]), int(robot.first_sphere[row] + robot.n_spheres[row]))
        centres.append(apply(T_parent_link, robot.centre_m[part]))
        link += [number] * int(robot.n_spheres[row])
    pairs = [_sphere_pairs(robot, one, other) for one, other in robot.checked_pair.tolist()] if self_collision else []
    none = np.empty((0, 2), np.int64)
    everywhere = np.concatenate([np.empty((0, 3)), *centres])
    return RobotSpheres(np.array(link, np.int64), everywhere, robot.radius_m, np.concatenate([none, *pairs]))


def _sphere_pairs(robot: RobotHull, one: int, other: int) -> IntArray:
    rows = [np.arange(int(robot.n_spheres[row]), dtype=np.int64) + int(robot.first_sphere[row]) for row in (one, other)]
    return np.stack(np.meshgrid(*rows, indexing="ij"), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class DrawnLayout:
    """What of a layout is drawn: its design (n_design,), and its transitions, none if there is no cycle."""

    design: FloatArray
    transitions: tuple[Transition, ...]


def drawn(layout: Layout) -> DrawnLayout:
    """Return the layout as it is now."""
    motions = []
    for row in range(len(layout.duration_s)):
        part = layout.transition == row
        velocity = layout.velocity[part]
        motions.append(
            Transition(
                int(layout.start_row[row]),
                int(layout.end_row[row]),
                layout.time_s[part],
                layout.position[part],
                None if np.isnan(velocity).any() else velocity,
            )
        )
    return DrawnLayout(layout.value, tuple(motions))


def drawn_before(layout: Layout) -> DrawnLayout:
    """Return the layout as the first start began, its cycle if there was one."""
    rows = np.unique(layout.before_transition).tolist()
    motions = []
    for row in rows:
        part = layout.before_transition == row
        motions.append(
            Transition(
                int(layout.start_row[row]),
                int(layout.end_row[row]),
                layout.before_time_s[part],
                layout.before_position[part],
            )
        )
    return DrawnLayout(layout.before, tuple(motions))
