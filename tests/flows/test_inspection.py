"""The whole chain on a small coarse cell: to a verified plan, and afterwards only what changed.

One lake serves the module; what a test adds to it changes no other test's outcome.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import yaml
from rich.console import Console

import tasks
from cellwright.errors import InfeasibleError, InvalidInputError
from flows import command_line, inspection
from flows.inspection_result import InspectionResult
from flows.placement_rounds import MOVED
from schemas.study_file import COLUMNS
from storage.lake import Lake
from tests.test_documents import blocks, commands

PROJECT = Path(__file__).parents[2]
EXAMPLE = PROJECT / "examples" / "grooved_cylinder.yaml"

SMALL = (
    "part.scale=0.4",
    "obstacles=[]",
    "planner.sampling.density=0.003 /mm^2",
    "planner.refinement.rounds=1",
    "planner.verification_cloud.density_factor=5",
    "planner.viewpoints.psi_tilt=[0 deg]",
    "planner.viewpoints.delta_rot=[0 deg, 90 deg]",
    "planner.stitching.roadmap_nodes=50",
    "planner.stitching.max_alternatives=2",
    "layout.evaluations=60",
    "layout.stitched=1",
)
"""A plan in seconds: a small part, few candidates, a small roadmap."""

# one worker for all of them, or each would plan the cell anew
pytestmark = pytest.mark.xdist_group("flow")


@pytest.fixture(scope="module")
def lake_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("inspection") / "lake")


def inspected(lake_url: str, *overrides: str, **keywords: Any) -> InspectionResult:
    return inspection.run(EXAMPLE, overrides=[*SMALL, *overrides], lake=lake_url, **{"direct": True, **keywords})


@pytest.fixture(scope="module")
def first(lake_url: str) -> InspectionResult:
    return inspected(lake_url)


def computed(result: InspectionResult) -> set[str]:
    """Return the stages that were computed; those that a placement runs again count only where they run first."""
    return {record.stage for record in result.records if not record.cached and MOVED not in record.name}


def digests(steps: Any) -> dict[str, str]:
    return {step["name"]: step["digest"] for step in steps}


CHAIN = list(tasks.STAGES)
ALL = set(CHAIN[: CHAIN.index("write_report") + 1])
"""Every stage of the chain; behind its report stand those that run where there is no plan, and those of other flows."""
CLOSING_GAPS = {"find_gaps", "extend_measurability"}
"""Rounds that a plan does not come from if the first selection was the best."""
BEFORE_PLACING = {"read_source", "assemble_cell", "preprocess_mesh", "sample_surface", "sample_viewpoints"}
BEFORE_SELECTING = BEFORE_PLACING | {"place_surroundings", "measure_samples", "follow_sweeps", "trim_measurability"}


def test_a_part_file_becomes_a_verified_plan(first: InspectionResult) -> None:
    assert computed(first) == ALL
    summary = first.summary
    assert summary["verified_states"] > 1000
    assert summary["coverage"] > 0.9
    assert summary["coverage_of_coverable"] > 0.9
    assert 1 <= summary["sweeps"] <= summary["greedy_sweeps"]
    assert summary["sweeps_lower_bound"] <= summary["sweeps"]
    assert 0 < summary["scanning_s"] < summary["duration_s"] < 60
    assert summary["uncertainty_p95_m"] < 100e-6


def test_a_second_run_computes_nothing(first: InspectionResult, lake_url: str) -> None:
    again = inspected(lake_url)
    assert computed(again) == set()
    assert again.refs == first.refs
    assert again.summary == first.summary
    assert again.stage_seconds == first.stage_seconds, "the seconds are those of the computing"


def test_another_title_recomputes_the_report_alone(first: InspectionResult, lake_url: str) -> None:
    other = inspected(lake_url, "planner.report.title=Another <title>")
    assert computed(other) == {"write_report"}
    assert b"<h1>Another &lt;title&gt;</h1>" in other.report.page


def test_another_goal_recomputes_from_the_selection_on(first: InspectionResult, lake_url: str) -> None:
    goal = inspected(lake_url, "planner.selection.min_coverage=0.8")
    assert "select_views" in computed(goal)
    assert computed(goal).isdisjoint(BEFORE_SELECTING)
    assert goal.summary["sweeps"] < first.summary["sweeps"]
    assert goal.summary["coverage_of_samples"] >= 0.8
    assert "not selected" in goal.summary["causes"]


def test_another_method_recomputes_from_the_selection_on(first: InspectionResult, lake_url: str) -> None:
    greedy = inspected(lake_url, "planner.selection.method=greedy", "planner.selection.min_coverage=0.5")
    assert "select_views" in computed(greedy)
    assert computed(greedy).isdisjoint(BEFORE_SELECTING)
    assert greedy.summary["cover_method"] == "greedy"


def test_moving_the_part_recomputes_from_its_place_on(first: InspectionResult, lake_url: str) -> None:
    moved = inspected(lake_url, "part.pose.position=[690 mm, 5 mm]", "planner.selection.min_coverage=0.8")
    assert computed(moved).isdisjoint(BEFORE_PLACING)
    assert {"place_surroundings", "follow_sweeps", "stitch_sweeps", "verify_plan"} <= computed(moved)
    assert moved.refs["trajectory"] != first.refs["trajectory"]


def test_a_refreshed_stage_alone_is_computed_again(first: InspectionResult, lake_url: str) -> None:
    again = inspected(lake_url, refresh={"simulate_scan"})
    assert computed(again) == {"simulate_scan"}
    assert again.refs == first.refs


def test_the_run_is_recorded_and_its_lineage_reaches_the_part(first: InspectionResult, lake_url: str) -> None:
    lake = Lake(lake_url)
    recorded = next(run for run in lake.runs() if run["run_id"] == first.run_id)
    assert digests(recorded["steps"]) == {record.name: record.ref.digest for record in first.records}
    stages = {line.manifest.about.stage for line in lake.lineage(first.refs["report"]) if line.manifest}
    assert ALL - {"record_plan", *CLOSING_GAPS} <= stages <= ALL
    assert lake.verify() == []


def test_the_result_is_shown_to_a_person(first: InspectionResult) -> None:
    shown = io.StringIO()
    first.show(Console(file=shown, width=200))
    text = shown.getvalue()
    for words in (
        "Inspection plan: grooved cylinder",
        "surface measured",
        "verified states",
        "computed, 0 from the lake",
    ):
        assert words in text
    assert "| cycle time |" in first.as_markdown()
    assert first.coverage_rows()


def test_a_folder_that_cannot_be_written_is_refused_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InvalidInputError, match=r"cannot write into .*: Not a directory: choose another --out"):
        inspected(str(tmp_path / "lake"), out=tmp_path / "file" / "results")
    assert not (tmp_path / "lake").exists()


def test_a_part_out_of_reach_is_infeasible_and_says_why(lake_url: str, first: InspectionResult) -> None:
    with pytest.raises(InfeasibleError, match="reach"):
        inspected(lake_url, "part.pose.position=[5 m, 0 m]", "table.pose.position=[5 m, 0 m, 100 mm]")


def test_a_body_that_does_not_stand_in_the_cell_carries_nothing(first: InspectionResult, lake_url: str) -> None:
    from flows.requests import request_of

    request = request_of(EXAMPLE, SMALL).model_copy(update={"rests_on": "forearm_link"})
    with pytest.raises(InvalidInputError, match="the part rests on 'forearm_link', which does not stand in the cell"):
        inspection.plan_and_record(request, lake_url, set(), run_id="shelf", direct=True, found=[])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("command-line")


@pytest.fixture(scope="module")
def printed(folder: Path) -> dict[str, Any]:
    settings = [word for override in SMALL for word in ("--set", override)]
    done = subprocess.run(
        [sys.executable, "-m", "flows.command_line", "inspect", str(EXAMPLE), *settings, "--direct", "--json",
         "--lake", "lake", "--out", "results/first"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(PROJECT), "OMP_NUM_THREADS": "1", "CELLWRIGHT_HOME": str(folder)},
        capture_output=True,
        text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    printed: dict[str, Any] = json.loads(done.stdout)
    return printed


@pytest.fixture
def lake(folder: Path, printed: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("CELLWRIGHT_LAKE", str(folder / "lake"))
    return str(folder / "lake")


class TestCommandLine:
    """`cellwright inspect --direct` in a process of its own and on a lake of its own, and what people do afterwards."""

    def test_another_process_and_lake_make_the_same_plan(
        self, printed: dict[str, Any], first: InspectionResult
    ) -> None:
        assert digests(printed["steps"]) == {record.name: record.ref.digest for record in first.records}
        assert printed["summary"] == first.summary

    def test_the_files_are_where_it_says_and_open(self, printed: dict[str, Any], folder: Path) -> None:
        from PIL import Image

        results = folder / "results" / "first"
        paths = {name: folder / path for name, path in printed["files"].items()}
        assert {path.name for path in paths.values()} == {path.name for path in results.iterdir()} == {
            "report.html", "plan.mcap", "trajectory.parquet", "segments.parquet", "scan.parquet", "summary.json",
            "cell.png", "coverage.png", "uncertainty.png", "plan.png",
        }  # fmt: skip
        states = pq.read_table(results / "trajectory.parquet")
        assert states["time_s"][0].as_py() == 0.0
        assert states.schema.field("position_rad").metadata[b"unit"] == b"rad"
        assert pq.read_table(results / "scan.parquet").num_rows == printed["summary"]["scan_points"]
        assert (
            pq.read_table(results / "segments.parquet")["kind"].to_pylist().count("sweep")
            == printed["summary"]["sweeps"]
        )
        for name in ("coverage", "uncertainty", "plan"):
            with Image.open(results / f"{name}.png") as image:
                assert image.width > 500
        summary = json.loads((results / "summary.json").read_text())
        assert summary == {name: value for name, value in printed.items() if name not in ("files", "took_s")}

    def test_the_exported_report_says_how_this_run_went(self, printed: dict[str, Any], folder: Path) -> None:
        page = (folder / "results" / "first" / "report.html").read_text()
        assert "<!--RUN-->" not in page
        assert f"Run {printed['run_id']}" in page
        assert page.count("<td>computed</td>") == len(printed["steps"])
        assert "source-file/" in page and "by read_source version" in page

    def test_the_recording_opens_and_has_one_tree_of_frames(self, printed: dict[str, Any], folder: Path) -> None:
        from mcap.reader import make_reader

        with (folder / "results" / "first" / "plan.mcap").open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None and summary.statistics is not None
        assert {channel.topic for channel in summary.channels.values()} == {"/scene", "/tf", "/joint_states", "/scan"}
        assert summary.statistics.message_start_time == 0
        assert summary.statistics.message_end_time == pytest.approx(1e9 * printed["summary"]["duration_s"], abs=1e3)

    def test_the_lake_answers_what_was_missed_and_where_the_plan_came_from(
        self, lake: str, printed: dict[str, Any], capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert command_line.main(["lake", "show", "coverage", "--json"]) == 0
        shown = json.loads(capsys.readouterr().out)
        assert shown["digest"] == printed["artefacts"]["coverage"]["digest"]
        counted = shown["causes"]["points.cause"]
        assert {cause: n for cause, n in counted.items() if cause != "none"} == printed["summary"]["causes"]
        assert command_line.main(["lake", "lineage", "trajectory"]) == 0
        assert "source: source-file/" in capsys.readouterr().out
        query = f"SELECT count(*) AS n FROM coverage_points WHERE digest = '{shown['digest']}'"
        assert command_line.main(["lake", "sql", query, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)[0]["n"] == sum(counted.values())

    @pytest.mark.parametrize("document", ["README.md", "docs/inspect.md", "docs/lake.md"])
    def test_what_the_documents_ask_the_lake_is_answered(
        self, lake: str, document: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        asked = [words for words in commands(PROJECT / document) if words[0] == "lake" and words[1] != "gc"]
        asked += [["lake", "sql", query] for query in blocks(PROJECT / document, "sql")]
        for words in asked:
            assert command_line.main(words) == 0, words
            assert capsys.readouterr().out
        assert asked

    def test_a_rerun_prints_a_table_and_computes_nothing(self, lake: str, capsys: pytest.CaptureFixture[str]) -> None:
        settings = [word for override in SMALL for word in ("--set", override)]
        assert command_line.main(["inspect", str(EXAMPLE), *settings, "--direct"]) == 0
        printed = capsys.readouterr()
        assert "Stages: 0 computed" in printed.out
        assert "write_report: cached" in printed.err


def test_a_study_of_plans_shares_what_does_not_differ(
    first: InspectionResult, lake_url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = dict(override.split("=", 1) for override in SMALL)
    study = {
        "cellwright-study": 1,
        "name": "Goals",
        "cell": str(EXAMPLE),
        "set": {path: yaml.safe_load(value) for path, value in settings.items()},
        "axes": {"goal": {"all": {}, "most": {"planner.selection.min_coverage": 0.8}}},
        "figures": [{"title": "Sweeps", "x": "goal", "y": "sweeps"}],
    }
    (tmp_path / "goals.yaml").write_text(yaml.safe_dump(study))
    words = ["sweep", str(tmp_path / "goals.yaml"), "--lake", lake_url, "--out", str(tmp_path / "out"), "--direct"]
    assert command_line.main(words) == 0
    printed = capsys.readouterr()
    assert "follow_sweeps: cached" in printed.err
    assert "run 2 of 2 (most)" in printed.err
    table = pq.read_table(tmp_path / "out" / "table.parquet").to_pylist()
    assert [row["goal"] for row in table] == ["all", "most"]
    assert table[0]["coverage"] == first.summary["coverage"]
    assert table[1]["sweeps"] < table[0]["sweeps"]
    assert table[0]["follow_sweeps [s]"] == table[1]["follow_sweeps [s]"] > 0
    assert table[0].keys() - {"goal"} <= COLUMNS | {name for name in table[0] if name.endswith(" [s]")}


@pytest.mark.flow
class TestUnderPrefect:
    """The same plan as a flow run: what Prefect is told, and what it is not."""

    @pytest.fixture
    def ran(self, first: InspectionResult, lake_url: str, prefect_server: str) -> Iterator[InspectionResult]:
        yield inspected(lake_url, direct=False)

    def test_the_flow_run_shows_its_stages_and_figures_and_keeps_no_data(
        self, ran: InspectionResult, first: InspectionResult, prefect_server: str
    ) -> None:
        from prefect.client.orchestration import get_client
        from prefect.client.schemas.filters import ArtifactFilter, FlowRunFilter

        assert ran.refs == first.refs
        assert computed(ran) == set()
        with get_client(sync_client=True) as client:
            run = client.read_flow_run(ran.run_id)  # type: ignore[arg-type]
            mine = FlowRunFilter(id={"any_": [ran.run_id]})
            for _ in range(100):  # the server writes task runs down some time after they have ended
                stages = client.read_task_runs(flow_run_filter=mine, limit=200)
                ended = {stage.name for stage in stages if stage.state_name != "Running"}
                if ended == {record.name for record in ran.records}:
                    break
                time.sleep(0.1)
            artifacts = client.read_artifacts(
                artifact_filter=ArtifactFilter(flow_run_id={"any_": [ran.run_id]}), limit=50
            )
        assert run.state is not None and run.state.is_completed()
        assert run.state.data is None
        assert run.parameters["request"]["name"] == "grooved cylinder"
        assert len(json.dumps(run.parameters)) < 20_000
        assert {stage.name for stage in stages} == {record.name for record in ran.records}
        assert {stage.state_name for stage in stages} == {"Cached"}
        found = {artifact.key: artifact for artifact in artifacts}
        assert found.keys() == {
            "inspection-summary", "inspection-coverage", "inspection-figure-cell",
            "inspection-figure-coverage", "inspection-figure-uncertainty",
            "inspection-figure-plan",
        }  # fmt: skip
        assert "| surface measured |" in str(found["inspection-summary"].data)
        assert str(found["inspection-figure-plan"].data).startswith("data:image/png;base64,")


@pytest.mark.slow
def test_another_seed_makes_another_plan(first: InspectionResult, lake_url: str) -> None:
    other = inspected(lake_url, "planner.seed=1")
    assert {"sample_surface", "stitch_sweeps"} <= computed(other)
    assert computed(other).isdisjoint({"read_source", "assemble_cell", "preprocess_mesh", "place_surroundings"})
    assert other.refs["trajectory"] != first.refs["trajectory"]
