"""What stands in the way of samples where there is no plan."""

from __future__ import annotations

import pytest

from cellwright.causes import Cause
from cellwright.errors import InvalidInputError
from schemas.findings import SampleFindings
from schemas.views import ViewSelection
from tasks.explain_samples import ExplanationParams, explain_samples
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.plate_scene import nothing_around, plate, points_on_top, reached, selected, views_down

SAMPLES = points_on_top((0.0, 0.0), (0.09, 0.0), (0.0, 0.1), (0.0, 0.19), (0.02, -0.1), (0.03, 0.0))
VIEWS = views_down((0.0, 0.0), (0.0, 0.1), (0.0, -0.1))
REACHED = reached(3, (0, -0.05, 0.05), (1, -0.01, 0.05), outcome=(0, 0, Cause.COLLISION), blocked_by=(-1, -1, 1))


def explained(selection: ViewSelection | None) -> SampleFindings:
    found = explain_samples(plate(), nothing_around(), SAMPLES, VIEWS, REACHED, selection, params=ExplanationParams())
    assert isinstance(found, SampleFindings)
    return found


def test_each_sample_has_the_furthest_test_that_a_candidate_brought_it() -> None:
    found = explained(None)
    assert [Cause(cause) for cause in found.cause.tolist()] == [
        Cause.NOT_SELECTED,  # view 0 would measure it
        Cause.TOO_SHORT,  # view 0 sees it, but its piece ends before
        Cause.NOT_SELECTED,
        Cause.FIELD_OF_VIEW,
        Cause.COLLISION,
        Cause.NOT_SELECTED,
    ]
    assert found.coverable.tolist() == [True, False, True, False, False, True]
    assert found.blocked_by.tolist() == [-1, -1, -1, -1, 1, -1]
    assert found.body[1] == "part"


def test_what_a_selected_sweep_would_measure_is_told_apart() -> None:
    found = explained(selected(0))
    assert [Cause(cause) for cause in found.cause[[0, 2, 5]].tolist()] == [
        Cause.NOT_SCANNED,
        Cause.NOT_SELECTED,
        Cause.NOT_SCANNED,
    ]


def test_the_result_is_the_one_of_this_version() -> None:
    check_golden(explain_samples, rounded(explained(selected(0))))


def test_artefacts_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="3 viewpoints but reachability knows 2"):
        explain_samples(plate(), nothing_around(), SAMPLES, VIEWS, reached(2), None, params=ExplanationParams())


def test_progress_rises_to_the_end() -> None:
    told: list[float] = []
    explain_samples(
        plate(), nothing_around(), SAMPLES, VIEWS, REACHED, None, params=ExplanationParams(), progress=told.append
    )
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0)
