from __future__ import annotations

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.bodies import Mesh
from cellwright.cell.containment import closed_mesh, component_points


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_points_are_inside_a_torus_where_its_equation_says(seed: int) -> None:
    generator = np.random.default_rng(seed)
    torus = trimesh.creation.torus(0.5, 0.2, major_sections=48, minor_sections=24)
    turn = trimesh.transformations.random_rotation_matrix(generator.uniform(size=3))
    torus.apply_transform(turn)
    closed = closed_mesh(mesh_of(torus))
    assert closed is not None
    points = generator.uniform(-0.8, 0.8, (200, 3))
    x, y, z = (points @ turn[:3, :3]).T
    depth = 0.2 - np.hypot(np.hypot(x, y) - 0.5, z)
    clear = np.abs(depth) > 0.01  # farther from the surface than the facets are from the torus
    found = np.array([closed.contains(point) for point in points])
    assert (found == (depth > 0))[clear].all()


def test_rays_through_vertices_and_edges_are_counted_once() -> None:
    box = closed_mesh(mesh_of(trimesh.creation.box(extents=(2, 2, 2))))
    sphere = closed_mesh(mesh_of(trimesh.creation.icosphere(subdivisions=2)))
    assert box is not None
    assert sphere is not None
    grid = np.linspace(-0.5, 0.5, 5)  # above vertices, edges and the faces' diagonals
    for x in grid:
        for y in grid:
            for z in (-1.5, -0.5, 0.0, 0.5, 1.5):
                point = np.array([x, y, z])
                assert box.contains(point) == (abs(z) < 1)
                if abs(np.linalg.norm(point) - 1) > 0.05:
                    assert sphere.contains(point) == (np.linalg.norm(point) < 1)


def test_a_cavity_is_outside() -> None:
    outer, inner = trimesh.creation.box(extents=(2, 2, 2)), trimesh.creation.box(extents=(1, 1, 1))
    closed = closed_mesh(mesh_of(trimesh.util.concatenate([outer, inner])))
    assert closed is not None
    assert not closed.contains(np.zeros(3))
    assert closed.contains(np.array([0.75, 0.1, 0.2]))


def test_an_open_mesh_has_no_inside() -> None:
    box = trimesh.creation.box()
    assert closed_mesh(Mesh(np.asarray(box.vertices), np.asarray(box.faces[1:], np.int32))) is None
    assert closed_mesh(Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32))) is None


def test_unwelded_corners_do_not_open_a_mesh() -> None:
    box = trimesh.creation.box()
    soup = Mesh(np.asarray(box.triangles).reshape(-1, 3), np.arange(36, dtype=np.int32).reshape(-1, 3))
    assert closed_mesh(soup) is not None


def test_every_piece_has_its_point() -> None:
    pieces = [trimesh.creation.box().apply_translation((3.0 * k, 0, 0)) for k in range(4)]
    points = component_points(mesh_of(trimesh.util.concatenate(pieces)))
    assert sorted((points[:, 0] / 3).round().tolist()) == [0, 1, 2, 3]
