"""The layout problems of Baumgaertner 2025: its Figures 1, 2 and 5, and the two machines of its Table 1.

The paper states few dimensions. What it states is taken (four stations with position and rotation about z, single
points above them as approaches, no secondary objective; two machines with large hulls, doors at different heights,
approach trajectories that start before them); everything else here is chosen and named below.
"""

from __future__ import annotations

import math

import numpy as np

from cellwright.cell.built_in_robots import built_in_arm
from cellwright.cell.harness import Harness, fixed_distance, planar
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.solvers.layout.bodies import (
    RobotSpheres,
    Spheres,
    box_hull,
    end_effector_point,
    workspace_walls,
)
from cellwright.solvers.layout.problem import Approach, LayoutCost, LayoutProblem, Station, TargetKind

DOWN = np.diag([1.0, -1.0, -1.0])
"""Rotation of a tool whose z points down."""


def station_distance_problem() -> LayoutProblem:
    """Return Fig. 2: two stations and the two-joint robot; what turns is the robot's revolute joint.

    Chosen: round tables of 0.2 m radius and 0.4 m height, anywhere (x, y, rotation) in a room of 2.8 m by 2.8 m about
    the robot; the tool, which reaches 0.40 to 1.20 m, has to stand 0.1 m above their middle.
    """
    arm = built_in_arm("pr_robot")
    table = Spheres(np.array([[0.0, 0.0, 0.2]]), np.array([0.2]))
    target = Approach(pose(np.array([[0.0, 0.0, 0.5]]), np.eye(3)[None]), TargetKind.POSITION)
    room = (-1.2, 1.2)
    stations = tuple(Station(name, planar(room, room), table, (target,)) for name in ("blue", "red"))
    spheres = end_effector_point(arm, radius_m=0.02, base_radius_m=0.2)
    walls = workspace_walls(np.array([-1.4, -1.4, -np.inf]), np.array([1.4, 1.4, np.inf]), holds_robot=False)
    return LayoutProblem(arm, stations, robot_spheres=spheres, walls=walls)


def walled_station_problem(n_wall: int = 19) -> LayoutProblem:
    """Return Fig. 1: two stations, of which the red one carries a wall that may stand in the robot's way.

    Chosen: both tables, of 0.25 m radius, stand 0.9 m from the robot's axis, on any side of it, and turn on the spot.
    The wall is a row of ``n_wall`` spheres of 4 cm radius, as high as the arm and 0.9 m long, on the red table beside
    its target: radially it makes the arm draw back to get past it, tangentially behind the target it is in nobody's
    way, and nowhere does it keep the tables farther apart, so that no proxy sees it. The red table turns from radially
    by 90 deg one way and 60 deg the other. The arm is a row of spheres.
    """
    arm = built_in_arm("pr_robot")
    table = Spheres(np.array([[0.0, 0.0, 0.2]]), np.array([0.25]))
    along = np.linspace(-0.25, 0.65, n_wall)
    wall = np.stack([along, np.full(n_wall, 0.12), np.full(n_wall, 0.5)], axis=1)
    red = Spheres(np.concatenate([table.centres, wall]), np.concatenate([table.radii, np.full(n_wall, 0.04)]))
    target = Approach(pose(np.array([[0.0, 0.0, 0.5]]), np.eye(3)[None]), TargetKind.POSITION)
    free = fixed_distance(np.zeros(3), 0.9)
    held = fixed_distance(np.zeros(3), 0.9, turn=(-math.pi / 2.0, math.pi / 3.0))
    stations = (Station("blue", free, table, (target,)), Station("red", held, red, (target,)))
    tool = np.linspace(-0.35, 0.05, 9)
    arm_spheres = np.stack([tool, np.zeros(9), np.zeros(9)], axis=1)
    spheres = RobotSpheres(
        np.concatenate([[0], np.full(9, 2)]),
        np.concatenate([[[0.0, 0.0, 0.15]], arm_spheres]),
        np.concatenate([[0.2], np.full(9, 0.05)]),
    )
    return LayoutProblem(arm, stations, robot_spheres=spheres)


def thin_wall_problem() -> LayoutProblem:
    """Return what section 5 warns of: a wall so thin that a robot whose motion is checked at few points steps over it.

    Chosen: two fixed targets 0.9 m from the two-joint robot's axis, 1.2 rad apart, and a radial wall of spheres of
    1 cm radius halfway between them, from 0.6 m outwards; the tool is a point of 2 cm radius, which has to draw back.
    """
    arm = built_in_arm("pr_robot")
    along = np.arange(0.6, 1.26, 0.015)
    wall = Spheres(np.stack([along, np.zeros_like(along), np.full_like(along, 0.5)], axis=1), np.full(len(along), 0.01))
    target = Approach(pose(np.array([[0.9, 0.0, 0.5]]), np.eye(3)[None]), TargetKind.POSITION)
    stations = [
        Station(name, Harness((), pose(np.zeros(3), rotation_from_rpy(0.0, 0.0, angle))), Spheres(), (target,))
        for name, angle in (("blue", -0.6), ("red", 0.6))
    ]
    stations.append(Station("wall", Harness(), wall))
    spheres = RobotSpheres(np.array([2]), arm.T_last_flange[:3, 3][None], np.array([0.02]))
    return LayoutProblem(arm, tuple(stations), robot_spheres=spheres)


def four_station_problem(robot: str = "kr180_r2500_extra", target: TargetKind = TargetKind.POSE) -> LayoutProblem:
    """Return Fig. 5: four small rectangular stations in position and rotation about z, single points above them.

    Chosen: tables 0.5 m by 0.4 m by 0.3 m with a hull of four spheres, within 2.2 m of the robot in x and y, their tops
    0.5 m to 0.8 m high (too little to stand them above each other), the tool pointing down 0.25 m above them, a robot
    base of 0.65 m radius, the end effector as a point of 0.05 m radius.
    """
    arm = built_in_arm(robot)
    hull = box_hull((0.5, 0.4, 0.3), (2, 2, 1), np.array([0.0, 0.0, -0.15]))
    above = Approach(pose(np.array([[0.0, 0.0, 0.25]]), DOWN[None]), target)
    side = (-2.2, 2.2)
    stations = tuple(
        Station(f"station {number}", planar(side, side, z=(0.5, 0.8)), hull, (above,)) for number in range(1, 5)
    )
    spheres = end_effector_point(arm, radius_m=0.05, base_radius_m=0.65)
    return LayoutProblem(arm, stations, robot_spheres=spheres)


DOOR_HEIGHTS_M = (1.0, 1.9)
"""Where the tool enters the machines of Table 1: farther apart than the stroke of the SCARA."""
MACHINES = ("machining centre", "printer")
_JOINT_DEVIATION = 1e-4
"""Standard deviation of every joint in rad or m for the repeatability cost of Table 1; chosen."""


def two_machine_problem(robot: str, *, cells: int = 3, repeatability: float = 20.0) -> LayoutProblem:
    """Return Table 1: a robot carries parts between two machines through doors at different heights.

    Chosen: machines of 1.8 m by 1.6 m by 2.4 m with a hull of ``cells``^3 spheres, movable in x, y and rotation within
    3.5 m of the robot; a straight approach of 0.5 m into each, 1.0 m and 1.9 m above the floor, that starts 0.55 m
    before the door. A six-axis arm enters with its tool's z along the way in and turns freely about it; the SCARA,
    whose tool points down, has to meet positions alone (and stands on a column so that the lower door suits it).
    Repeatability costs ``repeatability`` s per metre at the clamping positions.
    """
    arm = built_in_arm(robot)
    size = (1.6, 1.8, 2.4)
    inwards = rotation_from_rpy(0.0, math.pi / 2.0, 0.0)
    prismatic = not arm.revolute.all()
    target = TargetKind.POSITION if prismatic else TargetKind.AXIS
    stations = []
    for name, height in zip(MACHINES, DOOR_HEIGHTS_M):
        # the door looks along -x of the machine's frame, which lies on the floor below the door
        hull = box_hull(size, (cells, cells, cells), np.array([0.5 * size[0], 0.0, 0.5 * size[2]]))
        way = np.array([[-0.55, 0.0, height], [-0.3, 0.0, height], [-0.05, 0.0, height]])
        out = np.concatenate([way, way[-2::-1]])
        approach = Approach(pose(out, np.repeat(inwards[None], len(out), axis=0)), target)
        side = (-3.5, 3.5)
        stations.append(Station(name, planar(side, side), hull, (approach,)))
    spheres = end_effector_point(arm, radius_m=0.1, base_radius_m=0.6)
    cost = LayoutCost(repeatability=repeatability, joint_deviation=(_JOINT_DEVIATION,) * arm.n_joints)
    column = np.eye(4)
    if prismatic:
        # the middle of the SCARA's stroke at the lower door
        column[2, 3] = DOOR_HEIGHTS_M[0] - 0.08
    return LayoutProblem(arm, tuple(stations), base=Harness((), column), robot_spheres=spheres, cost=cost)
