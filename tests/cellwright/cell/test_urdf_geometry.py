from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Sphere
from cellwright.cell.built_in_robots import built_in_bodies
from cellwright.cell.robot import Robot
from cellwright.cell.transforms import apply
from cellwright.cell.urdf_geometry import (
    body_names,
    check_geometry,
    collision_bodies,
    mesh_references,
    meshes_among,
    meshes_in,
    resolve_mesh,
)
from cellwright.errors import InvalidInputError
from tests.cellwright.cell.robots import published_crx, shared

TETRAHEDRON = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def arm(geometry: str, scale: str = "") -> Robot:
    return Robot.from_urdf(
        f"""<robot name="arm"><link name="base_link"/><link name="hand"/>
        <link name="upper"><collision><origin xyz="0 0 1"/><geometry>{geometry}</geometry></collision></link>
        <link name="flange"><collision><geometry><sphere radius="0.1"/></geometry></collision>
        <collision><geometry><sphere radius="0.2"/></geometry></collision></link>
        <joint name="one" type="revolute"><parent link="base_link"/><child link="upper"/><axis xyz="0 0 1"/>
          <limit lower="-1" upper="2" velocity="3"/></joint>
        <joint name="fix" type="fixed"><parent link="upper"/><child link="flange"/><origin xyz="1 0 0"/></joint>
        <joint name="two" type="revolute"><parent link="upper"/><child link="hand"/><axis xyz="0 0 1"/>
          <limit lower="-1" upper="2" velocity="3"/></joint></robot>"""
    )


@pytest.mark.parametrize(
    ("geometry", "shape"),
    [
        ('<box size="1 2 3"/>', Box((1, 2, 3))),
        ('<cylinder radius="1" length="2"/>', Cylinder(1, 2)),
        ('<sphere radius="1"/>', Sphere(1)),
        ('<capsule radius="1" length="2"/>', Capsule(1, 2)),
    ],
)
def test_primitives_are_read(geometry: str, shape: object) -> None:
    bodies = collision_bodies(arm(geometry), meshes_among({}))
    assert bodies[0].shape == shape
    assert (bodies[0].name, bodies[0].parent) == ("upper", 1)
    assert bodies[0].T_parent_body[:3, 3].tolist() == [0, 0, 1]


def test_links_fixed_to_a_moving_link_are_merged_with_it() -> None:
    bodies = collision_bodies(arm('<sphere radius="1"/>'), meshes_among({}))
    assert [(body.name, body.parent) for body in bodies] == [("upper", 1), ("flange.1", 1), ("flange.2", 1)]
    assert bodies[1].T_parent_body[:3, 3].tolist() == [1, 0, 0]


def test_meshes_are_scaled_and_mirrored_ones_turned_right_side_out() -> None:
    geometry = '<mesh filename="package://p/meshes/t.obj" scale="0.1 0.1 -0.1"/>'
    robot = arm(geometry)
    assert mesh_references(robot.urdf) == ("package://p/meshes/t.obj",)
    mesh = collision_bodies(robot, meshes_among({"t.obj": TETRAHEDRON}))[0].shape
    assert isinstance(mesh, Mesh)
    assert mesh.vertices.min(axis=0).tolist() == [0, 0, -0.1]
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.einsum("fi,fi->", a, np.cross(b, c)) / 6 == pytest.approx(1e-3 / 6)


@pytest.mark.parametrize(
    ("geometry", "said"),
    [
        ("", "'upper' has 0 shapes"),
        ('<cone radius="1"/>', "<cone>"),
        ('<sphere radius="-1"/>', r"radius \[-1.0\]"),
        ('<box size="1 2"/>', "size='1 2'"),
        ('<cylinder radius="1"/>', "no length"),
        ("<mesh/>", "no filename"),
        ('<mesh filename="a/gone.stl"/>', "'upper': mesh 'a/gone.stl' is not among the given files"),
        ('<mesh filename="empty.stl"/>', "'upper': empty.stl is empty"),
        ('<mesh filename="garbage.stl"/>', "'upper': garbage.stl"),
        ('<mesh filename="garbage.dae"/>', "cannot be read as DAE"),
        ('<mesh filename="scene.blend"/>', "no known kind"),
        ('<mesh filename="t.obj" scale="0 1 1"/>', "scaled by"),
        ('<mesh filename="flat.obj"/>', "triangles without area"),
    ],
)
def test_geometry_that_cannot_be_read_names_the_link(geometry: str, said: str) -> None:
    files = {
        "empty.stl": b"",
        "garbage.stl": bytes(range(256)) * 3,
        "garbage.dae": b"\0\1\2",
        "scene.blend": b"x",
        "t.obj": TETRAHEDRON,
        "flat.obj": b"v 0 0 0\nv 1 0 0\nv 1 0 0\nf 1 2 3\n",
    }
    with pytest.raises(InvalidInputError, match=said):
        collision_bodies(arm(geometry), meshes_among(files))


@pytest.mark.parametrize(
    "filename",
    ["package://arm_description/meshes/a.stl", "meshes/a.stl", "package://other/share/meshes/a.stl", "a.stl"],
)
def test_meshes_are_found_around_the_urdf(tmp_path: Path, filename: str) -> None:
    folder = tmp_path / "arm_description" / "urdf"
    (tmp_path / "arm_description" / "meshes").mkdir(parents=True)
    (folder / "meshes").mkdir(parents=True)
    expected = tmp_path / "arm_description" / "meshes" / "a.stl"
    if "arm_description" not in filename:
        expected = folder / ("a.stl" if filename == "a.stl" else "meshes/a.stl")
    expected.write_bytes(b"x")
    assert resolve_mesh(filename, folder) == expected
    assert meshes_in(folder)(filename) == b"x"


def test_the_folder_of_a_package_can_be_stated(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a.stl").write_bytes(b"x")
    found = resolve_mesh("package://p/a.stl", tmp_path / "urdf", {"p": tmp_path / "elsewhere"})
    assert found == tmp_path / "elsewhere" / "a.stl"


def test_a_missing_mesh_lists_where_it_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"'meshes/gone.stl' was not found: tried .*gone.stl"):
        resolve_mesh("meshes/gone.stl", tmp_path)


def test_the_published_robots_load() -> None:
    folder = shared("robots/ur10e")
    ur10e = Robot.from_urdf((folder / "ur10e.urdf").read_text())
    assert [body.parent for body in collision_bodies(ur10e, meshes_in(folder))] == list(range(7))
    text, folder = published_crx()
    crx = Robot.from_urdf(text)
    assert crx.flange_link == "fanuc_flange"
    assert [body.parent for body in collision_bodies(crx, meshes_in(folder))] == list(range(7))


def test_the_built_in_ur10e_encloses_the_published_meshes_closely() -> None:
    import trimesh

    folder = shared("robots/ur10e")
    published = collision_bodies(Robot.from_urdf((folder / "ur10e.urdf").read_text()), meshes_in(folder))
    # the published link frames are ours, so bodies can be compared on their links
    for ours, theirs in zip(built_in_bodies("ur10e"), published, strict=True):
        assert (ours.name, ours.parent) == (theirs.name, theirs.parent)
        assert isinstance(ours.shape, Mesh)
        assert isinstance(theirs.shape, Mesh)
        mesh = trimesh.Trimesh(apply(theirs.T_parent_body, theirs.shape.vertices), theirs.shape.faces)
        points = np.vstack([mesh.vertices, trimesh.sample.sample_surface(mesh, 2000, seed=0)[0]])
        corners = apply(ours.T_parent_body, ours.shape.vertices)[ours.shape.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        beyond = (points @ normals.T - np.einsum("fi,fi->f", normals, corners[:, 0])).max(axis=1)  # convex, outward
        assert beyond.max() < 1e-4
        assert -beyond.mean() < 1e-3


def test_a_mesh_in_mm_is_told_from_its_size() -> None:
    geometry = '<mesh filename="t.obj" scale="200 200 200"/>'
    with pytest.raises(InvalidInputError, match="link 'upper' has a length or offset of 200 m, but 50 m is the most"):
        collision_bodies(arm(geometry), meshes_among({"t.obj": TETRAHEDRON}))


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        ("<mesh/>", "has no filename"),
        ("<cone/>", "is a <cone>"),
        ('<box size="1 -1 1"/>', "it must be positive"),
        ('<cylinder radius="1" length="99"/>', "a length or offset of 99 m"),
        ('<sphere radius="30"/>', "a length or offset of 60 m"),
    ],
)
def test_geometry_is_checked_without_its_meshes(geometry: str, words: str) -> None:
    check_geometry(arm('<mesh filename="nowhere.stl"/>').tree)
    with pytest.raises(InvalidInputError, match=words):
        check_geometry(arm(geometry).tree)


def test_bodies_have_the_names_that_are_told_beforehand() -> None:
    robot = arm('<sphere radius="1"/>')
    assert body_names(robot.tree) == [body.name for body in collision_bodies(robot, meshes_among({}))]
