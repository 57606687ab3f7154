from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.transforms import pose, rotation_from_quaternion
from cellwright.errors import InvalidInputError
from schemas.artefact import digest
from schemas.cell_objects import packed_bodies
from schemas.motion import ScanCloud, Trajectory
from schemas.poses import Pose
from schemas.scanner import ScannerParams
from schemas.sources import CellModel
from tasks.place_surroundings import SurroundingsParams, place_surroundings
from tasks.simulate_scan import ScanParams, simulate_scan
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.plate_scene import DOWN, plate

ARM = """<robot name="arm">
  <link name="base_link"/><link name="one"/><link name="tool0"/>
  <joint name="a" type="revolute"><parent link="base_link"/><child link="one"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
  <joint name="b" type="revolute"><parent link="one"/><child link="tool0"/><origin xyz="0.5 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
</robot>"""
T_WORLD_PART = pose(np.array([0.5, 0.1, 0.2]), np.eye(3))
T_WORLD_BASE = pose(np.array([0.0, 0.0, 0.382]), np.eye(3))
"""The arm swings in a plane 0.182 m above the plate, its scanner looks down."""


def cell_model(*bodies: Body) -> CellModel:
    return CellModel(
        urdf=ARM,
        base_link="base_link",
        flange_link="tool0",
        T_world_base=T_WORLD_BASE,
        T_flange_scanner=pose(np.zeros(3), DOWN),
        joint=("a", "b"),
        lower_rad=np.full(2, -3.0),
        upper_rad=np.full(2, 3.0),
        max_velocity_rad_s=np.ones(2),
        max_acceleration_rad_s2=np.ones(2),
        start_rad=np.zeros(2),
        ignored_pair=np.empty((0, 2), np.int32),
        ignored_reason=np.empty(0, np.int8),
        **packed_bodies(bodies),
    )


def swing(*kinds: str) -> Trajectory:
    """Each segment turns joint a by 0.1 rad in half a second, b against it, at constant speed."""
    n = len(kinds)
    time = np.arange(n + 1) * 0.5
    a = 0.2 * time
    return Trajectory(
        time_s=time,
        position_rad=np.stack([a, -a], axis=1),
        velocity_rad_s=np.tile([0.2, -0.2], (n + 1, 1)),
        acceleration_rad_s2=np.zeros((n + 1, 2)),
        segment=np.minimum(np.arange(n + 1), n - 1).astype(np.int32),
        travel_m=np.full(n + 1, np.nan),
        kind=kinds,
        view=np.array([0 if kind == "sweep" else -1 for kind in kinds], np.int32),
        branch=np.zeros(n, np.int8),
        direction=np.ones(n, np.int8),
        start_s=time[:-1],
        end_s=time[1:],
        via=("",) * n,
        order_method=("greedy",),
        order_duration_s=np.array([time[-1]]),
        order_chosen=np.array([True]),
        left_out_view=np.zeros(0, np.int32),
        left_out_reason=(),
        replaced_view=np.zeros(0, np.int32),
        replaced_reason=(),
        order_lower_bound_s=0.0,
        order_proven=False,
    )


def scan(trajectory: Trajectory, *bodies: Body, noise: bool = False, seed: int = 0) -> ScanCloud:
    params = ScanParams(
        scanner=ScannerParams(points_per_profile=11, profile_rate_hz=20.0),
        T_world_part=Pose.of(T_WORLD_PART),
        noise=noise,
        seed=seed,
    )
    model = cell_model(*bodies)
    around = place_surroundings(model, params=SurroundingsParams(T_world_part=Pose.of(T_WORLD_PART)))
    cloud = simulate_scan(model, plate(), around, trajectory, params=params)
    assert isinstance(cloud, ScanCloud)
    return cloud


def test_profiles_stand_where_the_joints_are_at_their_times() -> None:
    cloud = scan(swing("sweep"))
    np.testing.assert_allclose(cloud.time_s, np.arange(11) * 0.05)
    a = 0.2 * cloud.time_s
    # the scanner's mount is joint b, half a metre out on link one; b turns back, so the scanner keeps its orientation
    expected = np.stack([0.5 * np.cos(a) - 0.5, 0.5 * np.sin(a) - 0.1, np.full(11, 0.182)], axis=1)
    np.testing.assert_allclose(cloud.position_m, expected, atol=1e-12)
    np.testing.assert_allclose(rotation_from_quaternion(cloud.quaternion), np.tile(DOWN, (11, 1, 1)), atol=1e-12)
    assert len(cloud.points_m) == 11 * 11
    assert np.abs(cloud.points_m[:, 2]).max() < 1e-7
    np.testing.assert_allclose(cloud.points_m[:, 0], cloud.position_m[cloud.profile, 0], atol=1e-7)
    assert (plate().normals[cloud.face] == [0.0, 0.0, 1.0]).all()


def test_connections_measure_nothing() -> None:
    cloud = scan(swing("connection", "sweep", "connection"))
    assert set(cloud.segment.tolist()) == {1}
    assert cloud.time_s.min() >= 0.5 and cloud.time_s.max() <= 1.0
    assert len(scan(swing("connection")).points_m) == 0


def test_obstacles_in_the_world_hide_the_part() -> None:
    lid = Body("lid", Box((2.0, 2.0, 0.01)), WORLD, pose(np.array([0.5, 0.0, 0.3]), np.eye(3)))
    assert len(scan(swing("sweep"), lid).points_m) == 0
    beside = Body("beside", Box((2.0, 0.1, 0.01)), WORLD, pose(np.array([0.5, 5.0, 0.3]), np.eye(3)))
    assert len(scan(swing("sweep"), beside).points_m) == 11 * 11


def test_noise_depends_on_the_seed_alone() -> None:
    clean, noisy = scan(swing("sweep")), scan(swing("sweep"), noise=True)
    assert digest(noisy) == digest(scan(swing("sweep"), noise=True))
    assert digest(noisy) != digest(scan(swing("sweep"), noise=True, seed=1))
    offset = np.linalg.norm(noisy.points_m - clean.points_m, axis=1)
    assert 10e-6 < offset.mean() < 60e-6


def test_a_trajectory_of_another_robot_is_refused() -> None:
    plan = swing("sweep")
    three = np.zeros((2, 3))
    plan = dataclasses.replace(plan, position_rad=three, velocity_rad_s=three, acceleration_rad_s2=three)
    with pytest.raises(InvalidInputError, match="moves 3 joints but the robot has 2"):
        scan(plan)


def test_the_result_is_the_one_of_this_version() -> None:
    cloud = scan(swing("connection", "sweep"), noise=True, seed=3)
    points_m, uncertainty_m = np.round(cloud.points_m, 6) + 0.0, np.round(cloud.uncertainty_m, 9)
    check_golden(simulate_scan, rounded(cloud, points_m=points_m, uncertainty_m=uncertainty_m))
