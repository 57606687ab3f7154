from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from PIL import Image

from schemas.sequence_summary import acceleration_words, alternatives_words, bound_words, cost_label, ordering_words
from tasks.write_sequence_report import SequenceReportParams, write_sequence_report
from tests import small_sequence as small
from tests.tasks.goldens import check_golden


@cache
def report():
    return write_sequence_report(
        small.cell(), small.task_list(), small.alternatives(), small.sequence(), small.verification(),
        params=SequenceReportParams(title="A <small> station", notes="Mind the post."),
    )  # fmt: skip


def test_the_page_stands_alone_and_escapes_what_people_wrote():
    page = report().page.decode()
    assert "A &lt;small&gt; station" in page and "Mind the post." in page
    assert not re.search(r'(src|href)="https?:', page) and page.count("data:image/png;base64,") == 3


def test_the_summary_adds_up():
    told = json.loads(report().summary)
    assert told["moving_s"] + told["strokes_s"] + told["dwell_s"] == pytest.approx(told["duration_s"])
    assert told["cost"] == pytest.approx(told["duration_s"], rel=1e-6)
    assert sorted(told["sequence"]) == ["a", "b", "c", "d"]
    assert told["orders"]["sequence"] == told["cost"] >= told["lower_bound"]
    assert 0.0 <= told["gap"] < 1.0 and set(told["orders"]) == {"as listed", "nearest next", "sequence"}


def test_a_likely_bound_is_told_beside_the_proven_one():
    found = replace(
        small.sequence(), cost=1706.6, lower_bound=1303.62, likely_bound=1646.0, least_ratio=0.87, n_guessed=342,
        proven=False, stopped_by="evaluations", unit="",
    )  # fmt: skip
    told = write_sequence_report(
        small.cell(), small.task_list(), small.alternatives(), found, small.verification(),
        params=SequenceReportParams(),
    )  # fmt: skip
    figures = json.loads(told.summary)
    words = (
        "1303.62 proven (gap 23.6%, stopped by evaluations); 1646.00 (gap 3.6%) if no motion is cheaper than 0.87 of "
        "its guess, as none was of the 342 that were planned, other orders included"
    )
    assert bound_words(figures) == words and words in told.page.decode()
    assert figures["likely_bound"] == 1646.0 and figures["least_ratio"] == 0.87 and figures["motions_guessed"] == 342
    without = json.loads(report().summary)
    assert without["likely_bound"] is None and "of its guess" not in report().page.decode()


def test_torques_get_a_panel_of_the_plan_where_they_are_known():
    told = replace(small.sequence(), torque_nm=np.full_like(small.sequence().position_rad, 20.0))
    found = write_sequence_report(
        small.cell(), small.task_list(), small.alternatives(), told, small.verification(), params=SequenceReportParams()
    )
    with Image.open(io.BytesIO(found.plan_png)) as three, Image.open(io.BytesIO(report().plan_png)) as two:
        assert 2 * three.height == 3 * two.height and three.width == two.width


def test_every_stop_and_every_check_is_on_the_page():
    page = report().page.decode()
    for word in ("colliding states", "tool off its task", "as listed", "nearest next"):
        assert word in page
    assert page.count('<td class="unit">a</td>') == 1


def test_the_result_is_the_one_of_this_version():
    told = json.loads(report().summary)
    told = {name: round(value, 2) if isinstance(value, float) else value for name, value in told.items()}
    kept = {name: told[name] for name in ("tasks", "sequence", "duration_s", "dwell_s", "cost_of", "unit")}
    text = re.sub(rb"base64,[^\"]*", b"", report().page).decode()
    check_golden(write_sequence_report, f"{kept} {re.sub(r'[0-9.,]+', '#', text)}")


def told_of(**changes):
    own = small.sequence()
    asked = ("torque_squared_n2m2s", "speed_squared_rad2_s", "holding_n2m2s") if "weight_time" in changes else ()
    found = replace(own, **{name: np.zeros(len(getattr(own, name))) for name in asked}, **changes)
    told = write_sequence_report(
        small.cell(), small.task_list(), small.alternatives(), found, small.verification(),
        params=SequenceReportParams(),
    )  # fmt: skip
    return json.loads(told.summary), told.page.decode()


def test_a_proof_is_said_to_hold_over_the_motions_found():
    figures, page = told_of(proven=True)
    assert (
        "no other sequence over the motions found is cheaper" in bound_words(figures) and bound_words(figures) in page
    )


def test_torques_above_their_limits_are_told_where_nothing_keeps_them():
    figures, page = told_of(weight_time=1.0, torque_share=1.537)
    assert len(figures["attention"]) == 1 and "the largest torque is 153.7% of its limit" in figures["attention"][0]
    assert '<div class="card attention">' in page and "153.7% of its limit" in page
    for changes in ({"torque_share": 0.99}, {"torque_share": 1.0000001, "keeps_torques": True}):
        figures, page = told_of(**changes)
        assert figures["attention"] == [] and '<div class="card attention">' not in page


def test_accelerations_above_their_limits_are_told_of_optimal_motions():
    figures, page = told_of(weight_time=1.0, acceleration_share=26.2, keeps_accelerations=False, keeps_torques=True)
    words = acceleration_words(figures)
    assert words.startswith("26.2 times its stated limit") and words in page and figures["acceleration_share"] == 26.2
    assert acceleration_words(told_of()[0]) == ""


def test_a_cost_that_is_not_the_cycle_time_is_not_called_so():
    figures, page = told_of(cost_name="velocity bound", cost=10.0)
    assert cost_label(figures) == "ordering cost" and "<th>ordering cost</th>" in page
    assert (
        "slowest joint at full speed; not the cycle time" in ordering_words(figures) and ordering_words(figures) in page
    )
    figures, page = told_of(cost=10.0, keeps_torques=True)
    assert ordering_words(figures).startswith("the time of motions planned in time; not the cycle time")
    figures, page = told_of()
    assert cost_label(figures) == "cost" and ordering_words(figures) == "" and "not the cycle time" not in page


def test_ways_left_out_are_counted():
    figures, page = json.loads(report().summary), report().page.decode()
    left_out = small.alternatives().n_left_out
    assert figures["alternatives_left_out"] == left_out.sum() > 0 and alternatives_words(figures) in page
    assert f"{left_out.sum():,} further ways of {(left_out > 0).sum()} tasks left out" in alternatives_words(figures)


def test_a_sequence_looked_for_by_optimal_control_is_not_said_to_be_looked_for_by_something_else():
    assert "was not looked for by that" in told_of(weight_time=1.0)[1]
    assert "was not looked for by that" not in told_of(weight_time=1.0, cost_name="optimal control", unit="")[1]
