from __future__ import annotations

import numpy as np

from schemas.artefact import digest
from tasks.take_sequence import take_sequence
from tests.tasks import test_sequence_sweeps as sequencing
from tests.tasks.goldens import check_golden

pytestmark = sequencing.pytestmark


def test_the_result_is_the_one_of_this_version() -> None:
    plan = sequencing.taken(sequencing.by_time(), sequencing.stitched("greedy"))
    check_golden(take_sequence, repr((plan.order_method, plan.order_chosen.tolist(), np.round(plan.end_s, 2).tolist())))


def test_only_the_motion_and_the_orders_are_new() -> None:
    old = sequencing.stitched("greedy")
    plan = sequencing.taken(sequencing.by_time(), old)
    assert plan.left_out_view.tolist() == old.left_out_view.tolist() and plan.replaced_reason == old.replaced_reason
    assert sorted(plan.view.tolist()) == sorted(old.view.tolist())
    assert plan.order_lower_bound_s == 0.0 and not plan.order_proven
    assert plan.time_s[-1] == sequencing.by_time().time_s[-1]


def test_a_sequence_that_costs_more_changes_nothing() -> None:
    best = sequencing.stitched()
    assert digest(sequencing.taken(sequencing.run(sequencing.BY_TIME), best)) == digest(best)
