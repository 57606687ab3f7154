from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.solvers.sweeps.poses import sort_within


@settings(deadline=None)
@given(st.lists(st.lists(st.floats(-1.0, 1.0), max_size=40), max_size=8))
def test_runs_are_sorted_each_by_itself(runs: list[list[float]]) -> None:
    values = np.array([value for run in runs for value in run], float)
    sort_within(np.cumsum([0, *map(len, runs)]), values)
    assert values.tolist() == [value for run in runs for value in sorted(run)]


@pytest.mark.parametrize("order", ["random", "falling", "rising", "equal"])
def test_long_runs_are_sorted_too(order: str) -> None:
    n = 5000
    values = {
        "random": np.random.default_rng(0).uniform(-1.0, 1.0, n),
        "falling": np.linspace(1.0, -1.0, n),
        "rising": np.linspace(-1.0, 1.0, n),
        "equal": np.zeros(n),
    }[order]
    expected = np.concatenate([values[:7], np.sort(values[7:-3]), values[-3:]])
    sort_within(np.array([7, n - 3]), values)
    assert np.array_equal(values, expected)
