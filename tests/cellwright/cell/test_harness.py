from __future__ import annotations

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.harness import DesignJoint, Harness, X, Z, fixed, fixed_distance, planar, wall_following
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.errors import InvalidInputError


def random_harness(seed: int) -> Harness:
    rng = np.random.default_rng(seed)
    joints = [
        DesignJoint(f"j{n}", bool(rng.integers(2)), rng.normal(size=3), -1.0, 2.0, random_pose(rng))
        for n in range(rng.integers(0, 5))
    ]
    return Harness(tuple(joints), random_pose(rng))


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return pose(rng.normal(size=3), rotation_from_rpy(*rng.uniform(-3, 3, 3)))


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_numbers_and_symbols_are_the_same(seed: int) -> None:
    harness = random_harness(seed)
    values = np.random.default_rng(seed).uniform(harness.lower, harness.upper)
    x = casadi.SX.sym("x", harness.n_joints)
    symbolic = np.asarray(casadi.Function("pose", [x], [harness.symbolic_pose(x)])(values))
    np.testing.assert_allclose(harness.poses(values), symbolic, atol=1e-13)
    np.testing.assert_array_equal(harness.fixed_at(values).poses(np.zeros(0)), harness.poses(values))


def test_a_planar_station_goes_where_its_joints_say() -> None:
    harness = planar((-1, 1), (-2, 2), z=(0, 1))
    assert harness.names == ("x", "y", "z", "turn")
    expected = pose(np.array([0.5, -1.0, 0.25]), rotation_from_rpy(0, 0, 0.7))
    np.testing.assert_allclose(harness.poses(np.array([0.5, -1.0, 0.25, 0.7])), expected, atol=1e-15)
    np.testing.assert_allclose(planar((0, 1), (0, 1), z=(0.3, 0.3)).poses(np.zeros(3))[2, 3], 0.3)


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_a_fixed_distance_stays_fixed(around: float, turn: float) -> None:
    centre = np.array([1.0, 2.0, 0.5])
    T = fixed_distance(centre, 0.8).poses(np.array([around, turn]))
    assert np.linalg.norm(T[:3, 3] - centre) == pytest.approx(0.8)
    assert T[2, 3] == 0.5


def test_a_station_on_a_wall_slides_along_it_and_faces_the_room() -> None:
    harness = wall_following(np.array([0.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0]), 0.3)
    T = harness.poses(np.array([1.5]))
    # the room lies on the left of the way from start to end
    np.testing.assert_allclose(T[:3, 0], [-1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [-0.3, 1.5, 0.0], atol=1e-12)
    assert harness.upper[0] == 2.0


def test_an_empty_range_is_named_with_its_gap() -> None:
    with pytest.raises(InvalidInputError, match=r"'x' has an empty range.* 0.25 m above"):
        DesignJoint("x", False, X, 0.75, 0.5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DesignJoint("a", True, np.zeros(3), 0, 1), "direction"),
        (lambda: DesignJoint("a", True, Z, 0, np.inf), "finite"),
        (lambda: Harness((DesignJoint("a", True, Z, 0, 1), DesignJoint("a", False, Z, 0, 1))), "own name"),
        (lambda: fixed(np.eye(3)), "4 x 4"),
        (lambda: wall_following(np.zeros(3), np.array([0, 0, 1.0])), "horizontal"),
        (lambda: fixed_distance(np.zeros(3), -1.0), "negative"),
    ],
)
def test_what_makes_no_harness_is_refused(make: object, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        make()  # type: ignore[operator]
