from __future__ import annotations

from pathlib import Path

import pytest

from cellwright.errors import InvalidInputError
from schemas.cell_file import load_cell_file
from tests.small_inspection import write_cell

BALL = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
LIMIT = 'lower="-3" upper="3" velocity="2"'
START = "robot.start=[1 deg, 1 deg, 1 deg, 1 deg, 1 deg, 1 deg]"


def arm(n_joints: int = 6, *, xyz: str = "0 0.05 0.25", shape: str = BALL, limit: str = LIMIT) -> str:
    links = "".join(f'<link name="l{n}">{shape if n else ""}</link>' for n in range(n_joints + 1))
    joints = "".join(
        f'<joint name="j{n}" type="revolute"><parent link="l{n}"/><child link="l{n + 1}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{"0 0 1" if n in (0, 4) else "0 1 0"}"/><limit {limit}/></joint>'
        for n in range(n_joints)
    )
    return f'<robot name="arm">{links}{joints}</robot>'


def said(folder: Path, *settings: str, urdf: str | None = None) -> str:
    cell = write_cell(folder)
    if urdf is not None:
        (folder / "arm.urdf").write_text(urdf)
        settings = ("robot.model=arm.urdf", *settings)
    with pytest.raises(InvalidInputError) as caught:
        load_cell_file(cell, settings)
    return str(caught.value)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["robot.lower=10 deg", "robot.upper=-10 deg"], "robot.lower: joint 'shoulder_pan_joint' has lower limit"),
        (["robot.upper=-400 deg"], "robot.upper: joint 'shoulder_pan_joint' has lower limit"),
        (["robot.start=[0 deg, 0 deg, 0 deg, 0 deg, 0 deg, 900 deg]"], "wrist_3_joint 900 deg is outside -360 to 360"),
        (["robot.start=[0 deg, 0 deg]"], "robot.start: has 2 entries but ur10e has 6 joints"),
        (["robot.base_link=nope"], "robot.base_link: 'nope' is no link of ur10e: known are base_link"),
        (["robot.flange_link=tool"], "robot.flange_link: 'tool' is no link of ur10e: did you mean tool0?"),
        (["robot.flange_link=base_link"], "robot.flange_link: ur10e: no moving joint lies between"),
        (["robot.flange_link=wrist_2_link"], "robot.model: the arm has 5 joints between base and flange, but only"),
        (["robot.model=scara"], "robot.model: scara: joint 'joint_3' is prismatic"),
        (["table.name=forearm_link", "part.rests_on=forearm_link"], "table.name: 'forearm_link' names a link of the"),
        (["may_touch=[[tabel, forearm_link]]"], "may_touch.0: 'tabel' is no body and no link with a shape: did you"),
    ],
)
def test_a_robot_that_no_run_would_take_is_refused_with_its_key(
    settings: list[str], words: str, tmp_path: Path
) -> None:
    assert words in said(tmp_path, *settings)


@pytest.mark.parametrize(
    ("urdf", "words"),
    [
        (arm(7), "robot.model: the arm has 7 joints"),
        (
            arm(xyz="0 50 200"),
            "the arm reaches 1236.93 m, but 50 m is the most that can be planned: are its lengths in",
        ),
        (arm(xyz="0 0 1e300"), "the arm reaches 6e+300 m"),
        (arm(xyz="0 0 0.001"), "the arm reaches 6 mm, but 10 mm is the least"),
        (arm(shape=BALL.replace("0.01", "100")), "collision geometry of link 'l1' has a length or offset of 200 m"),
        (arm(shape=BALL.replace("0.01", "-1")), "collision geometry of link 'l1' has radius [-1.0]"),
        (arm(limit='lower="-3" upper="3" velocity="0"'), "robot.model: arm.urdf: joint 'j0' has velocity limit 0"),
        (arm(limit='lower="3" upper="-3" velocity="1"'), "robot.model: arm.urdf: joint 'j0' has lower limit 3"),
        (
            arm().replace("1 0 0", "0 1 0").replace("0 0 1", "0 1 0"),
            "the arm is singular in every configuration: axes 1, 2, 3, 4, 5 and 6 are parallel, so that",
        ),
        (arm(limit='lower="-3" upper="3"'), 'add velocity="..." to its <limit> or state robot.max_velocity'),
    ],
)
def test_a_faulty_urdf_is_refused_before_anything_is_computed(urdf: str, words: str, tmp_path: Path) -> None:
    message = said(tmp_path, START, urdf=urdf)
    assert words in message


def test_an_arm_from_a_urdf_needs_a_start_and_limits_given_beside_it_count(tmp_path: Path) -> None:
    assert "robot.start: is missing, and arm.urdf has none of its own" in said(tmp_path, urdf=arm())
    (tmp_path / "arm.urdf").write_text(arm(limit='lower="-3" upper="3"'))
    settings = ["robot.model=arm.urdf", START, "robot.max_velocity=90 deg/s", "may_touch=[[l1, l3], [l2, table]]"]
    assert load_cell_file(tmp_path / "cell.yaml", settings).robot.max_velocity_rad_s is not None


def test_the_bodies_of_a_link_go_by_its_name(tmp_path: Path) -> None:
    write_cell(tmp_path)
    (tmp_path / "arm.urdf").write_text(arm(shape=2 * BALL))
    settings = ["robot.model=arm.urdf", START, "may_touch=[[l1, l3], [l2.2, table]]"]
    assert load_cell_file(tmp_path / "cell.yaml", settings).may_touch == (("l1", "l3"), ("l2.2", "table"))
