from __future__ import annotations

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.convex_gap import convex_gap, hull_of, hull_table
from cellwright.cell.transforms import pose

ENGINE_ERROR = 3e-6


def random_shape(rng: np.random.Generator) -> Shape:
    size = rng.uniform(0.02, 0.4, 3)
    kind = rng.integers(5)
    if kind == 4:
        points = rng.normal(size=(30, 3)) * 0.1
        hull = ConvexHull(points[ConvexHull(points).vertices])
        a, b, c = (hull.points[hull.simplices[:, k]] for k in range(3))
        faces = hull.simplices.copy()
        inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
        faces[inward] = faces[inward, ::-1]
        return Mesh(hull.points, faces.astype(np.int32))
    return (Box(tuple(size)), Sphere(size[0]), Capsule(size[0], size[1]), Cylinder(size[0], size[1]))[kind]


def geometry(shape: Shape):
    match shape:
        case Box(size):
            return coal.Box(*size)
        case Sphere(radius):
            return coal.Sphere(radius)
        case Capsule(radius, length):
            return coal.Capsule(radius, length)
        case Cylinder(radius, length):
            return coal.Cylinder(radius, length)
        case Mesh(vertices, faces):
            points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
            points.extend(list(vertices))
            triangles.extend([coal.Triangle(*row) for row in faces.tolist()])
            return coal.Convex(points, triangles)


def gap(a: Shape, b: Shape, T: np.ndarray, wanted: float = 1e9, clearance: float = -1e9, direction=(0.3, -0.5, 0.8)):
    table = hull_table([hull_of(a, np.eye(4)), hull_of(b, np.eye(4))])
    return convex_gap(*table, 0, 1, T, wanted, clearance, np.array([*direction, 0, 0], float), np.empty((7, 4)))


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_bounds_enclose_the_distance_that_the_engine_finds(seed):
    rng = np.random.default_rng(seed)
    a, b = random_shape(rng), random_shape(rng)
    T = pose(rng.normal(size=3) * 0.3, Rotation.random(rng=rng).as_matrix())
    found = coal.distance(
        geometry(a),
        coal.Transform3s(),
        geometry(b),
        coal.Transform3s(T[:3, :3], T[:3, 3]),
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )
    least, most = gap(a, b, T)
    if found > 0:
        assert found - 1e-4 <= least <= found + ENGINE_ERROR
        assert found - ENGINE_ERROR <= most <= found + 1e-4
    else:
        assert least <= ENGINE_ERROR
        assert most <= ENGINE_ERROR


def test_two_boxes_face_to_face():
    least, most = gap(Box((0.2, 0.2, 0.2)), Box((0.4, 0.1, 0.1)), pose(np.array([0.5, 0.02, 0.0]), np.eye(3)))
    assert least == pytest.approx(0.2, abs=1e-9)
    assert most == pytest.approx(0.2, abs=1e-7)


def test_the_search_stops_when_a_bound_decides():
    T = pose(np.array([0.5, 0.02, 0.0]), np.eye(3))
    least, most = gap(Box((0.2, 0.2, 0.2)), Sphere(0.1), T, wanted=0.1, direction=(-1, 0, 0))
    assert least >= 0.1 and most == 1e300, "one support is enough from the right direction"
    least, most = gap(Box((0.2, 0.2, 0.2)), Sphere(0.1), pose(np.zeros(3), np.eye(3)), clearance=0.0)
    assert most < 0.0


def test_a_notched_mesh_does_not_fill_its_hull():
    import trimesh

    solid = trimesh.creation.box(extents=(0.2, 0.2, 0.2))
    notched = trimesh.creation.annulus(r_min=0.05, r_max=0.1, height=0.1)
    whole = hull_of(Mesh(np.asarray(solid.vertices), np.asarray(solid.faces, np.int32)), np.eye(4))
    part = hull_of(Mesh(np.asarray(notched.vertices), np.asarray(notched.faces, np.int32)), np.eye(4))
    open_box = hull_of(Mesh(np.asarray(solid.vertices), np.asarray(solid.faces[:-1], np.int32)), np.eye(4))
    assert whole.solid and not part.solid and not open_box.solid
    assert len(whole.points) == 8


def test_the_same_mesh_with_a_vertex_for_each_corner_is_solid_too():
    import trimesh

    solid = trimesh.creation.box(extents=(0.2, 0.2, 0.2))
    soup = Mesh(solid.triangles.reshape(-1, 3), np.arange(36, dtype=np.int32).reshape(-1, 3))
    assert hull_of(soup, np.eye(4)).solid
