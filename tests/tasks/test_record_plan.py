"""The recording shows the plan: one tree of frames, the robot where kinematics says, the cloud when it was measured."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cellwright.cell.transforms import pose, rotation_from_quaternion
from schemas.motion import Recording
from schemas.poses import Pose
from tasks.record_plan import RecordingParams, record_plan
from tests.tasks import plan_artefacts as plan
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.plate_scene import plate
from tests.tasks.test_simulate_scan import T_WORLD_BASE

PARAMS = RecordingParams(T_world_part=Pose.of(plan.T_WORLD_PART), frame_rate_hz=30, cloud_rate_hz=5)


@cache
def recording(params: RecordingParams = PARAMS) -> Recording:
    return record_plan(plan.cell(), plate(), plan.trajectory(), plan.scan(), params=params)


def poses_of(frame: str) -> tuple[np.ndarray, np.ndarray]:
    """Times in s and poses (n, 4, 4) in the parent."""
    found = recording()
    rows = found.pose_frame == found.frame.index(frame)
    return found.pose_time_ns[rows] / 1e9, pose(
        found.pose_position_m[rows], rotation_from_quaternion(found.pose_quaternion[rows])
    )


def test_frames_form_one_tree_under_the_world() -> None:
    parent = dict(zip(recording().frame, recording().frame_parent, strict=True))
    assert len(parent) == len(recording().frame)
    assert parent.keys() == {"base", "part", "link_1", "link_2", "flange", "scanner"}
    for frame in parent:
        seen = [frame]
        while seen[-1] != "world":
            seen.append(parent[seen[-1]])
            assert len(seen) <= len(parent) + 1, "a loop"
    assert set(recording().entity_frame) <= {"world", *parent}


def test_every_frame_has_a_pose_from_the_first_moment_on() -> None:
    for frame in recording().frame:
        assert poses_of(frame)[0][0] == 0.0
    assert recording().state_time_ns[0] == 0


def test_links_stand_where_plane_trigonometry_puts_them() -> None:
    time, T_base_one = poses_of("link_1")
    a = 0.2 * time  # `swing` turns joint a by 0.2 rad/s, b against it
    np.testing.assert_allclose(T_base_one[:, 0, 0], np.cos(a), atol=1e-12)
    np.testing.assert_allclose(T_base_one[:, 1, 0], np.sin(a), atol=1e-12)
    _, T_base_two = poses_of("link_2")
    np.testing.assert_allclose(T_base_two[:, :2, 3], 0.5 * np.stack([np.cos(a), np.sin(a)], axis=1), atol=1e-12)
    np.testing.assert_allclose(T_base_two[:, :3, :3], np.broadcast_to(np.eye(3), (len(a), 3, 3)), atol=1e-12)


def test_the_scanner_at_the_end_of_the_tree_is_that_of_the_cell() -> None:
    model = plan.cell()
    T_world_scanner = (
        poses_of("base")[1][0] @ poses_of("link_2")[1][-1] @ poses_of("flange")[1][0] @ poses_of("scanner")[1][0]
    )
    end = 0.2 * plan.trajectory().time_s[-1]
    expected = T_WORLD_BASE @ pose(0.5 * np.array([np.cos(end), np.sin(end), 0]), np.eye(3)) @ model.T_flange_scanner
    np.testing.assert_allclose(T_world_scanner, expected, atol=1e-12)


@pytest.mark.parametrize("rate", [1.0, 3.0, 30.0, 50.0, 999.0])
def test_ticks_rise_from_the_first_state_to_the_last(rate: float) -> None:
    params = RecordingParams(T_world_part=Pose(), frame_rate_hz=rate)
    found = record_plan(plan.cell(), plate(), plan.trajectory(), plan.scan(), params=params)
    time = found.pose_time_ns[found.pose_frame == found.frame.index("link_1")]
    assert time[0] == 0
    assert time[-1] == found.state_time_ns[-1] == 2_000_000_000
    assert np.diff(time).min() > 1e6, "no tick stands a rounding error before the end"
    assert np.diff(time).max() <= 1e9 / rate + 1


def test_joint_states_are_those_of_the_trajectory() -> None:
    trajectory = plan.trajectory()
    np.testing.assert_array_equal(recording().position_rad, trajectory.position_rad)
    np.testing.assert_array_equal(recording().velocity_rad_s, trajectory.velocity_rad_s)
    np.testing.assert_array_equal(recording().state_time_ns, np.round(trajectory.time_s * 1e9).astype(np.int64))


def test_joint_states_carry_the_torques_of_a_trajectory_that_has_them() -> None:
    torque = np.random.default_rng(0).normal(size=plan.trajectory().position_rad.shape)
    told = plan.changed(plan.trajectory(), torque_nm=torque)
    found = record_plan(plan.cell(), plate(), told, plan.scan(), params=PARAMS)
    np.testing.assert_array_equal(found.torque_nm, torque)
    assert recording().torque_nm.shape == (len(torque), 0)


def test_bodies_hang_on_what_moves_them_and_are_coloured_by_what_they_are() -> None:
    found = recording()
    carried = dict(zip(found.entity, found.entity_frame, strict=True))
    assert carried == {
        "base_link": "base", "one.1": "link_1", "tool0": "link_2", "camera": "link_2", "table": "world", "part": "part",
    }  # fmt: skip
    colour = dict(zip(found.entity, map(tuple, found.entity_colour.tolist()), strict=True))
    assert colour["base_link"] == colour["one.1"] == colour["tool0"]
    assert len({colour[name] for name in ("base_link", "camera", "table", "part")}) == 4


def test_triangles_are_those_of_the_bodies_in_their_frames() -> None:
    found = recording()
    assert found.entity_n_faces.sum() == len(found.triangle_m)
    first, count = found.entity_first_face, found.entity_n_faces
    np.testing.assert_array_equal(first, np.cumsum(count) - count)
    row = found.entity.index("camera")
    corners = found.triangle_m[first[row] : first[row] + count[row]].reshape(-1, 3)
    np.testing.assert_allclose(corners.min(axis=0), [0.09, -0.015, -0.02], atol=1e-12)
    np.testing.assert_allclose(corners.max(axis=0), [0.11, 0.015, 0.02], atol=1e-12)
    row = found.entity.index("part")
    corners = found.triangle_m[first[row] : first[row] + count[row]]
    np.testing.assert_array_equal(corners, plate().vertices_m[plate().faces].reshape(-1, 9))


def test_points_appear_in_portions_not_before_they_are_measured_and_not_after_the_end() -> None:
    found, scan = recording(), plan.scan()
    shown = found.cloud_time_ns / 1e9
    assert np.all(np.diff(shown) >= 0)
    order = [int(np.flatnonzero((scan.points_m == point).all(axis=1))[0]) for point in found.cloud_point_m]
    assert sorted(order) == list(range(6))
    measured = scan.time_s[scan.profile[order]]
    assert np.all(shown >= measured - 1e-9)
    assert np.all(shown - measured <= 1 / 5 + 1e-9)
    assert shown[-1] <= plan.trajectory().time_s[-1]
    assert len(np.unique(shown)) == 4


def test_a_scan_without_points_is_recorded_too() -> None:
    empty = plan.changed(
        plan.scan(),
        points_m=np.zeros((0, 3), np.float32),
        uncertainty_m=np.zeros(0, np.float32),
        face=np.zeros(0, np.int32),
        profile=np.zeros(0, np.int32),
    )
    found = record_plan(plan.cell(), plate(), plan.trajectory(), empty, params=PARAMS)
    assert len(found.cloud_time_ns) == 0


def test_the_result_is_the_one_of_this_version() -> None:
    check_golden(record_plan, rounded(recording()))
