"""The report: one page that needs nothing else, says what the artefacts say, and escapes what people wrote."""

from __future__ import annotations

import io
import json
import re
import sys
from functools import cache
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cellwright.causes import Cause
from schemas.inspection_summary import METRICS, cover_words, summarise
from schemas.report import InspectionReport
from tasks.fit_spheres import SphereParams, fit_spheres
from tasks.write_report import ReportParams, template_digest, write_report
from tests.tasks import plan_artefacts as plan
from tests.tasks.goldens import check_golden
from tests.tasks.plate_scene import plate

VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Reads a page strictly: tags must close in order. Keeps text, scripts, and what would be fetched."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []
        self.scripts: list[str] = []
        self.styles: list[str] = []
        self.sources: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        assert tag not in ("link", "iframe", "object", "embed", "base")
        self.sources += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        within = self.open[-1] if self.open else ""
        {"script": self.scripts, "style": self.styles}.get(within, self.texts).append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.texts))

    def scene(self) -> dict[str, Any]:
        (script,) = [text for text in self.scripts if text.lstrip().startswith("const scene = ")]
        scene, _ = json.JSONDecoder().raw_decode(script.lstrip().removeprefix("const scene = "))
        return scene  # type: ignore[no-any-return]


def written(**changes: Any) -> InspectionReport:
    parts: dict[str, Any] = {
        "mesh": plate(),
        "cell": plan.cell(),
        "cloud": plan.cloud(),
        "overlaps": plan.changed(plan.overlaps(), body=(), other=(), depth_m=np.zeros(0), finding=()),
        "coverage": plan.coverage(),
        "viewpoints": plan.viewpoints(),
        "reachability": plan.reachability(),
        "measurability": plan.measurability(),
        "selection": plan.selection(),
        "trajectory": plan.trajectory(),
        "verification": plan.verification(),
        "scan": plan.scan(),
        "params": ReportParams(title="Plate", notes="A remark"),
    }
    return write_report(**{**parts, **changes})  # type: ignore[no-any-return]


@cache
def report() -> InspectionReport:
    return written()


@cache
def page() -> Page:
    return Page(report().page.decode())


def test_the_page_is_whole_html_and_fetches_nothing() -> None:
    assert report().page.startswith(b"<!doctype html>")
    assert all(source.startswith("data:image/png;base64,") for source in page().sources)
    assert len(page().sources) == 4
    assert not re.search(r"@import|url\(", "".join(page().styles))
    own = [script for script in page().scripts if "const scene" in script]
    assert not re.search(r"https?:|fetch\(|XMLHttpRequest|import\(", "".join(own))


def test_the_page_says_what_the_summary_says() -> None:
    summary, text = json.loads(report().summary), page().text
    assert summary["coverage"] == pytest.approx(4 / 6)
    for words in (
        "Plate", "A remark", "66.67%", "80.00%", "2 sweeps measure 66.67% of the surface in 2.0 s", "45 µm",
        "4,321 states", "checked again by FCL", "collide with table", "6 points in 6 profiles", "distance of bodies",
        "4.30 mm proven least distance", "as near as 4.32 mm (one.1 and part at 1.25 s)", "none stands in another",
    ):  # fmt: skip
        assert words in text, words
    for cause in (Cause.COLLISION, Cause.NOT_SCANNED):
        assert f"{cause.label} 1 16.67%" in text


def test_sweeps_stand_in_the_order_in_which_they_run() -> None:
    # number, begins, lasts, length, direction, samples, it alone, worst uncertainty, view, branch
    assert re.search(r"\b1 0\.50 0\.50 \d+ along x \d+ \d+ \S+ 4 0\b", page().text)
    assert re.search(r"\b2 1\.50 0\.50 \d+ along x \d+ \d+ \S+ 1 0\b", page().text)
    assert "nan" not in page().text.lower()


def test_the_scene_is_json_of_the_part_its_points_and_the_sweeps() -> None:
    scene = page().scene()
    assert len(scene["mesh"]["i"]) == len(plate().faces)
    np.testing.assert_allclose(np.ptp(scene["mesh"]["x"]), 400)
    assert {cloud["name"]: len(cloud["x"]) for cloud in scene["clouds"]} == {
        "measured": 4, "collision": 1, "not scanned": 1,
    }  # fmt: skip
    assert scene["sweeps"]["text"] == ["1", "", "", "2", "", ""]
    assert scene["sweeps"]["hover"][0] == "sweep 1: 80 mm in 0.50 s"
    for cloud in scene["clouds"]:
        assert len(cloud["shade"]) == len(cloud["x"]) and set(cloud["shade"]) <= set(range(10))
        assert len(cloud["uncertainty"]) == (0 if cloud["missed"] else len(cloud["x"]))
    # view 4 stands above (-0.1, 0) and moves along x
    assert scene["sweeps"]["y"][:2] == [0.0, 0.0]
    assert scene["sweeps"]["z"][:3] == [182.0, 182.0, None]
    assert -150 <= scene["sweeps"]["x"][0] < scene["sweeps"]["x"][1] <= -50


def test_what_people_write_is_shown_and_never_run() -> None:
    hostile = "</script><script>alert('é $1 & $2')</script><!--RUN-->"
    joints = plan.changed(plan.cell(), joint=("_a$", "$b</script>"))
    coverage = plan.changed(plan.coverage(), body=("</td><script>", "part"))
    mesh = plan.changed(plate(), finding=("<img src=x onerror=1>",))
    found = written(params=ReportParams(title=hostile, notes=hostile), cell=joints, coverage=coverage, mesh=mesh)
    html = found.page.decode()
    shown = Page(html)
    assert shown.text.count(hostile) == 2 + 1  # title, heading, notes
    assert len(shown.scripts) == len(page().scripts)
    assert html.count("<!--RUN-->") == 1
    assert "<img src=x onerror=1>" in shown.text


def test_the_figures_are_in_the_page_and_open() -> None:
    import base64

    for png in (report().cell_png, report().coverage_png, report().uncertainty_png, report().plan_png):
        assert f"data:image/png;base64,{base64.b64encode(png).decode()}" in page().sources
        with Image.open(io.BytesIO(png)) as image:
            assert min(image.size) > 300


def test_a_big_cloud_is_thinned_and_the_missed_points_go_first() -> None:
    n = 3000
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.2, 0.2, (n, 2)), np.zeros(n)])
    cloud = plan.changed(
        plan.cloud(), points_m=points, normals=np.tile([0.0, 0.0, 1.0], (n, 1)), face=np.zeros(n, np.int32)
    )
    for n_missed in (40, 2500):
        cause = np.zeros(n, np.int8)
        cause[:n_missed] = Cause.INCIDENCE
        coverage = plan.changed(
            plan.coverage(),
            measured=cause == 0,
            coverable=cause == 0,
            cause=cause,
            blocked_by=np.full(n, -1, np.int32),
            uncertainty_m=np.where(cause == 0, 5e-5, np.nan).astype(np.float32),
        )
        found = written(cloud=cloud, coverage=coverage, params=ReportParams(max_points=1000))
        drawn = {cloud["name"]: len(cloud["x"]) for cloud in Page(found.page.decode()).scene()["clouds"]}
        assert sum(drawn.values()) <= 1000
        assert drawn["incidence"] == (40 if n_missed == 40 else 500)


def test_a_plan_that_measured_nothing_still_has_a_report() -> None:
    cause = np.full(6, Cause.NOT_SCANNED, np.int8)
    coverage = plan.changed(
        plan.coverage(),
        measured=cause == 0,
        cause=cause,
        uncertainty_m=np.full(6, np.nan, np.float32),
        share_measured=0.0,
        share_of_coverable=0.0,
    )
    found = written(coverage=coverage)
    assert "– µm" in Page(found.page.decode()).text
    assert json.loads(found.summary)["uncertainty_median_m"] is None


def test_the_summary_holds_the_figures_that_studies_may_draw() -> None:
    summary = summarise(
        plate(),
        plan.viewpoints(),
        plan.measurability(),
        plan.selection(),
        plan.trajectory(),
        plan.scan(),
        plan.coverage(),
        plan.verification(),
        overlaps=plan.changed(plan.overlaps(), body=(), other=(), depth_m=np.zeros(0), finding=()),
        reachability=plan.reachability(),
    )
    assert summary == json.loads(report().summary)
    numbers = {name for name, value in summary.items() if isinstance(value, int | float)}
    assert numbers == METRICS
    assert summary["causes"] == {"collision": 1, "not scanned": 1}
    assert summary["collides_with"] == {"table": 1}
    assert summary["scanning_s"] == pytest.approx(1.0)


def test_what_needs_attention_is_said_on_top_and_nothing_where_there_is_nothing() -> None:
    assert json.loads(report().summary)["attention"] == []
    assert "What needs attention" not in page().text
    assert "Note: " not in page().text
    trajectory = plan.changed(
        plan.trajectory(), left_out_view=np.array([3], np.int32), left_out_reason=("no way leads to <it>",)
    )
    found = written(overlaps=plan.overlaps(), reachability=plan.reachability(1234), trajectory=trajectory)
    summary, text = json.loads(found.summary), Page(found.page.decode()).text
    assert summary["overlaps"][0]["bodies"] == ["part", "table"]
    assert summary["overlaps"][0]["depth_at_least_m"] == 0.0121
    assert summary["unsettled_sweeps"] == 1234
    assert summary["left_out_sweeps"] == [{"view": 3, "reason": "no way leads to <it>"}]
    assert len(summary["attention"]) == 3
    stands = plan.changed(plan.overlaps(), tipping=("the part would <tip>",), note=("the part reaches far",))
    tips = written(overlaps=stands)
    assert json.loads(tips.summary)["attention"][-1] == "the part would <tip>"
    assert json.loads(tips.summary)["notes"] == ["the part reaches far"]
    assert "the part would <tip>" in Page(tips.page.decode()).text
    assert "Note: the part reaches far." in Page(tips.page.decode()).text
    _, _, after = text.partition("What needs attention")
    for words in (
        "part and table stand in one another, by at least 12.1 mm", "view 3 is left out: no way leads to <it>",
        "1,234 candidate sweeps may be executable further", "those that stand in one another are named above",
    ):  # fmt: skip
        assert words in after, words
    assert after.index("stand in one another") < after.index("Coverage on the part")


def samples_of_their_own() -> Any:
    return plan.changed(plan.viewpoints(), sample=np.arange(6, dtype=np.int32))


def test_only_what_executed_sweeps_measure_counts_as_covered() -> None:
    whole = json.loads(written(viewpoints=samples_of_their_own()).summary)
    assert whole["coverage_of_samples"] == 1.0
    partial = plan.changed(
        plan.trajectory(),
        view=np.array([-1, 4, -1, 4], np.int32),
        left_out_view=np.array([1], np.int32),
        left_out_reason=("no way",),
    )
    summary = json.loads(written(viewpoints=samples_of_their_own(), trajectory=partial).summary)
    assert summary["coverage_of_samples"] == pytest.approx(4 / 6)  # the selection claims all six


def test_the_hulls_stand_in_the_report_with_their_picture_and_their_proofs() -> None:
    spheres = fit_spheres(plan.cell(), None, params=SphereParams(n_spheres=1, n_starts=1, n_spheres_of={"table": 0}))
    part = fit_spheres(None, plate(), params=SphereParams(n_spheres=3, n_starts=1))
    shown = Page(written(part_hull=part, cell_hull=spheres).page.decode())
    assert len(shown.sources) == len(page().sources) + 1
    n_bodies = 1 + int((spheres.n_spheres > 0).sum())
    n_spheres = len(part.radius_m) + len(spheres.radius_m)
    assert f"{n_spheres} spheres hold {n_bodies} bodies; of {n_bodies} it is proven" in shown.text
    assert "left out: table." in shown.text
    assert f"part 3 100 % {part.volume_ratio[0]:.2f} {1e3 * part.protrusion_mean_m[0]:.1f} /" in shown.text
    assert "Sphere hulls" not in page().text


def test_after_sweeps_were_excluded_the_fewest_are_not_proven_and_the_bound_says_of_what() -> None:
    assert "Chosen from 6 candidates; proven fewest." in page().text
    selection = plan.changed(plan.selection(), n_excluded=2, lower_bound=1.2)
    found = written(selection=selection)
    summary = json.loads(found.summary)
    assert (summary["sweeps_proven_fewest"], summary["sweeps_excluded"]) == (False, 2)
    words = "at least 2 needed without the 2 that cannot be executed or connected"
    assert f"Chosen from 6 candidates; {words}." in Page(found.page.decode()).text
    assert cover_words({**summary, "sweeps_excluded": 0}) == "at least 2 needed"


def test_sweeps_that_were_replaced_need_attention_only_where_something_is_lost() -> None:
    replaced = plan.changed(
        plan.trajectory(), replaced_view=np.array([3], np.int32), replaced_reason=("no way leads there",)
    )
    without_loss = json.loads(written(trajectory=replaced).summary)
    assert without_loss["attention"] == []
    assert without_loss["replaced_sweeps"] == [{"view": 3, "reason": "no way leads there"}]
    selection = plan.changed(plan.selection(), cause=np.array([0, 0, 0, 0, 0, Cause.NOT_CONNECTED], np.int8))
    (found,) = json.loads(written(trajectory=replaced, selection=selection).summary)["attention"]
    assert found == (
        "1 sample is measured only by sweeps that cannot be executed or connected (view 3: no way leads there)"
    )


def test_a_bound_of_the_order_is_said_to_hold_for_the_connections_found() -> None:
    bounded = plan.changed(plan.trajectory(), order_lower_bound_s=1.5)
    text = Page(written(trajectory=bounded).page.decode()).text
    assert "Over the connections that were found no order of these sweeps takes less than 1.5 s." in text
    proven = Page(written(trajectory=plan.changed(bounded, order_proven=True)).page.decode()).text
    assert "No other order of these sweeps over the connections that were found is shorter" in proven


def test_checks_are_told_in_units_of_the_shop_floor() -> None:
    text = page().text
    assert "✓ joint speed, of its limit 98% ≤ 100%" in text
    assert "✓ distance of bodies 4.3 mm ≥ 0 mm" in text


def test_a_plan_in_which_nothing_can_be_hit_has_no_least_distance() -> None:
    free = plan.changed(plan.verification(), least_distance_m=np.inf, proven_distance_m=np.inf, nearest_bodies=("", ""))
    found = written(verification=free)
    assert json.loads(found.summary)["least_distance_m"] is None
    assert "– proven least distance" in Page(found.page.decode()).text


def test_the_key_of_the_page_follows_template_and_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    before = template_digest()
    assert before == template_digest()
    module = sys.modules["tasks.write_report"]  # the stage hides it
    monkeypatch.setattr(module, "version", lambda name: "999" if name == "plotly" else "1")
    upgraded = template_digest()
    monkeypatch.setattr(module, "version", lambda name: "1")
    assert len({before, upgraded, template_digest()}) == 3


def test_gaps_that_refinement_appended_are_no_planning_samples() -> None:
    found = []
    for gaps in ([6, 7, 8], [0, 0, 0]):
        entries = plan.changed(
            plan.measurability(),
            view=np.array([1, 1, 1, 4, 4, 4, 4], np.int32),
            sample=np.array([0, 1, 2, 0, *gaps], np.int32),
            cause=np.zeros(9, np.int8),
        )
        summary = json.loads(written(viewpoints=samples_of_their_own(), measurability=entries).summary)
        found.append(summary["coverage_of_samples"])
    assert found == [0.5, 0.5]


def test_the_result_is_the_one_of_this_version() -> None:
    # the pictures and plotly's script change with the libraries, the rest of the page only with this stage
    html = report().page.decode()
    html = re.sub(r"base64,[A-Za-z0-9+/=]+", "base64,", html)
    html = re.sub(
        r"<script>.*?</script>", lambda found: found[0] if "const scene" in found[0] else "", html, flags=re.S
    )
    check_golden(write_report, html + report().summary)
