import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from cellwright.arrays import FloatArray
from cellwright.cell.parametric_parts import box, grooved_cylinder, plate_with_pocket
from cellwright.cell.surface_sampling import (
    OPPOSED,
    SurfacePoints,
    sample_blue_noise,
    sample_randomly,
    widest_radius,
)


def flat(size: float = 1.0) -> FloatArray:
    return np.array([[[0, 0, 0], [size, 0, 0], [size, size, 0]], [[0, 0, 0], [size, size, 0], [0, size, 0]]])


def normals_of(triangles: FloatArray) -> FloatArray:
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(cross / np.linalg.norm(cross, axis=1, keepdims=True))


def sampled(method: str, triangles: FloatArray, n: int, seed: int) -> SurfacePoints:
    rng = np.random.default_rng(seed)
    if method == "random":
        return sample_randomly(triangles, n, rng)
    return sample_blue_noise(triangles, normals_of(triangles), n, rng)


def triangles_of(seed: int, n: int) -> FloatArray:
    triangles = np.random.default_rng(seed).normal(size=(n, 3, 3))
    triangles[: n // 2] *= 0.01  # areas that differ by four orders of magnitude
    return triangles


@settings(max_examples=50, deadline=None)
@given(st.sampled_from(["random", "blue-noise"]), st.integers(1, 12), st.integers(1, 300), st.integers(0, 2**31))
def test_points_lie_on_their_faces_in_the_number_asked_for(method: str, n_faces: int, n: int, seed: int) -> None:
    triangles = triangles_of(seed, n_faces)
    found = sampled(method, triangles, n, seed)
    assert found.points.shape == (n, 3) and found.face.shape == (n,)
    assert (np.diff(found.face) >= 0).all()
    corners = triangles[found.face]
    # barycentric coordinates by least squares: an oracle that shares nothing with the sampler
    for point, (a, b, c) in zip(found.points, corners):
        weights, *_ = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), point - a, rcond=None)
        assert weights.min() >= -1e-9 and weights.sum() <= 1 + 1e-9
        assert np.abs(a + weights @ np.stack([b - a, c - a]) - point).max() < 1e-9


@pytest.mark.parametrize("method", ["random", "blue-noise"])
def test_faces_get_samples_in_proportion_to_their_area(method: str) -> None:
    mesh = plate_with_pocket()
    triangles = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    n = 4000
    counts = np.bincount(sampled(method, triangles, n, 3).face, minlength=len(triangles))
    expected = n * areas / areas.sum()
    assert (np.abs(counts - expected) < 5 * np.sqrt(expected) + 3).all()


@pytest.mark.parametrize("method", ["random", "blue-noise"])
def test_points_are_uniform_inside_a_face(method: str) -> None:
    points = sampled(method, flat(), 6400, 5).points
    counts = np.histogram2d(points[:, 0], points[:, 1], bins=8, range=[[0, 1], [0, 1]])[0]
    assert np.abs(counts - 100).max() < 50
    chi2 = ((counts - 100) ** 2 / 100).sum()
    assert chi2 < 110  # 63 degrees of freedom: the 99.98 % quantile


@pytest.mark.parametrize("method", ["random", "blue-noise"])
def test_the_same_seed_gives_the_same_points_and_another_seed_others(method: str) -> None:
    one, again, other = (sampled(method, flat(), 200, seed).points for seed in (1, 1, 2))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("seed", range(3))
def test_blue_noise_keeps_its_distance_where_random_points_do_not(seed: int) -> None:
    n = 1000
    widest = 2 * widest_radius(1.0, n)
    nearest = {
        method: cKDTree(points).query(points, k=2)[0][:, 1]
        for method in ("random", "blue-noise")
        for points in [sampled(method, flat(), n, seed).points]
    }
    assert nearest["blue-noise"].min() > 0.55 * widest  # Yuksel reports about 0.7 of the widest for ten candidates
    assert nearest["random"].min() < 0.1 * widest
    assert nearest["blue-noise"].std() < 0.3 * nearest["random"].std()


def test_blue_noise_leaves_smaller_holes_than_random_points() -> None:
    rng = np.random.default_rng(9)
    probes = np.column_stack([rng.random((20_000, 2)), np.zeros(20_000)])
    gap = {
        method: cKDTree(sampled(method, flat(), 1000, 4).points).query(probes)[0].max()
        for method in ("random", "blue-noise")
    }
    assert gap["blue-noise"] < 0.6 * gap["random"]


def test_the_two_faces_of_a_thin_wall_are_spaced_independently() -> None:
    top = flat()
    bottom = top[:, ::-1] - np.array([0, 0, 1e-4])
    triangles = np.concatenate([top, bottom])
    found = sampled("blue-noise", triangles, 2000, 1)
    upper = found.points[found.face < 2]
    assert len(upper) == pytest.approx(1000, abs=30)
    assert cKDTree(upper).query(upper, k=2)[0][:, 1].min() > 0.5 * 2 * widest_radius(1.0, 1000)


def test_only_points_with_opposed_normals_may_be_near() -> None:
    mesh = box((0.1, 0.1, 0.1))
    triangles = mesh.vertices[mesh.faces]
    normals = normals_of(triangles)
    found = sampled("blue-noise", triangles, 800, 2)
    near = cKDTree(found.points).query_pairs(0.5 * 2 * widest_radius(0.06, 800), output_type="ndarray")
    cosine = np.einsum("ij,ij->i", normals[found.face[near[:, 0]]], normals[found.face[near[:, 1]]])
    assert (cosine < OPPOSED).all()


def test_elimination_removes_the_most_crowded_as_a_plain_implementation_does() -> None:
    from cellwright.cell.surface_sampling import _eliminated

    rng = np.random.default_rng(11)
    points = np.column_stack([rng.random((150, 2)), np.zeros(150)])
    n, radius = 30, widest_radius(1.0, 30)
    pairs = cKDTree(points).query_pairs(2 * radius, output_type="ndarray")
    least = radius * (1 - (n / 150) ** 1.5) * 0.65
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    weight = np.where(distance <= 2 * radius, (1 - np.maximum(distance, 2 * least) / (2 * radius)) ** 8, 0.0)
    np.fill_diagonal(weight, 0.0)
    left = np.ones(150, bool)
    for _ in range(150 - n):
        crowding = np.where(left, weight[:, left].sum(axis=1), -1.0)
        left[np.argmax(crowding)] = False
    assert np.array_equal(_eliminated(points, pairs, n, radius), left)


def test_sampling_a_part_takes_about_a_second() -> None:
    mesh = grooved_cylinder()
    triangles = mesh.vertices[mesh.faces]
    sampled("blue-noise", triangles, 10, 0)  # compiles
    began = time.process_time()
    sampled("blue-noise", triangles, 8500, 0)
    assert time.process_time() - began < 2.0
