"""A robot that cannot be planned with, and cells in which nothing can move."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from flows.requests import request_of
from schemas.cell_objects import build_cell
from tasks.assemble_cell import assemble_cell
from tests.faults.bench import MALFORMED, NO_ANSWER, Bench
from tests.small_inspection import CELL, write_cell

POST_AROUND_THE_BASE = (
    "obstacles=[{name: post, cylinder: {radius: 100 mm, length: 500 mm}, pose: {position: [0 m, 0 m, 0.2 m]}}]"
)


def arm(n_joints: int, kind: str = "revolute", limit: str = 'lower="-3" upper="3" velocity="2" effort="1"') -> str:
    links = "".join(f'<link name="l{n}"/>' for n in range(n_joints + 1))
    joints = "".join(
        f'<joint name="j{n}" type="{kind if n == 2 else "revolute"}"><parent link="l{n}"/><child link="l{n + 1}"/>'
        f'<origin xyz="0 0.05 0.25"/><axis xyz="{"0 0 1" if n in (0, 4) else "0 1 0"}"/><limit {limit}/></joint>'
        for n in range(n_joints)
    )
    return f'<robot name="arm">{links}{joints}</robot>'


@pytest.mark.parametrize(
    ("urdf", "says"),
    [
        (arm(5), "the arm has 5 joints"),
        (arm(7), "the arm has 7 joints"),
        (arm(6, "prismatic"), "joint 'j2' is prismatic: only arms of revolute joints"),
        (arm(6, limit=""), "joint 'j0' has no velocity limit in the URDF: add"),
        (arm(6, limit='lower="nan" upper="3" velocity="2" effort="1"'), "lower='nan'"),
        (arm(6, limit='lower="3" upper="-3" velocity="2" effort="1"'), "lower must be less than upper"),
        (arm(6).replace("0.25", "250"), "arm.urdf: the arm reaches 1500 m"),
        (arm(6).replace("0.25", "1e300"), "arm.urdf: the arm reaches 6e+300 m"),
        (arm(6).replace("0 0.05 0.25", "0 0 0"), "arm.urdf: the arm reaches 0 mm"),
        (arm(6, limit='lower="-3" upper="3" velocity="0" effort="1"'), "arm.urdf: joint 'j0' has velocity limit 0"),
        (
            arm(6).replace(
                '<link name="l1"/>', '<link name="l1"><collision><geometry><cone/></geometry></collision></link>'
            ),
            "arm.urdf: collision geometry of link 'l1' is a <cone>",
        ),
        (arm(6)[:300], "is not valid XML"),
        ("rubbish", "is not valid XML"),
        ("<html/>", "outermost element is <html>, not <robot>"),
        ('<robot name="x"><link name="a"/></robot>', "no moving joint hangs on link 'a'"),
        (
            arm(6).replace(
                '<link name="l1"/>',
                '<link name="l1"><collision><geometry><mesh filename="gone.stl"/></geometry></collision></link>',
            ),
            "mesh 'gone.stl' was not found: tried",
        ),
    ],
)
def test_a_malformed_robot_is_refused(urdf: str, says: str, bench: Bench) -> None:
    (bench.folder / "arm.urdf").write_text(urdf)
    angles = ", ".join(["10 deg"] * urdf.count("<joint"))
    said = bench.refused_setting(
        MALFORMED, "robot.model=arm.urdf", f"robot.start=[{angles}]", "robot.max_acceleration=100 deg/s^2"
    )
    assert says in said


def test_a_robot_that_is_singular_everywhere_is_refused(bench: Bench) -> None:
    end = '<child link="l6"/><origin xyz="0 0.05 0.25"/><axis xyz="0 1 0"/>'
    assert end in arm(6)
    (bench.folder / "arm.urdf").write_text(
        arm(6).replace(end, end.replace("0 0.05 0.25", "0 0 0.25").replace("1 0", "0 1"))
    )
    angles = ", ".join(["10 deg"] * 6)
    settings = ["robot.model=arm.urdf", f"robot.start=[{angles}]", "robot.max_acceleration=100 deg/s^2"]
    said = bench.refused_setting(MALFORMED, *settings)
    assert "singular in every configuration: axes 5 and 6 are collinear" in said


@pytest.mark.parametrize(
    ("code", "settings", "says"),
    [
        (MALFORMED, ["robot.start=[0 deg, 0 deg, 0 deg, 0 deg, 0 deg, 0 deg]"], "the start configuration collides: "),
        (MALFORMED, ["obstacles=[{name: hall, box: {size: [9 m, 9 m, 9 m]}}]"], "with 'hall'"),
        (
            MALFORMED,
            [POST_AROUND_THE_BASE],
            "collides: .* with 'post'",
        ),
        (NO_ANSWER, ["part.pose.position=[5 m, 0 m]", "table.pose.position=[5 m, 0 m, 0.1 m]"], "out of reach"),
        (
            MALFORMED,
            ["planner.reachability.clearance=1 m"],
            "closer than 1000 mm.*lower planner.reachability.clearance",
        ),
        (NO_ANSWER, ["planner.measurability.max_uncertainty=1e-9 um"], r"uncertainty\): add tilts"),
        (NO_ANSWER, ["planner.reachability.shortest=100 m"], r"too short"),
    ],
)
def test_a_cell_in_which_nothing_can_move_is_refused(code: int, settings: list[str], says: str, bench: Bench) -> None:
    assert re.search(says, bench.refused_setting(code, *settings))


@pytest.mark.parametrize(
    ("position", "says"),
    [("[0 m, 0 m, 0.05 m]", "50 emitter occluded"), ("AT_THE_SCANNER", "the start configuration brings")],
)
def test_a_part_in_the_robot_is_refused(position: str, says: str, bench: Bench) -> None:
    if position == "AT_THE_SCANNER":
        position = "[{:.4f} m, {:.4f} m, {:.4f} m]".format(*_scanner_housing_at_start(bench.folder))
    text = re.sub(r"  rests_on: table\n  pose: .*\n", f"  pose: {{position: {position}}}\n", CELL, count=1)
    text = text.replace("position: [700 mm, 0 mm, 100 mm]", "position: [900 mm, 900 mm, -100 mm]")
    code = NO_ANSWER if "occluded" in says else MALFORMED
    assert says in bench.refused(code, cell=write_cell(bench.folder, text))


def _scanner_housing_at_start(folder: Path) -> list[float]:
    params = request_of(write_cell(folder)).cell
    cell = build_cell(assemble_cell((), params=params))
    row = [body.name for body in cell.bodies].index("scanner body")
    body, links = cell.bodies[row], cell.robot.link_poses(cell.start)
    position: list[float] = (cell.T_world_base @ links[body.parent] @ body.T_parent_body)[:3, 3].tolist()
    return position
