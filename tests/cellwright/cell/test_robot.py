from __future__ import annotations

import dataclasses
import pickle
import re

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell import built_in_robots
from cellwright.cell.built_in_robots import built_in, built_in_robot
from cellwright.cell.robot import ACCELERATION_TIME, Robot
from cellwright.errors import InvalidInputError
from tests.cellwright.cell.robots import random_chain, shared, urdf_of

ARM = """<robot name="arm">
  <link name="world"/> <link name="base_link"/> <link name="upper"/> <link name="fore"/> <link name="hand"/>
  <link name="flange"/> <link name="finger"/> <link name="rail"/>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base_link"/><origin xyz="1 2 3"/></joint>
  <joint name="one" type="revolute"><parent link="base_link"/><child link="upper"/><axis xyz="0 0 2"/>
    <limit lower="-1" upper="2" velocity="3" effort="1"/></joint>
  <joint name="two" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.5" rpy="0 1.5 0"/>
    <axis xyz="0 1 0"/><limit velocity="2" effort="1"/></joint>
  <joint name="wrist" type="fixed"><parent link="fore"/><child link="hand"/><origin xyz="0.3 0 0"/></joint>
  <joint name="plate" type="fixed"><parent link="hand"/><child link="flange"/><origin xyz="0.1 0 0"/></joint>
  <joint name="grip" type="prismatic"><parent link="hand"/><child link="finger"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.1" velocity="1" effort="1"/></joint>
  <joint name="slide" type="fixed"><parent link="world"/><child link="rail"/></joint>
</robot>"""


def arm_with(old: str, new: str) -> str:
    assert old in ARM
    return ARM.replace(old, new)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), n_joints=st.integers(1, 8))
def test_kinematics_agree_with_pinocchio(seed: int, n_joints: int) -> None:
    import pinocchio

    generator = np.random.default_rng(seed)
    robot = Robot.from_urdf(urdf_of(random_chain(generator, n_joints)))
    model = robot.model
    data = model.createData()
    flange = model.getFrameId("flange")
    for q in generator.uniform(-3, 3, (3, n_joints)):
        pinocchio.forwardKinematics(model, data, q)
        pinocchio.updateFramePlacements(model, data)
        pinocchio.computeJointJacobians(model, data, q)
        frame = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        assert np.abs(robot.flange_pose(q) - data.oMf[flange].homogeneous).max() < 1e-12
        for number, T in enumerate(robot.link_poses(q)):
            assert np.abs(T - data.oMi[number].homogeneous).max() < 1e-12
        theirs = pinocchio.getFrameJacobian(model, data, flange, frame).reshape(6, n_joints)
        assert np.abs(robot.jacobian(q) - theirs).max() < 1e-12


def test_the_chain_is_read_from_base_link_to_flange() -> None:
    robot = Robot.from_urdf(ARM)
    assert (robot.base_link, robot.flange_link, robot.joint_names) == ("base_link", "flange", ("one", "two"))
    assert robot.chain.axis.tolist() == [[0, 0, 1], [0, 1, 0]]
    assert robot.chain.lower.tolist() == [-1, -2 * np.pi]
    assert robot.chain.max_acceleration == pytest.approx(np.array([3, 2]) / ACCELERATION_TIME)
    assert robot.flange_pose(np.array([0.0, -1.5]))[:3, 3] == pytest.approx([0.4, 0, 0.5])
    assert robot.model.nq == 2


def test_links_are_carried_by_the_joint_before_them() -> None:
    robot = Robot.from_urdf(ARM)
    attached = robot.tree.attachments(robot.base_link, robot.joints)
    assert {link: number for link, (number, _) in attached.items()} == {
        "world": 0, "base_link": 0, "upper": 1, "fore": 2, "hand": 2, "flange": 2, "finger": 2, "rail": 0,
    }  # fmt: skip
    assert attached["finger"][1][:3, 3] == pytest.approx([0.3, 0, 0])
    assert attached["rail"][1][:3, 3] == pytest.approx([-1, -2, -3])


def test_another_base_and_flange_can_be_named() -> None:
    robot = Robot.from_urdf(ARM, base_link="upper", flange_link="fore")
    assert robot.joint_names == ("two",)


def test_tool0_is_the_flange_where_there_is_one() -> None:
    text = arm_with(
        "</robot>",
        '<link name="x_tool0"/>'
        '<joint name="t" type="fixed"><parent link="flange"/><child link="x_tool0"/></joint></robot>',
    )
    assert Robot.from_urdf(text).flange_link == "x_tool0"


def test_without_a_named_flange_it_is_the_last_moving_link() -> None:
    text = ARM.replace('"flange"', '"plate_link"').replace('type="prismatic"', 'type="fixed"')
    assert Robot.from_urdf(text).flange_link == "fore"


def test_limits_of_the_cell_replace_those_of_the_urdf() -> None:
    robot = Robot.from_urdf(ARM, lower={"two": -1.0}, max_velocity=(5.0,), max_acceleration=[7.0, 8.0])
    assert robot.chain.lower.tolist() == [-1, -1]
    assert robot.chain.max_velocity.tolist() == [5, 5]
    assert robot.chain.max_acceleration.tolist() == [7, 8]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not valid XML"),
        ("<model/>", "outermost element is <model>"),
        ('<robot xmlns:xacro="http://wiki.ros.org/xacro"><xacro:macro/></robot>', "unexpanded xacro"),
        ("<robot/>", "no link"),
        (arm_with('<link name="rail"/>', ""), "'slide' names link 'rail'"),
        (arm_with('<link name="rail"/>', '<link name="rail"/><link name="hand"/>'), "two links named 'hand'"),
        (arm_with('<link name="rail"/>', '<link name="rail"/><link name="loose"/>'), "2 links without a parent"),
        (arm_with('<child link="rail"/>', '<child link="hand"/>'), "two parents, by joints 'wrist' and 'slide'"),
        (arm_with('<parent link="world"/><child link="base_link"/>', '<parent link="fore"/><child link="base_link"/>'),
         "2 links without|circle"),
        (arm_with('lower="-1" ', ""), "'one' has no lower limit"),
        (arm_with('upper="2" ', ""), "'one' has no upper limit"),
        (arm_with('<limit velocity="2" effort="1"/>', ""), "'two' has no velocity limit"),
        (arm_with('upper="2"', 'upper="-1"'), "'one' has lower limit -1 and upper limit -1"),
        (arm_with('velocity="2"', 'velocity="0"'), "'two' has velocity limit 0"),
        (arm_with('velocity="2"', 'velocity="fast"'), "velocity='fast'"),
        (arm_with('velocity="2"', 'velocity="nan"'), "velocity='nan'"),
        (arm_with('xyz="0 0 2"', 'xyz="0 0 0"'), "'one' has the axis"),
        (arm_with('xyz="0 0 0.5"', 'xyz="0 0"'), "xyz='0 0'"),
        (arm_with('type="continuous"', 'type="prismatic"'), "'two' is prismatic"),
        (arm_with('type="continuous"', 'type="screw"'), "'two' has type 'screw'"),
        (arm_with('<axis xyz="0 1 0"/>', '<mimic joint="one"/>'), "'two' mimics 'one'"),
        (arm_with('<child link="upper"/>', ""), "'one' has no <child>"),
    ],
)  # fmt: skip
def test_a_malformed_urdf_is_one_clear_error(text: str, said: str) -> None:
    with pytest.raises(InvalidInputError, match=said):
        Robot.from_urdf(text)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"base_link": "nowhere"}, "no link 'nowhere'"),
        ({"base_link": "rail"}, "does not hang on link 'rail'|no moving joint"),
        ({"flange_link": "base_link"}, "no moving joint"),
        ({"flange_link": "finger"}, "'grip' is prismatic"),
        ({"max_velocity": {"three": 1.0}}, "names three"),
        ({"max_velocity": (1.0, 2.0, 3.0)}, "3 values, but the arm has 2 joints"),
        ({"max_acceleration": (0.0,)}, "acceleration limit 0"),
    ],
)
def test_options_that_do_not_fit_are_one_clear_error(options: dict[str, object], said: str) -> None:
    with pytest.raises(InvalidInputError, match=said):
        Robot.from_urdf(ARM, **options)  # type: ignore[arg-type]


def test_missing_limits_can_be_stated_by_the_cell() -> None:
    text = arm_with('lower="-1" ', "")
    assert Robot.from_urdf(text, lower={"one": -0.5}).chain.lower[0] == -0.5


def test_robots_pickle() -> None:
    robot = built_in_robot("ur10e")
    again = pickle.loads(pickle.dumps(robot))
    q = np.array(built_in("ur10e").home)
    assert (again.flange_pose(q) == robot.flange_pose(q)).all()


def test_the_ur10e_stands_where_the_published_table_says() -> None:
    facts = yaml.safe_load(shared("robots/facts/ur10e.yaml").read_text())
    robot = built_in_robot("UR10e")
    published = Robot.from_urdf(shared("robots/ur10e/ur10e.urdf").read_text())
    for check in facts["checks"]["fk"]:
        T = robot.flange_pose(np.array(check["q"]))
        assert T[:3, 3] == pytest.approx(check["tool0_xyz"], abs=1e-6)
    for q in np.random.default_rng(0).uniform(-3, 3, (20, 6)):
        assert np.abs(robot.flange_pose(q) - published.flange_pose(q)).max() < 5e-9
    assert robot.chain.lower == pytest.approx(published.chain.lower)
    assert robot.chain.max_velocity == pytest.approx(published.chain.max_velocity)
    limits = facts["limits"]["joints"]
    assert robot.chain.max_acceleration.tolist() == [joint["acceleration"] for joint in limits]
    assert list(robot.joint_names) == [joint["joint"] for joint in limits] == list(built_in("ur10e").joint_names)


def test_an_unknown_built_in_robot_gets_a_hint() -> None:
    with pytest.raises(InvalidInputError, match=re.escape("did you mean 'ur10e'?")):
        built_in_robot("ur10")


def test_the_digest_of_a_built_in_robot_changes_with_its_data(monkeypatch: pytest.MonkeyPatch) -> None:
    before = built_in_robots.built_in_digest("ur10e")
    assert before == built_in_robots.built_in_digest("UR10e")
    faster = dataclasses.replace(built_in_robots.BUILT_IN[0], max_acceleration=(13.0,) * 6)
    monkeypatch.setattr(built_in_robots, "BUILT_IN", (faster,))
    assert built_in_robots.built_in_digest("ur10e") != before
