from __future__ import annotations

import itertools

import numpy as np
import pytest

from cellwright.solvers.path_smoothing import round_corners, shorten
from cellwright.solvers.roadmap import travel_time
from tests.cellwright.solvers.flat_worlds import BoxWorld

SPEED = np.array([1.0, 2.0])


def corners(seed, n=6):
    return np.cumsum(np.random.default_rng(seed).uniform(-1, 1, (n, 2)), axis=0)


def test_a_shortened_path_keeps_its_ends_is_free_and_not_longer():
    wall = BoxWorld([((-0.1, -5.0), (0.1, 1.0))])
    detour = np.array([[-1.0, 0.0], [-1.0, 3.0], [0.5, 3.5], [1.0, 2.0], [1.0, 0.0]])
    path = shorten(detour, SPEED, wall, np.random.default_rng(0), step=0.01, n_attempts=200)
    assert np.array_equal(path[[0, -1]], detour[[0, -1]])
    assert not any(wall.motion_collides(a, b, 0.002) for a, b in itertools.pairwise(path))
    before, after = (float(travel_time(p[:-1], p[1:], SPEED).sum()) for p in (detour, path))
    assert after < 0.85 * before


def test_corners_that_can_be_left_out_are():
    path = shorten(corners(0), SPEED, BoxWorld([]), np.random.default_rng(0), step=0.05, n_attempts=0)
    assert np.array_equal(path, corners(0)[[0, -1]])


@pytest.mark.parametrize("seed", range(5))
def test_a_rounded_path_is_twice_differentiable_and_stays_in_the_corners_triangles(seed):
    polyline = corners(seed)
    pieces = round_corners(polyline, SPEED, BoxWorld([]), step=0.05)
    assert np.array_equal(pieces[0](pieces[0].knots[:1])[0], polyline[0])
    assert pieces[-1](pieces[-1].knots[-1:])[0] == pytest.approx(polyline[-1], abs=1e-12)
    for piece in pieces:
        inner = piece.knots[1:-1]
        for order in range(3):
            before, after = piece(inner - 1e-9, order), piece(inner + 1e-9, order)
            size = 1.0 + np.abs(piece(piece.knots, order)).max()
            assert after == pytest.approx(before, abs=1e-6 * size / np.diff(piece.knots).min() ** order)
        dense = np.linspace(piece.knots[0], piece.knots[-1], 4001)
        derivative = np.gradient(piece(dense), dense, axis=0)
        assert derivative[1:-1] == pytest.approx(piece(dense, 1)[1:-1], abs=5e-2)


def test_a_corner_whose_blend_collides_is_rounded_less_or_passed_at_rest():
    polyline = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    near, at = BoxWorld([((0.0, 0.03), (0.97, 1.0))]), BoxWorld([((0.0, 1e-6), (1.0 - 1e-6, 1.0))])
    assert len(round_corners(polyline, np.ones(2), near, step=0.01)) == 1
    narrow = round_corners(polyline, np.ones(2), near, step=0.01)[0]
    wide = round_corners(polyline, np.ones(2), BoxWorld([]), step=0.01)[0]
    assert np.diff(narrow.knots)[1] < np.diff(wide.knots)[1]
    dense = narrow(np.linspace(0.0, narrow.knots[-1], 2001))
    assert not any(near.collides(q) for q in dense)
    assert len(round_corners(polyline, np.ones(2), at, step=0.01)) == 2


def test_a_path_that_turns_back_on_itself_stops_there():
    polyline = np.array([[0.0, 0.0], [1.0, 0.0], [0.2, 0.0]])
    assert len(round_corners(polyline, np.ones(2), BoxWorld([]), step=0.01)) == 2
