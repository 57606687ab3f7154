from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
import pytest
import yaml

from cellwright.cell.bodies import Mesh
from cellwright.cell.built_in_robots import (
    BUILT_IN,
    BuiltIn,
    built_in,
    built_in_arm,
    built_in_bodies,
    built_in_robot,
    built_in_urdf,
)
from cellwright.cell.cell import Cell
from cellwright.cell.ignored_pairs import ignored_pairs
from cellwright.cell.inverse_kinematics import inverse_kinematics_for
from cellwright.cell.mesh_files import mesh_from_bytes
from cellwright.cell.scene import Scene
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import rotation_from_rpy
from cellwright.errors import InvalidInputError
from schemas.cell_file import BUILT_IN_ROBOTS
from tests.cellwright.cell.robots import shared

FACTS = {
    "ur10e": "ur10e",
    "crx10ia_l": "crx10ial",
    "kr180_r2500_extra": "kr180_r2500_extra",
    "nj290": "comau_nj290",
    "irb6640": "irb6640_irb6400",
    "scara": "scara_wbk",
    "pr_robot": "pr_robot",
}
CRX_MESHES = ("base.stl", "j1.stl", "j2.stl", "j3.stl", "j4.stl", "j5.stl", "j6.stl")
TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
SIX_AXES = [entry for entry in BUILT_IN if len(entry.joint_names) == 6]
NAMES = [entry.name for entry in BUILT_IN]


def facts_of(name: str) -> dict[str, Any]:
    facts: dict[str, Any] = yaml.safe_load(shared(f"robots/facts/{FACTS[name]}.yaml").read_text())
    return facts


def arm_of(entry: BuiltIn) -> SerialArm:
    return built_in_arm(entry.name)


@pytest.mark.parametrize("entry", BUILT_IN, ids=NAMES)
def test_every_robot_has_its_joints_in_order_and_a_home_within_its_limits(entry: BuiltIn) -> None:
    arm = arm_of(entry)
    assert arm.joint_names == entry.joint_names
    assert len(entry.home) == len(entry.max_acceleration) == len(entry.joint_names)
    assert (arm.lower <= entry.home).all() and (arm.upper >= entry.home).all()
    assert arm.flange_link == "tool0"


def test_the_cell_file_knows_the_robots_and_their_joints() -> None:
    assert {entry.name: len(entry.joint_names) for entry in BUILT_IN} == BUILT_IN_ROBOTS


@pytest.mark.parametrize("name", [name for name in FACTS if name != "ur10e"])
def test_the_flange_stands_where_the_facts_say(name: str) -> None:
    facts, arm = facts_of(name), arm_of(built_in(name))
    for check in facts["checks"]["fk"]:
        T = arm.flange_pose(np.array(check["q"], float))
        np.testing.assert_allclose(T[:3, 3], check["tool0_xyz"], atol=2e-6)
        turned = rotation_from_rpy(*check["tool0_rpy"]).T @ T[:3, :3]
        assert math.acos(min(1.0, (np.trace(turned) - 1.0) / 2.0)) < 5e-3


@pytest.mark.parametrize("name", [name for name in FACTS if name != "ur10e"])
def test_limits_are_those_of_the_facts(name: str) -> None:
    joints, arm = facts_of(name)["limits"]["joints"], arm_of(built_in(name))
    for field, ours in (
        ("lower", arm.lower),
        ("upper", arm.upper),
        ("velocity", arm.max_velocity),
        ("acceleration", arm.max_acceleration),
        ("effort", arm.max_effort),
    ):
        np.testing.assert_allclose(ours, [joint[field] for joint in joints], rtol=1e-4, atol=1e-5, err_msg=field)


@pytest.mark.parametrize("name", [name for name in FACTS if name != "ur10e"])
def test_masses_and_centres_are_those_of_the_facts(name: str) -> None:
    links = {link.get("name"): link for link in ElementTree.fromstring(built_in_urdf(name)).iterfind("link")}
    for fact in facts_of(name)["inertia"]["links"]:
        inertial = links[fact["name"]].find("inertial")
        assert inertial is not None
        mass, origin = inertial.find("mass"), inertial.find("origin")
        assert mass is not None and origin is not None
        assert float(mass.get("value", "")) == pytest.approx(fact["mass"], abs=1e-4)
        np.testing.assert_allclose([float(x) for x in origin.get("xyz", "").split()], fact["com"], atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_every_tensor_belongs_to_a_body_of_positive_density(name: str) -> None:
    for link in ElementTree.fromstring(built_in_urdf(name)).iterfind("link"):
        element = link.find("inertial/inertia")
        if element is None:
            continue
        ixx, ixy, ixz, iyy, iyz, izz = (
            float(element.get(key, "")) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        moments = np.linalg.eigvalsh([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        assert moments[0] > 0.0
        assert moments[2] <= moments[0] + moments[1] + 1e-6, link.get("name")


@pytest.mark.parametrize("entry", SIX_AXES, ids=[entry.name for entry in SIX_AXES])
def test_a_six_axis_robot_stands_free_at_home_and_is_not_always_in_its_own_way(entry: BuiltIn) -> None:
    robot, bodies = built_in_robot(entry.name), built_in_bodies(entry.name)
    rows: dict[str, list[int]] = {}
    for row, body in enumerate(bodies):
        rows.setdefault(body.name.split(".")[0], []).append(row)
    declared = [(a, b) for one, other in entry.touching for a in rows[one] for b in rows[other]]
    start = np.array(entry.home)
    cell = Cell(robot, bodies, np.empty((0, 2), np.int32), np.eye(4), np.eye(4), start)
    ignored = ignored_pairs(cell, range(len(bodies)), np.random.default_rng(0), declared=declared, n_samples=200)
    scene = Scene(Cell(robot, bodies, ignored.pairs, np.eye(4), np.eye(4), start))
    assert scene.colliding_pair(start) is None
    chain = robot.chain
    samples = np.random.default_rng(1).uniform(chain.lower, chain.upper, (200, 6))
    assert sum(scene.colliding_pair(q) is not None for q in samples) < 100


@pytest.mark.parametrize("entry", SIX_AXES, ids=[entry.name for entry in SIX_AXES])
def test_inverse_kinematics_finds_home_back(entry: BuiltIn) -> None:
    robot = built_in_robot(entry.name)
    q = np.array(entry.home) + 0.1
    found = inverse_kinematics_for(robot.chain).solve(robot.flange_pose(q)[None])[0]
    apart = np.abs(np.remainder(found - q + math.pi, 2.0 * math.pi) - math.pi).max(axis=1)
    assert np.nanmin(apart) < 1e-5


@pytest.mark.parametrize("name", ["scara", "pr_robot"])
def test_a_prismatic_robot_is_for_layout_alone(name: str) -> None:
    with pytest.raises(InvalidInputError, match="is prismatic: only arms of revolute joints can be planned"):
        built_in_robot(name)


@pytest.mark.parametrize(
    ("name", "folder", "files"),
    [
        (
            "ur5",
            "motion/ur5/collision",
            ("base.stl", "shoulder.stl", "upperarm.stl", "forearm.stl", "wrist1.stl", "wrist2.stl", "wrist3.stl"),
        ),
        (
            "crx10ia_l",
            "robots/crx10ia_l/collision",
            CRX_MESHES,
        ),
    ],
)
def test_the_bodies_enclose_the_published_meshes(name: str, folder: str, files: tuple[str, ...]) -> None:
    bodies = built_in_bodies(name)
    for number, file in enumerate(files):
        published = mesh_from_bytes(file, shared(f"{folder}/{file}").read_bytes(), np.ones(3))
        corners = published.vertices
        if name == "crx10ia_l":  # millimetres, in frames of their own beside the links'
            corners = corners * 1e-3
            low = facts_of(name)["collision"]["links"][number]["mesh_bounds"][0]
            corners = corners + np.round(np.array(low) - corners.min(axis=0), 4)
        inside = np.zeros(len(corners), bool)
        for body in bodies:
            if body.parent == number:
                assert isinstance(body.shape, Mesh)
                inside |= within(body.shape, corners)
        assert inside.all()


def within(polyhedron: Mesh, points: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Whether points lie inside a convex polyhedron, by the planes of its faces."""
    a, b, c = (polyhedron.vertices[polyhedron.faces[:, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    # 1e-9 m^3: slivers between corners rounded to 0.01 mm have no trustworthy plane
    wide = np.linalg.norm(normal, axis=1) > 1e-7
    normal = normal[wide] / np.linalg.norm(normal[wide], axis=1, keepdims=True)
    inside: np.ndarray[Any, Any] = (points @ normal.T - (a[wide] * normal).sum(axis=1) < 2e-5).all(axis=1)
    return inside
