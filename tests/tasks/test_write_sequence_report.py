from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache

import pytest

from schemas.sequence_summary import bound_words
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
        "its guess, as none of 342 was"
    )
    assert bound_words(figures) == words and words in told.page.decode()
    assert figures["likely_bound"] == 1646.0 and figures["least_ratio"] == 0.87 and figures["motions_guessed"] == 342
    without = json.loads(report().summary)
    assert without["likely_bound"] is None and "of its guess" not in report().page.decode()


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
