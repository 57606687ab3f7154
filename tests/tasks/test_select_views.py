import numpy as np
import pytest

from cellwright.causes import Cause
from cellwright.errors import InfeasibleError, InvalidInputError
from schemas.artefact import digest
from schemas.views import Measurability
from tasks.select_views import SetCoverParams, select_views
from tests.cellwright.solvers.cover_instances import strips_on_cylinder
from tests.tasks.goldens import check_golden
from tests.tasks.plan_artefacts import changed, trajectory


def measurability(dense, uncertainty=None, cause=None):
    sample, view = np.nonzero(dense)
    values = np.full(dense.shape, 4e-5) if uncertainty is None else np.asarray(uncertainty)
    n_views = dense.shape[1]
    found = np.where(dense.any(axis=1), 0, int(Cause.INCIDENCE)) if cause is None else np.asarray(cause)
    return Measurability(
        view=view.astype(np.int32),
        sample=sample.astype(np.int32),
        uncertainty_m=values[sample, view].astype(np.float32),
        start_m=np.zeros(n_views),
        end_m=np.ones(n_views),
        cause=found.astype(np.int8),
    )


def strips(seed=2):
    dense = strips_on_cylinder(80, 500, seed)
    return dense, np.random.default_rng(seed).uniform(2e-5, 9e-5, dense.shape)


@pytest.mark.parametrize("method", ["best", "greedy", "exact"])
def test_each_method_measures_every_sample_and_its_counts_are_right(method):
    dense, uncertainty = strips()
    found = select_views(measurability(dense, uncertainty), params=SetCoverParams(method=method))
    chosen = dense[:, found.view]
    assert chosen.any(axis=1).all()
    assert np.all(found.cause == 0)
    assert np.all(np.diff(found.view) > 0)
    assert found.n_samples.tolist() == chosen.sum(axis=0).tolist()
    assert found.n_only.tolist() == chosen[chosen.sum(axis=1) == 1].sum(axis=0).tolist()
    assert np.nanmax(found.max_uncertainty_m) == pytest.approx(
        np.where(chosen, uncertainty[:, found.view], np.inf).min(axis=1).max(), rel=1e-6
    )
    assert 0 < found.lower_bound <= len(found.view) + 1e-6
    assert found.gap == pytest.approx((len(found.view) - np.ceil(found.lower_bound - 1e-6)) / len(found.view))
    assert found.proven == (found.gap == 0)


def test_best_and_exact_are_equally_small_and_proven_and_greedy_stands_beside_them():
    dense, uncertainty = strips()
    entries = measurability(dense, uncertainty)
    best, exact, greedy = (
        select_views(entries, params=SetCoverParams(method=method)) for method in ("best", "exact", "greedy")
    )
    assert best.proven
    assert exact.proven
    assert len(best.view) == len(exact.view) < len(greedy.view)
    assert sorted(best.greedy_view.tolist()) == greedy.view.tolist()
    assert greedy.method == "greedy"
    assert greedy.stopped_by == ""
    assert greedy.lower_bound <= len(best.view)


def test_greedy_takes_the_lower_worst_uncertainty_among_equal_gains():
    dense = np.array([[1, 1, 1], [1, 1, 1]], bool)
    uncertainty = np.array([[5e-5, 1e-5, 3e-5], [1e-5, 4e-5, 3e-5]])
    found = select_views(measurability(dense, uncertainty), params=SetCoverParams(method="greedy"))
    assert found.view.tolist() == [2]


def test_among_equally_small_selections_the_less_uncertain_one_is_taken():
    dense = np.array([[1, 1, 1], [1, 1, 1]], bool)
    uncertainty = np.array([[5e-5, 1e-5, 3e-5], [1e-5, 4e-5, 3e-5]])
    found = select_views(measurability(dense, uncertainty), params=SetCoverParams())
    assert found.view.tolist() == [1]
    assert found.max_uncertainty_m.tolist() == pytest.approx([4e-5])


def test_samples_that_no_view_measures_keep_their_cause_and_do_not_count():
    dense = np.array([[1, 0], [0, 0], [0, 1]], bool)
    found = select_views(measurability(dense, cause=[0, Cause.DETECTOR_OCCLUDED, 0]), params=SetCoverParams())
    assert found.view.tolist() == [0, 1]
    assert found.cause.tolist() == [0, Cause.DETECTOR_OCCLUDED, 0]


@pytest.mark.parametrize("method", ["best", "greedy", "exact"])
def test_a_lower_goal_leaves_samples_out_and_says_that_they_were_not_selected(method):
    dense = np.zeros((10, 3), bool)
    dense[:8, 0] = True
    dense[8, 1] = dense[9, 2] = True
    found = select_views(measurability(dense), params=SetCoverParams(method=method, min_coverage=0.8))
    assert found.view.tolist() == [0]
    assert found.cause.tolist() == [0] * 8 + [Cause.NOT_SELECTED] * 2
    assert found.proven


def test_nothing_measurable_is_a_finding_with_the_causes_counted():
    entries = measurability(
        np.zeros((5, 4), bool), cause=[Cause.COLLISION, Cause.COLLISION, Cause.COLLISION, 1, Cause.UNCERTAINTY]
    )
    with pytest.raises(InfeasibleError) as caught:
        select_views(entries, params=SetCoverParams())
    assert "none of 4 views measures any of 5 samples" in str(caught.value)
    assert "3 collision" in str(caught.value)
    assert "1 field of view" in str(caught.value)


@pytest.mark.parametrize(
    ("causes", "advice"),
    [
        ([Cause.JOINT_SPEED] * 20 + [Cause.UNCERTAINTY], "lower scan_speed_m_s"),
        ([Cause.OUT_OF_REACH] * 20, "move the part (T_world_part) into the robot's reach"),
        ([Cause.TOO_SHORT] * 6 + [Cause.JOINT_SPEED] * 4, "lower shortest_m; lower scan_speed_m_s"),
        ([Cause.NOT_CONNECTED] * 3, "move the part (T_world_part)"),
    ],
)
def test_the_advice_is_for_the_causes_that_stop_most_samples(causes, advice):
    with pytest.raises(InfeasibleError) as caught:
        select_views(measurability(np.zeros((len(causes), 2), bool), cause=causes), params=SetCoverParams())
    assert str(caught.value).endswith(f"): {advice}")


def test_entries_may_come_in_any_order_and_twice():
    dense, uncertainty = strips()
    entries = measurability(dense, uncertainty)
    order = np.random.default_rng(0).permutation(np.repeat(np.arange(len(entries.view)), 2))
    shuffled = Measurability(
        view=entries.view[order],
        sample=entries.sample[order],
        uncertainty_m=entries.uncertainty_m[order],
        start_m=entries.start_m,
        end_m=entries.end_m,
        cause=entries.cause,
    )
    params = SetCoverParams()
    assert digest(select_views(shuffled, params=params)) == digest(select_views(entries, params=params))


def test_the_same_measurability_gives_the_same_bytes():
    dense, uncertainty = strips(seed=7)
    entries = measurability(dense, uncertainty)
    params = SetCoverParams(max_work=2e8)
    assert digest(select_views(entries, params=params)) == digest(select_views(entries, params=params))


@pytest.mark.parametrize(("field", "value", "words"), [("view", 9, "view 9"), ("sample", -1, "sample -1")])
def test_entries_that_name_what_does_not_exist_are_refused(field, value, words):
    entries = measurability(np.ones((2, 2), bool))
    broken = {name: getattr(entries, name) for name in ("view", "sample", "uncertainty_m", "start_m", "end_m", "cause")}
    broken[field] = np.where(np.arange(4) == 1, value, broken[field]).astype(np.int32)
    with pytest.raises(InvalidInputError, match=words):
        select_views(Measurability(**broken), params=SetCoverParams())


def test_uncertainties_that_are_not_finite_are_refused():
    entries = measurability(np.ones((2, 2), bool), np.full((2, 2), np.nan))
    with pytest.raises(InvalidInputError, match="not finite"):
        select_views(entries, params=SetCoverParams())


def test_the_result_is_the_one_of_this_version():
    dense, uncertainty = strips()
    found = select_views(measurability(dense, uncertainty), params=SetCoverParams())
    assert found.proven  # so the stored bound is a whole number and does not hang on the last bit of a float
    check_golden(select_views, found)


def leaving_out(*views):
    return changed(trajectory(), left_out_view=np.array(views, np.int32), left_out_reason=("walled in",) * len(views))


@pytest.mark.parametrize("method", ["best", "greedy", "exact"])
def test_views_that_an_earlier_trajectory_left_out_are_not_selected(method):
    dense, uncertainty = strips()
    params = SetCoverParams(method=method)
    barred = select_views(measurability(dense, uncertainty), params=params).view[:3]
    found = select_views(measurability(dense, uncertainty), leaving_out(*barred), params=params)
    assert not np.isin(found.view, barred).any()
    assert found.n_excluded == 3
    replaced = changed(trajectory(), replaced_view=barred, replaced_reason=("walled in",) * 3)
    assert digest(select_views(measurability(dense, uncertainty), replaced, params=params)) == digest(found)
    left = dense.copy()
    left[:, barred] = False
    chosen = dense[:, found.view].any(axis=1)
    assert np.array_equal(chosen, left.any(axis=1))
    assert np.array_equal(found.cause, np.where(chosen, Cause.NONE, Cause.NOT_CONNECTED))


def test_where_only_left_out_views_measure_anything_their_reasons_are_told():
    with pytest.raises(InfeasibleError, match=r"1 aside that cannot be executed or connected \(view 0: walled in\)"):
        select_views(measurability(np.ones((4, 1), bool)), leaving_out(0), params=SetCoverParams())


@pytest.mark.parametrize(
    ("method", "reads"),
    [
        ("best", {"node_limit", "max_work", "seed"}),
        ("greedy", set()),
        ("exact", {"node_limit", "time_limit_s", "seed"}),
    ],
)
def test_settings_count_for_the_methods_that_read_them_alone(method, reads):
    for name, value in (("node_limit", 7), ("max_work", 1e8), ("time_limit_s", 3.0), ("seed", 5)):
        other = (
            SetCoverParams(**{"method": method, name: value}).canonical() != SetCoverParams(method=method).canonical()
        )
        assert other == (name in reads)


def test_without_limits_the_exact_method_has_one_that_no_clock_decides():
    assert SetCoverParams(method="exact").node_limit == 1000
    assert SetCoverParams(method="exact").time_limit_s is None
    assert SetCoverParams(method="exact", time_limit_s=5.0).node_limit is None
