"""The proof that spheres cover a surface: it holds for dense samples, and no hole is too small for it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.parametric_parts import plate_with_pocket
from cellwright.cell.surface_sampling import sample_randomly
from cellwright.cell.transforms import rotation_from_rpy
from cellwright.solvers.spheres.certificate import grow_over_surface, prove_surface
from cellwright.solvers.spheres.metrics import union_gaps

LEAF, MARGIN = 1e-3, 1e-6
SQUARE = np.array([[[-1.0, -1, 0], [1, -1, 0], [1, 1, 0]], [[-1.0, -1, 0], [1, 1, 0], [-1, 1, 0]]])
QUARTERS = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
"""Middles of the quarters of the square: balls of radius sqrt(1/2) about them meet in its middle and at its rim."""
ANGLES = st.tuples(*(st.floats(-3.0, 3.0),) * 3)


def plate() -> FloatArray:
    mesh = plate_with_pocket()
    return np.asarray(mesh.vertices[mesh.faces])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 6))
def test_what_is_proven_holds_at_every_sample_and_what_is_not_has_a_gap_of_at_most_a_leaf(
    seed: int, n_balls: int, n_triangles: int
) -> None:
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-1, 1, (n_triangles, 3, 3))
    centres, radii = rng.uniform(-1, 1, (n_balls, 3)), rng.uniform(0.2, 1.8, n_balls)
    proof = prove_surface(triangles, centres, radii, leaf=0.01, margin=MARGIN)
    weights = rng.dirichlet(np.ones(3), 4000)
    points = np.einsum("pk,tkc->tpc", weights, triangles).reshape(-1, 3)
    worst = union_gaps(points, centres, radii).max()
    if proof.covered:
        assert worst <= -MARGIN * 0.99
        assert len(proof.witnesses) == 0
    else:
        # every witness lies on a piece that no ball holds as a whole
        assert (union_gaps(proof.witnesses, centres, radii) > -0.011).all()
        assert (proof.gaps > 0.0).all()


@settings(max_examples=60, deadline=None)
@given(st.floats(-8.0, -0.5), ANGLES, st.floats(-100.0, 100.0))
def test_a_hole_is_refused_however_small(exponent: float, angles: tuple[float, ...], shift: float) -> None:
    turn = rotation_from_rpy(*angles)
    # the rim is covered by far, only the middle of the square is left out
    radius = math.sqrt(0.5) - 10.0**exponent
    rim = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
    centres = np.concatenate([QUARTERS, rim])
    radii = np.array([radius] * 4 + [0.95] * 4 + [0.4] * 4)
    radii[4:8] = 1.0 - 10.0**exponent
    placed = SQUARE @ turn.T + shift, centres @ turn.T + shift, radii
    proof = prove_surface(*placed, leaf=LEAF, margin=0.0)
    assert not proof.covered
    assert np.linalg.norm(proof.witnesses - shift, axis=1).min() < 10.0**exponent * 4 + 2 * LEAF


@settings(max_examples=40, deadline=None)
@given(st.floats(2e-3, 0.3), ANGLES, st.floats(-100.0, 100.0))
def test_balls_that_overlap_by_more_than_a_leaf_are_proven(
    overlap: float, angles: tuple[float, ...], shift: float
) -> None:
    turn = rotation_from_rpy(*angles)
    radii = np.full(4, math.sqrt(0.5) + overlap)
    assert prove_surface(SQUARE @ turn.T + shift, QUARTERS @ turn.T + shift, radii, leaf=LEAF, margin=MARGIN).covered


def test_the_margin_is_kept() -> None:
    centre, radius = np.zeros((1, 3)), np.array([math.sqrt(2.0)])
    assert not prove_surface(SQUARE, centre, radius, leaf=LEAF, margin=0.0).covered  # corners on the very skin
    assert prove_surface(SQUARE, centre, radius + 1e-4, leaf=LEAF, margin=9e-5).covered
    assert not prove_surface(SQUARE, centre, radius + 1e-4, leaf=LEAF, margin=1.1e-4).covered


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 8))
def test_grown_spheres_are_proven_and_shrink_nowhere(seed: int, n_balls: int) -> None:
    rng = np.random.default_rng(seed)
    triangles = plate()
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    centres, radii = rng.uniform(low, high, (n_balls, 3)), rng.uniform(0.0, 0.03, n_balls)
    grown = grow_over_surface(triangles, centres, radii, leaf=5e-4, margin=1e-7)
    assert (grown >= radii).all()
    proof = prove_surface(triangles, centres, grown, leaf=5e-4, margin=1e-7)
    assert proof.covered
    points = sample_randomly(triangles, 5000, rng).points
    assert union_gaps(points, centres, grown).max() <= 0.0


def test_degenerate_triangles_are_covered_as_the_segments_and_points_that_they_are() -> None:
    needle = np.array([[[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0]], [[2.0, 0, 0]] * 3])
    centres = np.array([[0.25, 0, 0], [0.75, 0, 0], [2, 0, 0]])
    assert prove_surface(needle, centres, np.array([0.3, 0.3, 1e-3]), leaf=LEAF, margin=MARGIN).covered
    assert not prove_surface(needle, centres, np.array([0.3, 0.2, 1e-3]), leaf=LEAF, margin=MARGIN).covered
    assert not prove_surface(needle, centres, np.array([0.3, 0.3, 0.0]), leaf=LEAF, margin=MARGIN).covered


@pytest.mark.parametrize("n_copies", [1, 50])
def test_no_more_than_a_few_thousand_witnesses_are_kept(n_copies: int) -> None:
    triangles = np.tile(SQUARE, (n_copies, 1, 1))
    proof = prove_surface(triangles, np.zeros((1, 3)), np.array([0.1]), leaf=0.1, margin=MARGIN)
    assert not proof.covered
    assert 100 < len(proof.witnesses) <= 4096
