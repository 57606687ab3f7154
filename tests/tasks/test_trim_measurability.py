from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.causes import Cause
from cellwright.errors import InvalidInputError
from cellwright.solvers.sweeps.trimming import trim_entries
from schemas.views import Measurability, Reachability
from tasks.trim_measurability import TrimParams, trim_measurability
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.plate_scene import points_on_top, views_down

# the views look down at x = 0, 0.1 and 0; samples lie at x = -0.05, 0, 0.04, 0.3
SAMPLES = points_on_top((-0.05, 0.0), (0.0, 0.0), (0.04, 0.0), (0.3, 0.0))
VIEWS = views_down((0.0, 0.0), (0.1, 0.0), (0.0, 0.0))
BEFORE = Measurability(
    view=np.array([0, 0, 0, 1, 2], np.int32),
    sample=np.array([0, 1, 2, 2, 0], np.int32),
    uncertainty_m=np.array([1e-5, 2e-5, 3e-5, 4e-5, 5e-5], np.float32),
    start_m=np.array([-0.05, -0.06, -0.05]),
    end_m=np.array([0.04, -0.06, -0.05]),
    cause=np.array([0, 0, 0, Cause.INCIDENCE], np.int8),
)


def reached(*pieces: tuple[int, float, float], outcome=(0, 0, 0)) -> Reachability:
    n = len(pieces)
    return Reachability(
        view=np.array([view for view, *_ in pieces], np.int32),
        branch=np.zeros(n, np.int8),
        start_m=np.array([start for _, start, _ in pieces]),
        end_m=np.array([end for *_, end in pieces]),
        q_start_rad=np.zeros((n, 6)),
        outcome=np.array(outcome, np.int8),
        blocked_by=np.full(3, -1, np.int32),
        body=("part",),
    )


def trimmed(reachability: Reachability) -> Measurability:
    return trim_measurability(SAMPLES, VIEWS, BEFORE, reachability, params=TrimParams())


def test_entries_outside_the_first_piece_are_dropped_and_the_interval_shrinks():
    found = trimmed(reached((0, -0.02, 0.05), (0, -0.1, 0.1), outcome=(0, Cause.COLLISION, Cause.OUT_OF_REACH)))
    assert found.view.tolist() == [0, 0]
    assert found.sample.tolist() == [1, 2]
    assert found.uncertainty_m.tolist() == BEFORE.uncertainty_m[1:3].tolist()
    assert found.start_m[0] == pytest.approx(0.0) and found.end_m[0] == pytest.approx(0.04)
    assert np.isnan(found.start_m[1:]).all() and np.isnan(found.end_m[1:]).all()


def test_a_lost_sample_names_the_furthest_test_that_its_views_reached():
    found = trimmed(reached((0, -0.02, 0.05), outcome=(0, Cause.COLLISION, Cause.OUT_OF_REACH)))
    # view 0 has a piece that ends before sample 0; view 2 does not even reach it
    assert found.cause.tolist() == [Cause.TOO_SHORT, 0, 0, Cause.INCIDENCE]
    found = trimmed(reached(outcome=(Cause.JOINT_LIMIT, Cause.COLLISION, Cause.OUT_OF_REACH)))
    assert found.cause.tolist() == [Cause.JOINT_LIMIT, Cause.JOINT_LIMIT, Cause.COLLISION, Cause.INCIDENCE]


def test_the_result_is_the_one_of_this_version():
    found = trimmed(reached((0, -0.02, 0.05), (0, -0.1, 0.1), outcome=(0, Cause.COLLISION, Cause.OUT_OF_REACH)))
    check_golden(trim_measurability, rounded(found))


def test_pieces_over_everything_change_nothing():
    found = trimmed(reached((0, -1.0, 1.0), (1, -1.0, 1.0), (2, -1.0, 1.0)))
    assert found.sample.tolist() == BEFORE.sample.tolist()
    assert np.allclose(found.start_m, BEFORE.start_m) and np.allclose(found.end_m, BEFORE.end_m)
    assert found.cause.tolist() == BEFORE.cause.tolist()


def test_artefacts_that_do_not_belong_together_are_refused():
    with pytest.raises(InvalidInputError, match="the surface has 1"):
        trim_measurability(points_on_top((0.0, 0.0)), VIEWS, BEFORE, reached(), params=TrimParams())


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_trimming_agrees_with_a_plain_loop(seed):
    rng = np.random.default_rng(seed)
    n_sweeps, n_samples, n = 6, 8, 30
    sweep, sample, travel = rng.integers(n_sweeps, size=n), rng.integers(n_samples, size=n), rng.uniform(-1, 1, n)
    has = rng.random(n_sweeps) < 0.7
    start, end = np.where(has, -rng.random(n_sweeps), np.nan), np.where(has, rng.random(n_sweeps), np.nan)
    outcome = np.where(has, 0, rng.integers(6, 11, n_sweeps)).astype(np.int8)
    found = trim_entries(
        sweep,
        sample,
        travel,
        piece_start=start,
        piece_end=end,
        outcome=outcome,
        cause=np.zeros(n_samples, np.int8),
    )
    for k in range(n):
        assert found.kept[k] == (has[sweep[k]] and start[sweep[k]] <= travel[k] <= end[sweep[k]])
    for row in range(n_sweeps):
        left = travel[found.kept & (sweep == row)]
        assert len(left) == 0 or (found.start[row], found.end[row]) == (left.min(), left.max())
        assert np.isnan(found.start[row]) == (len(left) == 0)
    for row in range(n_samples):
        lost = [Cause.TOO_SHORT if has[s] else outcome[s] for s in sweep[(sample == row)]]
        covered = (found.kept & (sample == row)).any()
        assert found.cause[row] == (0 if covered else max(lost, default=0))
