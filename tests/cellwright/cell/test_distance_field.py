from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.distance_field import distance_bounds, distance_table, mesh_field
from cellwright.cell.mesh_topology import is_closed_and_oriented
from cellwright.cell.transforms import pose
from tests.cellwright.cell.cells import bumpy_part

SIZE = (0.30, 0.20, 0.10)


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


def table_of(shape: Shape, *, tabled: bool = True, at=(0.0, 0.0, 0.0), turn=((1, 0, 0), (0, 1, 0), (0, 0, 1))):
    return distance_table([shape], [pose(np.array(at), np.array(turn, float))], [tabled], spacing=0.008, padding=0.05)


def bounds_in(table, points):
    return np.array([distance_bounds(table.real, table.whole, table.lower, table.upper, 0, *p) for p in points])


def bounds_at(shape: Shape, points, **placed):
    return bounds_in(table_of(shape, **placed), points)


@cache
def box_field():
    return table_of(mesh_of(trimesh.creation.box(SIZE)))


def box_distance(points):
    away = np.abs(points) - 0.5 * np.array(SIZE)
    return np.linalg.norm(np.maximum(away, 0), axis=1) + np.minimum(away.max(axis=1), 0)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_bounds_of_a_field_enclose_the_signed_distance_inside_outside_and_beyond_the_grid(seed):
    points = np.random.default_rng(seed).uniform(-0.4, 0.4, (60, 3))
    exact, found = box_distance(points), bounds_in(box_field(), points)
    assert (found[:, 0] <= exact).all() and (found[:, 1] >= exact).all()
    inside_grid = (np.abs(points) < 0.5 * np.array(SIZE) + 0.05).all(axis=1) & (np.abs(exact) > 0.004)
    assert (exact - found[:, 0])[inside_grid].max(initial=0) < 0.016


def test_a_part_with_bumps_is_bounded_as_the_mesh_library_measures_it():
    part = bumpy_part(3)
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (400, 3))
    exact = -trimesh.proximity.signed_distance(trimesh.Trimesh(part.vertices, part.faces), points)
    found = bounds_at(part, points)
    assert (found[:, 0] <= exact + 1e-9).all() and (found[:, 1] >= exact - 1e-9).all()


@pytest.mark.parametrize(
    ("shape", "point", "distance"),
    [
        (Box(SIZE), (0.15, 0.10, 0.08), 0.03),
        (Box(SIZE), (0.0, 0.0, 0.04), -0.01),
        (Sphere(0.1), (0.0, 0.3, 0.4), 0.4),
        (Capsule(0.1, 0.4), (0.0, 0.3, 0.1), 0.2),
        (Capsule(0.1, 0.4), (0.0, 0.0, 0.5), 0.2),
        (Cylinder(0.1, 0.4), (0.13, 0.0, 0.24), 0.05),
        (Cylinder(0.1, 0.4), (0.0, 0.0, 0.19), -0.01),
    ],
)
def test_simple_shapes_are_exact(shape, point, distance):
    assert bounds_at(shape, [point])[0] == pytest.approx([distance, distance], abs=1e-12)


def test_a_body_elsewhere_is_met_where_it_stands():
    # its long axis lies along y
    quarter = ((0, -1, 0), (1, 0, 0), (0, 0, 1))
    found = bounds_at(Box(SIZE), [(1.0, 2.0 + 0.15 + 0.07, 3.0)], at=(1.0, 2.0, 3.0), turn=quarter)
    assert found[0] == pytest.approx([0.07, 0.07])


def test_an_open_shell_is_enclosed_for_safety_but_claims_no_solid():
    solid = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    # a hole smaller than the grid: the flood stays outside
    shell = Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces[1:], np.int32))
    assert not is_closed_and_oriented(shell.faces)
    low, high = bounds_at(shell, [(0.0, 0.0, 0.0)])[0]
    assert low < -0.09
    assert high > 0.09


def test_a_thin_sheet_has_no_inside():
    sheet = Mesh(
        np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.2, np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    )
    found = bounds_at(sheet, [(0.0, 0.0, 0.03), (0.0, 0.0, -0.03)])
    assert (found[:, 0] > 0.02).all() and (found[:, 1] < 0.04).all()


def test_a_mesh_without_field_is_bounded_by_its_box():
    low, high = bounds_at(mesh_of(trimesh.creation.box(SIZE)), [(0.15 + 0.03, 0.1 + 0.04, 0.0)], tabled=False)[0]
    assert low == pytest.approx(0.05, abs=1e-5)
    assert high == 1e300


def test_a_large_mesh_gets_a_coarser_grid_instead_of_a_larger_one():
    field = mesh_field(mesh_of(trimesh.creation.box((3.0, 3.0, 3.0))), spacing=0.008, padding=0.1, most_nodes=20_000)
    assert field.lower.size < 25_000
    assert field.spacing > 0.1


def test_triangles_with_vertices_of_their_own_enclose_a_solid_too():
    solid = trimesh.creation.box(SIZE)
    soup = Mesh(solid.triangles.reshape(-1, 3), np.arange(36, dtype=np.int32).reshape(-1, 3))
    assert mesh_field(soup, spacing=0.01, padding=0.02).closed
