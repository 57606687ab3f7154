from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from cellwright.arrays import BoolArray, FloatArray, IntArray
from cellwright.cell.bodies import Mesh
from cellwright.cell.occlusion import Occluder
from cellwright.errors import InvalidInputError


def mesh_of(solid: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


def fan() -> trimesh.Trimesh:
    """A double cone of 720 slivers that meet in two vertices."""
    return trimesh.creation.revolve(np.array([[0.0, -0.05], [0.1, 0.0], [0.0, 0.05]]), sections=720)


def needle() -> trimesh.Trimesh:
    """A prism 10 m long and 1 mm thin: triangles of aspect 1 to 10,000."""
    return trimesh.creation.cylinder(radius=0.0005, height=10.0, sections=24)


CONVEX = {
    "cube": trimesh.creation.box(extents=(0.3, 0.3, 0.3)),
    "sphere": trimesh.creation.icosphere(subdivisions=3, radius=0.1),
    "fan": fan(),
    "needle": needle(),
}


def turned(solid: trimesh.Trimesh, rng: np.random.Generator) -> trimesh.Trimesh:
    moved = solid.copy()
    T = trimesh.transformations.random_rotation_matrix(rng.random(3))
    T[:3, 3] = rng.normal(size=3)
    moved.apply_transform(T)
    return moved


def segments_through_edges(solid: trimesh.Trimesh, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Segments from outside a convex solid to inside, aimed exactly (but for rounding) at edges and vertices."""
    edge = solid.vertices[solid.edges_unique[rng.integers(len(solid.edges_unique), size=n)]]
    share = rng.choice([0.0, 0.25, 0.5, 1.0, np.nan], size=n)
    share = np.where(np.isnan(share), rng.random(n), share)[:, None]
    aim = edge[:, 0] + share * (edge[:, 1] - edge[:, 0])
    weights = rng.dirichlet(np.ones(4), size=n)
    within = solid.vertices[rng.integers(len(solid.vertices), size=(n, 4))]
    inside = 0.5 * solid.center_mass + 0.5 * np.einsum("nk,nki->ni", weights, within)
    return aim + rng.uniform(0.1, 3.0, (n, 1)) * (aim - inside), inside


@pytest.mark.parametrize("name", CONVEX)
@pytest.mark.parametrize("is_turned", [False, True])
def test_no_segment_into_a_closed_solid_slips_through_an_edge_or_a_vertex(name: str, is_turned: bool) -> None:
    rng = np.random.default_rng(7)
    solid = turned(CONVEX[name], rng) if is_turned else CONVEX[name]
    outside, inside = segments_through_edges(solid, 40_000, rng)
    occluder = Occluder(mesh_of(solid))
    assert occluder.blocked(outside, inside).all()
    assert occluder.blocked(inside, outside).all()
    assert np.isfinite(occluder.first_hit(inside, outside - inside)[0]).all()


def test_the_aimed_segments_are_hard_and_slip_through_an_ordinary_intersection_test() -> None:
    rng = np.random.default_rng(7)
    solid = turned(CONVEX["fan"], rng)
    outside, inside = segments_through_edges(solid, 300, rng)
    assert not meets_any(outside, inside, solid.triangles).all()


def meets_any(start: FloatArray, end: FloatArray, triangles: FloatArray) -> BoolArray:
    """Brute force after Moeller and Trumbore 1997, in double precision, (segments,)."""
    along = (end - start)[:, None]
    a, b, c = triangles[None, :, 0], triangles[None, :, 1], triangles[None, :, 2]
    p = np.cross(along, c - a)
    det = ((b - a) * p).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = ((start[:, None] - a) * p).sum(-1) / det
        q = np.cross(start[:, None] - a, b - a)
        v = (along * q).sum(-1) / det
        t = ((c - a) * q).sum(-1) / det
        return np.asarray(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)).any(axis=1))


def orientations(a: IntArray, b: IntArray, c: IntArray, d: IntArray) -> IntArray:
    """Exact signs of the volume of the tetrahedra abcd on integers."""
    return np.sign((np.cross(b - a, c - a) * (d - a)).sum(-1))


@given(seed=st.integers(0, 10_000), reach=st.sampled_from([3, 6, 20]))
@settings(max_examples=60, deadline=None)
def test_blocked_agrees_with_exact_integer_geometry(seed: int, reach: int) -> None:
    rng = np.random.default_rng(seed)
    hull = ConvexHull(rng.integers(-reach, reach + 1, (12, 3)), qhull_options="QJ")
    points = np.rint(hull.points).astype(np.int64)
    triangles = points[hull.simplices]
    triangles = triangles[np.abs(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])).any(1)]
    start, end = rng.integers(-2 * reach, 2 * reach + 1, (2, 400, 1, 3))
    a, b, c = triangles[None, :, 0], triangles[None, :, 1], triangles[None, :, 2]
    side_start, side_end = orientations(a, b, c, start), orientations(a, b, c, end)
    edges = np.stack([orientations(start, end, *pair) for pair in ((a, b), (b, c), (c, a))])
    strict = (side_start * side_end < 0) & (np.abs(edges.sum(axis=0)) == 3)
    clear = (side_start * side_end > 0) | ((edges > 0).any(axis=0) & (edges < 0).any(axis=0))
    found = Occluder(Mesh(points.astype(float), hull.simplices)).blocked(start[:, 0].astype(float), end[:, 0])
    assert found[strict.any(axis=1)].all()
    assert not found[clear.all(axis=1)].any()


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_lattice_segments_into_a_lattice_solid_never_leak(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = trimesh.convex.convex_hull(rng.integers(-4, 5, (10, 3)).astype(float))
    assume(solid.is_watertight and solid.volume > 1.0)
    centre = np.einsum("fij->j", solid.triangles) / (3 * len(solid.faces))
    lattice = np.rint(centre)
    depth = np.einsum("fj,fj->f", solid.triangles[:, 0] - lattice, solid.face_normals)
    assume(depth.min() > 1e-9)
    outside = rng.integers(-9, 10, (500, 3)).astype(float)
    outside = outside[np.abs(outside).max(axis=1) > 4]
    assert Occluder(mesh_of(solid)).blocked(outside, lattice[None]).all()


def test_blocked_and_first_hit_agree_with_brute_force_on_a_part_that_is_not_convex() -> None:
    rng = np.random.default_rng(3)
    solid = trimesh.creation.torus(0.1, 0.03, major_sections=24, minor_sections=12)
    start, end = rng.uniform(-0.15, 0.15, (2, 800, 3))
    occluder = Occluder(mesh_of(solid))
    expected = meets_any(start, end, solid.triangles)
    assert 100 < expected.sum() < 700
    np.testing.assert_array_equal(occluder.blocked(start, end), expected)
    distance, face = occluder.first_hit(start, end - start)
    length = np.linalg.norm(end - start, axis=1)
    np.testing.assert_array_equal(distance < length, expected)
    hit = np.isfinite(distance)
    point = start[hit] + distance[hit, None] * (end - start)[hit] / length[hit, None]
    corner, normal = solid.triangles[face[hit], 0], solid.face_normals[face[hit]]
    assert np.abs(np.einsum("ij,ij->i", point - corner, normal)).max() < 1e-13
    assert not meets_any(start[hit], start[hit] + 0.999999 * (point - start[hit]), solid.triangles).any()
    assert (face[~hit] == -1).all()


def test_a_cube_is_hit_where_it_stands() -> None:
    occluder = Occluder(mesh_of(trimesh.creation.box(extents=(2.0, 2.0, 2.0))))
    distance, _ = occluder.first_hit(
        np.array([[3.0, 0.2, 0.3], [3.0, 0.2, 0.3]]), np.array([[-5.0, 0, 0], [1.0, 0, 0]])
    )
    assert distance.tolist() == [2.0, np.inf]


def surface_points(solid: trimesh.Trimesh, n: int, rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    face = rng.integers(len(solid.faces), size=n)
    weights = rng.dirichlet(np.ones(3), size=n)
    weights[::4, 2] = 0.0  # a quarter of them on edges
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("nk,nki->ni", weights, solid.triangles[face]), face


@pytest.mark.parametrize("away", [0.0, 1.0, 20.0])
def test_a_sample_is_not_hidden_by_the_face_it_lies_on(away: float) -> None:
    rng = np.random.default_rng(5)
    solid = turned(trimesh.creation.icosphere(subdivisions=2, radius=0.1), rng)
    solid.apply_translation([away, -away, away / 3])
    points, face = surface_points(solid, 20_000, rng)
    normals = solid.face_normals[face]
    tangent = np.cross(normals, rng.normal(size=normals.shape))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    angle = np.radians(rng.choice([0.0, 40.0, 75.0], size=len(points)))[:, None]
    targets = points + 0.2 * (np.cos(angle) * normals + np.sin(angle) * tangent)
    # neighbouring faces of a convex solid lie below the tangent plane
    occluder = Occluder(mesh_of(solid))
    assert not occluder.blocked(points, targets).any()
    occluder.contact = 0.0
    assert occluder.blocked(points, targets).any()


def test_a_wall_a_micrometre_above_the_sample_hides_it() -> None:
    floor = trimesh.creation.box(extents=(1.0, 1.0, 0.2))
    lid = trimesh.creation.box(extents=(1.0, 1.0, 1e-6))
    lid.apply_translation([0, 0, 0.1 + 1.5e-6])
    occluder = Occluder(mesh_of(floor), mesh_of(lid))
    assert occluder.blocked(np.array([[0.1, 0.2, 0.1]]), np.array([[0.1, 0.2, 0.3]])).all()
    assert not Occluder(mesh_of(floor)).blocked(np.array([[0.1, 0.2, 0.1]]), np.array([[0.1, 0.2, 0.3]])).any()


def test_faces_are_numbered_through_the_meshes() -> None:
    floor = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    lid = Mesh(floor.vertices + np.array([0, 0, 1.0]), np.array([[0, 2, 1]]))
    _, face = Occluder(floor, lid).first_hit(np.array([[0.2, 0.2, 2.0], [0.2, 0.2, 0.5]]), np.array([[0, 0, -1.0]] * 2))
    assert face.tolist() == [1, 0]


def test_an_edge_on_face_blocks_a_line_of_sight_in_its_plane() -> None:
    wall = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    start, end = np.array([[-1.0, 0.25, 0], [-1.0, 3.0, 0]]), np.array([[2.0, 0.25, 0], [2.0, 3.0, 0]])
    assert Occluder(wall).blocked(start, end).tolist() == [True, False]


def test_nothing_and_equal_triangles_and_equal_ends_are_handled() -> None:
    start, end = np.zeros((1, 3)) - 1.0, np.ones((1, 3))
    assert not Occluder().blocked(start, end).any()
    assert Occluder().first_hit(start, end)[1].tolist() == [-1]
    heap = Mesh(np.array([[0.0, -1, -1], [0, 2, -1], [0, -1, 2]]), np.tile([0, 1, 2], (500, 1)))
    assert Occluder(heap).blocked(start, end).all()
    assert not Occluder(heap).blocked(end, end).any()
    assert len(Occluder(heap).blocked(np.empty((0, 3)), np.empty((0, 3)))) == 0


def test_the_number_of_threads_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    start, end = rng.uniform(-0.2, 0.2, (2, 30_000, 3))
    occluder = Occluder(mesh_of(CONVEX["sphere"]))
    one, many = (occluder.first_hit(start, end - start, n_threads=n) for n in (1, 4))
    np.testing.assert_array_equal(one[0], many[0])
    np.testing.assert_array_equal(one[1], many[1])
    np.testing.assert_array_equal(occluder.blocked(start, end, n_threads=1), occluder.blocked(start, end, n_threads=4))


def test_broken_meshes_and_rays_are_refused_with_the_fact() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    with pytest.raises(InvalidInputError, match="vertex 3 of 3"):
        Occluder(Mesh(vertices, np.array([[0, 1, 3]])))
    with pytest.raises(InvalidInputError, match="1 vertices are not finite"):
        Occluder(Mesh(np.array([[0.0, 0, 0], [np.nan, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])))
    with pytest.raises(InvalidInputError, match="no direction"):
        Occluder().first_hit(np.zeros((1, 3)), np.zeros((1, 3)))
