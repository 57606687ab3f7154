"""Charts are PNG that open, show what they are given, and are the same bytes for the same data."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cellwright.arrays import AnyArray
from cellwright.figures.charts import plan_chart, uncertainty_histogram
from cellwright.figures.study_charts import study_chart

RED, GREEN, BLUE = (209, 73, 91), (228, 243, 235), (63, 167, 214)


def pixels(png: bytes) -> AnyArray:
    with Image.open(io.BytesIO(png)) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def share(png: bytes, colour: tuple[int, int, int], off: int = 6) -> float:
    """Return the share of the pixels that have a colour, or nearly."""
    return float((np.abs(pixels(png) - colour).max(axis=-1) <= off).mean())


def plan(
    joints: tuple[str, ...] = ("pan", "lift"),
    segments: Any = ((0.0, 1.0, False), (1.0, 2.0, True)),
    **torques: AnyArray,
) -> bytes:
    time = np.linspace(0, 2, 50)
    position = np.stack([np.sin(time + row) for row in range(len(joints))], axis=1)
    velocity = np.gradient(position, time, axis=0)
    return plan_chart(time, position, velocity, np.full(len(joints), 2.0), joints, segments, **torques)


def test_the_histogram_shows_bars_and_the_permitted_limit() -> None:
    png = uncertainty_histogram(np.random.default_rng(0).uniform(20e-6, 90e-6, 500).astype(np.float32), 100e-6)
    assert pixels(png).shape == (396, 880, 3)
    assert share(png, BLUE) > 0.05
    assert share(png, RED) > 1e-3


@pytest.mark.parametrize("values", [[], [np.nan, np.nan]])
def test_nothing_measured_is_an_empty_histogram(values: list[float]) -> None:
    png = uncertainty_histogram(np.array(values, np.float32), 100e-6)
    assert share(png, BLUE) == 0
    assert share(png, RED) > 1e-3


def test_sweeps_stand_on_coloured_ground() -> None:
    assert pixels(plan()).shape == (616, 1320, 3)
    half, none = share(plan(), GREEN, 2), share(plan(segments=((0.0, 2.0, False),)), GREEN, 2)
    whole = share(plan(segments=((0.0, 2.0, True),)), GREEN, 2)
    assert none == 0
    assert whole / 2 == pytest.approx(half, rel=0.1)


def test_torques_stand_in_a_further_panel_as_shares_of_their_limits() -> None:
    torque, limits = np.outer(np.linspace(0.0, 40.0, 50), [1.0, -0.5]), np.array([50.0, 25.0])
    told = plan(torque=torque, max_torque=limits)
    assert pixels(told).shape == (924, 1320, 3)
    assert share(told, RED) == pytest.approx(4 / 3 * share(plan(), RED), rel=0.1), "each panel has its line of limits"
    assert plan(torque=2 * torque, max_torque=2 * limits) == told
    assert plan(torque=np.zeros((50, 0)), max_torque=limits) == plan()


def test_torques_above_their_limits_are_seen_above_the_line() -> None:
    torque, limits = np.outer(np.linspace(0.0, 40.0, 50), [1.0, -0.5]), np.array([50.0, 25.0])
    rows = []
    for factor in (1, 5):
        red = np.abs(pixels(plan(torque=factor * torque, max_torque=limits)) - RED).max(axis=-1) <= 60
        rows.append(np.flatnonzero(red.sum(axis=1) > 1000))
    assert rows[0][0] == rows[1][0], "the speeds' line stays"
    assert rows[1][-1] > rows[0][-1] + 150, "four times its limit needs the room above it"


@pytest.mark.parametrize("names", [("_hidden", "$x$"), ("$", "a_b^c"), ("\\frac", "%d")])
def test_names_are_shown_as_they_are(names: tuple[str, ...]) -> None:
    # an underscore in front would leave the name out of the legend, a dollar sign would begin a formula
    assert plan(names) != plan(("", ""))


def test_equal_data_are_equal_bytes() -> None:
    assert plan() == plan()
    assert b"matplotlib" not in plan()[:2000].lower()


ROWS = [
    {"density": density, "tilting": tilting, "sweeps": sweeps + run + 5 * (tilting == "on"), "coverage": None}
    for density, sweeps in (("1", 4), ("10", 8))
    for tilting in ("off", "on")
    for run in (0, 2)
]
AXES = {"density": ("1", "10"), "tilting": ("off", "on")}


def study(**changes: Any) -> bytes:
    settings: dict[str, Any] = {
        "title": "Sweeps", "x": "density", "y": "sweeps", "y_label": "sweeps", "lines": "tilting", "panels": None,
        "log": False, "factor": 1.0, "published": [], "rows": ROWS,
    }  # fmt: skip
    settings.update(changes)
    return study_chart(settings.pop("rows"), settings.pop("published"), AXES, **settings)


def test_a_study_draws_a_line_for_each_point_of_an_axis() -> None:
    both, one = study(), study(rows=[row for row in ROWS if row["tilting"] == "on"])
    first, second = (42, 157, 92), (224, 122, 31)
    assert share(both, first) > 2e-4 < share(both, second)
    assert share(one, second) > 2e-4
    assert share(one, first) < share(both, first)


def test_panels_stand_side_by_side() -> None:
    assert pixels(study(lines=None, panels="tilting")).shape[1] > 1.7 * pixels(study(lines=None)).shape[1]


def test_published_values_stand_beside_ours() -> None:
    plain = study()
    assert study(published=[{"density": "1", "tilting": "on", "sweeps": 9}]) != plain
    assert study(published=[{"density": "1", "sweeps": 9}]) != plain, "it holds for all lines"
    assert study(published=[{"density": "1", "coverage": 9}]) == plain
    assert study(published=[{"density": "5", "sweeps": 9}]) == plain


def test_a_study_without_any_result_draws_empty_axes() -> None:
    assert pixels(study(rows=[], log=True)).shape[0] > 300
    assert pixels(study(y="coverage")).shape[0] > 300


def test_a_study_says_how_many_runs_have_no_value() -> None:
    failed = {"density": "1", "tilting": "on", "error": "out of reach"}
    assert study(rows=[*ROWS, failed]) != study(), "the heading counts the run without a value"
