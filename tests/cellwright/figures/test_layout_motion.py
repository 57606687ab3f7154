"""Charts of a layout: every joint has its panel, every start its bar; the best of n is the mean over all choices."""

from __future__ import annotations

import io
import itertools

import numpy as np
import pytest
from PIL import Image

from cellwright.figures.layout_charts import best_of_n_chart, expected_best
from cellwright.figures.layout_motion import motion_chart, starts_chart


def size_of(png: bytes) -> tuple[int, int]:
    return Image.open(io.BytesIO(png)).size


def test_every_joint_has_a_panel() -> None:
    time = np.linspace(0.0, 1.0, 5)
    heights = []
    for n in (2, 6):
        motion = ("there", time, np.outer(time, np.ones(n)))
        png = motion_chart(
            [motion], [f"joint $ {k}" for k in range(n)], np.arange(n) > 0, -np.ones(n), 2.0 * np.ones(n)
        )
        heights.append(size_of(png)[1])
    assert heights[1] > 2 * heights[0]


def test_starts_are_drawn_with_and_without_a_cycle_before() -> None:
    cycles, passed = np.array([1.0, 0.5, 2.0]), np.array([True, True, False])
    assert starts_chart(cycles, passed, 1.5) != starts_chart(cycles, passed, float("nan"))


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_the_expected_best_is_the_mean_over_all_choices(n: int) -> None:
    values = np.sort(np.random.default_rng(n).uniform(0.5, 2.0, 5))
    every = [min(choice) for choice in itertools.combinations(values.tolist(), n)]
    assert expected_best(values, n) == pytest.approx(np.mean(every))


def test_runs_that_missed_their_gate_take_part_as_never_best() -> None:
    assert expected_best(np.array([1.0, np.inf]), 1) == np.inf
    assert expected_best(np.array([1.0, np.inf]), 2) == 1.0
    assert size_of(best_of_n_chart({"ours": [1.0, np.inf, 0.5], "none": [np.inf] * 3}))[0] > 100
