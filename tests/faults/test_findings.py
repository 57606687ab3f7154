"""A run without a plan says what stands in the way of each sample: counted, on the part, on paper and in the lake."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from cellwright.arrays import FloatArray
from cellwright.cell.verification_scene import VerificationScene
from cellwright.errors import InfeasibleError, InvalidInputError
from flows import command_line, inspection
from flows import findings as findings_of_a_run
from flows.execution import Unwatched
from storage.lake import Lake
from tests.faults.bench import MALFORMED, NO_ANSWER, Bench
from tests.small_inspection import write_cell

CAGE = "obstacles=[{}]".format(
    ", ".join(
        f"{{name: {name}, box: {{size: [{size}]}}, pose: {{position: [{position}]}}}}"
        for name, size, position in (
            ("lid", "500 mm, 500 mm, 10 mm", "700 mm, 0 mm, 440 mm"),
            ("front", "10 mm, 500 mm, 240 mm", "455 mm, 0 mm, 320 mm"),
            ("back", "10 mm, 500 mm, 240 mm", "945 mm, 0 mm, 320 mm"),
            ("left", "480 mm, 10 mm, 240 mm", "700 mm, 245 mm, 320 mm"),
            ("right", "480 mm, 10 mm, 240 mm", "700 mm, -245 mm, 320 mm"),
        )
    )
)
"""Walls and a lid around the part: everything sees it, nothing gets in."""


def run(bench: Bench, *settings: str, code: int, words: tuple[str, ...] = ()) -> tuple[str, str]:
    cell = write_cell(bench.folder)
    set_words = [word for setting in settings for word in ("--set", setting)]
    out = ["--out", str(bench.folder / "out")]
    assert command_line.main(["inspect", str(cell), "--direct", "--lake", bench.lake, *out, *set_words, *words]) == code
    printed = bench.capsys.readouterr()
    return printed.out, printed.err


def findings(bench: Bench, *settings: str, code: int = NO_ANSWER) -> dict[str, Any]:
    printed, _ = run(bench, *settings, code=code, words=("--json",))
    found: dict[str, Any] = json.loads(printed)["findings"]
    return found


def shown(bench: Bench, reference: str) -> dict[str, Any]:
    assert command_line.main(["lake", "show", reference, "--lake", bench.lake, "--json"]) == 0
    found: dict[str, Any] = json.loads(bench.capsys.readouterr().out)
    return found


@pytest.mark.parametrize(
    ("settings", "cause"),
    [
        (("part.pose.position=[3 m, 0 m]", "table.pose.position=[3 m, 0 m, 0.1 m]"), "out of reach"),
        (("planner.measurability.max_uncertainty=1e-9 um",), "uncertainty"),
    ],
)
def test_the_cause_that_stops_every_sample_is_counted(settings: tuple[str, ...], cause: str, bench: Bench) -> None:
    found = findings(bench, *settings)
    assert found["samples"] == 50
    assert sum(found["causes"].values()) == 50
    assert found["causes"][cause] >= 45, "the table hides a few from the laser"
    assert found["step"] == "select_views"
    assert found["exit_code"] == NO_ANSWER
    artefact = shown(bench, f"{found['artefact']['kind']}/{found['artefact']['digest'][:12]}")
    assert artefact["causes"] == {"samples.cause": found["causes"]}


def test_a_body_in_the_way_is_named_with_the_samples_it_costs(bench: Bench) -> None:
    found = findings(bench, CAGE)
    assert sum(found["causes"].values()) == found["samples"]
    assert found["causes"]["collision"] == sum(found["collides_with"].values())
    assert max(found["causes"], key=found["causes"].__getitem__) == "collision"
    assert set(found["collides_with"]) <= {"lid", "front", "back", "left", "right"}
    artefact = shown(bench, f"sample-findings/{found['artefact']['digest'][:12]}")
    assert artefact["collisions"] == found["collides_with"]
    page = (bench.folder / "out" / "findings.html").read_text()
    for body, count in found["collides_with"].items():
        assert f"{body} ({count})" in page


def test_page_picture_and_json_lie_in_the_folder(bench: Bench) -> None:
    (bench.folder / "out").mkdir()
    (bench.folder / "out" / "plan.mcap").write_bytes(b"of an earlier run")
    found = findings(bench, "planner.measurability.max_uncertainty=1e-9 um")
    paths = {name: Path(path) for name, path in found["files"].items()}
    page = paths["findings"].read_text()
    assert "No plan for small" in page
    assert "the predicted uncertainty exceeds the permitted one" in page
    assert "http" not in page, "it opens without a network"
    assert found["earlier_files"] == ["plan.mcap"]
    assert "still lie in this folder: plan.mcap" in page
    with Image.open(io.BytesIO(paths["figure: findings"].read_bytes())) as picture:
        assert picture.width > 500
    assert json.loads(paths["findings as JSON"].read_text()) == found


def test_a_person_sees_the_table_and_then_the_error_with_the_cell_file_and_the_key(bench: Bench) -> None:
    printed, said = run(bench, "planner.measurability.max_uncertainty=1e-9 um", code=NO_ANSWER)
    assert printed == ""
    *before, last = said.rstrip("\n").split("\n")
    assert any("50" in line and "uncertainty" in line for line in before)
    assert any(str(bench.folder / "out" / "findings.html") in line for line in before)
    assert last.startswith("error: none of 150 views measures any of 50 samples")
    assert f"in {bench.folder / 'cell.yaml'}: " in last
    assert "planner.measurability.max_uncertainty = 1e-09 um" in last


def test_a_run_that_fails_before_the_arm_is_asked_has_the_error_alone(bench: Bench) -> None:
    found = findings(bench, "robot.start=[0 deg, 0 deg, 0 deg, 0 deg, 0 deg, 0 deg]", code=MALFORMED)
    assert (found["samples"], found["causes"], found["artefact"]) == (0, {}, None)
    assert found["step"] == "assemble_cell"
    assert "robot.start" in found["error"]
    page = (bench.folder / "out" / "findings.html").read_text().replace("&#39;", "'")
    message, _, keys = found["error"].removesuffix(")").partition(" (in ")
    assert f"<p>{message}</p><p>In the cell file {keys}.</p>" in page
    assert "The cell cannot be used as the cell file describes it." in page
    assert not (bench.folder / "out" / "findings.png").exists()


def test_a_plan_that_fails_its_verification_is_shown_where_it_fails(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def touching(scene: VerificationScene, q: FloatArray) -> tuple[str, str] | None:
        return ("scanner body", "part") if abs(q[0]) > 0.4 else None

    (bench.folder / "out").mkdir()
    (bench.folder / "out" / "findings.png").write_bytes(b"of an earlier run")
    monkeypatch.setattr(VerificationScene, "collision", touching)
    found = findings(bench)
    assert found["step"] == "verify_plan"
    said = re.fullmatch(
        r"The plan fails at ([\d.]+) s of ([\d.]+) s, on (?:sweep \d of \d \(view \d+\)|the way from .+ to .+)\.",
        found["failed_motion"],
    )
    assert said is not None and 0 < float(said[1]) < float(said[2])
    assert f"at {float(said[1]):.2f}" in found["error"] and "scanner body touches part" in found["error"]
    assert (found["samples"], found["causes"]) == (0, {}), "no sample has anything in its way"
    assert found["failed_motion"] in (bench.folder / "out" / "findings.html").read_text()
    assert {path.name for path in (bench.folder / "out").iterdir()} == {
        "findings.html", "findings.json", "findings_cell.png",
    }  # fmt: skip


def test_the_failure_is_on_the_run_s_record(bench: Bench) -> None:
    found = findings(bench, "planner.measurability.max_uncertainty=1e-9 um")
    assert command_line.main(["lake", "runs", "--lake", bench.lake, "--json"]) == 0
    record = json.loads(bench.capsys.readouterr().out)[-1]
    assert record["run_id"] == found["run_id"]
    assert (record["state"], record["failed_step"]) == ("failed", "select_views")
    assert "explain_samples" in [step["name"] for step in record["steps"]]


def test_a_plan_takes_the_findings_of_an_earlier_run_away(bench: Bench) -> None:
    findings(bench, "planner.measurability.max_uncertainty=1e-9 um")
    run(bench, code=0)
    assert {path.name for path in (bench.folder / "out").iterdir()} >= {"report.html", "summary.json"}
    assert not list((bench.folder / "out").glob("findings*"))


NOTHING_PASSES = "planner.measurability.max_uncertainty=1e-9 um"


def test_what_breaks_while_explaining_is_told_beside_the_error_and_never_instead_of_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ValueError("zero-size array")

    monkeypatch.setattr(findings_of_a_run, "_counted", broken)
    printed, said = run(bench, NOTHING_PASSES, code=NO_ANSWER, words=("--json",))
    assert said.startswith("error: none of 150 views measures any of 50 samples")
    assert said.endswith("\nnote: explaining it failed: ValueError: zero-size array\n")
    told = json.loads(printed)
    assert told["notes"] == ["explaining it failed: ValueError: zero-size array"]
    assert (told["exit_code"], told["findings"]["step"]) == (NO_ANSWER, "select_views")
    (record,) = [each for each in Lake(bench.lake).runs() if each["run_id"] == told["findings"]["run_id"]]
    assert (record["state"], record["failed_step"]) == ("failed", "select_views")


def test_a_full_disk_hides_neither_the_error_nor_what_was_found(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise InvalidInputError("cannot write findings.html: No space left on device: choose another --out")

    monkeypatch.setattr(findings_of_a_run, "write_files", full)
    printed, said = run(bench, NOTHING_PASSES, code=NO_ANSWER, words=("--json",))
    assert said.startswith("error: none of 150 views measures any of 50 samples")
    assert "\nnote: writing the findings failed: cannot write findings.html: No space left" in said
    assert json.loads(printed)["findings"]["causes"] == {"uncertainty": 50}


def test_a_cell_file_that_is_edited_during_the_run_does_not_change_what_is_said_of_it(bench: Bench) -> None:
    class Editing(Unwatched):
        def started(self, name: str) -> None:
            cell.write_text("cellwright: [half a line")

    cell = write_cell(bench.folder)
    with pytest.raises(InfeasibleError, match=r"planner\.measurability\.max_uncertainty = 1e-09 um"):
        inspection.run(cell, overrides=[NOTHING_PASSES], lake=bench.lake, direct=True, watcher=Editing())
