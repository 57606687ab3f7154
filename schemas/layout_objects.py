"""Between layout parameters, hulls and the library's `LayoutProblem`; and a `Layout` as pictures take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.built_in_robots import built_in, built_in_urdf
from cellwright.cell.robot import moving_joints
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import apply
from cellwright.errors import InvalidInputError
from cellwright.solvers.layout.bodies import ROBOT_BASE, TOOL, link_name
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
    end_effector_point,
)
from cellwright.solvers.layout.solution import Transition
from schemas.layout import Layout, RobotHull
from schemas.layout_params import ArmParams, LayoutProblemParams, PlacedHull, StationParams, Vector
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
        _robot_spheres(params, arm, T_flange_tool, robot, hulls),
        tuple(Wall(wall.name, np.array(wall.normal), wall.offset_m, wall.holds_robot) for wall in params.walls),
        None if params.home_q is None else np.array(params.home_q),
        params.clearance_m,
        LayoutCost(cost.manipulability_s, cost.repeatability_s_per_m, deviation, cost.worst_case, cost.along_path),
    )


def _station(params: StationParams, hulls: SphereHull | None) -> Station:
    spheres = _spheres(f"station {params.name!r}", params.hulls, params.centre_m, params.radius_m, hulls)
    approaches = tuple(
        Approach.along(
            np.stack([pose.matrix() for pose in each.T_station_tool]),
            speed_m_s=each.speed_m_s,
            turn_rad_s=each.turn_rad_s,
            target=TargetKind(each.target),
            name=each.name,
        )
        for each in params.approaches
    )
    return Station(params.name, params.harness.harness(), spheres, approaches)


def _spheres(
    owner: str,
    wanted: Sequence[PlacedHull],
    centre_m: Sequence[Vector],
    radius_m: Sequence[float],
    hulls: SphereHull | None,
) -> Spheres:
    """Return given spheres and those of fitted hulls in the frame of what carries them."""
    centres, radii = [np.array(centre_m, float).reshape(-1, 3)], [np.array(radius_m, float)]
    for placed in wanted:
        if hulls is None or placed.body not in hulls.body:
            raise InvalidInputError(f"{owner} needs a hull of {placed.body!r}, but there is none")
        row = hulls.body.index(placed.body)
        part = slice(int(hulls.first_sphere[row]), int(hulls.first_sphere[row] + hulls.n_spheres[row]))
        centres.append(apply(placed.T_station_body.matrix(), hulls.centre_m[part]))
        radii.append(hulls.radius_m[part])
    return Spheres(np.concatenate(centres), np.concatenate(radii))


def _robot_spheres(
    params: LayoutProblemParams,
    arm: SerialArm,
    T_flange_tool: FloatArray,
    robot: RobotHull | None,
    hulls: SphereHull | None,
) -> RobotSpheres:
    wanted = params.spheres
    tool = wanted.tool
    mounted = _spheres("the tool", tool.hulls, tool.centre_m, tool.radius_m, hulls)
    held = Spheres(apply(arm.T_last_flange, mounted.centres), mounted.radii)
    point = end_effector_point(arm, T_flange_tool, wanted.tool_radius_m, base_radius_m=wanted.base_radius_m)
    if wanted.model == "point":
        return with_tool(arm, point, held, self_collision=False)
    if robot is None:
        raise InvalidInputError("the robot's links need a hull, but there is none")
    links = link_spheres(arm, robot, self_collision=wanted.self_collision)
    if wanted.base_radius_m > 0.0:
        links = RobotSpheres(
            np.append(links.link, 0),
            np.concatenate([links.centres, point.centres[:1]]),
            np.append(links.radii, wanted.base_radius_m),
            links.self_pairs,
            (*links.body, ROBOT_BASE),
        )
    if wanted.tool_radius_m > 0.0:
        held = Spheres(np.concatenate([held.centres, point.centres[-1:]]), np.append(held.radii, wanted.tool_radius_m))
    return with_tool(arm, links, held, self_collision=wanted.self_collision)


def link_spheres(arm: SerialArm, robot: RobotHull, *, self_collision: bool) -> RobotSpheres:
    """Return a robot's hull on the links of an arm: the spheres of links that are fixed to one are its own.

    Joints that are none of the arm's, such as those of fingers, stand still in a layout: the links behind them are
    fixed to the arm's, so that pairs on one link, or on neighbours, need no check.
    """
    joints = [joint for joint in arm.tree.path(arm.base_link, arm.flange_link) if joint.name in arm.joint_names]
    attached = arm.tree.attachments(arm.base_link, moving_joints(joints, arm.base_link, arm.flange_link))
    number = [attached[name][0] for name in robot.link]
    centres = []
    for row, name in enumerate(robot.link):
        part = slice(int(robot.first_sphere[row]), int(robot.first_sphere[row] + robot.n_spheres[row]))
        centres.append(apply(attached[name][1], robot.centre_m[part]))
    checked = [(one, other) for one, other in robot.checked_pair.tolist() if abs(number[one] - number[other]) > 1]
    pairs = [_sphere_pairs(robot, one, other) for one, other in checked] if self_collision else []
    none = np.empty((0, 2), np.int64)
    everywhere = np.concatenate([np.empty((0, 3)), *centres])
    link = np.repeat(np.array(number, np.int64), robot.n_spheres)
    body = [
        link_name(name) if joint else ROBOT_BASE
        for name, joint, n_spheres in zip(robot.link, number, robot.n_spheres.tolist())
        for _ in range(n_spheres)
    ]
    return RobotSpheres(link, everywhere, robot.radius_m, np.concatenate([none, *pairs]), tuple(body))


def with_tool(arm: SerialArm, spheres: RobotSpheres, tool: Spheres, *, self_collision: bool) -> RobotSpheres:
    """Return a robot's spheres and those of a tool that its URDF does not know, given in the last link's frame.

    The tool keeps clear of the links that it can meet: not of its own and the one before it, and neither of those that
    it always touches, or never, in random configurations.
    """
    if not len(tool):
        return spheres
    pairs = _tool_pairs(arm, spheres, tool) if self_collision else np.empty((0, 2), np.int64)
    return RobotSpheres(
        np.concatenate([spheres.link, np.full(len(tool), arm.n_joints)]),
        np.concatenate([spheres.centres, tool.centres]),
        np.concatenate([spheres.radii, tool.radii]),
        np.concatenate([spheres.self_pairs, pairs]),
        (*spheres.body, *[TOOL] * len(tool)),
    )


def _tool_pairs(arm: SerialArm, spheres: RobotSpheres, tool: Spheres) -> IntArray:
    """Return rows of a link's sphere and a tool's, the latter numbered behind all others, (pairs, 2)."""
    from cellwright.cell.ignored_pairs import Reason
    from cellwright.cell.sphere_pairs import N_SAMPLES, hull_pairs

    last = arm.n_joints
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper, (N_SAMPLES, last))
    poses = arm.link_poses(q)
    rows = [np.flatnonzero(spheres.link == link) for link in range(last)]
    found = hull_pairs(
        [*(spheres.centres[each] for each in rows), tool.centres],
        [*(spheres.radii[each] for each in rows), tool.radii],
        list(range(last + 1)),
        [poses[:, link] for link in range(last + 1)],
        [(last - 1, last)],
        known={(one, other): Reason.DECLARED for other in range(last) for one in range(other)},
    )
    mounted = len(spheres) + np.arange(len(tool))
    grids = [np.stack(np.meshgrid(rows[link], mounted, indexing="ij"), -1) for link, _ in found.checked.tolist()]
    return np.concatenate([np.empty((0, 2), np.int64), *(grid.reshape(-1, 2) for grid in grids)])


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
        velocity = layout.before_velocity[part]
        motions.append(
            Transition(
                int(layout.start_row[row]),
                int(layout.end_row[row]),
                layout.before_time_s[part],
                layout.before_position[part],
                None if np.isnan(velocity).any() else velocity,
            )
        )
    return DrawnLayout(layout.before, tuple(motions))
