import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from cellwright.cell import harness as mechanisms
from cellwright.cell.transforms import pose, rotation_from_rpy
from schemas.cell_file_harness import HarnessSection

AT = pose(np.array([0.7, 0.1, 0.3]), rotation_from_rpy(0.1, 0.2, 0.3))


def read(**keys: Any) -> HarnessSection:
    return HarnessSection.model_validate(keys)


def refused(**keys: Any) -> str:
    with pytest.raises(ValidationError) as caught:
        read(**keys)
    return str(caught.value.errors()[0]["msg"])


@settings(deadline=None)  # the first call loads the kinematics
@given(st.tuples(*[st.floats(-0.2, 0.2)] * 3))
def test_planar_is_two_slides_and_a_turn(values: tuple[float, float, float]) -> None:
    section = read(planar={"x": ["-200 mm", "200 mm"], "y": ["-20 cm", "0.2 m"], "yaw": ["-90 deg", "90 deg"]})
    ours = section.harness(T_last_carried=AT)
    theirs = mechanisms.planar((-0.2, 0.2), (-0.2, 0.2), (-math.pi / 2, math.pi / 2), T_last_carried=AT)
    assert ours.names == ("x", "y", "yaw")
    np.testing.assert_allclose(ours.lower, theirs.lower)
    np.testing.assert_allclose(ours.upper, theirs.upper)
    np.testing.assert_allclose(ours.poses(np.array(values)), theirs.poses(np.array(values)), atol=1e-15)


@settings(deadline=None)  # the first call loads the kinematics
@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_a_turn_and_an_offset_keep_a_fixed_distance(around: float, turn: float) -> None:
    section = read(
        joints=[
            {"offset": {"position": ["100 mm", "0 mm", "0 mm"]}},
            {"turn": "z", "range": ["-90 deg", "90 deg"], "name": "around"},
            {"offset": {"position": ["600 mm", "0 mm", "0 mm"]}},
            {"turn": "z", "range": ["-90 deg", "90 deg"]},
        ]
    )
    harness = section.harness()
    expected = mechanisms.fixed_distance(np.array([0.1, 0.0, 0.0]), 0.6).poses(np.array([around, turn]))
    assert harness.names == ("around", "turn z")
    found = harness.poses(np.array([around, turn]))
    np.testing.assert_allclose(found, expected, atol=1e-15)
    assert math.hypot(found[0, 3] - 0.1, found[1, 3]) == pytest.approx(0.6)


@settings(deadline=None)  # the first call loads the kinematics
@given(st.floats(0.0, 1.5))
def test_a_slide_behind_a_turned_offset_follows_a_wall(along: float) -> None:
    start, end = np.array([0.5, -0.5, 0.0]), np.array([0.5, 1.0, 0.0])
    section = read(
        joints=[
            {"offset": {"position": ["500 mm", "-500 mm", "0 mm"], "rotation": ["0 deg", "0 deg", "180 deg"]}},
            {"slide": [0, -1, 0], "range": ["0 mm", "1.5 m"]},
            {"offset": {"position": ["300 mm", "0 mm", "0 mm"]}},
        ]
    )
    expected = mechanisms.wall_following(start, end, from_wall=0.3)
    np.testing.assert_allclose(
        section.harness().poses(np.array([along])), expected.poses(np.array([along])), atol=1e-12
    )


def test_joints_without_a_name_are_told_apart() -> None:
    slide = {"slide": "x", "range": ["0 mm", "1 mm"]}
    assert read(joints=[slide, slide, slide | {"name": "slide x 2"}]).harness().names == (
        "slide x",
        "slide x 3",
        "slide x 2",
    )


def test_the_root_comes_before_all_joints() -> None:
    section = read(planar={"x": ["-1 m", "1 m"]})
    np.testing.assert_allclose(section.harness(AT).poses(np.array([0.5]))[:3, 3], AT[:3, 3] + 0.5 * AT[:3, 0])


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "a harness has no joint that moves: give it planar or joints with a range"),
        ({"planar": {}}, "planar has no range: give it at least one of x, y, yaw"),
        (
            {"planar": {"x": ["200 mm", "-200 mm"]}},
            "is reversed, from 200 mm to -200 mm, its lower end 400 mm above its upper end: write [-200 mm, 200 mm]",
        ),
        (
            {"planar": {"yaw": ["5 deg", "5 deg"]}},
            "is empty, from 5 deg to 5 deg, 0 deg wide: any width above that makes it a range, or leave it "
            "out to hold still",
        ),
        ({"planar": {"x": ["-200", "200 mm"]}}, "'-200' has no unit but a length needs one: write -200 mm"),
        (
            {"planar": {"x": ["-1 mm", "2 mm", "3 mm"]}},
            "has 3 entries but a range has two ends: write it like [-200 mm, 200 mm]",
        ),
        (
            {"planar": {"yaw": "90 deg"}},
            "'90 deg' is not a range: write its two ends, like [-90 deg, 90 deg]",
        ),
        (
            {"joints": [{"slide": "x", "range": ["-5 deg", "5 deg"]}]},
            "'-5 deg' is not a length: write it in mm, um, cm, m or in",
        ),
        (
            {"joints": [{"turn": "z", "range": ["-5 mm", "5 mm"]}]},
            "'-5 mm' is not an angle: write it in deg or rad",
        ),
        ({"joints": [{"slide": "x"}]}, "a joint that slides has no range: write range: [-200 mm, 200 mm]"),
        ({"joints": [{"turn": "z"}]}, "a joint that turns has no range: write range: [-90 deg, 90 deg]"),
        (
            {"joints": [{"slide": "x", "turn": "z", "range": ["-5 mm", "5 mm"]}]},
            "an element of a harness has slide and turn: give it one of slide, turn, offset",
        ),
        (
            {"joints": [{"range": ["-5 mm", "5 mm"]}]},
            "an element of a harness has nothing that moves: give it one of slide, turn, offset",
        ),
        (
            {"joints": [{"slide": "u", "range": ["-5 mm", "5 mm"]}]},
            "'u' is not an axis: write x, y, z or a direction like [1, 1, 0]",
        ),
        (
            {"joints": [{"slide": [0, 0, 0], "range": ["-5 mm", "5 mm"]}]},
            "[0, 0, 0] has no direction: write x, y, z or one like [1, 1, 0]",
        ),
        (
            {"joints": [{"slide": [1, 0], "range": ["-5 mm", "5 mm"]}]},
            "has 2 entries but a direction has 3: write x, y, z or [dx, dy, dz]",
        ),
        (
            {"joints": [{"offset": {"position": ["1 mm", "0 mm", "0 mm"]}}]},
            "a harness has no joint that moves: give it planar or joints with a range",
        ),
        (
            {"planar": {"x": ["-1 mm", "1 mm"]}, "joints": [{"slide": "x", "range": ["-5 mm", "5 mm"]}]},
            "planar and joints are both given: keep one",
        ),
        (
            {"joints": [{"name": "a", "slide": "x", "range": ["-5 mm", "5 mm"]}] * 2},
            "two joints are named 'a': give each its own name",
        ),
    ],
)
def test_what_cannot_move_is_refused_with_the_mend(keys: dict[str, Any], message: str) -> None:
    assert refused(**keys) == message
