from __future__ import annotations

import numpy as np
import pytest

from cellwright.causes import Cause
from cellwright.errors import InvalidInputError
from schemas.part import SurfaceSamples
from schemas.views import Coverage
from tasks.measure_coverage import CoverageParams, measure_coverage
from tests.tasks.goldens import check_golden
from tests.tasks.plan_artefacts import changed, trajectory
from tests.tasks.plate_scene import nothing_around, plate, points_on_top, reached, scanned, selected, views_down

CLOUD = points_on_top((0.0, 0.0), (0.09, 0.0), (0.0, 0.1), (0.0, 0.19), (0.02, -0.1), (0.03, 0.0))
VIEWS = views_down((0.0, 0.0), (0.0, 0.1), (0.0, -0.1))
REACHED = reached(3, (0, -0.05, 0.05), (1, -0.01, 0.05), outcome=(0, 0, Cause.COLLISION), blocked_by=(-1, -1, 1))


def covered(points: list[list[float]], cloud: SurfaceSamples = CLOUD, radius_m: float = 2e-3) -> Coverage:
    params = CoverageParams(radius_m=radius_m)
    scan = scanned(np.array(points).reshape(-1, 3))
    found = measure_coverage(plate(), nothing_around(), cloud, scan, VIEWS, REACHED, selected(0), params=params)
    assert isinstance(found, Coverage)
    return found


def test_measured_points_coverable_points_and_causes() -> None:
    found = covered([[0.0005, 0.001, 0.0], [0.0, 0.0, 0.0001]])
    assert found.measured.tolist() == [True, False, False, False, False, False]
    assert [Cause(cause) for cause in found.cause.tolist()] == [
        Cause.NONE,
        Cause.TOO_SHORT,  # view 0 sees it, but its piece ends before
        Cause.NOT_SELECTED,
        Cause.FIELD_OF_VIEW,
        Cause.COLLISION,
        Cause.NOT_SCANNED,
    ]
    assert found.coverable.tolist() == [True, False, True, False, False, True]
    assert found.blocked_by.tolist() == [-1, -1, -1, -1, 1, -1]
    assert found.body[1] == "part"
    assert found.uncertainty_m[0] == np.float32(4e-5) and np.isnan(found.uncertainty_m[1:]).all()
    assert found.share_measured == pytest.approx(1 / 6)
    assert found.share_of_coverable == pytest.approx(1 / 3)


def test_the_radius_decides_what_is_near_enough() -> None:
    assert not covered([[0.0, 0.003, 0.0]]).measured[0]
    assert covered([[0.0, 0.003, 0.0]], radius_m=4e-3).measured[0]


def test_the_bottom_is_not_measured_through_the_plate() -> None:
    bottom = SurfaceSamples(
        points_m=CLOUD.points_m,
        normals=-CLOUD.normals,
        face=CLOUD.face,
        method="random",
        density_per_m2=1.0,
        area_m2=0.16,
    )
    found = covered([[0.0, 0.0, 0.0]], bottom)
    assert not found.measured.any() and not found.coverable.any()
    assert (found.share_measured, found.share_of_coverable) == (0.0, 0.0)


def test_a_two_sided_sheet_is_measured_on_the_side_that_faces_the_laser() -> None:
    scan = scanned(np.array([[0.0, 0.0, 0.0]]))
    for normal, is_measured in ((1.0, True), (-1.0, False)):
        cloud = SurfaceSamples(
            points_m=np.zeros((1, 3)),
            normals=np.array([[0.0, 0.0, normal]]),
            face=CLOUD.face[:1],
            method="random",
            density_per_m2=1.0,
            area_m2=0.16,
        )
        found = measure_coverage(
            plate(two_sided=True), nothing_around(), cloud, scan, VIEWS, REACHED, selected(0), params=CoverageParams()
        )
        assert bool(found.measured[0]) == is_measured


def test_an_empty_scan_is_explained_too() -> None:
    found = covered([])
    assert not found.measured.any()
    assert found.cause[0] == Cause.NOT_SCANNED


def test_what_only_a_left_out_view_measures_is_not_connected() -> None:
    points = scanned(np.array([[0.0005, 0.001, 0.0]]))
    plan = changed(trajectory(), left_out_view=np.array([1], np.int32), left_out_reason=("it is walled in",))
    inputs = plate(), nothing_around(), CLOUD, points, VIEWS, REACHED, selected(0, 1)
    found = measure_coverage(*inputs, plan, params=CoverageParams())
    assert found.cause[2] == Cause.NOT_CONNECTED
    replaced = changed(trajectory(), replaced_view=plan.left_out_view, replaced_reason=plan.left_out_reason)
    again = measure_coverage(*inputs[:-1], selected(0), replaced, params=CoverageParams())
    assert again.cause[2] == Cause.NOT_CONNECTED
    executed = measure_coverage(*inputs, trajectory(), params=CoverageParams())
    assert executed.cause[2] == Cause.NOT_SCANNED and executed.coverable[2]


def test_what_cannot_be_connected_counts_as_coverable_so_that_a_partial_plan_looks_no_better() -> None:
    points = scanned(np.array([[0.0005, 0.001, 0.0]]))
    plan = changed(trajectory(), left_out_view=np.array([1], np.int32), left_out_reason=("it is walled in",))
    inputs = plate(), nothing_around(), CLOUD, points, VIEWS, REACHED, selected(0, 1)
    whole = measure_coverage(*inputs, params=CoverageParams())
    partial = measure_coverage(*inputs, plan, params=CoverageParams())
    assert partial.coverable.tolist() == whole.coverable.tolist() == [True, False, True, False, False, True]
    assert partial.share_of_coverable == pytest.approx(1 / 3)
    assert partial.cause[[1, 4]].tolist() == [Cause.TOO_SHORT, Cause.COLLISION]


def test_artefacts_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="1 viewpoints but reachability knows 3"):
        measure_coverage(
            plate(),
            nothing_around(),
            CLOUD,
            scanned(np.zeros((1, 3))),
            views_down((0, 0)),
            REACHED,
            selected(0),
            params=CoverageParams(),
        )


def test_the_result_is_the_one_of_this_version() -> None:
    check_golden(measure_coverage, covered([[0.0005, 0.001, 0.0], [0.0, 0.0, 0.0001]]))
