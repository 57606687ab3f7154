"""How a part stands: supports, where its centre of mass lies, how far it sticks out; against planes and polygons."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import BASE, WORLD, Body, Box, Cylinder, Mesh, Shape
from cellwright.cell.part_standing import (
    PartStanding,
    contact_points,
    convex_hull,
    inside_by,
    mass_centre,
    part_standing,
)
from cellwright.cell.transforms import pose, rotation_from_rpy
from tests.cellwright.cell.cells import at, scanning_cell

FAR = 3.0
"""Metres from the robot, where only the bodies of a test stand."""
TABLE = Box((0.3, 0.3, 0.2))


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


def box_mesh(*size: float) -> Mesh:
    return mesh_of(trimesh.creation.box(size))


def standing(part: Shape, T_part: FloatArray, *others: tuple[str, Shape, FloatArray]) -> PartStanding:
    cell = scanning_cell()
    arm = tuple(body for body in cell.bodies if body.parent > BASE)
    bodies = [Body(name, shape, WORLD, at(FAR, 0, 0) @ T) for name, shape, T in others]
    part_body = Body("part", part, WORLD, at(FAR, 0, 0) @ T_part)
    return part_standing(replace(cell, bodies=(*arm, *bodies, part_body), ignored_pairs=np.empty((0, 2), np.int32)))


@pytest.mark.parametrize("table", [TABLE, mesh_of(trimesh.creation.box((0.3, 0.3, 0.2)).subdivide())])
@pytest.mark.parametrize("turned", [0.0, 0.4])
def test_a_part_in_the_middle_of_its_table_stands_inside_by_half_its_foot(table: Shape, turned: float) -> None:
    T = at(0.02, 0.01, 0.15) @ pose(np.zeros(3), rotation_from_rpy(0.0, 0.0, turned))
    found = standing(box_mesh(0.1, 0.06, 0.1), T, ("table", table, at(0, 0, 0)))
    assert (found.supports, found.others, found.nearest) == (("table",), (), "")
    assert found.margin == pytest.approx(0.03)
    assert found.overhang == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("table", [TABLE, mesh_of(trimesh.creation.box((0.3, 0.3, 0.2)).subdivide())])
@pytest.mark.parametrize(("x", "margin", "overhang"), [(0.13, 0.02, 0.03), (0.17, -0.02, 0.07)])
def test_a_part_over_the_edge_is_measured_from_the_edge(table: Shape, x: float, margin: float, overhang: float) -> None:
    found = standing(box_mesh(0.1, 0.1, 0.1), at(x, 0, 0.15), ("table", table, at(0, 0, 0)))
    assert found.supports == ("table",)
    assert found.margin == pytest.approx(margin)
    assert found.overhang == pytest.approx(overhang)


def test_a_part_on_a_small_pedestal_sticks_out_and_stands() -> None:
    plate = box_mesh(0.4, 0.4, 0.02)
    found = standing(plate, at(0, 0, 0.11), ("table", Box((0.2, 0.2, 0.2)), at(0, 0, 0)))
    assert found.margin == pytest.approx(0.1)
    assert found.overhang == pytest.approx(0.1 * math.sqrt(2))  # its corners
    round_table = standing(plate, at(0, 0, 0.11), ("table", Cylinder(0.1, 0.2), at(0, 0, 0)))
    assert round_table.margin == pytest.approx(0.1, rel=1e-3)


def test_a_part_across_two_supports_stands_between_them() -> None:
    beam, leg = box_mesh(0.5, 0.04, 0.04), Box((0.05, 0.1, 0.2))
    found = standing(beam, at(0, 0, 0.12), ("left", leg, at(-0.2, 0, 0)), ("right", leg, at(0.2, 0, 0)))
    assert found.supports == ("left", "right")
    assert found.margin == pytest.approx(0.02)
    assert found.overhang == pytest.approx(0.025)
    alone = standing(beam, at(0, 0, 0.12), ("left", leg, at(-0.2, 0, 0)))
    assert alone.margin == pytest.approx(-0.175)


def test_what_presses_from_above_or_the_side_holds_but_does_not_carry() -> None:
    part = box_mesh(0.1, 0.1, 0.1)
    clamp = ("clamp", Box((0.05, 0.05, 0.05)), at(0.16, 0, 0.225))
    found = standing(part, at(0.17, 0, 0.15), ("table", TABLE, at(0, 0, 0)), clamp)
    assert (found.supports, found.others) == (("table",), ("clamp",))
    side = ("stop", Box((0.05, 0.05, 0.05)), at(0.245, 0, 0.15))
    assert standing(part, at(0.17, 0, 0.15), ("table", TABLE, at(0, 0, 0)), side).others == ("stop",)


def test_a_part_in_the_air_is_told_with_the_nearest_body_and_its_distance() -> None:
    shelf = ("shelf", Box((0.1, 0.1, 0.01)), at(0, 0, 0.4))
    found = standing(box_mesh(0.1, 0.1, 0.1), at(0, 0, 0.162), ("table", TABLE, at(0, 0, 0)), shelf)
    assert (found.supports, found.others, found.nearest) == ((), (), "table")
    assert found.gap == pytest.approx(0.012)
    assert math.isnan(found.margin)
    nothing = standing(box_mesh(0.1, 0.1, 0.1), at(0, 0, 0.162))
    assert (nothing.nearest, math.isnan(nothing.gap)) == ("", True)


def test_a_sunk_part_is_neither_in_the_air_nor_said_to_tip() -> None:
    found = standing(box_mesh(0.1, 0.1, 0.1), at(0.2, 0, 0.13), ("table", TABLE, at(0, 0, 0)))
    assert (found.supports, found.others, found.nearest) == ((), ("table",), "")


def test_an_open_shell_stands_by_the_centre_of_its_area() -> None:
    solid = trimesh.creation.box((0.1, 0.1, 0.1))
    solid.update_faces(solid.face_normals[:, 0] < 0.9)  # without one side the centre moves away from it
    found = standing(mesh_of(solid), at(0, 0, 0.15), ("table", TABLE, at(0, 0, 0)))
    assert found.margin == pytest.approx(0.04)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_the_centre_of_mass_is_that_of_a_peer_however_the_mesh_is_turned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hull = trimesh.convex.convex_hull(rng.normal(size=(12, 3)) + rng.normal(size=3))
    corners = np.asarray(hull.triangles, float)
    for order in ((0, 1, 2), (0, 2, 1)):
        assert mass_centre(corners[:, order], closed=True) == pytest.approx(hull.center_mass, abs=1e-9)
    assert mass_centre(corners, closed=False) == pytest.approx(hull.centroid, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 30))
def test_a_hull_holds_its_points_and_its_corners_are_among_them(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.round(rng.normal(size=(n, 2)), 1)  # coarse: doubles and points on lines
    hull = convex_hull(points)
    assert {tuple(corner) for corner in hull.tolist()} <= {tuple(point) for point in points.tolist()}
    assert all(inside_by(point, hull) >= -1e-12 for point in points)
    outside = hull.mean(axis=0) + 1e3 * np.array([math.cos(seed), math.sin(seed)])
    assert inside_by(outside, hull) < -900


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_the_contact_of_two_triangles_is_their_common_region(seed: int) -> None:
    """The oracle: no point of a dense sample of both triangles lies outside of the hull of the corners."""
    rng = np.random.default_rng(seed)
    one, other = np.zeros((2, 1, 3, 3))
    one[0, :, :2], other[0, :, :2] = rng.uniform(-1, 1, (2, 3, 2))
    shares = rng.dirichlet((1, 1, 1), 4000)
    both = shares @ one[0, :, :2]
    a, b, c = other[0, :, :2]
    inverse = np.linalg.inv(np.column_stack([b - a, c - a]))
    st_ = (both - a) @ inverse.T
    common = both[(st_ >= 0).all(axis=1) & (st_.sum(axis=1) <= 1)]
    found = contact_points(one, other, 1e-3)
    if not len(common):
        return
    hull = convex_hull(found[:, :2])
    assert min(inside_by(point, hull) for point in common) >= -1e-9
    assert contact_points(one, other + np.array([0, 0, 2e-3]), 1e-3).shape == (0, 3)
