"""A planar arm of two joints among posts, a pendulum, and the paths and problems that tests and figures share."""

from __future__ import annotations

from functools import cache, reduce

import numpy as np

from cellwright.cell.bodies import WORLD, Body, Capsule, Cylinder
from cellwright.cell.built_in_robots import built_in_arm
from cellwright.cell.cell import Cell
from cellwright.cell.robot import Robot
from cellwright.cell.scene import Scene
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_dynamics import SymbolicDynamics, symbolic_dynamics
from cellwright.solvers.optimal_control.program import CostWeights, MotionProgram
from cellwright.solvers.path_smoothing import round_corners, shorten
from cellwright.solvers.path_timing import Limits, TimedMotion, time_path, time_straight
from cellwright.solvers.random_trees import connect_by_trees

START, GOAL = np.array([-0.5, 0.9]), np.array([1.5, 0.3])
"""Between them stands a post: the arm has to fold."""
ALONG_X = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])

_LINK = """<link name="{name}"><inertial><origin xyz="{middle} 0 0"/><mass value="{mass}"/>
<inertia ixx="0.005" ixy="0" ixz="0" iyy="{turn}" iyz="0" izz="{turn}"/></inertial></link>"""
_JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} 0 0"/><axis xyz="{axis}"/><limit lower="-3.1" upper="3.1" velocity="{speed}" effort="{effort}"/>
</joint>"""


def planar_urdf(axis: str = "0 0 1", effort: tuple[float, float] = (60.0, 30.0)) -> str:
    return "".join(
        [
            '<robot name="planar"><link name="base_link"/>',
            _LINK.format(name="upper", middle=0.3, mass=6.0, turn=0.18),
            _LINK.format(name="fore", middle=0.25, mass=4.0, turn=0.09),
            _JOINT.format(
                name="a", kind="revolute", parent="base_link", child="upper", x=0, axis=axis, speed=3, effort=effort[0]
            ),
            _JOINT.format(
                name="b", kind="revolute", parent="upper", child="fore", x=0.6, axis=axis, speed=4, effort=effort[1]
            ),
            "</robot>",
        ]
    )


def pendulum(T_world_base: np.ndarray | None = None) -> SymbolicDynamics:
    """A rod of 2 kg and 0.5 m that swings about its base's y."""
    urdf = (
        '<robot name="pendulum"><link name="base_link"/>'
        + _LINK.format(name="rod", middle=0.25, mass=2.0, turn=2.0 * 0.5**2 / 12.0)
        + _JOINT.format(
            name="a", kind="continuous", parent="base_link", child="rod", x=0, axis="0 1 0", speed=10, effort=20
        )
        + "</robot>"
    )
    return symbolic_dynamics(SerialArm.from_urdf(urdf), T_world_base=T_world_base)


@cache
def dynamics_of(name: str) -> SymbolicDynamics:
    return symbolic_dynamics(built_in_arm(name))


@cache
def program_of(name: str, weights: CostWeights | None = None, n_steps: int = 20) -> MotionProgram:
    return MotionProgram(dynamics_of(name), weights, n_steps=n_steps)


def held_configurations(name: str, count: int, seed: int) -> np.ndarray:
    """Random configurations (count, joints) that the arm can hold."""
    dynamics, rng = dynamics_of(name), np.random.default_rng(seed)
    found: list[np.ndarray] = []
    while len(found) < count:
        q = rng.uniform(dynamics.lower, dynamics.upper)
        if (np.abs(dynamics.holding_torque(q)) < 0.98 * dynamics.max_effort).all():
            found.append(q)
    return np.array(found)


def planar_cell() -> Cell:
    def at(x: float, y: float) -> np.ndarray:
        T = np.eye(4)
        T[:2, 3] = x, y
        return T

    def rod(x: float) -> np.ndarray:
        T = at(x, 0.0)
        T[:3, :3] = ALONG_X
        return T

    bodies = (
        Body("upper", Capsule(0.03, 0.6), 1, rod(0.3)),
        Body("fore", Capsule(0.025, 0.5), 2, rod(0.25)),
        Body("post", Cylinder(0.1, 0.4), WORLD, at(0.82, 0.25)),
        Body("pole", Cylinder(0.08, 0.4), WORLD, at(0.42, 0.75)),
    )
    robot = Robot.from_urdf(planar_urdf())
    return Cell(robot, bodies, np.array([[0, 1]], np.int32), np.eye(4), np.eye(4), np.zeros(2))


def planar_path(scene: Scene, q_a: np.ndarray = START, q_b: np.ndarray = GOAL) -> TimedMotion:
    """A collision-free path by random trees, timed."""
    chain = scene.cell.robot.chain
    box, speed = (chain.lower, chain.upper), chain.max_velocity
    limits = Limits(speed, chain.max_acceleration)
    path = connect_by_trees(scene, q_a, q_b, box, speed, step=0.02, n_most=4000, rng=np.random.default_rng(3))
    assert path is not None
    path = shorten(path, speed, scene, np.random.default_rng(1), step=0.02, n_attempts=3)
    pieces = [
        time_path(piece, piece.grid(), limits, 0.02)
        if len(piece.control) > 1
        else time_straight(piece(piece.knots[:1])[0], piece(piece.knots[-1:])[0], limits, 0.02)
        for piece in round_corners(path, speed, scene, step=0.02)
    ]
    return reduce(lambda one, following: one.then(following), pieces)


def planar_program(n_steps: int = 20) -> MotionProgram:
    arm = SerialArm.from_robot(planar_cell().robot)
    return MotionProgram(symbolic_dynamics(arm), CostWeights(1.0, 1e-3, 0.1), n_steps=n_steps)
