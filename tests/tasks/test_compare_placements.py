from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest

from cellwright.cell.transforms import pose
from schemas.placement import Placement, PlacementOutcome, placement_figures
from tasks.compare_placements import ComparisonParams, compare_placements
from tests.tasks import plan_artefacts as plan
from tests.tasks.goldens import check_golden
from tests.tasks.plate_scene import plate

MOTION = pose(np.array([0.01, 0.0, 0.0]), np.eye(3))


def placement(**changes: Any) -> Placement:
    return plan.changed(
        Placement(
            joint=("x", "yaw"),
            turns=np.array([False, True]),
            value=np.array([0.01, 0.0]),
            lower=np.array([-0.1, -1.0]),
            upper=np.array([0.1, 1.0]),
            carried=("table",),
            T_world_part_before=plan.T_WORLD_PART,
            T_world_part=MOTION @ plan.T_WORLD_PART,
            T_world_base_before=np.eye(4),
            T_world_base=np.eye(4),
            T_world_motion=MOTION,
            refused_test=("sweep", "overlap"),
            refused_what=("view 4", "part and post"),
            refused_cause=("out of reach", ""),
            refused_count=np.array([7, 2], np.int64),
            trace_judged=np.array([1, 5], np.int64),
            trace_estimate_s=np.array([1.9, 1.7]),
            trial_value=np.array([[0.01, 0.0]]),
            trial_estimate_s=np.array([1.75]),
            trial_bound_s=np.array([1.7]),
            trial_cycle_s=np.array([1.8]),
            trial_reason=("",),
            trial_method=("search",),
            gap_moved=(),
            gap_standing=(),
            gap_m=np.zeros(0),
            moves="part",
            is_better=True,
            reason="20 placements were judged",
            cycle_before_s=2.0,
            cycle_s=1.8,
            bound_before_s=1.9,
            n_judged=20,
        ),
        **changes,
    )


def faster() -> Any:
    """The same plan in nine tenths of the time."""
    now = plan.trajectory()
    return plan.changed(now, time_s=0.9 * now.time_s, start_s=0.9 * now.start_s, end_s=0.9 * now.end_s)


def compared(found: Placement | None = None, failure: str = "", **moved: Any) -> PlacementOutcome:
    """Compare the plan with a faster one; keywords replace what belongs to that."""
    new = {
        "moved_cell": plan.cell(),
        "moved_trajectory": faster(),
        "moved_coverage": plan.coverage(),
        "moved_overlaps": plan.overlaps(),
    }
    old = plan.cell(), plate(), plan.trajectory(), plan.coverage(), plan.overlaps()
    outcome: PlacementOutcome = compare_placements(
        found or placement(), *old, *(new | moved).values(), params=ComparisonParams(failure=failure)
    )
    return outcome


def test_a_faster_plan_that_loses_nothing_is_taken() -> None:
    outcome = compared()
    assert outcome.moved and outcome.value.tolist() == [0.01, 0.0] and outcome.refusal == ""
    assert (outcome.cycle_before_s, outcome.cycle_after_s) == pytest.approx((2.0, 1.8))
    assert (outcome.scanning_before_s, outcome.scanning_after_s) == pytest.approx((1.0, 0.9))
    figures = placement_figures(outcome)
    assert figures["words"] == "x 10.0 mm, yaw 0.0 deg"
    assert figures["joints"] == {"x": {"slide_m": 0.01}, "yaw": {"turn_rad": 0.0}}
    assert figures["designs_refused"] == 9


def test_its_picture_shows_both() -> None:
    from matplotlib.image import imread

    picture = imread(io.BytesIO(compared().picture))
    assert picture.shape[1] > picture.shape[0] > 300 and float(picture.std()) > 0.05
    assert compared().picture == compared().picture


def test_without_another_plan_the_placement_is_kept_for_the_searchs_reason() -> None:
    kept = compared(
        placement(is_better=False, reason="nothing is better"),
        moved_cell=None, moved_trajectory=None, moved_coverage=None, moved_overlaps=None,
    )  # fmt: skip
    assert not kept.moved and kept.reason == "nothing is better" and kept.refusal == ""
    assert kept.cycle_after_s == kept.cycle_before_s == 2.0
    assert kept.value.tolist() == [0.0, 0.0] and kept.picture == b""


def refusal(failure: str = "", **moved: Any) -> str:
    kept = compared(failure=failure, **moved)
    assert not kept.moved and kept.cycle_after_s == kept.cycle_before_s and kept.picture == b""
    words = "x 10.0 mm, yaw 0.0 deg looked better, but "
    assert kept.reason.startswith(words)
    assert kept.reason == words + kept.refusal == words + placement_figures(kept)["refusal"]
    return kept.refusal


def test_a_plan_that_takes_as_long_is_not_taken() -> None:
    assert refusal(moved_trajectory=plan.trajectory()) == "its plan takes 2.00 s, not less than 2.00 s"


def test_a_plan_that_measures_less_is_not_taken() -> None:
    less = plan.changed(plan.coverage(), share_measured=0.6)
    assert refusal(moved_coverage=less) == "it measures 60.0000% of the surface there, not 66.6667%"


def test_a_plan_with_a_shorter_sweep_is_not_taken() -> None:
    now = faster()
    short = plan.changed(now, travel_m=np.where(now.segment == 1, 0.9 * now.travel_m, now.travel_m))
    assert refusal(moved_trajectory=short) == "view 4 would be shorter there"


def test_a_plan_without_a_sweep_is_not_taken_and_says_why_it_is_left_out() -> None:
    other = plan.changed(
        faster(), view=np.array([-1, 4, -1, 2], np.int32), left_out_view=np.array([1], np.int32),
        left_out_reason=("walled in",),
    )  # fmt: skip
    assert refusal(moved_trajectory=other) == "view 1 cannot be executed there (walled in)"


def test_a_plan_without_any_motion_is_not_taken() -> None:
    nothing = plan.changed(
        faster(), time_s=np.zeros(0), position_rad=np.zeros((0, 2)), velocity_rad_s=np.zeros((0, 2)),
        acceleration_rad_s2=np.zeros((0, 2)), segment=np.zeros(0, np.int32), travel_m=np.zeros(0), kind=(),
        view=np.zeros(0, np.int32), branch=np.zeros(0, np.int8), direction=np.zeros(0, np.int8), start_s=np.zeros(0),
        end_s=np.zeros(0), via=(),
    )  # fmt: skip
    words = refusal(moved_trajectory=nothing, moved_coverage=None)
    assert words == "view 4 cannot be executed there (it is left out), view 1 cannot be executed there (it is left out)"


def test_bodies_that_stand_deeper_in_one_another_are_not_taken() -> None:
    deeper = plan.changed(plan.overlaps(), depth_m=np.array([0.02]))
    expected = "part and table would stand in one another there, by at least 20.0 mm"
    assert refusal(moved_overlaps=deeper) == expected


def test_a_part_that_would_tip_is_not_taken() -> None:
    tipping = plan.changed(plan.overlaps(), tipping=("the part would tip",))
    assert refusal(moved_overlaps=tipping) == "there the part would tip"


def test_a_part_that_tips_in_another_way_is_not_taken_one_that_tips_as_before_is() -> None:
    now, then = (plan.changed(plan.overlaps(), tipping=(f"the part would tip {how}",)) for how in ("left", "right"))
    old = plan.cell(), plate(), plan.trajectory(), plan.coverage(), now
    for overlaps, expected in ((then, "there the part would tip right"), (now, "")):
        new = plan.cell(), faster(), plan.coverage(), overlaps
        kept: PlacementOutcome = compare_placements(placement(), *old, *new, params=ComparisonParams())
        assert kept.refusal == expected and kept.moved == (not expected)


def test_a_plan_that_fails_its_verification_is_not_taken_however_fast() -> None:
    assert refusal("arm meets part at 1.20 s") == "its plan fails its verification: arm meets part at 1.20 s"


def test_the_result_is_the_one_of_this_version() -> None:
    outcome = compared(moved_trajectory=plan.trajectory())
    check_golden(compare_placements, outcome)
