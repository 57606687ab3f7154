"""The recording shows stations moving to their places, then the robot's cycle, as the layout has it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from cellwright.cell.transforms import pose, rotation_from_quaternion
from schemas.layout import Layout
from schemas.layout_objects import build_problem
from schemas.motion import Recording
from storage.mcap import decode, encode
from tasks.record_layout import record_layout
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.test_optimise_layout import request, solved, two_tables

MOVING_S = 2.0


@cache
def recording() -> Recording:
    found: Recording = record_layout(None, (), None, None, two_tables(), params=request().recording)
    return found


def poses_of(frame: str) -> tuple[np.ndarray, np.ndarray]:
    """Times in s and poses (n, 4, 4) in the parent."""
    found = recording()
    rows = found.pose_frame == found.frame.index(frame)
    rotation = rotation_from_quaternion(found.pose_quaternion[rows])
    return found.pose_time_ns[rows] / 1e9, pose(found.pose_position_m[rows], rotation)


def test_stations_move_from_where_they_began_to_where_they_stand() -> None:
    layout = two_tables()
    for row, name in enumerate(("blue", "red"), 1):
        time, T = poses_of(f"station/{name}")
        assert time[0] == 0.0 and time[-1] == MOVING_S
        np.testing.assert_allclose(T[0], layout.T_world_body_before[row].reshape(4, 4), atol=1e-9)
        np.testing.assert_allclose(T[-1], layout.T_world_body[row].reshape(4, 4), atol=1e-9)


def test_the_cycle_follows_and_ends_where_it_began() -> None:
    found, layout = recording(), two_tables()
    time = found.state_time_ns / 1e9
    assert (np.diff(found.state_time_ns) > 0).all()
    assert time[-1] - MOVING_S == np.round(layout.cycle_s, 9) or abs(time[-1] - MOVING_S - layout.cycle_s) < 1e-6
    np.testing.assert_allclose(found.position_rad[0], found.position_rad[-1], atol=1e-6)
    np.testing.assert_allclose(found.position_rad[0], layout.approach_position[0], atol=1e-12)


def test_the_tool_meets_the_targets_in_the_moving_frames() -> None:
    found, problem = recording(), build_problem(request().layout.problem, None, None, None)
    last = {name: poses_of(name)[1][-1] for name in ("base", "link_2", "flange", "tool", "station/blue")}
    T_world_tool = last["base"] @ last["link_2"] @ last["flange"] @ last["tool"]
    goal = last["station/blue"] @ problem.stations[0].approaches[0].T_station_tool[0]
    np.testing.assert_allclose(T_world_tool[:3, 3], goal[:3, 3], atol=1e-3)
    assert set(found.entity_frame) <= {"world", *found.frame}
    assert {"hull of blue", "hull of red", "blue", "red"} <= set(found.entity)


def test_an_approach_is_shown_between_transitions() -> None:
    from tests.small_layout import table

    line: list[dict[str, Any]] = [{"position": ["0 m", "0 m", "0.5 m"]}, {"position": ["50 mm", "0 m", "0.5 m"]}]
    stations = [table("blue", approaches=[{"line": line, "back": True, "target": "position"}]), table("red")]
    layout = solved(stations=stations, solver={"starts": 1})
    assert layout.converged
    found = record_layout(
        None, (), None, None, layout, params=request(stations=stations, solver={"starts": 1}).recording
    )
    shown = found.state_time_ns[-1] / 1e9 - MOVING_S
    np.testing.assert_allclose(shown, layout.cycle_s + 2.0 * 0.05 / 0.25, atol=1e-6)


def test_viewers_can_open_it() -> None:
    again = decode(Recording, encode(recording()))
    assert isinstance(again, Recording)
    np.testing.assert_array_equal(again.triangle_m, recording().triangle_m)


def known_layout() -> Layout:
    """Return the layout of two tables with places and motions that no program has chosen."""
    there, back = np.array([[-0.25, 0.3], [0.1, 0.4], [0.25, 0.3]]), np.array([[0.25, 0.3], [-0.25, 0.3]])
    return replace(
        two_tables(),
        before=np.array([-1.2, 0.8]),
        value=np.array([-0.25, 0.25]),
        transition=np.array([0, 0, 0, 1, 1], np.int32),
        time_s=np.array([0.0, 0.2, 0.4, 0.0, 0.35]),
        position=np.concatenate([there, back]),
        velocity=np.full((5, 2), np.nan),
        approach_visit=np.array([0, 1], np.int32),
        approach_position=np.array([[-0.25, 0.3], [0.25, 0.3]]),
    )


def test_the_result_is_the_one_of_this_version() -> None:
    # where the pair stands about the robot is nobody's choice, and a program's last digits decide how states are spaced
    found = record_layout(None, (), None, None, known_layout(), params=request().recording)
    assert len(found.state_time_ns) > 4 and len(found.pose_time_ns) > 100
    check_golden(record_layout, rounded(found, 6))
