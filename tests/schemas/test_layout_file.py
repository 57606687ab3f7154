"""A layout file says what stands where and what may be moved; a mistake in it names line, key, value and mend."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import apply
from cellwright.errors import InvalidInputError
from cellwright.solvers.layout.examples import four_station_problem, station_distance_problem, two_machine_problem
from cellwright.solvers.layout.problem import LayoutProblem
from flows.layout_requests import layout_request
from schemas.layout_file import load_layout_file
from schemas.layout_objects import build_problem
from schemas.sources import SourceFile
from tasks.spherize_robot import spherize_robot
from tests.small_layout import document, gripper_urdf, gripping, table, write_layout

PROJECT = Path(__file__).parents[2]
ROBOT = document()["robot"]
AT_TOP = {"name": "top", "pose": {"position": ["0 m", "0 m", "0.1 m"]}}


def problem_of(path: Path) -> LayoutProblem:
    return build_problem(layout_request(load_layout_file(path)).layout.problem, None, None, None)


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("four_stations", four_station_problem()),
        ("two_machines", two_machine_problem("kr180_r2500_extra")),
        ("two_tables", station_distance_problem()),
    ],
)
def test_the_shipped_examples_are_the_problems_of_the_paper(name: str, known: LayoutProblem) -> None:
    problem = problem_of(PROJECT / "examples" / f"{name}.yaml")
    assert (problem.visits, problem.cyclic, problem.cost) == (known.visits, known.cyclic, _cost_of(known))
    np.testing.assert_allclose(problem.robot_spheres.centres, known.robot_spheres.centres, atol=1e-12)
    np.testing.assert_allclose(problem.robot_spheres.radii, known.robot_spheres.radii, atol=1e-12)
    np.testing.assert_allclose([problem.lower, problem.upper], [known.lower, known.upper], atol=1e-12)
    designs = np.random.default_rng(0).uniform(known.lower, known.upper, (5, known.n_design))
    np.testing.assert_allclose(problem.station_poses(designs), known.station_poses(designs), atol=1e-12)
    for one, other in zip(problem.stations, known.stations, strict=True):
        order = [np.lexsort(station.hull.centres.round(9).T) for station in (one, other)]
        np.testing.assert_allclose(one.hull.centres[order[0]], other.hull.centres[order[1]], atol=1e-12)
        for mine, theirs in zip(one.approaches, other.approaches, strict=True):
            assert mine.target is theirs.target
            np.testing.assert_allclose(mine.T_station_tool, theirs.T_station_tool, atol=1e-12)


def _cost_of(known: LayoutProblem) -> object:
    return known.cost


def test_joints_move_a_station_from_where_it_is_placed(tmp_path: Path) -> None:
    placed = table("red", pose={"position": ["1 m", "2 m", "0 m"], "rotation": ["0 deg", "0 deg", "90 deg"]})
    problem = problem_of(write_layout(tmp_path, stations=[table("blue"), placed]))
    at_rest = problem.station_poses(np.zeros(2))[1]
    np.testing.assert_allclose(at_rest[:3, 3], [1.0, 2.9, 0.0], atol=1e-12)


def test_a_sequence_names_stations_approaches_and_home(tmp_path: Path) -> None:
    pick = {"name": "pick", "pose": {"position": ["0 m", "0 m", "0.5 m"]}, "target": "position"}
    place = {**pick, "name": "place"}
    file = load_layout_file(
        write_layout(
            tmp_path,
            robot={**ROBOT, "home": ["0 deg", "100 mm"]},
            stations=[table("blue", approaches=[pick, place]), table("red")],
            sequence=["home", "blue place", "red", "blue pick"],
        )
    )
    assert file.visits() == [(-1, 0), (0, 1), (1, 0), (0, 0)]


def test_a_way_may_be_gone_back(tmp_path: Path) -> None:
    line = [{"position": ["0 m", "0 m", "0.6 m"]}, {"position": ["0 m", "0 m", "0.5 m"]}]
    blue = table("blue", approaches=[{"line": line, "back": True, "target": "position", "speed": "0.1 m/s"}])
    problem = problem_of(write_layout(tmp_path, stations=[blue, table("red")]))
    [approach] = problem.stations[0].approaches
    np.testing.assert_allclose(approach.T_station_tool[:, 2, 3], [0.6, 0.5, 0.6])
    assert approach.duration_s == pytest.approx(2.0)


def test_points_come_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "way.csv").write_text("x,y,z\n0, 0, 500\n0 0 600\n")
    blue = table("blue", approaches=[{"points": {"file": "way.csv"}, "target": "position"}])
    problem = problem_of(write_layout(tmp_path, stations=[blue, table("red")]))
    np.testing.assert_allclose(problem.stations[0].approaches[0].T_station_tool[:, 2, 3], [0.5, 0.6])


def test_limits_are_laid_over_the_robots_own(tmp_path: Path) -> None:
    problem = problem_of(
        write_layout(tmp_path, robot={**ROBOT, "upper": ["90 deg", "0.5 m"], "max_velocity": ["1 rad/s", "0.5 m/s"]})
    )
    np.testing.assert_allclose(problem.arm.upper, [math.pi / 2, 0.5])
    np.testing.assert_allclose(problem.arm.max_velocity, [1.0, 0.5])


def test_a_tool_beyond_the_urdf_keeps_clear_like_the_links(tmp_path: Path) -> None:
    flange = SerialArm.from_urdf(gripper_urdf(), flange_link="hand").T_last_flange
    (tmp_path / "arm.urdf").write_text(gripper_urdf())
    tool = [{"spheres": [{"centre": ["0.1 m", "0 m", "0 m"], "radius": "0.1 m"}]}]
    changes = gripping(
        hull={"spheres": 3, "tool_radius": "20 mm", "base_radius": "0.1 m"}, tool={"position": ["0.8 m", "0 m", "0 m"]},
        tool_hull=tool,
    )  # fmt: skip
    plain, with_tool = (built(tmp_path, write_layout(tmp_path, **each)).robot_spheres for each in (gripping(), changes))
    n = len(plain)
    assert {"robot base", "link 'upper'", "link 'hand'"} <= set(plain.body) and with_tool.body[:n] == plain.body
    assert with_tool.body[n:] == ("robot base", "the tool", "the tool")
    assert with_tool.link[n:].tolist() == [0, 2, 2]
    np.testing.assert_allclose(with_tool.radii[n:], [0.1, 0.1, 0.02])
    np.testing.assert_allclose(
        with_tool.centres[n + 1 :], [apply(flange, np.array([[x, 0, 0]]))[0] for x in (0.1, 0.8)]
    )
    # the tool may fold back onto the column, but never meets the arm that carries it
    pairs = with_tool.self_pairs[len(plain.self_pairs) :]
    assert {(int(with_tool.link[one]), int(other)) for one, other in pairs} == {(0, n + 1), (0, n + 2)}


def built(folder: Path, path: Path) -> LayoutProblem:
    """Return the problem of a file whose robot has no meshes, with its links covered."""
    request = layout_request(load_layout_file(path))
    assert request.robot_hull is not None
    urdf = SourceFile(name="arm.urdf", content=(folder / "arm.urdf").read_bytes())
    hull = spherize_robot((urdf,), params=request.robot_hull)
    return build_problem(request.layout.problem, urdf, hull, None)


def test_a_tool_without_links_is_the_point_and_its_hull(tmp_path: Path) -> None:
    tool = [{"sphere": {"radius": "30 mm"}, "pose": {"position": ["0 m", "0 m", "0.1 m"]}}]
    problem = problem_of(write_layout(tmp_path, robot={**ROBOT, "tool_hull": tool}))
    assert problem.robot_spheres.link.tolist() == [0, 2, 2]
    np.testing.assert_allclose(problem.robot_spheres.radii, [0.2, 0.02, 0.03])


def test_a_way_may_say_how_fast_it_turns(tmp_path: Path) -> None:
    turn = {"position": ["0 m", "0 m", "0.5 m"], "rotation": ["0 deg", "0 deg", "90 deg"]}
    line = [{"position": ["0 m", "0 m", "0.5 m"]}, turn]
    way = {"line": line, "target": "position", "speed": "0.1 m/s"}
    for turn_speed, expected in (({}, math.pi / 2.0), ({"turn_speed": "45 deg/s"}, 2.0)):
        blue = table("blue", approaches=[{**way, **turn_speed}])
        problem = problem_of(write_layout(tmp_path, stations=[blue, table("red")]))
        assert problem.stations[0].approaches[0].duration_s == pytest.approx(expected)


def hulled(hull: Any) -> list[dict[str, Any]]:
    return [table("blue", hull=[hull]), table("red")]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"statons": []}, "unknown key 'statons': did you mean stations?"),
        ({"stations": []}, "needs at least 1"),
        ({"stations": [table("blue"), table("blue")]}, "'blue' names something else too (line "),
        ({"stations": [table("home"), table("red")]}, "means the robot's home configuration"),
        ({"stations": [table("robot base"), table("red")]}, "means a part of the robot"),
        ({"sequence": ["blu", "red"]}, "'blu' is no station and no approach of one: did you mean blue?"),
        ({"sequence": ["home", "red"]}, "visits home, but robot.home is missing"),
        ({"sequence": ["red"]}, "the robot makes 1 visits: a transition needs two"),
        ({"stations": [table("a", harness=None), table("b", harness=None)]}, "nothing can be moved"),
        ({"robot": {"model": "pr_robt"}}, "did you mean pr_robot?"),
        ({"robot": {**ROBOT, "home": ["0 deg"]}}, "has 1 entries but the arm has 2 joints"),
        ({"robot": {**ROBOT, "home": ["0 deg", "0 deg"]}}, "joint 'joint_p' slides: write a length"),
        ({"robot": {**ROBOT, "home": ["0 deg", "2 m"]}}, "joint 'joint_p' at 2 m is outside 0 to 0.8 m"),
        (
            {"robot": {**ROBOT, "max_velocity": "60 deg/s"}},
            "joint 'joint_p' slides: write a length for it, one value a joint",
        ),
        (
            {"stations": [table("blue", approaches=[AT_TOP]), table("blue top")]},
            "with approach 'top' it reads 'blue top', which names something too (line ",
        ),
        (
            {"stations": [table("blue", hull=2 * [{"sphere": {"radius": "1 m"}}]), table("blue 2")]},
            "with its hull 2 it reads 'blue 2'",
        ),
        (
            {"robot": {**ROBOT, "lower": ["0 deg", "0.5 m"], "upper": ["90 deg", "0.3 m"]}},
            "joint 'joint_p' has lower limit 0.5 m and upper limit 0.3 m: move them apart by more than 0.2 m",
        ),
        ({"workspace": {"min": ["0 m", "0 m", "0 m"], "max": ["1 m", "-1 m", "1 m"]}}, "in y: widen it by more than"),
        ({"walls": [{"name": "w", "normal": [0, 0, 0], "offset": "0 m"}]}, "has no direction"),
        (
            {"walls": [{"name": "w", "normal": [1e308, 1e308, 0], "offset": "0 m"}]},
            "of length 1.41e+308 has",
        ),
        (
            {"stations": [table("blue", harness={"joints": [{"slide": [1e308, 1e308, 0], "range": ["0 m", "1 m"]}]})]},
            "is too long for a direction",
        ),
        (
            {"stations": [table("blue", hull=[{"box": {"size": 3 * ["1 m"]}, "cells": [9, 9, 9]}]), table("red")]},
            "a hull has 729 spheres: 512 is the most that it may have: use fewer",
        ),
        (
            {"stations": [table("blue", hull=9 * [{"box": {"size": 3 * ["1 m"]}, "count": 500}]), table("red")]},
            "all hulls have 4501 spheres: 4096 can be checked: use fewer",
        ),
        (
            {"stations": hulled({"box": {"size": ["1 m"] * 3}, "sphere": {"radius": "1 m"}})},
            "a hull has box and sphere",
        ),
        ({"stations": hulled({"sphere": {"radius": "1 m"}, "cells": [1, 1, 1]})}, "cells divide a box"),
        ({"stations": [table("blue", approaches=[{}]), table("red")]}, "an approach has no pose"),
        ({"cost": {"repeatability": 20}}, "repeatability needs joint_deviation"),
        ({"solver": {"method": "stagd"}}, "did you mean staged?"),
        ({"cellwright": 2}, "this release reads cellwright: 1"),
    ],
)
def test_a_mistake_is_named_with_its_mend(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = write_layout(tmp_path, **changes)
    with pytest.raises(InvalidInputError) as refused:
        load_layout_file(path)
    assert message in str(refused.value)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    ("ends", "message"),
    [
        (
            ["100 deg", "-100 deg"],
            "is reversed, from 100 deg to -100 deg, its lower end 200 deg above its upper end: write [",
        ),
        (["10 deg", "10 deg"], "is empty, from 10 deg to 10 deg, 0 deg wide: any width above that makes it a range"),
    ],
)
def test_a_harness_with_an_empty_range_is_refused(tmp_path: Path, ends: list[str], message: str) -> None:
    harness = {"joints": [{"turn": "z", "range": ends}]}
    with pytest.raises(InvalidInputError) as refused:
        load_layout_file(write_layout(tmp_path, stations=[table("blue", harness=harness), table("red")]))
    assert message in str(refused.value) and "stations.0.harness.joints.0.range" in str(refused.value)


def test_a_file_of_tasks_is_told_apart() -> None:
    with pytest.raises(InvalidInputError, match="lists tasks, not stations: run cellwright sequence"):
        load_layout_file(PROJECT / "examples" / "drilling_panel.yaml")


def test_an_inspections_file_is_told_apart() -> None:
    with pytest.raises(InvalidInputError, match="describes an inspection, not a layout: run cellwright inspect"):
        load_layout_file(PROJECT / "examples" / "grooved_cylinder.yaml")


@pytest.mark.parametrize(
    ("wrong", "key", "message"),
    [
        (('lower="-2.9" upper="2.9"', ""), "model", "joint 'shoulder' has lower limit 0 and upper limit 0 rad, as it"),
        (('lower="-2.9"', 'lower="3.1"'), "model", "move them apart by more than 0.2 rad"),
        (('velocity="1.5"', ""), "model", "joint 'shoulder' has no velocity limit: add velocity to its <limit>"),
        (('xyz="0.6 0 0"', 'xyz="600 0 0"'), "model", "the arm reaches 601.2 m, but 50 m is the most"),
        (("0.5 0.06 0.06", "500 60 60"), "model", "link 'upper' has a length or offset of 500 m"),
        (("0.5 0.06 0.06", "0 0.06 0.06"), "model", "link 'upper' has size [0.0, 0.06, 0.06]: it must be positive"),
        (('name="hand"', 'name="palm"'), "model", "names link 'hand', which the URDF does not have"),
        (("<robot", "<robo"), "model", "the URDF is not valid XML"),
        (("", ""), "flange_link", "has no link 'gone'"),
    ],
)
def test_a_malformed_robot_is_named_with_its_mend(
    tmp_path: Path, wrong: tuple[str, str], key: str, message: str
) -> None:
    (tmp_path / "arm.urdf").write_text(gripper_urdf().replace(*wrong))
    path = write_layout(tmp_path, **gripping(**({"flange_link": "gone"} if key == "flange_link" else {})))
    with pytest.raises(InvalidInputError) as refused:
        load_layout_file(path)
    assert f"robot.{key}: arm.urdf: " in str(refused.value) and message in str(refused.value)


def test_a_way_with_a_speed_does_not_stand_still(tmp_path: Path) -> None:
    still = {"path": 2 * [{"position": ["0 m", "0 m", "0.5 m"]}], "target": "position", "speed": "0.1 m/s"}
    path = write_layout(tmp_path, stations=[table("blue", approaches=[still]), table("red")])
    with pytest.raises(InvalidInputError, match="poses 1 and 2 of the way are the same"):
        load_layout_file(path)
