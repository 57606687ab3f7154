from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cellwright.solvers.path_timing import Limits, time_path
from cellwright.solvers.stitched_plan import StitchSettings
from cellwright.solvers.sweeps.passing import ALL_ENDS, PASSING, STOPPING, PassedOption, passed_options
from tests.cellwright.solvers import scanning_cell

SETTINGS = StitchSettings(scan_speed=0.1, tool_acceleration=1.0, max_alternatives=2)


@cache
def options() -> list[list[PassedOption]]:
    return passed_options(scanning_cell.cell(), scanning_cell.sweeps(2), SETTINGS, at_speed=True)


def test_each_stop_costs_what_getting_to_speed_costs():
    for option in options()[0]:
        took = {ends: option.motions[ends].duration for ends in ALL_ENDS}
        length = abs(float(np.ptp(option.motions[PASSING].position[:, -1])))
        assert took[PASSING] == pytest.approx(length / 0.1, abs=2e-3)
        assert took[STOPPING] == pytest.approx(length / 0.1 + 0.1, abs=5e-3)  # 0.1 m/s at 1 m/s^2, twice half of it
        assert took[True, False] == pytest.approx(0.5 * (took[PASSING] + took[STOPPING]), abs=5e-3)


def test_an_end_is_at_rest_or_at_scanning_speed_as_it_says():
    for option in options()[1]:
        for (begins, ends), motion in option.motions.items():
            speed = np.abs(motion.velocity[[0, -1], -1])
            assert speed == pytest.approx([0.1 * begins, 0.1 * ends], rel=1e-6, abs=1e-12)


def test_all_timings_run_along_the_same_path():
    option = options()[0][0]
    stops = option.motions[STOPPING]
    for motion in option.motions.values():
        np.testing.assert_allclose(motion.position[[0, -1]], stops.position[[0, -1]], atol=1e-12)
        row = len(motion.time) // 2
        nearest = int(np.argmin(np.abs(stops.position[:, -1] - motion.position[row, -1])))
        np.testing.assert_allclose(stops.position[nearest], motion.position[row], atol=2e-3)


def test_both_directions_are_there():
    assert {option.direction for option in options()[0]} == {1, -1}
    assert all(option.passes for option in options()[0])


def test_without_speed_there_are_stops_alone():
    own = passed_options(scanning_cell.cell(), scanning_cell.sweeps(1), SETTINGS, at_speed=False)
    assert all(set(option.motions) == {STOPPING} and not option.passes for option in own[0])


def test_a_path_is_passed_as_fast_as_its_limits_allow():
    from scipy.interpolate import CubicSpline

    knots = np.linspace(0.0, 1.0, 11)
    path = CubicSpline(knots, np.column_stack([knots, 0.2 * knots]))
    limits = Limits(np.array([0.5, 1.0]), np.array([2.0, 2.0]))
    assert time_path(path, knots, limits, 0.01, (True, True)).duration == pytest.approx(2.0, rel=1e-6)
    assert time_path(path, knots, limits, 0.01).duration == pytest.approx(2.25, rel=0.01)
    one = time_path(path, knots, limits, 0.01, (True, False))
    assert one.velocity[0, 0] == pytest.approx(0.5, rel=1e-6) and one.velocity[-1].tolist() == [0.0, 0.0]
