from __future__ import annotations

import numpy as np

from schemas.views import CoverageGaps
from tasks.find_gaps import GapParams, find_gaps
from tests.tasks.goldens import check_golden
from tests.tasks.plate_scene import nothing_around, plate, points_on_top, reached, selected, views_down

CLOUD = points_on_top((0.0, 0.0), (0.09, 0.0), (0.0, 0.1), (0.0, 0.19), (0.02, 0.1))
VIEWS = views_down((0.0, 0.0), (0.0, 0.1), (0.0, 0.0))
REACHED = reached(3, (0, -0.05, 0.05), (0, 0.05, 0.2), (1, -0.01, 0.05), (2, 0.0, 0.1))


def test_gaps_are_missed_by_the_selection_and_measured_by_another_best_piece() -> None:
    gaps = find_gaps(plate(), nothing_around(), CLOUD, VIEWS, REACHED, selected(0), (), params=GapParams())
    # point 1 lies on the second piece of view 0, which does not count, and on view 2; nobody measures point 3
    assert gaps.point.tolist() == [1, 2, 4]
    assert (gaps.n_checked, gaps.n_missed) == (5, 4)


def test_points_of_earlier_rounds_are_not_listed_again() -> None:
    earlier = CoverageGaps(point=np.array([2], np.int32), n_checked=5, n_missed=4)
    gaps = find_gaps(plate(), nothing_around(), CLOUD, VIEWS, REACHED, selected(0), (earlier,), params=GapParams())
    assert gaps.point.tolist() == [1, 4]
    assert gaps.n_missed == 4


def test_a_selection_of_everything_leaves_no_gap_that_could_be_closed() -> None:
    gaps = find_gaps(plate(), nothing_around(), CLOUD, VIEWS, REACHED, selected(0, 1, 2), (), params=GapParams())
    assert gaps.point.tolist() == []
    assert gaps.n_missed == 1


def test_the_result_is_the_one_of_this_version() -> None:
    found = find_gaps(plate(), nothing_around(), CLOUD, VIEWS, REACHED, selected(0), (), params=GapParams())
    check_golden(find_gaps, found)
