"""A layout is the best of its gated starts; where none passes, what blocks it and the smallest relaxation are kept."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellwright.errors import InvalidInputError
from flows.layout_requests import LayoutRequest, layout_request
from schemas.artefact import digest
from schemas.layout import Layout
from schemas.layout_file import LayoutFile
from schemas.layout_objects import build_problem, drawn, drawn_before
from schemas.layout_summary import refusal_of
from tasks.optimise_layout import optimise_layout
from tests.small_layout import CYCLE_S, SPEED_RAD_S, TURN_RAD, document, table
from tests.tasks.goldens import check_golden, rounded


def request(**changes: Any) -> LayoutRequest:
    return layout_request(LayoutFile.model_validate(document(**changes), context={"folder": Path()}))


def solved(**changes: Any) -> Layout:
    found: Layout = optimise_layout(None, None, None, params=request(**changes).layout)
    return found


@cache
def two_tables() -> Layout:
    return solved()


def test_two_tables_come_as_near_as_their_discs_allow() -> None:
    layout = two_tables()
    assert layout.converged and layout.blocking == "" and len(layout.requirement) == 0
    assert layout.cycle_s == pytest.approx(CYCLE_S, rel=2e-3)
    apart = (layout.value[1] - layout.value[0] + np.pi) % (2.0 * np.pi) - np.pi
    assert abs(apart) == pytest.approx(TURN_RAD, rel=2e-3)


def test_all_starts_are_kept_and_the_best_is_the_layout() -> None:
    layout = two_tables()
    assert len(layout.trial_cycle_s) == 2 and layout.trial_converged.all()
    assert layout.cycle_s == layout.trial_cycle_s.min() == layout.trial_cycle_s[layout.best_start]


def test_motions_pass_the_gate_that_stands_beside_them() -> None:
    layout = two_tables()
    assert (layout.found <= layout.permitted).all()
    for motion in drawn(layout).transitions:
        rates = np.abs(np.diff(motion.q, axis=0)) / np.diff(motion.times_s)[:, None]
        assert (rates <= layout.joint_speed * (1.0 + 1e-5)).all()
        assert (motion.q >= layout.joint_lower - 1e-9).all() and (motion.q <= layout.joint_upper + 1e-9).all()
    assert sum(motion.duration_s for motion in drawn(layout).transitions) == pytest.approx(layout.cycle_s)


def test_bodies_stand_where_their_design_joints_put_them() -> None:
    layout = two_tables()
    problem = build_problem(request().layout.problem, None, None, None)
    np.testing.assert_allclose(
        layout.T_world_body.reshape(-1, 4, 4)[1:], problem.station_poses(layout.value), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.norm(layout.T_world_body.reshape(-1, 4, 4)[1:, :2, 3], axis=1), 0.9)


def test_the_same_request_gives_the_same_bytes() -> None:
    assert digest(solved()) == digest(two_tables())


def test_the_first_start_may_be_the_placed_one() -> None:
    apart = table("red", pose={"rotation": ["0 deg", "0 deg", "90 deg"]})
    layout = solved(stations=[table("blue"), apart], solver={"starts": 1, "begin": "placed"})
    assert layout.converged
    np.testing.assert_array_equal(layout.before, [0.0, 0.0])
    assert layout.before_cycle_s == pytest.approx(2.0 * (np.pi / 2.0) / SPEED_RAD_S, rel=1e-6)


def test_a_placed_start_that_overlaps_is_refused_with_its_depth() -> None:
    with pytest.raises(InvalidInputError, match=r"blue and red overlap by 0\.4 m: move them apart by that"):
        solved(solver={"begin": "placed"})


def test_acceleration_limits_make_the_cycle_that_of_two_trapezoids() -> None:
    layout = solved(solver={"starts": 1, "method": "second_order"})
    acceleration = 6.0  # of the robot's revolute joint: 1.5 rad/s are reached in 0.25 s
    expected = 2.0 * 2.0 * np.sqrt(TURN_RAD / acceleration)
    if TURN_RAD * acceleration >= SPEED_RAD_S**2:
        expected = 2.0 * (TURN_RAD / SPEED_RAD_S + SPEED_RAD_S / acceleration)
    assert layout.converged and np.isfinite(layout.velocity).all()
    assert layout.cycle_s == pytest.approx(expected, rel=5e-3)


def test_with_acceleration_limits_the_layout_before_is_drawn_as_smoothly_as_the_one_after() -> None:
    apart = table("red", pose={"rotation": ["0 deg", "0 deg", "90 deg"]})
    layout = solved(stations=[table("blue"), apart], solver={"starts": 1, "begin": "placed", "method": "second_order"})
    (there, back) = drawn_before(layout).transitions
    assert there.velocity is not None and back.velocity is not None
    np.testing.assert_array_equal(there.velocity[[0, -1]], 0.0)
    # a cubic share of the way would be 1/32 after an eighth of the time, a straight line 1/8
    share = (there.at(np.array([0.125 * there.duration_s])) - there.q[0])[0, 0] / (there.q[-1] - there.q[0])[0]
    assert share < 0.1


def test_a_layout_before_that_overlaps_is_no_cycle_to_compare_with() -> None:
    joints = [
        {"name": "around", "turn": "z", "range": ["-5 deg", "5 deg"]},
        {"offset": {"position": ["0.9 m", "0 m", "0 m"]}},
    ]
    layout = solved(
        stations=[table("blue", harness={"joints": joints}), table("red", harness={"joints": joints})],
        solver={"starts": 1},
    )
    assert np.isnan(layout.before_cycle_s)
    assert "blue and red overlap" in layout.before_blocking


def test_a_station_out_of_reach_is_named_with_what_it_lacks() -> None:
    far = table("red", harness=None, pose={"position": ["1.5 m", "0 m", "0 m"]})
    layout = solved(stations=[table("blue"), far], solver={"starts": 1})
    assert not layout.converged
    assert layout.requirement[0] == "red is out of reach"
    assert layout.excess[0] == pytest.approx(0.3, abs=0.01)  # the tool reaches 1.2 m
    assert "red is out of reach (relax it by 3" in refusal_of(layout, sought=True)


def test_extras_may_be_left_out() -> None:
    far = table("red", harness=None, pose={"position": ["1.5 m", "0 m", "0 m"]})
    layout = solved(stations=[table("blue"), far], solver={"starts": 1, "extras": False})
    assert not layout.converged and layout.requirement == () and np.isnan(layout.before_cycle_s)


def test_the_result_is_the_one_of_this_version() -> None:
    # where the pair stands about the robot is nobody's choice, and how many steps a program takes neither
    layout = two_tables()
    loose = ("value", "T_world_body", "approach_position", "found", "trial_endpoint_m", "trial_penetration_m")
    blank = {name: np.zeros_like(getattr(layout, name)) for name in (*loose, "trial_iterations")}
    states = ("transition", "time_s", "position", "velocity", "before_transition", "before_time_s")
    states += ("before_position", "before_velocity")
    empty = {name: getattr(layout, name)[:0] for name in states}
    facts = {name: round(getattr(layout, name), 3) for name in ("cycle_s", "transition_s", "before_cycle_s")}
    check_golden(optimise_layout, rounded(layout, 3, **blank, **empty, **facts, best_start=0))
