"""Fitted spheres hold the mesh: asked of other means than the proof, on sound and on broken meshes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from cellwright.cell.bodies import Mesh
from cellwright.cell.mesh_files import mesh_from_bytes
from cellwright.cell.parametric_parts import box, plate_with_pocket
from cellwright.cell.surface_sampling import sample_randomly
from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.spheres import fitting
from cellwright.solvers.spheres.body import SphereBody
from cellwright.solvers.spheres.certificate import prove_surface
from cellwright.solvers.spheres.fitting import FitSettings, SphereFit, fit_spheres
from cellwright.solvers.spheres.metrics import union_gaps
from cellwright.solvers.spheres.robots import fit_many

DATA = Path(__file__).parents[5] / "shared" / "data"
PARTS = sorted(path for path in (DATA / "parts").glob("*")) if DATA.is_dir() else []
QUICK = FitSettings(n_starts=1, n_points=1500)
TORUS = trimesh.creation.torus(0.06, 0.02, major_sections=32, minor_sections=16)


def mesh_of(solid: Any) -> Mesh:
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


def fitted(mesh: Mesh, n_spheres: int, settings: FitSettings = QUICK, seed: int = 0) -> SphereFit:
    return fit_spheres(mesh, n_spheres, generator=np.random.default_rng(seed), settings=settings)


def assert_holds(fit: SphereFit, mesh: Mesh, n: int = 20_000) -> None:
    """Dense samples, corners and edges lie in the spheres, also with the radii of single precision."""
    triangles = np.asarray(mesh.vertices, float)[mesh.faces]
    points = sample_randomly(triangles, n, np.random.default_rng(99)).points
    along = np.random.default_rng(98).random((len(triangles), 3, 1))
    edges = (triangles + along * (np.roll(triangles, -1, axis=1) - triangles)).reshape(-1, 3)
    radii = fit.radii.astype(np.float32).astype(float)
    centres = fit.centres.astype(np.float32).astype(float)
    for cloud in (points, edges, triangles.reshape(-1, 3)):
        assert union_gaps(cloud, centres, radii).max() <= 0.0
    assert fit.surface_covered
    assert fit.metrics.coverage == 1.0


@pytest.mark.parametrize("n_spheres", [1, 2, 7, 20])
def test_every_number_of_spheres_holds_a_plate_and_its_inside(n_spheres: int) -> None:
    mesh = plate_with_pocket()
    fit = fitted(mesh, n_spheres)
    assert len(fit.radii) == n_spheres
    assert_holds(fit, mesh)
    assert fit.interior == "covered"
    rng = np.random.default_rng(1)
    below_pocket = rng.uniform([-0.06, -0.04, 0], [0.06, 0.04, 0.008], (20_000, 3))
    assert union_gaps(below_pocket, fit.centres, fit.radii).max() <= 0.0
    assert (np.diff(fit.radii) <= 0).all()


def test_more_spheres_are_tighter_and_ours_are_tighter_than_k_means() -> None:
    mesh = mesh_of(TORUS)
    few, many = fitted(mesh, 6), fitted(mesh, 20)
    plain = fitted(mesh, 20, FitSettings("k-means"))
    assert many.metrics.volume_ratio < few.metrics.volume_ratio
    assert many.metrics.volume_ratio < 0.8 * plain.metrics.volume_ratio
    assert_holds(plain, mesh)
    assert many.metrics.protrusion_max <= many.metrics.overshoot
    assert many.metrics.overshoot == pytest.approx(many.overshoot.max())


def test_k_means_as_published_may_leave_gaps_and_says_so() -> None:
    fit = fitted(plate_with_pocket(), 30, FitSettings("k-means", n_points=300, inflate=False))
    assert not fit.surface_covered
    assert fit.interior == "not covered"
    assert fit.metrics.gap_max > 0.0


def test_the_hole_of_a_ring_stays_open_where_spheres_are_enough() -> None:
    fit = fitted(mesh_of(TORUS), 24)
    assert fit.interior == "covered"
    assert union_gaps(np.zeros((1, 3)), fit.centres, fit.radii)[0] > 0.0


@pytest.mark.parametrize(
    "broken", ["hole", "crack", "turned", "doubled", "two pieces", "open sheet", "sliver", "loose"]
)
def test_broken_meshes_are_held_too(broken: str) -> None:
    solid = mesh_of(trimesh.creation.icosphere(subdivisions=4 if broken == "crack" else 2, radius=0.1))
    vertices, faces = solid.vertices, solid.faces
    if broken == "hole":
        faces = faces[5:]
    elif broken == "crack":
        faces = faces[1:]
    elif broken == "turned":
        faces = np.concatenate([faces[:40, ::-1], faces[40:]])
    elif broken == "doubled":
        faces = np.concatenate([faces, faces])
    elif broken == "two pieces":
        vertices = np.concatenate([vertices, vertices + np.array([0.5, 0, 0])])
        faces = np.concatenate([faces, faces + len(solid.vertices)])
    elif broken == "open sheet":
        grid = trimesh.creation.box(extents=(0.2, 0.1, 0.01))
        vertices, faces = np.asarray(grid.vertices), np.asarray(grid.faces, np.int32)[:4]
    elif broken == "sliver":
        faces = np.concatenate([faces, [[0, 0, 1], [2, 3, 3]]])
    else:
        vertices = np.concatenate([vertices, [[9.0, 9.0, 9.0]]])  # of no face
    mesh = Mesh(vertices, np.asarray(faces, np.int32))
    fit = fitted(mesh, 8)
    assert_holds(fit, mesh)
    assert fit.interior == ("none" if broken in ("open sheet", "hole") else "covered")
    assert fit.metrics.volume_ratio < (60 if broken == "open sheet" else 3)


@pytest.mark.parametrize(("offset", "n_spheres"), [(0.0, 8), (5.0, 8), (50.0, 2), (50.0, 8), (500.0, 1)])
def test_a_hull_stays_proven_in_single_precision_far_from_the_origin(offset: float, n_spheres: int) -> None:
    near = box((0.1, 0.08, 0.06))
    mesh = Mesh(near.vertices + offset * np.array([1.0, -1.0, 1.0 / 3.0]), near.faces)
    fit = fitted(mesh, n_spheres)
    centres, radii = fit.centres.astype(np.float32).astype(float), fit.radii.astype(np.float32).astype(float)
    assert prove_surface(mesh.vertices[mesh.faces], centres, radii, leaf=5e-5, margin=0.0).covered
    assert fit.margin < 2e-3 * np.linalg.norm([0.1, 0.08, 0.06])


def test_twice_the_spheres_do_not_cost_a_plump_body_more_volume() -> None:
    mesh = mesh_of(trimesh.creation.cylinder(0.05, 0.1, sections=24))
    few, many = (fitted(mesh, n, FitSettings(n_starts=2, n_points=1500)).metrics.volume_ratio for n in (5, 10))
    assert many <= few


@pytest.mark.parametrize("path", PARTS or [None], ids=lambda path: path.name if path else "no data")
def test_every_public_part_is_held(path: Path | None) -> None:
    if path is None:
        pytest.skip("the shared parts are not there")
    mesh = mesh_from_bytes(path.name, path.read_bytes())
    fit = fitted(mesh, 12, FitSettings(n_starts=1, n_points=1000))
    assert_holds(fit, mesh)
    assert fit.interior == ("none" if "wavy" in path.name else "covered")


def test_links_of_published_robots_are_held_within_the_volume_asked_for() -> None:
    links = sorted((DATA / "robots" / "ur10e" / "collision").glob("*.stl")) if DATA.is_dir() else []
    if not links:
        pytest.skip("the shared robot data is not there")
    meshes = {path.stem: mesh_from_bytes(path.name, path.read_bytes()) for path in links}
    fits = fit_many(meshes, [20] * len(meshes), np.random.default_rng(0), FitSettings(n_starts=1))
    for fit, mesh in zip(fits, meshes.values()):
        assert_holds(fit, mesh)
        assert fit.interior == "covered"
    assert np.mean([fit.metrics.volume_ratio for fit in fits]) < 1.8


def test_a_tolerance_is_kept_with_few_spheres() -> None:
    mesh = box((0.3, 0.1, 0.1))
    fits = [
        fit_spheres(mesh, tolerance=tolerance, generator=np.random.default_rng(0), settings=QUICK)
        for tolerance in (0.05, 0.025)
    ]
    assert fits[0].metrics.overshoot <= 0.05
    assert fits[1].metrics.overshoot <= 0.025
    assert len(fits[0].radii) < len(fits[1].radii) < 120


def test_the_number_for_a_tolerance_is_fitted_with_all_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int]] = []
    fit = fitting.fit_to_body

    def noted(body: SphereBody, n_spheres: int, generator: np.random.Generator, settings: FitSettings) -> SphereFit:
        asked.append((n_spheres, settings.n_starts))
        return fit(body, n_spheres, generator, settings)

    monkeypatch.setattr(fitting, "fit_to_body", noted)
    settings = FitSettings(n_starts=5, n_points=1500)
    found = fit_spheres(box((0.3, 0.1, 0.1)), tolerance=0.04, generator=np.random.default_rng(0), settings=settings)
    assert found.metrics.overshoot <= 0.04
    assert asked[-1] == (len(found.radii), 5) and {n for _, n in asked[:-1]} == {2}


def test_an_impossible_tolerance_says_how_close_it_came(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellwright.solvers.spheres.fitting.MOST_SPHERES", 8)
    with pytest.raises(InfeasibleError, match=r"8 spheres stick out by up to \d.* mm, more than the tolerance of 1 mm"):
        fit_spheres(box((0.3, 0.1, 0.1)), tolerance=1e-3, generator=np.random.default_rng(0), settings=QUICK)


def test_threads_change_nothing_and_seeds_do() -> None:
    meshes = {"plate": plate_with_pocket(), "torus": mesh_of(TORUS), "box": box((0.1, 0.1, 0.1))}
    runs = [fit_many(meshes, [5, 6, 3], np.random.default_rng(3), QUICK, n_threads=n) for n in (1, 3)]
    for one, other in zip(*runs):
        assert one.centres.tobytes() == other.centres.tobytes()
        assert one.radii.tobytes() == other.radii.tobytes()
        assert dataclasses.asdict(one.metrics) == dataclasses.asdict(other.metrics)
    assert fitted(meshes["torus"], 6, seed=4).radii.tobytes() != fitted(meshes["torus"], 6, seed=5).radii.tobytes()


def test_a_body_far_from_its_origin_is_fitted_like_one_at_it() -> None:
    near = plate_with_pocket()
    far = Mesh(near.vertices + np.array([100.0, -50.0, 20.0]), near.faces)
    assert_holds(fitted(far, 6), far, 2000)


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        (Mesh(np.zeros((3, 3)), np.empty((0, 3), np.int32)), "no triangles"),
        (Mesh(np.ones((3, 3)), np.array([[0, 1, 2]], np.int32)), "all vertices of the mesh are one point"),
        (Mesh(np.array([[np.nan] * 3, [0.0] * 3, [1.0] * 3]), np.array([[0, 1, 2]], np.int32)), "1 of 3 vertices"),
        (Mesh(box((1.0, 1.0, 1.0)).vertices + 1e8, box((1.0, 1.0, 1.0)).faces), "move it to its origin"),
    ],
)
def test_meshes_without_a_shape_are_refused(mesh: Mesh, words: str) -> None:
    with pytest.raises(InvalidInputError, match=words):
        fitted(mesh, 3)


def test_numbers_out_of_range_are_refused() -> None:
    generator = np.random.default_rng(0)
    for n_spheres, tolerance in ((None, None), (3, 0.1), (0, None), (513, None), (None, -1.0), (None, float("nan"))):
        with pytest.raises(InvalidInputError):
            fit_spheres(box((1, 1, 1)), n_spheres, tolerance=tolerance, generator=generator)
