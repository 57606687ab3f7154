from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cellwright.errors import InvalidInputError
from cellwright.solvers.placement.search import DISTINCT, FoundDesigns, SearchSettings, search_designs
from cellwright.solvers.placement.trial import Promise, TrialSettings, try_design, try_designs
from tests.cellwright.solvers import scanning_cell
from tests.cellwright.solvers.placement.placed_sweeps import harness, judge, problem

FEW = SearchSettings(n_evaluations=120, n_particles=12, n_kept=2)
TRIAL = TrialSettings(scanning_cell.SETTINGS, "best", 0)


@cache
def found(n_threads: int = 2) -> FoundDesigns:
    return search_designs(judge(), FEW, np.random.default_rng(0), n_threads=n_threads)


def test_the_result_does_not_depend_on_the_number_of_threads() -> None:
    one, two = found(1), found(2)
    for name in ("values", "estimate", "trace"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert one.refused == two.refused and list(one.refused) == list(two.refused)


def test_designs_are_within_the_harness_distinct_and_in_order() -> None:
    box = judge().problem.harness
    span = box.upper - box.lower
    assert 1 <= len(found().values) <= FEW.n_kept
    assert ((found().values >= box.lower) & (found().values <= box.upper)).all()
    assert found().estimate.tolist() == sorted(found().estimate.tolist())
    if len(found().values) == 2:
        assert np.max(np.abs(np.subtract(*found().values)) / span) >= DISTINCT


def test_every_design_is_judged_once_and_counted() -> None:
    assert found().n_evaluated <= FEW.n_evaluations
    assert 0 < sum(found().refused.values()) < found().n_evaluated
    assert (np.diff(found().trace[:, 1]) < 0).all()
    assert found().trace[0].tolist() == [1.0, found().present.estimate], "the present placement is judged first"


def test_what_is_found_is_better_than_the_present_placement() -> None:
    assert found().estimate[0] < found().present.estimate
    assert judge().judge(found().values[0]).estimate == found().estimate[0]


def test_progress_rises_to_at_most_one() -> None:
    shares: list[float] = []
    few = SearchSettings(n_evaluations=24, n_particles=6, n_kept=1)
    search_designs(judge(), few, np.random.default_rng(1), progress=shares.append)
    assert shares == sorted(shares) and 0.0 < shares[-1] <= 1.0


def test_one_evaluation_judges_the_present_placement_alone() -> None:
    alone = search_designs(judge(), SearchSettings(1, 40, 3), np.random.default_rng(0))
    assert alone.n_evaluated == 1 and len(alone.values) == 0


@pytest.mark.parametrize("wrong", [{"n_evaluations": 0}, {"n_particles": 0}, {"n_kept": 0}])
def test_a_search_for_nothing_is_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(InvalidInputError, match="give at least 1 of each"):
        SearchSettings(**wrong)


def test_a_true_cycle_is_not_below_its_bound() -> None:
    trials = try_designs(judge(), found(), TRIAL, cycle_now=np.inf)
    assert trials and all(trial.bound <= trial.cycle + 1e-9 for trial in trials)
    assert any(np.isfinite(trial.cycle) for trial in trials)


def test_nothing_is_tried_that_cannot_be_better() -> None:
    assert try_designs(judge(), found(), TRIAL, cycle_now=min(map(judge().bound, found().values))) == []


def test_a_design_that_cannot_be_executed_in_full_says_which_sweep() -> None:
    trial = try_design(problem(harness=harness(3.0)), Promise(np.array([2.5, 0.0, 0.0]), 1.0, 1.0), TRIAL, {})
    assert trial.cycle == np.inf and trial.reason == "view 0 cannot be executed: out of reach"
