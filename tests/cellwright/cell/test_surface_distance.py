"""Distances to a mesh agree with a brute-force peer, also for needles and points."""

from __future__ import annotations

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.bounding_volumes import build_tree
from cellwright.cell.surface_distance import distances


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60), st.sampled_from([1.0, 1e-3, 0.0]))
def test_distances_are_those_of_the_nearest_of_all_triangles(seed: int, n_faces: int, thickness: float) -> None:
    rng = np.random.default_rng(seed)
    # triangles squeezed towards a line are needles
    corners = rng.uniform(-1, 1, (n_faces, 3, 3))
    corners[:, 2] = corners[:, 0] + 0.5 * (corners[:, 1] - corners[:, 0]) + thickness * corners[:, 2]
    points = rng.uniform(-2, 2, (50, 3))
    tree = build_tree(corners.reshape(-1, 3), np.arange(3 * n_faces).reshape(-1, 3))
    weights = rng.dirichlet(np.ones(3), 300)
    found = distances(tree, points)
    dense = np.einsum("pk,tkc->tpc", weights, corners).reshape(-1, 3)
    sampled = np.linalg.norm(points[:, None] - dense, axis=-1).min(axis=1)
    assert (found <= sampled + 1e-9).all()
    if thickness == 1.0:
        nearest = trimesh.triangles.closest_point(np.repeat(corners, 50, axis=0), np.tile(points, (n_faces, 1)))
        exact = np.linalg.norm(nearest - np.tile(points, (n_faces, 1)), axis=1).reshape(n_faces, 50).min(axis=0)
        np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-12)


def test_points_on_the_mesh_have_no_distance() -> None:
    solid = trimesh.creation.icosphere(subdivisions=2)
    tree = build_tree(np.asarray(solid.vertices), np.asarray(solid.faces))
    on_it = np.concatenate([solid.vertices, solid.triangles_center])
    assert distances(tree, on_it).max() < 1e-12
