from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cellwright.errors import InfeasibleError, InvalidInputError
from schemas.artefact import digest
from schemas.poses import Pose
from schemas.sweep_params import StitchParams
from tasks.stitch_sweeps import stitch_sweeps
from tests.cellwright.solvers import scanning_cell
from tests.tasks.goldens import check_golden
from tests.tasks.scanning_artefacts import PART_POSE, cell_model, part_mesh, reachability, viewpoints

PARAMS = StitchParams(T_world_part=PART_POSE, scan_speed_m_s=0.2, max_alternatives=4, roadmap_nodes=300)


def run(params=PARAMS, cell=None, selection=None, progress=lambda share: None):
    return stitch_sweeps(
        cell or cell_model(),
        part_mesh(),
        viewpoints(),
        reachability(),
        selection or scanning_cell.selection(),
        params=params,
        progress=progress,
    )


@cache
def trajectory():
    return run()


def selected(views):
    full = scanning_cell.selection()
    rows = np.array(views, np.int32)
    return replace(
        full, view=rows, n_samples=full.n_samples[: len(rows)], n_only=full.n_only[: len(rows)],
        max_uncertainty_m=full.max_uncertainty_m[: len(rows)],
    )  # fmt: skip


def test_time_rises_strictly_and_segments_follow_each_other():
    plan = trajectory()
    assert plan.time_s[0] == 0.0 and np.all(np.diff(plan.time_s) > 0)
    assert np.array_equal(plan.start_s[1:], plan.end_s[:-1])
    assert plan.end_s[-1] == plan.time_s[-1]
    assert np.all(np.diff(plan.segment) >= 0) and set(plan.segment) == set(range(len(plan.kind)))
    assert np.isin(plan.start_s, plan.time_s).all() and np.isin(plan.end_s, plan.time_s).all()
    assert np.diff(plan.time_s).max() <= PARAMS.sample_s * 1.01


def test_sweeps_and_connections_alternate_and_every_selected_view_is_executed_once():
    plan = trajectory()
    assert plan.kind == ("connection", "sweep") * 5
    assert sorted(plan.view[1::2]) == [0, 1, 2, 3, 4]
    assert set(plan.view[::2]) == {-1} and set(plan.branch[::2]) == {-1} and set(plan.direction[::2]) == {0}
    assert set(plan.direction[1::2]) <= {-1, 1}
    assert set(plan.via[::2]) <= {"direct", "roadmap"} and set(plan.via[1::2]) == {""}


def test_travel_is_known_on_sweeps_only_and_covers_the_best_piece():
    plan = trajectory()
    of_sweep = np.array(plan.kind)[plan.segment] == "sweep"
    assert np.array_equal(np.isfinite(plan.travel_m), of_sweep)
    for segment in range(1, len(plan.kind), 2):
        travel = plan.travel_m[plan.segment == segment]
        assert (travel.min(), travel.max()) == pytest.approx((-0.06, 0.06), abs=1e-12)
        assert np.sign(travel[-1] - travel[0]) == plan.direction[segment]


def test_the_orders_that_were_compared_are_stored():
    plan = trajectory()
    assert plan.order_method == ("greedy", "exact")
    assert plan.order_chosen.tolist() == [False, True]
    assert plan.order_duration_s[1] <= plan.order_duration_s[0]
    assert plan.order_duration_s[1] == pytest.approx(plan.time_s[-1], abs=1e-6)
    assert run(PARAMS.model_copy(update={"method": "greedy"})).order_method == ("greedy",)


def test_the_plan_is_the_same_whenever_it_is_made():
    assert digest(run()) == digest(trajectory())


def test_the_result_is_the_one_of_this_version():
    plan = trajectory()
    decisions = [*zip(plan.view.tolist(), plan.branch.tolist(), plan.direction.tolist(), plan.via, strict=True)]
    # decisions and hundredths of seconds: the last digits of joint angles differ from machine to machine
    check_golden(stitch_sweeps, repr((decisions, np.round(plan.end_s, 2).tolist())))


def test_progress_rises_to_one():
    shares = []
    run(progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_one_view_alone_and_the_way_back_are_planned():
    plan = run(PARAMS.model_copy(update={"return_to_start": True}), selection=selected([3]))
    assert plan.kind == ("connection", "sweep", "connection")
    assert plan.position_rad[-1] == pytest.approx(scanning_cell.START, abs=1e-12)


def test_nothing_selected_is_invalid():
    with pytest.raises(InvalidInputError, match="no view is selected"):
        run(selection=selected([]))


def test_a_start_in_collision_is_invalid_and_names_the_pair():
    folded = replace(cell_model(), start_rad=np.array([0.0, -0.2, 0.9, -1.77, -1.57, 0.0]))
    with pytest.raises(InvalidInputError, match=r"start configuration brings \w+ and \w+ closer than 5 mm"):
        run(cell=folded)


def test_a_start_beyond_a_joint_limit_is_invalid_and_names_the_joint():
    turned = replace(cell_model(), start_rad=scanning_cell.START + np.array([0, 0, 0, 0, 0, 7.0]))
    with pytest.raises(InvalidInputError, match=r"joint wrist_3_joint at 7 rad, outside its limits -6\.283 to 6\.283"):
        run(cell=turned)


def test_the_exact_method_refuses_more_sweeps_than_it_may_order():
    with pytest.raises(InvalidInputError, match="at most 3 sweeps but 5 are selected"):
        run(PARAMS.model_copy(update={"method": "exact", "exact_up_to": 3}))


def test_artefacts_that_do_not_belong_together_are_invalid():
    with pytest.raises(InvalidInputError, match="view 9 is selected but there are 5 viewpoints"):
        run(selection=selected([9]))


def test_a_part_somewhere_else_is_an_error_that_names_views_reasons_and_mend():
    moved = PARAMS.model_copy(update={"T_world_part": Pose(position_m=(0.7, 0.9, 0.0))})
    with pytest.raises(InfeasibleError, match=r"0 of 5 .* \(view 0: none of its 3 pieces .*\): raise roadmap_nodes"):
        run(moved)
    empty = run(moved.model_copy(update={"min_sweeps": 0}))
    assert empty.kind == () and len(empty.time_s) == 0
    assert empty.left_out_view.tolist() == [0, 1, 2, 3, 4]
    assert empty.left_out_reason[0].startswith("none of its 3 pieces could be traced")


def test_what_an_earlier_trajectory_left_out_counts_as_replaced_unless_it_is_selected_again():
    earlier = replace(
        trajectory(),
        left_out_view=np.array([1, 7], np.int32),
        left_out_reason=("one", "seven"),
        replaced_view=np.array([5], np.int32),
        replaced_reason=("five",),
    )
    found = stitch_sweeps(
        cell_model(), part_mesh(), viewpoints(), reachability(), selected([1, 3]), earlier, params=PARAMS
    )
    assert len(found.left_out_view) == 0
    assert found.replaced_view.tolist() == [5, 7]
    assert found.replaced_reason == ("five", "seven")
    assert sorted(found.view[found.view >= 0]) == [1, 3]


def test_the_proof_of_the_order_is_stored():
    assert trajectory().order_proven
    assert trajectory().order_lower_bound_s == pytest.approx(trajectory().time_s[-1], abs=1e-6)
    assert len(trajectory().left_out_view) == len(trajectory().replaced_view) == 0
    greedy = run(PARAMS.model_copy(update={"method": "greedy"}))
    assert greedy.order_lower_bound_s <= trajectory().time_s[-1] + 1e-6


@pytest.mark.parametrize(("method", "reads"), [("best", True), ("exact", True), ("greedy", False)])
@pytest.mark.parametrize("setting", [{"exact_up_to": 3}, {"max_connections": 7}])
def test_limits_of_the_search_count_for_the_methods_that_search(method, reads, setting):
    other = StitchParams(method=method, **setting).canonical() != StitchParams(method=method).canonical()
    assert other == reads
