"""Metrics of hulls against shapes whose figures can be written down."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.bodies import Mesh
from cellwright.cell.parametric_parts import box, prism
from cellwright.solvers.spheres.body import sphere_body
from cellwright.solvers.spheres.metrics import HullMetrics, hull_metrics, overshoots, union_gaps, union_volume


def measured(mesh: Mesh, centres: object, radii: object) -> HullMetrics:
    """Measure spheres given in m."""
    body = sphere_body(mesh)
    c, r = (np.asarray(centres, float).reshape(-1, 3) - body.middle) / body.unit, np.atleast_1d(radii) / body.unit
    return hull_metrics(body, c, r, np.random.default_rng(0))


@settings(max_examples=30, deadline=None)
@given(st.floats(0.1, 3.0), st.floats(0.1, 3.0), st.floats(0.0, 6.0))
def test_the_volume_of_two_balls_is_that_of_the_formula(r: float, s: float, d: float) -> None:
    both = 4 / 3 * math.pi * (r**3 + s**3)
    lens = 0.0
    if d <= abs(r - s):
        lens = 4 / 3 * math.pi * min(r, s) ** 3
    elif d < r + s:
        lens = math.pi * (r + s - d) ** 2 * (d * d + 2 * d * (r + s) - 3 * (r - s) ** 2) / (12 * d)
    way = np.array([[0.0, 0, 0], [d * 0.6, d * 0.0, d * 0.8]])
    assert union_volume(way, np.array([r, s])) == pytest.approx(both - lens, rel=4e-3)


def test_a_ball_around_a_cube() -> None:
    edge, radius = 0.2, 0.2
    found = measured(box((edge, edge, edge)), [0, 0, edge / 2], radius)
    assert found.coverage == 1.0
    assert found.gap_max == 0.0
    assert found.protrusion_max == pytest.approx(radius - edge / 2, rel=1e-2)
    assert found.overshoot == pytest.approx(radius - edge / 2, rel=1e-9)
    assert found.volume == pytest.approx(4 / 3 * math.pi * radius**3, rel=1e-3)
    assert found.volume_ratio == pytest.approx(4 / 3 * math.pi * radius**3 / edge**3, rel=1e-3)
    rng = np.random.default_rng(1)
    ways = rng.normal(size=(200_000, 3))
    points = radius * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    away = np.linalg.norm(np.maximum(np.abs(points) - edge / 2, 0.0), axis=1)
    assert found.protrusion_mean == pytest.approx(away.mean(), rel=1e-2)
    assert found.protrusion_p95 == pytest.approx(np.quantile(away, 0.95), rel=1e-2)


def test_a_ball_inside_a_cube_leaves_its_surface_open() -> None:
    edge, radius = 0.2, 0.08
    found = measured(box((edge, edge, edge)), [0, 0, edge / 2], radius)
    assert found.coverage == 0.0
    assert found.protrusion_max == 0.0
    assert found.overshoot == 0.0
    assert found.gap_max == pytest.approx(math.sqrt(3) * edge / 2 - radius, rel=0.03)
    u = np.linspace(-1, 1, 401) * edge / 2
    exact = np.sqrt(u[:, None] ** 2 + u**2 + edge**2 / 4) - radius
    assert found.gap_mean == pytest.approx(exact.mean(), rel=1e-2)
    assert found.gap_p95 == pytest.approx(np.quantile(exact, 0.95), rel=1e-2)


def test_a_ball_that_holds_half_of_a_box() -> None:
    found = measured(box((0.4, 0.02, 0.02)), [0.2, 0, 0.01], 0.2)
    assert found.coverage == pytest.approx(0.5, abs=0.02)
    assert found.gap_max == pytest.approx(0.2, rel=0.02)


def test_balls_along_a_cylinder() -> None:
    radius, length, n = 0.05, 0.4, 9
    angle = 2 * math.pi * np.arange(96) / 96
    mesh = prism(radius * np.column_stack([np.cos(angle), np.sin(angle)]), length)
    gap = length / n
    reach = math.hypot(radius, gap / 2) * 1.0001
    centres = np.column_stack([np.zeros((n, 2)), gap * (np.arange(n) + 0.5)])
    found = measured(mesh, centres, np.full(n, reach))
    assert found.coverage == 1.0
    caps = math.pi * (reach - gap / 2) ** 2 * (2 * reach + gap / 2) / 3
    slice_ = math.pi * gap * (reach**2 - gap**2 / 12)
    assert found.volume == pytest.approx(n * slice_ + 2 * caps, rel=2e-3)
    assert found.protrusion_max == pytest.approx(reach - gap / 2, rel=0.02)


def test_the_overshoot_bounds_every_protrusion_of_random_balls() -> None:
    body = sphere_body(Mesh(*(lambda m: (np.asarray(m.vertices), np.asarray(m.faces, np.int32)))(
        trimesh.creation.torus(0.3, 0.1))))  # fmt: skip
    rng = np.random.default_rng(2)
    for _ in range(5):
        centres, radii = rng.uniform(-0.4, 0.4, (6, 3)), rng.uniform(0.01, 0.3, 6)
        found = hull_metrics(body, centres, radii, rng)
        assert found.protrusion_max <= found.overshoot + 1e-9
        assert found.protrusion_mean <= found.protrusion_max
        assert (overshoots(body, centres, radii) <= radii + 2.0).all()


def test_shells_inside_a_body_do_not_loosen_the_overshoot() -> None:
    inner = trimesh.creation.icosphere(subdivisions=2, radius=0.02).apply_translation([0, 0, 0.1])
    cube = box((0.2, 0.2, 0.2))
    nested = Mesh(
        np.concatenate([cube.vertices, inner.vertices]),
        np.concatenate([cube.faces, inner.faces + len(cube.vertices)]).astype(np.int32),
    )
    whole, hollow = (measured(mesh, [0, 0, 0.1], 0.18) for mesh in (cube, nested))
    assert hollow.overshoot == pytest.approx(whole.overshoot, rel=1e-9)
    assert hollow.protrusion_max == pytest.approx(whole.protrusion_max, rel=1e-9)
    assert hollow.volume_ratio == pytest.approx(whole.volume_ratio, rel=0.02)


def test_gaps_are_signed_distances_to_the_union() -> None:
    centres, radii = np.array([[0.0, 0, 0], [3.0, 0, 0]]), np.array([1.0, 0.5])
    points = np.array([[0.0, 0, 0], [2.0, 0, 0], [3.0, 0, 2.0]])
    assert union_gaps(points, centres, radii).tolist() == pytest.approx([-1.0, 0.5, 1.5])
