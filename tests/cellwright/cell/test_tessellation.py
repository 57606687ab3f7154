"""Bodies as triangles: closed, outward, inscribed, and as large as the solids they stand for."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.tessellation import triangles_of

SOLIDS: list[tuple[Shape, float, tuple[float, float, float]]] = [
    (Box((0.1, 0.2, 0.3)), 0.006, (0.05, 0.1, 0.15)),
    (Cylinder(0.1, 0.4), math.pi * 0.1**2 * 0.4, (0.1, 0.1, 0.2)),
    (Sphere(0.2), 4 / 3 * math.pi * 0.2**3, (0.2, 0.2, 0.2)),
    (Capsule(0.1, 0.4), math.pi * 0.1**2 * 0.4 + 4 / 3 * math.pi * 0.1**3, (0.1, 0.1, 0.3)),
]


def solid_of(shape: Shape, sections: int = 24) -> trimesh.Trimesh:
    return trimesh.Trimesh(*triangles_of(shape, sections), process=False)


@pytest.mark.parametrize(("shape", "volume", "half"), SOLIDS, ids=lambda value: type(value).__name__)
def test_a_shape_has_its_volume_and_is_centred_on_its_frame(
    shape: Shape, volume: float, half: tuple[float, float, float]
) -> None:
    solid = solid_of(shape, 96)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(volume, rel=3e-3)
    assert solid.volume <= volume * (1 + 1e-12), "inscribed, and turned outward"
    np.testing.assert_allclose(solid.bounds, [np.negative(half), half], atol=1e-3)
    np.testing.assert_allclose(solid.center_mass, 0, atol=1e-6)


@pytest.mark.parametrize(("shape", "volume", "half"), SOLIDS[1:], ids=lambda value: type(value).__name__)
def test_more_sections_come_closer(shape: Shape, volume: float, half: tuple[float, float, float]) -> None:
    coarse, fine = (volume - solid_of(shape, sections).volume for sections in (12, 48))
    assert 0 < fine < coarse / 8


def test_a_mesh_stays_as_it_is() -> None:
    vertices, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]], np.int32)
    found, triangles = triangles_of(Mesh(vertices, faces))
    np.testing.assert_array_equal(found, vertices)
    np.testing.assert_array_equal(triangles, faces)
