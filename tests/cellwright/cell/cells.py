"""Cells that several tests share."""

from __future__ import annotations

import numpy as np
import trimesh

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import WORLD, Body, Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.built_in_robots import built_in, built_in_bodies, built_in_robot
from cellwright.cell.cell import Cell
from cellwright.cell.robot import Robot
from cellwright.cell.transforms import pose


def at(x: float, y: float, z: float) -> FloatArray:
    return pose(np.array([x, y, z]), np.eye(3))


def bumpy_part(subdivisions: int = 4) -> Mesh:
    """A closed part that is not convex."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.12)
    bumps = 1 + 0.15 * np.sin(20 * ball.vertices[:, :1])
    return Mesh(np.asarray(ball.vertices * bumps), np.asarray(ball.faces, np.int32))


def neighbours_and_stand(bodies: tuple[Body, ...]) -> np.ndarray:
    """Pairs of neighbouring links, and of what stands."""
    return np.array(
        [
            (a, b)
            for a in range(len(bodies))
            for b in range(a + 1, len(bodies))
            if (min(bodies[a].parent, bodies[b].parent) >= 0 and abs(bodies[a].parent - bodies[b].parent) <= 1)
            or max(bodies[a].parent, bodies[b].parent) <= 0
        ],
        np.int32,
    ).reshape(-1, 2)


def cell_of(robot: Robot, bodies: tuple[Body, ...], T_world_base: FloatArray | None = None) -> Cell:
    T = np.eye(4) if T_world_base is None else T_world_base
    start = np.array(built_in("ur10e").home) if robot.n_joints == 6 else np.zeros(robot.n_joints)
    return Cell(robot, bodies, neighbours_and_stand(bodies), T, np.eye(4), start)


def scanning_cell(T_world_base: FloatArray | None = None) -> Cell:
    """The UR10e with a scanner among a table, a post, a ball and a rail, without part."""
    bodies = (
        *built_in_bodies("ur10e"),
        Body("housing", Box((0.185, 0.16, 0.18)), 6, at(0.155, 0, 0.09)),
        Body("handle", Cylinder(0.03, 0.12), 6, at(0, 0, 0.083)),
        Body("table", Box((0.6, 1.0, 0.05)), WORLD, at(0.7, 0, -0.03)),
        Body("post", Cylinder(0.05, 1.0), WORLD, at(-0.5, 0.5, 0.5)),
        Body("rail", Capsule(0.04, 0.8), WORLD, at(-0.5, -0.5, 0.5)),
        Body("lamp", Sphere(0.1), WORLD, at(0.3, 0.6, 1.0)),
    )
    return cell_of(built_in_robot("ur10e"), bodies, T_world_base)


def one_joint_cell(moving: Shape, standing: Shape, T_world_standing: FloatArray) -> Cell:
    """A turntable that carries a body half a metre from its vertical axis, and a body in the world."""
    robot = Robot.from_urdf(
        """<robot name="table"><link name="base_link"/><link name="flange"/>
        <joint name="turn" type="revolute"><parent link="base_link"/><child link="flange"/><axis xyz="0 0 1"/>
        <limit lower="-3" upper="3" velocity="1"/></joint></robot>"""
    )
    bodies = (Body("moving", moving, 1, at(0.5, 0, 0)), Body("standing", standing, WORLD, T_world_standing))
    return cell_of(robot, bodies)
