"""A study on a tiny grid, with the inspection itself replaced where only the study's own work is looked at."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import yaml
from PIL import Image
from rich.console import Console

from cellwright.errors import InfeasibleError, InvalidInputError, SolverError
from flows import inspection, study
from flows.execution import Unwatched
from flows.runner import Steps
from flows.study import StudyResult
from schemas.inspection_summary import METRICS
from tests.flows import small_stages
from tests.flows.small_stages import calls

STUDY: dict[str, Any] = {
    "cellwright-study": 1,
    "name": "Tiny",
    "cell": "grooved_cylinder",
    "axes": {
        "goal": {"all": {}, "most": {"planner.selection.min_coverage": 0.8}},
        "seed": {"0": {"planner.seed": 0}, "1": {"planner.seed": 1}},
    },
    "figures": [
        {"title": "Sweeps", "x": "goal", "y": "sweeps", "lines": "seed"},
        {"title": "Time", "x": "seed", "y": "select_views [s]", "panels": "goal", "scale": "log"},
    ],
    "published": [{"goal": "all", "sweeps": 9}],
}


class Plan:
    """What `flows.study` reads of an inspection's result."""

    def __init__(self, overrides: tuple[str, ...]) -> None:
        goal = 5 if any("min_coverage" in each for each in overrides) else 8
        self.summary = {
            **dict.fromkeys(METRICS, 0.5),
            "candidates": 100,
            "sweeps": goal,
            "order": "exact",
            "causes": {},
        }

    @property
    def stage_seconds(self) -> dict[str, float]:
        return {"read_source part": 1.0, "select_views": 2.0, "select_views round 1": 3.0, "verify_plan": 4.0}


class Heard(Unwatched):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def finished(self, name: str, *, cached: bool, seconds: float) -> None:
        self.lines.append(name)

    def failed(self, name: str) -> None:
        self.lines.append(f"{name}: failed")


def study_file(folder: Path, **changes: Any) -> Path:
    path = folder / "tiny.yaml"
    path.write_text(yaml.safe_dump({**STUDY, **changes}, sort_keys=False))
    return path


def run(path: Path, out: Path | None, watcher: Any = None, refresh: Any = ()) -> StudyResult:
    return study.run(path, lake="unused", refresh=refresh, out=out, watcher=watcher or Heard(), direct=True)


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    asked: list[tuple[str, ...]] = []

    def plan(cell: Path, *, overrides: tuple[str, ...], **ignored: Any) -> Plan:
        asked.append(overrides)
        if overrides == ("planner.selection.min_coverage=0.8", "planner.seed=1"):
            raise InfeasibleError("views reach 70% of the samples: add tilts")
        return Plan(overrides)

    monkeypatch.setattr(inspection, "run", plan)
    return asked


def test_a_study_leaves_one_row_a_run_and_its_pictures(planned: list[tuple[str, ...]], tmp_path: Path) -> None:
    heard = Heard()
    result = run(study_file(tmp_path), tmp_path / "out", heard)
    assert len(planned) == 4
    table = pq.read_table(tmp_path / "out" / "table.parquet").to_pylist()
    assert [(row["goal"], row["seed"], row["sweeps"]) for row in table] == [
        ("all", "0", 8), ("all", "1", 8), ("most", "0", 5), ("most", "1", None),
    ]  # fmt: skip
    assert [bool(row["error"]) for row in table] == [False, False, False, True]
    assert table[0]["planning_s"] == 5.0, "planning is from the samples to the trajectory, all rounds of it"
    assert table[0]["select_views round 1 [s]"] == 3.0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "table.parquet", "figure_1_sweeps.png", "figure_2_select_views_s.png",
    }  # fmt: skip
    for name, path in result.files.items():
        if name != "table":
            with Image.open(path) as image:
                assert image.width > 500
    assert heard.lines == [
        "run 1 of 4 (all, 0)", "run 2 of 4 (all, 1)", "run 3 of 4 (most, 0)", "run 4 of 4 (most, 1): failed",
    ]  # fmt: skip


def test_a_run_without_a_plan_is_shown_with_its_reason(planned: list[tuple[str, ...]], tmp_path: Path) -> None:
    shown = io.StringIO()
    result = run(study_file(tmp_path), tmp_path / "out")
    result.show(Console(file=shown, width=200))
    assert "no plan" in shown.getvalue()
    assert "No plan for most, 1: views reach 70% of the samples: add tilts" in shown.getvalue()
    assert result.as_json()["rows"][3]["error"] == "views reach 70% of the samples: add tilts"


def test_a_study_in_which_nothing_has_a_plan_ends_all_the_same(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def fail(*ignored: Any, **keywords: Any) -> Any:
        raise SolverError("the integer program ran out of memory")

    monkeypatch.setattr(inspection, "run", fail)
    result = run(study_file(tmp_path), tmp_path / "out")
    assert all(row["error"] for row in result.rows)
    assert all(path.is_file() for path in result.files.values())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"axes": {"goal": {"all": {"planner.selektion.method": "best"}}}, "figures": [], "published": []},
            "selektion",
        ),
        ({"cell": "groved_cylinder"}, "did you mean the example 'grooved_cylinder'"),
    ],
)
def test_a_mistake_shows_before_anything_runs(
    planned: list[tuple[str, ...]], tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InvalidInputError, match=message):
        run(study_file(tmp_path, **changes), tmp_path / "out")
    assert planned == []
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_refused_before_anything_runs(
    planned: list[tuple[str, ...]], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InvalidInputError, match="cannot write into"):
        run(study_file(tmp_path), tmp_path / "file" / "out")
    assert planned == []


def test_the_default_folder_is_named_after_the_study(
    planned: list[tuple[str, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(study_file(tmp_path), None).files["table"] == Path("tiny/table.parquet")


def test_a_refreshed_stage_is_computed_once_where_runs_share_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, lake_url: str, stages: None
) -> None:
    def chain(cell: Path, *, overrides: tuple[str, ...], refresh: Any, **ignored: Any) -> Plan:
        with Steps(lake_url, direct=True, refresh=refresh) as step:
            numbers = step(small_stages.count_up, {"n": 3})
            step(small_stages.scale, {"factor": 2.0 if "0.8" in overrides[0] else 3.0}, numbers=numbers)
        return Plan(overrides)

    monkeypatch.setattr(inspection, "run", chain)
    run(study_file(tmp_path), tmp_path / "out")
    assert calls == {"count_up": 1, "scale": 2}
    run(study_file(tmp_path), tmp_path / "out", refresh={"count_up", "scale"})
    assert calls == {"count_up": 2, "scale": 4}, "one for the four runs, and one for each of the two goals"
    run(study_file(tmp_path), tmp_path / "out")
    assert calls == {"count_up": 2, "scale": 4}
