"""The report of a layout stands alone, says what was found, and is never written of an attempt."""

from __future__ import annotations

import json
import re
from functools import cache

import pytest

from cellwright.errors import InfeasibleError
from schemas.layout import LayoutReport
from tasks.write_layout_report import write_layout_report
from tests.small_layout import table
from tests.tasks.goldens import check_golden
from tests.tasks.test_optimise_layout import request, solved, two_tables


@cache
def report() -> LayoutReport:
    found: LayoutReport = write_layout_report(None, None, None, two_tables(), params=request().report)
    return found


def test_the_page_needs_no_network() -> None:
    page = report().page.decode()
    assert not re.search(r"(?:src|href)=['\"]?(?:https?:)?//", page)
    assert page.count("data:image/png;base64,") == 3


def test_the_page_says_what_was_found() -> None:
    page, layout = report().page.decode(), two_tables()
    assert f"{layout.cycle_s:.3f} s" in page
    for text in ("blue.around", "red.around", "penetration of the robot on its way", "2 of 2"):
        assert text in page


def test_the_summary_holds_the_figures() -> None:
    summary, layout = json.loads(report().summary), two_tables()
    assert summary["cycle_s"] == layout.cycle_s and summary["starts_passed"] == 2
    assert list(summary["design"]) == ["blue.around", "red.around"]


def test_an_attempt_has_no_report() -> None:
    far = table("red", harness=None, pose={"position": ["1.5 m", "0 m", "0 m"]})
    changes = {"stations": [table("blue"), far], "solver": {"starts": 1}}
    layout = solved(**changes)
    with pytest.raises(InfeasibleError, match=r"missed its gate: red is not met by 0\.3 m"):
        write_layout_report(None, None, None, layout, params=request(**changes).report)


def test_the_result_is_the_one_of_this_version() -> None:
    # figures of pictures and of the program's last digits are taken out
    words = re.sub(r"base64,[^\"]*|-?\d+(?:\.\d+)?(?:e-?\d+)?", "#", report().page.decode())
    check_golden(write_layout_report, words)
