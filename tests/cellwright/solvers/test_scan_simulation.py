from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cellwright.causes import Cause
from cellwright.cell.bodies import Body, Mesh
from cellwright.cell.cell import Cell
from cellwright.cell.occlusion import Occluder
from cellwright.cell.robot import Robot
from cellwright.errors import InvalidInputError
from cellwright.solvers.measurability import Sweeps
from cellwright.solvers.scan_simulation import (
    PartSurface,
    ScanPoints,
    profile_times,
    scanner_poses,
    simulate_profiles,
)
from tests.cellwright.solvers.scenes import DOWN, SCANNER, box, judge, mesh_of, occluder_of, random_sweeps

PLATE = box((1.0, 1.0, 0.02), (0.0, 0.0, -0.01))
STEP = trimesh.util.concatenate([box((0.1, 0.1, 0.06), (0, 0, 0)), box((0.03, 0.1, 0.05), (0.03, 0, 0.055))])


def scan(solid: trimesh.Trimesh, position: list[list[float]], **keywords: object) -> ScanPoints:
    surface = PartSurface(np.asarray(solid.face_normals), two_sided=False)
    rotation = np.tile(DOWN, (len(position), 1, 1))
    return simulate_profiles(
        SCANNER,
        100e-6,
        occluder_of(solid),
        surface,
        np.array(position),
        rotation,
        **keywords,  # type: ignore[arg-type]
    )


def test_a_plane_is_measured_on_the_plane_along_the_laser_line() -> None:
    found = scan(PLATE, [[0.05, 0.1, 0.182], [0.06, 0.1, 0.182]])
    assert len(found.points) == 2 * SCANNER.points_per_profile
    assert np.abs(found.points[:, 2]).max() < 1e-15
    np.testing.assert_allclose(found.points[:, 0], np.array([0.05, 0.06])[found.profile], atol=1e-15)
    half = 0.182 * np.tan(SCANNER.aperture / 2)
    assert found.points[:, 1].min() == pytest.approx(0.1 - half) and found.points[:, 1].max() == pytest.approx(
        0.1 + half
    )
    expected = 40e-6 * np.hypot(1.0, (found.points[:, 1] - 0.1) / 0.182)
    np.testing.assert_allclose(found.uncertainty, expected, rtol=1e-6)


@pytest.mark.parametrize(("height", "is_measured"), [(0.12, False), (0.13, True), (0.22, True), (0.23, False)])
def test_points_outside_the_working_range_are_dropped(height: float, is_measured: bool) -> None:
    assert (len(scan(PLATE, [[0.0, 0.0, height]]).points) > 0) == is_measured


def test_what_is_too_near_still_hides_what_is_behind_it() -> None:
    lid = box((0.2, 0.2, 0.01), (0.0, 0.0, 0.1))
    assert len(scan(trimesh.util.concatenate([PLATE, lid]), [[0.0, 0.0, 0.182]]).points) == 0


def test_bodies_that_are_not_the_part_block_and_are_not_measured() -> None:
    surface = PartSurface(np.asarray(PLATE.face_normals), two_sided=False)
    position, rotation = np.array([[0.0, 0.0, 0.2]]), DOWN[None]
    for obstacle, n_points in (
        (box((0.02, 0.02, 0.01), (0.0, 0.0, 0.05)), (100, 199)),  # some rays, and in the working range itself
        (box((0.3, 0.3, 0.01), (0.0, 0.0, 0.05)), (0, 0)),
        (box((0.02, 0.3, 0.01), (-0.038, 0.0, 0.1)), (0, 0)),  # between plate and detector
    ):
        occluder = Occluder(mesh_of(PLATE), mesh_of(obstacle))
        found = simulate_profiles(SCANNER, 100e-6, occluder, surface, position, rotation)
        assert n_points[0] <= len(found.points) <= n_points[1]
        assert np.abs(found.points[:, 2]).max(initial=0.0) < 1e-15


def test_every_scanned_point_is_one_that_the_sensor_model_measures() -> None:
    rng = np.random.default_rng(8)
    mesh, normals = mesh_of(STEP), np.asarray(STEP.face_normals)
    sweeps = random_sweeps(30, 0.08, rng)
    found = simulate_profiles(
        SCANNER, 60e-6, Occluder(mesh), PartSurface(normals, two_sided=False), sweeps.position, sweeps.rotation
    )
    assert len(found.points) > 300
    for i in rng.choice(len(found.points), 200, replace=False):
        v = int(found.profile[i])
        here = Sweeps.untrimmed(sweeps.position[v : v + 1], sweeps.rotation[v : v + 1])
        inward = found.points[i] + 1e-9 * (sweeps.position[v] - found.points[i])  # off the border of the fan
        cause, uncertainty, travel = judge(SCANNER, 60e-6, mesh, inward, normals[found.face[i]], here, 0)
        assert cause in (Cause.NONE, Cause.FIELD_OF_VIEW)
        if cause == Cause.FIELD_OF_VIEW:
            across, depth = (inward - sweeps.position[v]) @ sweeps.rotation[v][:, 1:]
            assert abs(abs(np.arctan2(across, depth)) - SCANNER.aperture / 2) < 1e-9
        else:
            assert uncertainty == pytest.approx(float(found.uncertainty[i]), rel=1e-5)
        assert abs(travel) < 1e-9


def test_two_sided_faces_are_measured_from_both_sides() -> None:
    sheet = Mesh(np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.0, 0.8, 0]]), np.array([[0, 1, 2]]))
    position, rotation = np.array([[0.0, 0.0, 0.182], [0.0, 0.0, -0.182]]), np.stack([DOWN, np.eye(3)])
    for two_sided, profiles in ((True, {0, 1}), (False, {0})):
        surface = PartSurface(np.array([[0.0, 0.0, 1.0]]), two_sided)
        found = simulate_profiles(SCANNER, 100e-6, Occluder(sheet), surface, position, rotation)
        assert set(found.profile.tolist()) == profiles


def test_noise_runs_along_the_laser_ray_with_the_uncertainty_as_deviation() -> None:
    position = [[0.001 * i, 0.0, 0.182] for i in range(200)]
    clean, noisy = scan(PLATE, position), scan(PLATE, position, rng=np.random.default_rng(1))
    offset = noisy.points - clean.points
    ray = clean.points - np.array(position)[clean.profile]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    along = np.einsum("ij,ij->i", offset, ray)
    assert np.linalg.norm(offset - along[:, None] * ray, axis=1).max() < 1e-12
    ratio = along / clean.uncertainty
    assert abs(ratio.mean()) < 0.02 and ratio.std() == pytest.approx(1.0, abs=0.02)
    again = scan(PLATE, position, rng=np.random.default_rng(1))
    assert again.points.tobytes() == noisy.points.tobytes()


def test_the_number_of_threads_changes_no_byte() -> None:
    position = [[0.0005 * i, 0.0, 0.182] for i in range(300)]
    one, many = (scan(STEP, position, n_threads=n) for n in (1, 4))
    for name in ("points", "uncertainty", "face", "profile"):
        assert getattr(one, name).tobytes() == getattr(many, name).tobytes()


def test_profiles_are_taken_at_multiples_of_the_period_within_the_sweeps() -> None:
    times, interval = profile_times(np.array([0.0, 1.003]), np.array([0.05, 1.03]), 100.0)
    np.testing.assert_allclose(times, [0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 1.01, 1.02, 1.03])
    assert interval.tolist() == [0] * 6 + [1] * 3
    assert (times <= 1.03).all()
    assert len(profile_times(np.empty(0), np.empty(0), 100.0)[0]) == 0


def test_no_profiles_give_no_points() -> None:
    surface = PartSurface(np.asarray(PLATE.face_normals), two_sided=False)
    found = simulate_profiles(SCANNER, 100e-6, occluder_of(PLATE), surface, np.empty((0, 3)), np.empty((0, 3, 3)))
    assert found.points.shape == (0, 3)


TWO_JOINTS = """<robot name="two">
  <link name="base_link"/><link name="upper"/><link name="tool0"/>
  <joint name="a" type="revolute"><parent link="base_link"/><child link="upper"/><origin xyz="0 0 0.5"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
  <joint name="b" type="revolute"><parent link="upper"/><child link="tool0"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
</robot>"""


def two_joint_cell(bodies: tuple[Body, ...] = ()) -> Cell:
    T_world_base = np.eye(4)
    T_world_base[0, 3] = 1.0
    T_flange_scanner = np.eye(4)
    T_flange_scanner[2, 3] = 0.1
    robot = Robot.from_urdf(TWO_JOINTS)
    return Cell(robot, bodies, np.empty((0, 2), np.int32), T_world_base, T_flange_scanner, np.zeros(2))


def test_scanner_poses_chain_base_robot_and_mount_into_the_part() -> None:
    T_world_part = np.eye(4)
    T_world_part[:3, 3] = [0.2, 0.0, 0.1]
    poses = scanner_poses(two_joint_cell(), T_world_part, np.array([[0.0, 0.0], [np.pi / 2, np.pi / 2]]))
    np.testing.assert_allclose(poses[0, :3, 3], [1.0 + 0.4 - 0.2, 0.0, 0.5 + 0.1 - 0.1], atol=1e-15)
    # turned about z, the arm and, through joint b, the mount point along y
    np.testing.assert_allclose(poses[1, :3, 3], [0.8, 0.4 + 0.1, 0.4], atol=1e-15)
    np.testing.assert_allclose(poses[1, :3, 2], [0.0, 1.0, 0.0], atol=1e-15)
    with pytest.raises(InvalidInputError, match="moves 3 joints but the robot has 2"):
        scanner_poses(two_joint_cell(), T_world_part, np.zeros((1, 3)))
