from __future__ import annotations

import numpy as np
import pytest
import trimesh

from cellwright.causes import Cause
from cellwright.cell.occlusion import Occluder
from cellwright.solvers.coverage import CandidatePieces, Misses, explain_misses, match_points
from tests.cellwright.solvers.scenes import SCANNER, box, looking_down, occluder_of

U_MAX = 100e-6
UP = np.array([[0.0, 0.0, 1.0]])


def test_matches_agree_with_brute_force(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellwright.solvers.coverage._NEIGHBOURS_AT_ONCE", 50)
    rng = np.random.default_rng(0)
    points, scanned = rng.random((200, 3)), rng.random((400, 3))
    normals, scanned_normals = rng.normal(size=(200, 3)), rng.normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scanned_normals /= np.linalg.norm(scanned_normals, axis=1, keepdims=True)
    uncertainty = rng.random(400).astype(np.float32)
    found = match_points(points, normals, scanned, scanned_normals, uncertainty, 0.12)
    near = np.linalg.norm(points[:, None] - scanned[None], axis=2) <= 0.12
    candidates = np.where(near & (normals @ scanned_normals.T > 0.5), uncertainty, np.inf)
    expected = np.where(np.isinf(candidates.min(axis=1)), np.nan, candidates.min(axis=1))
    assert 20 < np.isnan(expected).sum() < 180
    np.testing.assert_array_equal(found, expected.astype(np.float32))


def test_a_scan_of_one_side_of_a_thin_wall_does_not_measure_the_other() -> None:
    points = np.array([[0.0, 0, 0.0005], [0.0, 0, -0.0005]])
    normals = np.array([[0.0, 0, 1], [0.0, 0, -1]])
    found = match_points(points, normals, points[:1], normals[:1], np.array([3e-5], np.float32), 2e-3)
    assert found[0] == np.float32(3e-5) and np.isnan(found[1])


def test_an_empty_scan_measures_nothing() -> None:
    none = np.empty((0, 3))
    assert np.isnan(match_points(np.zeros((2, 3)), np.repeat(UP, 2, 0), none, none, np.empty(0, np.float32), 1.0)).all()


def explain(
    pieces: list[tuple[int, float, float]],
    outcome: list[int],
    *,
    blocked_by: list[int] | None = None,
    selected: list[bool] | None = None,
    connected: list[bool] | None = None,
    occluder: Occluder | None = None,
    heights: tuple[float, ...] = (0.182,),
) -> Misses:
    n_views = len(outcome)
    rows = np.array(pieces, float).reshape(-1, 3)
    candidates = CandidatePieces(
        sweeps=looking_down(*((0.0, 0.0, heights[i % len(heights)]) for i in range(n_views))),
        view=rows[:, 0].astype(np.int32),
        start=rows[:, 1],
        end=rows[:, 2],
        outcome=np.array(outcome, np.int8),
        blocked_by=np.array(blocked_by or [-1] * n_views, np.int32),
        selected=np.array(selected or [False] * n_views),
        connected=np.array(connected or [True] * n_views),
    )
    return explain_misses(SCANNER, U_MAX, occluder or Occluder(), np.zeros((1, 3)), UP, candidates)


def test_a_point_that_no_candidate_can_see_has_the_cause_of_the_sensor_model() -> None:
    lid = box((0.02, 0.02, 0.02), (0.0, 0.0, 0.1))
    found = explain([(0, -1, 1)], [0], occluder=occluder_of(lid))
    assert found.cause.tolist() == [Cause.EMITTER_OCCLUDED] and not found.coverable[0]


@pytest.mark.parametrize(
    ("pieces", "outcome", "selected", "expected", "is_coverable"),
    [
        ([], [Cause.OUT_OF_REACH, Cause.JOINT_LIMIT], None, Cause.JOINT_LIMIT, False),
        ([], [Cause.NONE, Cause.NONE], None, Cause.OUT_OF_REACH, False),
        ([(0, 0.1, 0.2)], [Cause.NONE, Cause.COLLISION], None, Cause.TOO_SHORT, False),
        ([(0, 0.1, 0.2), (0, -0.1, 0.1)], [Cause.NONE, Cause.COLLISION], None, Cause.NOT_SELECTED, True),
        ([(1, -0.1, 0.1)], [Cause.COLLISION, Cause.NONE], [False, True], Cause.NOT_SCANNED, True),
        ([(0, -0.1, 0.1), (1, 0.1, 0.2)], [Cause.NONE, Cause.NONE], [False, True], Cause.NOT_SELECTED, True),
        # the plan executes only the first piece of a view
        ([(0, 0.1, 0.2), (0, -0.1, 0.1)], [Cause.NONE], [True], Cause.NOT_SELECTED, True),
        ([(0, -0.1, 0.1), (0, 0.1, 0.2)], [Cause.NONE], [True], Cause.NOT_SCANNED, True),
    ],
)
def test_the_cause_is_the_furthest_that_a_measuring_candidate_came(
    pieces: list[tuple[int, float, float]],
    outcome: list[int],
    selected: list[bool] | None,
    expected: Cause,
    is_coverable: bool,
) -> None:
    found = explain(pieces, outcome, selected=selected)
    assert Cause(int(found.cause[0])) == expected
    assert bool(found.coverable[0]) == is_coverable
    assert found.blocked_by.tolist() == [-1]


@pytest.mark.parametrize(
    ("pieces", "selected", "connected", "expected", "is_coverable"),
    [
        ([(0, -0.1, 0.1)], [True, False], [False, True], Cause.NOT_CONNECTED, True),
        ([(0, -0.1, 0.1), (1, -0.1, 0.1)], [False, False], [False, True], Cause.NOT_SELECTED, True),
        ([(0, -0.1, 0.1), (1, 0.1, 0.2)], [False, True], [False, True], Cause.NOT_CONNECTED, True),
        ([(0, -0.1, 0.1), (1, -0.1, 0.1)], [False, True], [False, True], Cause.NOT_SCANNED, True),
        ([(0, 0.1, 0.2)], [False, False], [False, True], Cause.TOO_SHORT, False),
    ],
)
def test_what_only_unconnected_candidates_measure_is_coverable_and_not_connected(
    pieces: list[tuple[int, float, float]],
    selected: list[bool],
    connected: list[bool],
    expected: Cause,
    is_coverable: bool,
) -> None:
    chosen = [one and other for one, other in zip(selected, connected, strict=True)]
    found = explain(pieces, [Cause.NONE, Cause.OUT_OF_REACH], selected=chosen, connected=connected)
    assert Cause(int(found.cause[0])) == expected
    assert bool(found.coverable[0]) == is_coverable


def test_a_collision_names_the_body_that_stopped_the_most_measuring_candidates() -> None:
    collision = [Cause.COLLISION] * 5
    found = explain([], [*collision, Cause.JOINT_LIMIT], blocked_by=[4, 2, 2, 4, 4, 1])
    assert found.cause.tolist() == [Cause.COLLISION] and found.blocked_by.tolist() == [4]
    # a candidate that cannot see the point has no vote
    found = explain([], collision, blocked_by=[7, 2, 7, 2, 7], heights=(0.5, 0.182))
    assert found.blocked_by.tolist() == [2]


def test_blocks_of_points_give_what_one_block_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    solid = trimesh.util.concatenate([box((0.2, 0.2, 0.02), (0, 0, -0.01)), box((0.02, 0.02, 0.02), (0.0, 0.0, 0.03))])
    points = np.stack([np.linspace(-0.05, 0.05, 40), np.zeros(40), np.zeros(40)], axis=1)
    pieces = CandidatePieces(
        sweeps=looking_down((0.0, 0.0, 0.182), (0.0, 0.03, 0.182)),
        view=np.array([0], np.int32),
        start=np.array([-0.02]),
        end=np.array([0.03]),
        outcome=np.array([0, Cause.COLLISION], np.int8),
        blocked_by=np.array([-1, 3], np.int32),
        selected=np.array([False, False]),
        connected=np.array([True, True]),
    )
    normals = np.repeat(UP, 40, axis=0)
    whole = explain_misses(SCANNER, U_MAX, occluder_of(solid), points, normals, pieces)
    assert len(set(whole.cause.tolist())) >= 3
    monkeypatch.setattr("cellwright.solvers.coverage._PAIRS_AT_ONCE", 14)
    blocks = explain_misses(SCANNER, U_MAX, occluder_of(solid), points, normals, pieces)
    for name in ("cause", "coverable", "blocked_by"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(blocks, name))
