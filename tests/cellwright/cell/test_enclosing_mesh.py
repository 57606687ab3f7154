"""Meshes of simple shapes contain them and hardly more."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.containment import closed_mesh, inside_all
from cellwright.cell.enclosing_mesh import enclosing_mesh

N = 4000


def on_skin(shape: Shape, rng: np.random.Generator) -> FloatArray:
    way = rng.normal(size=(N, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    along = np.array([0.0, 0.0, 1.0])
    match shape:
        case Sphere(radius):
            return radius * way
        case Capsule(radius, length):
            return radius * way + np.sign(way[:, 2:]) * along * length / 2
        case Cylinder(radius, length):
            flat = way * [1, 1, 0]
            flat *= radius / np.linalg.norm(flat, axis=1, keepdims=True)
            return flat + rng.uniform(-0.5, 0.5, (N, 1)) * length * along
        case Box(size):
            return rng.uniform(-0.5, 0.5, (N, 3)) * size
    raise AssertionError(shape)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (Box((0.1, 0.2, 0.3)), 0.006),
        (Sphere(0.1), 4 / 3 * math.pi * 1e-3),
        (Cylinder(0.1, 0.3), math.pi * 0.003),
        (Capsule(0.1, 0.3), math.pi * (0.003 + 4 / 3 * 1e-3)),
    ],
)
def test_the_mesh_contains_the_shape_and_is_hardly_larger(shape: Shape, volume: float) -> None:
    mesh = enclosing_mesh(shape)
    closed = closed_mesh(mesh)
    assert closed is not None
    points = on_skin(shape, np.random.default_rng(0)) * (1.0 - 1e-12)
    assert inside_all(points, closed).all()
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert volume * (1 - 1e-9) <= np.einsum("ij,ij->", a, np.cross(b, c)) / 6 <= volume * 1.05


def test_a_mesh_stays_what_it_is() -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32))
    assert enclosing_mesh(mesh) is mesh
