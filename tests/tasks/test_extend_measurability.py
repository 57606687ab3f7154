from __future__ import annotations

import numpy as np
import pytest

from cellwright.errors import InvalidInputError
from schemas.artefact import digest
from schemas.views import CoverageGaps, Measurability
from tasks.extend_measurability import ExtensionParams, extend_measurability
from tests.tasks.goldens import check_golden
from tests.tasks.plate_scene import nothing_around, plate, points_on_top, reached, views_down

CLOUD = points_on_top((0.0, 0.0), (0.09, 0.0), (0.0, 0.1), (0.0, 0.19), (0.02, 0.1))
VIEWS = views_down((0.0, 0.0), (0.0, 0.1), (0.0, 0.0))
REACHED = reached(3, (0, -0.05, 0.05), (0, 0.05, 0.2), (1, -0.01, 0.05), (2, 0.0, 0.1))
BEFORE = Measurability(
    view=np.array([0, 0, 2], np.int32),
    sample=np.array([0, 1, 1], np.int32),
    uncertainty_m=np.array([4e-5, 5e-5, 6e-5], np.float32),
    start_m=np.array([-0.01, np.nan, 0.02]),
    end_m=np.array([0.01, np.nan, 0.03]),
    cause=np.array([0, 0, 4], np.int8),
)


def gaps_at(*points: int) -> CoverageGaps:
    return CoverageGaps(point=np.array(points, np.int32), n_checked=5, n_missed=len(points))


def extended(gaps: CoverageGaps, before: Measurability = BEFORE) -> Measurability:
    after = extend_measurability(
        plate(), nothing_around(), CLOUD, gaps, VIEWS, before, REACHED, params=ExtensionParams()
    )
    assert isinstance(after, Measurability)
    return after


def pairs(measurability: Measurability) -> list[tuple[int, int]]:
    return list(zip(measurability.view.tolist(), measurability.sample.tolist(), strict=True))


def test_gaps_become_rows_behind_the_samples_with_all_best_pieces_that_measure_them() -> None:
    after = extended(gaps_at(1, 2))
    assert pairs(after) == [(0, 0), (0, 1), (1, 4), (2, 1), (2, 3)]
    assert after.cause.tolist() == [0, 0, 4, 0, 0]
    np.testing.assert_allclose(after.start_m, [-0.01, 0.0, 0.02], atol=1e-15)
    np.testing.assert_allclose(after.end_m, [0.01, 0.0, 0.09], atol=1e-15)
    kept = [0, 1, 3]
    np.testing.assert_array_equal(after.uncertainty_m[kept], BEFORE.uncertainty_m)


def test_a_second_round_appends_and_keeps_the_first() -> None:
    once, twice = extended(gaps_at(1)), extended(gaps_at(2, 4), extended(gaps_at(1)))
    assert set(pairs(once)) < set(pairs(twice))
    assert set(pairs(twice)) - set(pairs(once)) == {(1, 4), (1, 5)}
    assert digest(twice) == digest(extended(gaps_at(1, 2, 4)))


def test_without_gaps_nothing_changes() -> None:
    assert digest(extended(gaps_at())) == digest(BEFORE)


def test_artefacts_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="gap 7 is not among the 5 points"):
        extended(gaps_at(7))
    with pytest.raises(InvalidInputError, match="3 views but there are 1"):
        extend_measurability(
            plate(),
            nothing_around(),
            CLOUD,
            gaps_at(1),
            views_down((0.0, 0.0)),
            BEFORE,
            REACHED,
            params=ExtensionParams(),
        )


def test_the_result_is_the_one_of_this_version() -> None:
    check_golden(extend_measurability, extended(gaps_at(1, 2)))
