"""What a mesh encloses: closed, cracked, overlapping, hollow, open and flat ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import trimesh

from cellwright.cell.bodies import Mesh
from cellwright.cell.parametric_parts import plate_with_pocket
from cellwright.cell.solid_grid import enclosed_volume, is_one_closed_shell, solid_grid


def mesh_of(solid: Any) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


BALL = trimesh.creation.icosphere(subdivisions=4, radius=0.1)


def test_one_closed_shell_has_its_exact_volume() -> None:
    found = enclosed_volume(plate_with_pocket())
    assert found.kind == "enclosed"
    assert found.volume == pytest.approx(0.12 * 0.08 * 0.02 - 0.06 * 0.04 * 0.012, rel=1e-9)
    assert is_one_closed_shell(plate_with_pocket())


def test_overlapping_shells_count_once_and_cavities_count_as_enclosed() -> None:
    other = BALL.copy().apply_translation([0.1, 0, 0])
    lens = 5 / 12 * math.pi * 0.1**3  # two balls of one radius whose middles are a radius apart
    both = enclosed_volume(mesh_of(trimesh.util.concatenate([BALL, other])))
    assert both.volume == pytest.approx(8 / 3 * math.pi * 0.1**3 - lens, rel=0.015)
    hollow = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    hollow.invert()
    found = enclosed_volume(mesh_of(trimesh.util.concatenate([BALL, hollow])))
    assert found.kind == "enclosed"
    assert found.volume == pytest.approx(4 / 3 * math.pi * 0.1**3, rel=0.015)


def test_a_crack_or_a_turned_face_lets_nothing_out() -> None:
    faces = np.asarray(BALL.faces, np.int32)
    cracked = Mesh(np.asarray(BALL.vertices), faces[1:])
    turned = Mesh(np.asarray(BALL.vertices), np.concatenate([faces[:9, ::-1], faces[9:]]))
    for mesh in (cracked, turned):
        found = enclosed_volume(mesh)
        assert found.kind == "enclosed"
        assert found.volume == pytest.approx(4 / 3 * math.pi * 0.1**3, rel=0.015)
        assert not is_one_closed_shell(mesh)


def test_an_open_sheet_encloses_nothing_and_is_measured_by_its_convex_hull() -> None:
    half = Mesh(np.asarray(BALL.vertices), np.asarray(BALL.faces, np.int32)[BALL.triangles_center[:, 2] > 0])
    found = enclosed_volume(half)
    assert found.kind == "convex"
    assert found.volume == pytest.approx(2 / 3 * math.pi * 0.1**3, rel=0.05)
    assert not len(solid_grid(half).core())
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]], np.int32))
    assert enclosed_volume(flat).volume == pytest.approx(1e-3)
    assert not len(solid_grid(flat).core())


def test_nodes_that_are_outside_or_core_are_right_about_it() -> None:
    grid = solid_grid(mesh_of(BALL), 20_000)
    assert np.linalg.norm(grid.core(), axis=1).max() < 0.1
    assert len(grid.core()) > 1000
    nodes = grid.origin + grid.spacing * np.argwhere(grid.outside)
    assert np.linalg.norm(nodes, axis=1).min() > 0.099
    clearance = grid.clearance[grid.outside]
    # the nearest node that is not outside is at most a cell's diagonal and a half outside the ball
    assert (np.abs(clearance - (np.linalg.norm(nodes, axis=1) - 0.1)) < 2.6 * grid.spacing).all()


def test_a_plate_thinner_than_the_grid_has_its_exact_volume() -> None:
    sheet = trimesh.creation.box(extents=(1.0, 1.0, 1e-4))
    assert enclosed_volume(mesh_of(sheet)).volume == pytest.approx(1e-4, rel=1e-9)
