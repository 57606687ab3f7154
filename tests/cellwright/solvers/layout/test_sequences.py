from __future__ import annotations

import itertools
import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.sequences import StepMetric, cheapest_sums, cheapest_walk


def instance(seed: int, n_visits: int, cyclic: bool) -> tuple[FloatArray, FloatArray, list[tuple[int, int]]]:
    """Random candidates of a few layouts, some of them missing, and the transitions between the visits."""
    rng = np.random.default_rng(seed)
    first = rng.uniform(-math.pi, math.pi, (5, n_visits, 3, 2))
    last = first + rng.normal(0.0, 0.3, first.shape)
    gone = rng.random(first.shape[:3]) < 0.3
    first[gone], last[gone] = np.nan, np.nan
    pairs = [(visit, visit + 1) for visit in range(n_visits - 1)]
    return first, last, [*pairs, (n_visits - 1, 0)] if cyclic else pairs


def by_trying_all(metric: StepMetric, first: FloatArray, last: FloatArray, pairs: list[tuple[int, int]]) -> float:
    missing = np.asarray(np.isnan(first[:, :, 0]).all(axis=1))
    best = math.inf
    for choice in itertools.product(range(first.shape[1]), repeat=len(first)):
        total = 0.0
        for visit, candidate in enumerate(choice):
            if not missing[visit] and math.isnan(first[visit, candidate, 0]):
                total = math.inf
        for start, end in pairs:
            if not missing[start] and not missing[end] and total < math.inf:
                total += float(metric.steps(last[start, choice[start]], first[end, choice[end]]))
        best = min(best, total)
    return best


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n_visits=st.integers(2, 4),
    cyclic=st.booleans(),
    slowest=st.booleans(),
    circular=st.booleans(),
)
def test_sums_and_walks_are_those_of_trying_everything(
    seed: int, n_visits: int, cyclic: bool, slowest: bool, circular: bool
) -> None:
    metric = StepMetric(np.array([1.0, 0.4]), np.array([circular, False]), slowest)
    first, last, pairs = instance(seed, n_visits, cyclic)
    sums = cheapest_sums(metric, first, last, pairs, cyclic=cyclic)
    for row in range(len(first)):
        wanted = by_trying_all(metric, first[row], last[row], pairs)
        np.testing.assert_allclose(sums[row], wanted, rtol=1e-12)
        walk, value = cheapest_walk(metric, first[row], last[row], pairs, cyclic=cyclic)
        np.testing.assert_allclose(value, wanted, rtol=1e-12)
        taken = [float(metric.steps(last[row, start, walk[start]], first[row, end, walk[end]])) for start, end in pairs]
        counted = [each for each in taken if math.isfinite(each)]
        np.testing.assert_allclose(math.fsum(counted), wanted, rtol=1e-12)


def test_a_circular_joint_takes_the_short_way_round() -> None:
    metric = StepMetric(np.ones(1), np.array([True]), True)
    assert metric.steps(np.array([3.0]), np.array([-3.0])) == 2.0 * math.pi - 6.0


def test_the_number_of_layouts_at_once_changes_nothing() -> None:
    rng = np.random.default_rng(4)
    q = rng.uniform(-1.0, 1.0, (47, 3, 4, 2))
    metric, pairs = StepMetric(np.ones(2), np.zeros(2, bool), False), [(0, 1), (1, 2), (2, 0)]
    whole = cheapest_sums(metric, q, q, pairs, cyclic=True)
    alone = np.concatenate([cheapest_sums(metric, q[[row]], q[[row]], pairs, cyclic=True) for row in range(47)])
    assert whole.tobytes() == alone.tobytes()
