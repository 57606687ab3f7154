from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.bodies import Body, Box, Capsule, Cylinder, Mesh, Sphere
from cellwright.cell.cell import Cell
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.errors import SolverError
from cellwright.solvers.hermite import states_at
from cellwright.solvers.motion_steps import MovingCorners, dense_times, link_poses_of
from tests.cellwright.solvers import scanning_cell

SHAPES = (
    Box((0.3, 0.1, 0.2)),
    Cylinder(0.05, 0.3),
    Sphere(0.1),
    Capsule(0.05, 0.2),
    Mesh(np.random.default_rng(0).uniform(-0.1, 0.2, (20, 3)), np.array([[0, 1, 2]], np.int32)),
)


@dataclass
class Motion:
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray


def surface_points(shape, rng, n=200):
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    match shape:
        case Box(size):
            return rng.uniform(-0.5, 0.5, (n, 3)) * size
        case Sphere(radius):
            return radius * directions
        case Mesh(vertices, _):
            return vertices
        case Cylinder(radius, length):
            ring = directions[:, :2] / np.linalg.norm(directions[:, :2], axis=1, keepdims=True)
            return np.column_stack([radius * ring, rng.uniform(-0.5, 0.5, n) * length])
        case Capsule(radius, length):
            return radius * directions + np.array([0, 0, 1]) * np.sign(directions[:, 2:]) * length / 2


def test_the_link_poses_are_those_of_the_kernels():
    robot = scanning_cell.cell_without_part().robot
    q = np.random.default_rng(0).uniform(-3, 3, (20, 6))
    for row, poses in zip(q, link_poses_of(robot.chain, q), strict=True):
        assert poses == pytest.approx(robot.link_poses(row), abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_no_point_of_a_body_moves_further_than_the_bound(shape):
    rng = np.random.default_rng(1)
    bare = scanning_cell.cell_without_part()
    body = Body("tool", shape, 6, pose(np.array([0.1, 0.0, 0.2]), rotation_from_rpy(0.3, 0.5, 0.7)))
    cell = Cell(bare.robot, (body,), np.empty((0, 2), np.int32), np.eye(4), np.eye(4), bare.start)
    q = np.cumsum(rng.uniform(-0.1, 0.1, (30, 6)), axis=0)
    bound = MovingCorners.of(cell).displacement(q)
    points = np.column_stack([surface_points(shape, rng), np.ones(len(surface_points(shape, rng)))])
    T = link_poses_of(bare.robot.chain, q)[:, 6] @ body.T_parent_body
    moved = np.linalg.norm(np.diff((T @ points.T)[:, :3], axis=0), axis=1).max(axis=1)
    assert np.all(moved <= bound + 1e-12)
    assert np.all(bound <= 3.0 * moved)


def test_steps_are_as_small_as_asked_and_keep_all_states():
    cell = scanning_cell.cell()
    trajectory = scanning_cell.trajectory()
    motion = Motion(trajectory.time_s, trajectory.position_rad, trajectory.velocity_rad_s)
    corners = MovingCorners.of(cell)
    time = dense_times(motion, corners, step=2e-3, step_angle=0.005)
    position, _ = states_at(motion.time, motion.position, motion.velocity, time)
    assert np.isin(motion.time, time).all()
    assert corners.displacement(position).max() <= 2e-3 * (1 + 1e-6)
    assert np.abs(np.diff(position, axis=0)).max() <= 0.005 * (1 + 1e-6)
    assert len(time) < 3 * corners.displacement(motion.position).sum() / 2e-3 + len(motion.time)


def test_a_motion_that_is_not_finite_is_a_solver_error():
    motion = Motion(np.array([0.0, 1.0]), np.full((2, 6), np.nan), np.zeros((2, 6)))
    with pytest.raises(SolverError, match="cannot be cut"):
        dense_times(motion, MovingCorners.of(scanning_cell.cell()), step=1e-3, step_angle=0.1)


@settings(max_examples=60, deadline=None)
@given(
    speed=st.one_of(st.integers(1, 40).map(lambda n: 12.5 * n), st.floats(5.0, 200.0)),
    joint=st.integers(0, 5),
    from_angle=st.floats(-3.0, 3.0),
)
def test_a_joint_at_a_round_speed_never_turns_beyond_the_bound(speed, joint, from_angle):
    """50 deg/s over 8 ms is four times 0.1 deg: cut in four, rounding alone would take steps beyond the bound."""
    time = 0.008 * np.arange(40)
    velocity = np.zeros((40, 6))
    velocity[:, joint] = np.deg2rad(speed)
    position = velocity * time[:, None] + from_angle
    corners = MovingCorners.of(scanning_cell.cell_without_part())
    step, step_angle = 3e-3, float(np.deg2rad(0.1))
    dense = dense_times(Motion(time, position, velocity), corners, step=step, step_angle=step_angle)
    checked, _ = states_at(time, position, velocity, dense)
    assert np.abs(np.diff(checked, axis=0)).max() <= step_angle
    assert corners.displacement(checked).max() <= step
