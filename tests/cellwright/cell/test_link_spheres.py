from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Sphere
from cellwright.cell.link_spheres import cover_shape
from cellwright.cell.tessellation import triangles_of
from tests.cellwright.cell.cells import bumpy_part

SHAPES = {
    "box": Box((0.185, 0.16, 0.18)),
    "flat box": Box((0.3, 0.2, 0.01)),
    "cylinder": Cylinder(0.06, 0.12),
    "capsule": Capsule(0.06, 0.5),
    "sphere": Sphere(0.1),
    "part with bumps": bumpy_part(3),
}


def solid_of(shape) -> trimesh.Trimesh:
    vertices, faces = triangles_of(shape, sections=64)
    return trimesh.Trimesh(vertices, faces)


def in_any_ball(cover, points):
    away = np.linalg.norm(points[:, None] - cover.centres, axis=2)
    return (away <= cover.radii + 1e-12).any(axis=1)


@pytest.mark.parametrize("name", SHAPES)
def test_the_balls_contain_the_body_inside_and_on_its_surface(name):
    solid = solid_of(SHAPES[name])
    cover = cover_shape(SHAPES[name], 0.012)
    surface, _ = trimesh.sample.sample_surface(solid, 4000, seed=0)
    # all these bodies are stars about their origin
    inside = surface * np.random.default_rng(0).uniform(0, 1, (len(surface), 1)) ** (1 / 3)
    assert in_any_ball(cover, np.asarray(solid.vertices)).all()
    assert in_any_ball(cover, np.asarray(surface)).all()
    assert in_any_ball(cover, np.asarray(inside)).all()


@pytest.mark.parametrize("name", SHAPES)
def test_no_ball_sticks_out_further_than_asked(name):
    solid = solid_of(SHAPES[name])
    cover = cover_shape(SHAPES[name], 0.012)
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(40, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    skin = (cover.centres[:, None] + cover.radii[:, None, None] * direction).reshape(-1, 3)
    out = -trimesh.proximity.signed_distance(solid, skin[rng.permutation(len(skin))[:3000]])
    assert out.max() < 0.012 + 2 * 0.004 + 1e-3


@pytest.mark.parametrize("name", SHAPES)
def test_cores_lie_within_the_body(name):
    solid = solid_of(SHAPES[name])
    cover = cover_shape(SHAPES[name], 0.012)
    depth = trimesh.proximity.signed_distance(solid, cover.centres)
    # the drawn body is a polyhedron inscribed into round shapes
    assert (cover.cores <= depth + 1e-3).all()


def test_a_shell_is_covered_without_cores():
    solid = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    shell = Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces[20:], np.int32))
    cover = cover_shape(shell, 0.012)
    surface = np.asarray(trimesh.Trimesh(shell.vertices, shell.faces).triangles_center)
    assert in_any_ball(cover, surface).all()
    assert cover.cores.max() <= 0.0


def test_a_tighter_cover_takes_more_balls():
    counts = [len(cover_shape(SHAPES["box"], overshoot).radii) for overshoot in (0.02, 0.012)]
    assert counts[0] < counts[1] < 600


def test_the_same_body_gets_the_same_balls():
    a, b = cover_shape(SHAPES["part with bumps"], 0.015), cover_shape(SHAPES["part with bumps"], 0.015)
    assert np.array_equal(a.centres, b.centres) and np.array_equal(a.radii, b.radii)
