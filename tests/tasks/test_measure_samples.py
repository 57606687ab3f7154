from __future__ import annotations

import numpy as np

from cellwright.causes import Cause
from schemas.artefact import digest
from schemas.scanner import ScannerParams
from tasks.measure_samples import MeasurabilityParams, measure_samples
from tests.tasks.goldens import check_golden
from tests.tasks.plate_scene import nothing_around, plate, points_on_top, screen_above, views_down


def test_entries_travels_and_causes_of_a_plate() -> None:
    samples = points_on_top((0.0, 0.0), (0.1, 0.02), (0.0, 0.19))
    found = measure_samples(
        plate(), nothing_around(), samples, views_down((0.05, 0.0), (0.0, -1.0)), params=MeasurabilityParams()
    )
    assert list(zip(found.view, found.sample, strict=True)) == [(0, 0), (0, 1)]
    np.testing.assert_allclose(found.start_m, [-0.05, np.nan])
    np.testing.assert_allclose(found.end_m, [0.05, np.nan])
    assert found.cause.tolist() == [Cause.NONE, Cause.NONE, Cause.FIELD_OF_VIEW]
    np.testing.assert_allclose(found.uncertainty_m, 40e-6 * np.hypot(1, [0.0, 0.02 / 0.182]), rtol=1e-6)


def test_the_limits_come_from_the_params() -> None:
    samples, views = points_on_top((0.0, 0.0)), views_down((0.0, 0.0))
    strict = measure_samples(
        plate(), nothing_around(), samples, views, params=MeasurabilityParams(max_uncertainty_m=30e-6)
    )
    assert strict.cause.tolist() == [Cause.UNCERTAINTY]
    near = ScannerParams(max_standoff_m=0.18, best_standoff_m=0.17)
    found = measure_samples(plate(), nothing_around(), samples, views, params=MeasurabilityParams(scanner=near))
    assert found.cause.tolist() == [Cause.FIELD_OF_VIEW]


def test_the_same_inputs_give_the_same_bytes_and_progress_reaches_one() -> None:
    samples, views = points_on_top((0.0, 0.0), (0.03, 0.01)), views_down((0.0, 0.0), (0.0, 0.05))
    shares: list[float] = []
    first = measure_samples(
        plate(), nothing_around(), samples, views, params=MeasurabilityParams(), progress=shares.append
    )
    assert digest(first) == digest(
        measure_samples(plate(), nothing_around(), samples, views, params=MeasurabilityParams())
    )
    assert shares[-1] == 1.0


def test_what_stands_around_the_part_blocks_sight() -> None:
    samples, views = points_on_top((0.0, 0.0), (0.15, 0.0)), views_down((0.0, 0.0), (0.15, 0.0))
    found = measure_samples(plate(), screen_above(0.1), samples, views, params=MeasurabilityParams())
    assert found.cause.tolist() == [Cause.EMITTER_OCCLUDED, Cause.NONE]
    above_the_scanner = measure_samples(plate(), screen_above(0.3), samples, views, params=MeasurabilityParams())
    assert above_the_scanner.cause.tolist() == [Cause.NONE, Cause.NONE]


def test_the_result_is_the_one_of_this_version() -> None:
    samples, views = points_on_top((0.0, 0.0), (0.1, 0.02), (0.0, 0.19)), views_down((0.05, 0.0), (0.0, -1.0))
    found = measure_samples(plate(), nothing_around(), samples, views, params=MeasurabilityParams())
    check_golden(measure_samples, found)
