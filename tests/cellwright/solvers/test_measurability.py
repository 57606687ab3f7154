from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.causes import Cause
from cellwright.cell.bodies import Mesh
from cellwright.cell.occlusion import Occluder
from cellwright.solvers.measurability import Sweeps, measure_pairs, measured_by_any
from tests.cellwright.solvers.scenes import (
    SCANNER,
    box,
    judge,
    looking_down,
    mesh_of,
    occluder_of,
    random_sweeps,
    samples_on,
)

U_MAX = 100e-6
UP = np.array([[0.0, 0.0, 1.0]])
PLATE = box((1.0, 1.0, 0.02), (0.0, 0.0, -0.01))
FEATURES = trimesh.util.concatenate(
    [
        box((0.1, 0.1, 0.06), (0, 0, 0)),
        box((0.02, 0.1, 0.05), (0.04, 0, 0.055)),
        box((0.03, 0.03, 0.03), (-0.03, 0, 0.045)),
    ]
)


def test_a_plane_is_measured_head_on_with_the_uncertainty_of_the_standoff() -> None:
    found = measure_pairs(SCANNER, U_MAX, occluder_of(PLATE), np.zeros((1, 3)), UP, looking_down((-0.3, 0.0, 0.182)))
    assert found.cause.tolist() == [Cause.NONE]
    assert found.uncertainty[0] == pytest.approx(40e-6, rel=1e-6)
    assert found.travel[0] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("across", "height", "expected"),
    [
        (0.182 * math.tan(math.radians(15.5)), 0.182, Cause.NONE),  # on the fan's border
        (0.182 * math.tan(math.radians(15.6)), 0.182, Cause.FIELD_OF_VIEW),
        (0.0, 0.127, Cause.NONE),
        (0.0, 0.227, Cause.NONE),
        (0.0, 0.126, Cause.FIELD_OF_VIEW),
        (0.0, 0.228, Cause.FIELD_OF_VIEW),
    ],
)
def test_the_field_of_view_ends_at_the_fan_and_the_working_distances(
    across: float, height: float, expected: Cause
) -> None:
    sweep = looking_down((0.0, across, height))
    assert measure_pairs(SCANNER, 1e-3, occluder_of(PLATE), np.zeros((1, 3)), UP, sweep).cause[0] == expected


@pytest.mark.parametrize(
    ("normal_angle", "u_max", "expected"),
    [
        (0.0, 40e-6, Cause.NONE),  # exactly what is permitted
        (0.0, 39.9e-6, Cause.UNCERTAINTY),
        (-50.0, U_MAX, Cause.NONE),  # the detector looks at 50 + 22.66 degrees
        (-53.0, U_MAX, Cause.INCIDENCE),  # at 75.66 degrees
        (74.0, 1e-3, Cause.NONE),  # the detector's side: the laser decides
        (76.0, 1e-3, Cause.INCIDENCE),
        (60.0, 79e-6, Cause.UNCERTAINTY),  # 40 um / cos 60
        (60.0, 81e-6, Cause.NONE),
        (180.0, 1e-3, Cause.INCIDENCE),
    ],
)
def test_incidence_and_uncertainty_follow_the_angles(normal_angle: float, u_max: float, expected: Cause) -> None:
    angle = math.radians(normal_angle)
    normal = np.array([[-math.sin(angle), 0.0, math.cos(angle)]])
    found = measure_pairs(SCANNER, u_max, Occluder(), np.zeros((1, 3)), normal, looking_down((0.0, 0.0, 0.182)))
    assert found.cause[0] == expected


@pytest.mark.parametrize(
    ("wall", "expected"),
    [
        (box((0.01, 0.05, 0.05), (-0.03, 0.0, 0.07)), Cause.DETECTOR_OCCLUDED),  # on the detector's line of sight
        (box((0.01, 0.05, 0.05), (0.03, 0.0, 0.07)), Cause.NONE),  # on the other side
        (box((0.02, 0.02, 0.02), (0.0, 0.0, 0.1)), Cause.EMITTER_OCCLUDED),
        (box((0.02, 0.02, 0.02), (0.0, 0.0, 0.25)), Cause.NONE),  # behind the scanner
    ],
)
def test_walls_hide_the_sample_from_emitter_or_detector(wall: trimesh.Trimesh, expected: Cause) -> None:
    found = measure_pairs(
        SCANNER, U_MAX, occluder_of(PLATE, wall), np.zeros((1, 3)), UP, looking_down((0.1, 0.0, 0.182))
    )
    assert found.cause[0] == expected
    assert len(found.sweep) == (expected == Cause.NONE)


def test_the_stored_cause_is_the_furthest_that_any_sweep_came() -> None:
    wall = box((0.02, 0.02, 0.02), (0.0, 0.0, 0.1))
    low, high = (0.0, 0.0, 0.05), (0.0, 0.0, 0.182)
    for sweeps in (looking_down(low, high), looking_down(high, low)):
        found = measure_pairs(SCANNER, U_MAX, occluder_of(PLATE, wall), np.zeros((1, 3)), UP, sweeps)
        assert found.cause.tolist() == [Cause.EMITTER_OCCLUDED]
    assert measure_pairs(SCANNER, U_MAX, Occluder(), np.zeros((1, 3)), UP, looking_down()).cause.tolist() == [
        Cause.FIELD_OF_VIEW
    ]


def test_every_pair_agrees_with_the_definition_written_in_plain_numpy() -> None:
    rng = np.random.default_rng(2)
    mesh = mesh_of(FEATURES)
    points, normals = samples_on(FEATURES, 60, rng)
    sweeps = random_sweeps(150, 0.1, rng)
    narrow = rng.random(150) < 0.3
    sweeps = replace(sweeps, start=np.where(narrow, -0.01, -np.inf), end=np.where(narrow, 0.03, np.inf))
    found = measure_pairs(SCANNER, 60e-6, Occluder(mesh), points, normals, sweeps)
    entries = {
        (v, p): (u, s) for v, p, u, s in zip(found.sweep, found.point, found.uncertainty, found.travel, strict=True)
    }
    causes = np.zeros(len(points), int)
    tally = np.zeros(len(Cause), int)
    for v in range(len(sweeps)):
        for p in range(len(points)):
            cause, uncertainty, travel = judge(SCANNER, 60e-6, mesh, points[p], normals[p], sweeps, v)
            tally[cause] += 1
            causes[p] = max(causes[p], cause)
            assert ((v, p) in entries) == (cause == Cause.NONE)
            if cause == Cause.NONE:
                assert entries[v, p] == (pytest.approx(uncertainty, rel=1e-6), pytest.approx(travel, abs=1e-12))
    assert (tally[: Cause.DETECTOR_OCCLUDED + 1] > 0).all(), "the scene must try every test"
    causes[found.point] = Cause.NONE
    np.testing.assert_array_equal(found.cause, causes)
    assert list(entries) == sorted(entries), "by sweep, then by point"


@given(seed=st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_moving_part_and_sweeps_together_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, normals = samples_on(FEATURES, 30, rng)
    sweeps = random_sweeps(60, 0.1, rng)
    mesh = mesh_of(FEATURES)
    R = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    shift = rng.normal(size=3)
    moved_mesh = Mesh(mesh.vertices @ R.T + shift, mesh.faces)
    moved_sweeps = Sweeps.untrimmed(sweeps.position @ R.T + shift, R @ sweeps.rotation)
    before = measure_pairs(SCANNER, U_MAX, Occluder(mesh), points, normals, sweeps)
    after = measure_pairs(SCANNER, U_MAX, Occluder(moved_mesh), points @ R.T + shift, normals @ R.T, moved_sweeps)
    np.testing.assert_array_equal(before.sweep, after.sweep)
    np.testing.assert_array_equal(before.point, after.point)
    np.testing.assert_array_equal(before.cause, after.cause)
    np.testing.assert_allclose(before.uncertainty, after.uncertainty, rtol=1e-6)
    np.testing.assert_allclose(before.travel, after.travel, atol=1e-12)


@given(seed=st.integers(0, 10_000), shift=st.floats(-0.5, 0.5))
@settings(max_examples=20, deadline=None)
def test_a_sweep_measures_the_same_from_wherever_it_begins(seed: int, shift: float) -> None:
    rng = np.random.default_rng(seed)
    points, normals = samples_on(FEATURES, 30, rng)
    sweeps = random_sweeps(40, 0.1, rng)
    moved = Sweeps.untrimmed(sweeps.position + shift * sweeps.rotation[:, :, 0], sweeps.rotation)
    before, after = (measure_pairs(SCANNER, U_MAX, occluder_of(FEATURES), points, normals, s) for s in (sweeps, moved))
    np.testing.assert_array_equal(before.point, after.point)
    np.testing.assert_allclose(before.travel, after.travel + shift, atol=1e-12)


def test_the_number_of_threads_changes_no_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellwright.solvers.measurability._PAIRS_AT_ONCE", 500)
    rng = np.random.default_rng(4)
    points, normals = samples_on(FEATURES, 100, rng)
    sweeps = random_sweeps(200, 0.1, rng)
    one, many = (
        measure_pairs(SCANNER, U_MAX, occluder_of(FEATURES), points, normals, sweeps, n_threads=n) for n in (1, 4)
    )
    for name in ("sweep", "point", "uncertainty", "travel", "cause"):
        assert getattr(one, name).tobytes() == getattr(many, name).tobytes()


def test_points_measured_by_any_sweep_are_those_with_an_entry() -> None:
    rng = np.random.default_rng(6)
    points, normals = samples_on(FEATURES, 200, rng)
    sweeps = random_sweeps(300, 0.1, rng)
    occluder = occluder_of(FEATURES)
    found = measure_pairs(SCANNER, 60e-6, occluder, points, normals, sweeps)
    expected = np.isin(np.arange(200), found.point)
    assert 0 < expected.sum() < 200
    np.testing.assert_array_equal(measured_by_any(SCANNER, 60e-6, occluder, points, normals, sweeps), expected)


def test_the_travel_range_spans_the_measured_points() -> None:
    points = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.1, 0, 0]])
    sweeps = looking_down((0.05, 0.0, 0.182), (0.0, 0.0, 0.5))
    found = measure_pairs(SCANNER, U_MAX, occluder_of(PLATE), points, np.repeat(UP, 3, axis=0), sweeps)
    first, last = found.travel_range(2)
    np.testing.assert_allclose(first, [-0.05, np.nan])
    np.testing.assert_allclose(last, [0.15, np.nan])


def test_progress_ends_at_one() -> None:
    shares: list[float] = []
    points = np.zeros((1, 3))
    measure_pairs(SCANNER, U_MAX, Occluder(), points, UP, looking_down((0.0, 0.0, 0.182)), progress=shares.append)
    assert shares == [1.0]
