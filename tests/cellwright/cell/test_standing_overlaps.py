"""Overlaps of standing bodies: found by how deep they are, closed meshes or shells, and silent where bodies rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import BASE, WORLD, Body, Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.containment import closed_mesh, inside_all
from cellwright.cell.standing_overlaps import Overlap, standing_overlaps, standing_pairs, triangle_penetration
from cellwright.cell.transforms import pose, rotation_from_rpy
from tests.cellwright.cell.cells import at, bumpy_part, scanning_cell

TABLE = Box((0.3, 0.3, 0.2))
FAR = 3.0
"""Metres from the robot, where only the two bodies of a test stand."""


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


def without(solid: trimesh.Trimesh, direction: float) -> Mesh:
    """The mesh without its faces that look up (+1) or down (-1)."""
    opened = solid.copy()
    opened.update_faces(direction * opened.face_normals[:, 2] < 0.9)
    assert not opened.is_watertight
    return mesh_of(opened)


CAN = trimesh.creation.cylinder(radius=0.06, height=0.2)
PLATE = trimesh.creation.box((0.3, 0.3, 0.2))


def overlaps(one: Shape, T_one: FloatArray, other: Shape, T_other: FloatArray) -> list[Overlap]:
    cell = scanning_cell()
    bodies = (
        *cell.bodies,
        Body("one", one, WORLD, at(FAR, 0, 0) @ T_one),
        Body("other", other, WORLD, at(FAR, 0, 0) @ T_other),
    )
    found, engine = standing_overlaps(replace(cell, bodies=bodies))
    assert "FCL" in engine
    return [overlap for overlap in found if {overlap.body, overlap.other} == {"one", "other"}]


@pytest.mark.parametrize(
    "part", [mesh_of(CAN), without(CAN, -1), Cylinder(0.06, 0.2), Box((0.1, 0.1, 0.2)), Capsule(0.05, 0.1)]
)
@pytest.mark.parametrize("table", [TABLE, mesh_of(PLATE), without(PLATE, -1)])
def test_a_part_sunk_into_a_table_is_found_by_how_deep_and_a_resting_one_is_not(part: Shape, table: Shape) -> None:
    for sunk in (0.0, 0.0005, 0.0009):
        assert overlaps(table, at(0, 0, 0), part, at(0, 0, 0.2 - sunk)) == []
    for sunk in (0.0015, 0.004, 0.02):
        (found,) = overlaps(table, at(0, 0, 0), part, at(0, 0, 0.2 - sunk))
        assert found.depth <= sunk + 1e-9
        if not (isinstance(part, Capsule) and isinstance(table, Mesh) and sunk > 0.01):
            assert found.depth == pytest.approx(sunk, rel=0.05)


def test_bodies_apart_do_not_overlap() -> None:
    assert overlaps(TABLE, at(0, 0, 0), mesh_of(CAN), at(0, 0, 0.21)) == []
    assert overlaps(TABLE, at(0, 0, 0), mesh_of(CAN), at(0.4, 0, 0)) == []


def test_a_body_inside_a_mesh_overlaps_it_and_inside_a_shell_does_not() -> None:
    (found,) = overlaps(bumpy_part(), at(0, 0, 0), Sphere(0.02), at(0, 0, 0))
    assert 0.09 < found.depth < 0.12
    assert overlaps(without(PLATE, -1), at(0, 0, 0), Sphere(0.02), at(0, 0, 0)) == []


def test_thin_sheets_that_cross_are_found() -> None:
    flat, upright = trimesh.creation.box((0.3, 0.3, 0.0015)), trimesh.creation.box((0.0015, 0.1, 0.1))
    (found,) = overlaps(mesh_of(flat), at(0, 0, 0), mesh_of(upright), at(0, 0, 0.02))
    assert 0.005 < found.depth <= 0.0308  # lifting the upright one frees it


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_moving_a_box_by_less_than_the_depth_never_frees_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size, turn = rng.uniform(0.05, 0.3, 3), rotation_from_rpy(*rng.uniform(-3, 3, 3))
    T = pose(rng.uniform(-0.1, 0.1, 3), turn)
    found = overlaps(TABLE, np.eye(4), Box(tuple(size.tolist())), T)
    if not found:
        return
    for direction in rng.normal(size=(20, 3)):
        away = at(*(0.95 * found[0].depth * direction / np.linalg.norm(direction)))
        moved = trimesh.collision.CollisionManager()
        moved.add_object("table", trimesh.creation.box(TABLE.size))
        moved.add_object("box", trimesh.creation.box(size, away @ T))
        assert moved.in_collision_internal()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_crossing_triangles_come_apart_by_their_penetration_and_by_nothing_shorter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = rng.normal(size=(2, 3, 3))
    depth = float(triangle_penetration(one[None], other[None])[0])
    manager = trimesh.collision.CollisionManager()
    manager.add_object("one", trimesh.Trimesh(one, [[0, 1, 2]]))
    manager.add_object("other", trimesh.Trimesh(other, [[0, 1, 2]]))
    assert manager.in_collision_internal() == (depth > 0.0)
    if depth < 1e-3:
        return
    freed = False
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    shorter = triangle_penetration(one + 0.999 * depth * directions[:, None], np.broadcast_to(other, (2000, 3, 3)))
    assert (shorter > 0.0).all()
    edges, others = np.roll(one, -1, axis=0) - one, np.roll(other, -1, axis=0) - other
    axes = [
        np.cross(edges[0], edges[1]),
        np.cross(others[0], others[1]),
        *(np.cross(e, f) for e in edges for f in others),
    ]
    for axis in axes:
        for sign in (1.0, -1.0):
            away = sign * 1.001 * depth * axis / np.linalg.norm(axis)
            freed |= bool(triangle_penetration((one + away)[None], other[None])[0] == 0.0)
    assert freed


def test_pairs_are_those_of_the_world_and_of_base_and_world() -> None:
    cell = scanning_cell()
    rows = {row: body.parent for row, body in enumerate(cell.bodies)}
    pairs = {tuple(pair) for pair in standing_pairs(cell).tolist()}
    assert pairs == {
        (a, b)
        for a in rows
        for b in rows
        if a < b and rows[a] <= BASE and rows[b] <= BASE and WORLD in (rows[a], rows[b])
    }
    assert standing_pairs(cell, [(10, 9)]).tolist() == [list(pair) for pair in sorted(pairs - {(9, 10)})]


def test_the_base_in_a_plinth_overlaps_and_on_a_plinth_does_not() -> None:
    for sunk, count in ((0.0, 0), (0.05, 1)):
        cell = scanning_cell()
        lowest = cell.bodies[0].T_parent_body
        foot = cell.bodies[0].shape
        assert isinstance(foot, Mesh)
        bottom = float((foot.vertices @ lowest[:3, :3].T + lowest[:3, 3])[:, 2].min())
        plinth = Body("plinth", Box((0.3, 0.3, 0.5)), WORLD, at(0, 0, bottom - 0.25 + sunk))
        cell = replace(cell, bodies=(*cell.bodies[:7], plinth), T_world_base=np.eye(4))
        found, _ = standing_overlaps(cell)
        assert len(found) == count
        if found:
            assert (found[0].body, found[0].other) == ("plinth", "base_link_inertia")
            assert found[0].depth == pytest.approx(sunk, rel=0.05)


def test_many_points_are_inside_as_each_of_them_is() -> None:
    closed = closed_mesh(bumpy_part())
    assert closed is not None
    points = np.random.default_rng(0).uniform(-0.15, 0.15, (500, 3))
    assert inside_all(points, closed).tolist() == [closed.contains(point) for point in points]
