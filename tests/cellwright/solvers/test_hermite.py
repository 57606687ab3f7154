from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import CubicHermiteSpline

from cellwright.solvers.hermite import (
    interval_states,
    peak_acceleration,
    peak_velocity,
    position_extremes,
    states_at,
    subdivide,
)

NUMBER = st.floats(-10.0, 10.0, allow_subnormal=False)
STATES = st.tuples(
    arrays(float, 4, elements=st.floats(0.05, 2.0)),
    arrays(float, (4, 2), elements=NUMBER),
    arrays(float, (4, 2), elements=NUMBER),
)


@given(STATES)
@settings(max_examples=60, deadline=None)
def test_the_extremes_are_those_of_a_dense_sampling_of_scipys_spline(states):
    gaps, position, velocity = states
    time = np.cumsum(gaps)
    spline = CubicHermiteSpline(time, position, velocity)
    low, high = position_extremes(time, position, velocity)
    fastest, hardest = peak_velocity(time, position, velocity), peak_acceleration(time, position, velocity)
    for i in range(len(time) - 1):
        dense = np.linspace(time[i], time[i + 1], 2001)
        inside = dense[:-1]
        p, v, a = spline(dense), spline(dense, 1), spline(inside, 2)
        scale = 1e-9 + np.abs(a).max() * (dense[1] - dense[0])
        assert np.all(low[i] <= p.min(axis=0) + 1e-9) and np.all(low[i] >= p.min(axis=0) - scale)
        assert np.all(high[i] >= p.max(axis=0) - 1e-9) and np.all(high[i] <= p.max(axis=0) + scale)
        assert fastest[i] == pytest.approx(np.abs(v).max(axis=0), abs=2 * scale)
        assert np.all(fastest[i] >= np.abs(v).max(axis=0) - 1e-7)
        assert hardest[i] == pytest.approx(np.abs(a).max(axis=0), rel=2e-3, abs=1e-3)


@given(STATES, st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_states_between_are_those_of_scipys_spline(states, share):
    gaps, position, velocity = states
    time = np.cumsum(gaps)
    at = np.array([time[0] + share * (time[-1] - time[0]), time[0], time[-1]])
    spline = CubicHermiteSpline(time, position, velocity)
    p, v = states_at(time, position, velocity, at)
    assert p == pytest.approx(spline(at), abs=1e-9)
    assert v == pytest.approx(spline(at, 1), abs=1e-6)


@given(STATES, st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_states_of_intervals_are_those_of_scipys_spline_accelerations_too(states, share):
    gaps, position, velocity = states
    time = np.cumsum(gaps)
    found = interval_states(time, position, velocity, np.array([0.0, share, 1.0]))
    for i in range(len(time) - 1):
        both = slice(i, i + 2)
        spline = CubicHermiteSpline(time[both], position[both], velocity[both])
        at = time[i] + np.array([0.0, share, 1.0]) * (time[i + 1] - time[i])
        for derivative, values in enumerate(found):
            assert values[i] == pytest.approx(spline(at, derivative), rel=1e-7, abs=1e-4 * 10.0**derivative)


@given(arrays(float, 5, elements=st.floats(0.01, 3.0)), arrays(np.int64, 4, elements=st.integers(1, 7)))
def test_cutting_keeps_all_times_and_makes_equal_parts(gaps, parts):
    time = np.cumsum(gaps)
    cut = subdivide(time, parts)
    assert len(cut) == parts.sum() + 1
    assert np.all(np.isin(time, cut))
    assert np.diff(cut) == pytest.approx(np.repeat(np.diff(time) / parts, parts), rel=1e-6)
