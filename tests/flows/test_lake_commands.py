"""What `cellwright lake` shows, on a lake of three small artefacts."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flows import command_line
from flows.runner import Steps
from storage.lake import Lake
from storage.manifests import Recipe
from tests.flows import small_stages as small


class TestLakeCommands:
    """`cellwright lake`, on a lake of three small artefacts."""

    @pytest.fixture
    def lake(self, lake_url: str, stages: None, monkeypatch: pytest.MonkeyPatch) -> Lake:
        monkeypatch.setenv("CELLWRIGHT_LAKE", lake_url)
        with Steps(lake_url, direct=True) as step:
            numbers = step(small.count_up, {"n": 4})
            step(small.add_up, {}, parts=(numbers, step(small.scale, {}, numbers=numbers)))
        return Lake(lake_url)

    def json_of(self, capsys: pytest.CaptureFixture[str], *command: str, code: int = 0) -> Any:
        assert command_line.main(["lake", *command, "--json"]) == code
        return json.loads(capsys.readouterr().out)

    def text_of(self, capsys: pytest.CaptureFixture[str], *command: str, code: int = 0) -> str:
        assert command_line.main(["lake", *command]) == code
        return capsys.readouterr().out

    def test_ls_lists_artefacts_in_the_order_they_were_made(
        self, lake: Lake, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert [row["stage"] for row in self.json_of(capsys, "ls")] == ["count_up", "scale", "add_up"]
        assert "add_up v1" in self.text_of(capsys, "ls")

    def test_an_empty_lake_says_so(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert "is empty: fill it with `cellwright inspect" in self.text_of(capsys, "ls", "--lake", str(tmp_path))
        assert self.json_of(capsys, "ls", "--lake", str(tmp_path)) == []

    @pytest.mark.parametrize("action", ["show", "lineage"])
    def test_what_is_asked_of_an_empty_lake_names_what_to_do(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], action: str
    ) -> None:
        assert command_line.main(["lake", action, "coverage", "--lake", str(tmp_path)]) == 2
        said = capsys.readouterr().err
        assert "no artefact 'coverage'" in said
        assert "is empty: fill it with `cellwright inspect CELL.yaml`, or name another" in said

    @pytest.mark.parametrize("command", [["ls"], ["runs"], ["verify"], ["gc"], ["sql", "FROM runs"], ["show", "scan"]])
    def test_a_lake_that_is_not_there_is_refused(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
    ) -> None:
        assert command_line.main(["lake", *command, "--lake", str(tmp_path / "typo")]) == 2
        said = capsys.readouterr().err
        assert f"there is no lake at {tmp_path / 'typo'}: fill it with `cellwright inspect CELL.yaml`, or name" in said
        assert not (tmp_path / "typo").exists()

    def test_an_empty_address_is_no_lake(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        assert command_line.main(["lake", "ls", "--lake", ""]) == 2
        assert "is not an address for a lake" in capsys.readouterr().err

    def test_repair_sets_a_flipped_bit_aside_and_the_next_run_makes_it_anew(
        self, lake: Lake, lake_url: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        path = Path(next(iter(self.json_of(capsys, "show", "test-total")["files"].values())))
        whole = path.read_bytes()
        path.write_bytes(whole[:40] + bytes([whole[40] ^ 1]) + whole[41:])
        assert "`cellwright lake verify --repair` sets it aside" in self.text_of(capsys, "verify", code=5)
        assert "1 problems, 1 set aside: run again" in self.text_of(capsys, "verify", "--repair")
        assert self.json_of(capsys, "verify") == {"artefacts": 2, "problems": []}
        with Steps(lake_url, direct=True) as step:
            numbers = step(small.count_up, {"n": 4})
            step(small.add_up, {}, parts=(numbers, step(small.scale, {}, numbers=numbers)))
        assert self.json_of(capsys, "verify") == {"artefacts": 3, "problems": []}
        assert path.read_bytes() == whole

    @pytest.mark.parametrize("content", [b'{"run_id": 5, "steps": 5}', b"[]", b"{", b"\xff"])
    def test_what_is_no_record_of_a_run_is_named_and_left_out(
        self, lake: Lake, lake_url: str, capsys: pytest.CaptureFixture[str], content: bytes
    ) -> None:
        lake.record_run("whole", {"steps": []})
        broken = Path(lake_url) / "runs" / "broken.json"
        broken.write_bytes(content)
        assert command_line.main(["lake", "runs"]) == 0
        told = capsys.readouterr()
        assert "whole" in told.out
        assert f"warning: {broken}: is no record of a run" in told.err
        assert "whole" in [row["run_id"] for row in self.json_of(capsys, "sql", "FROM runs")]
        assert str(broken) in self.text_of(capsys, "verify", code=5)
        self.text_of(capsys, "verify", "--repair")
        assert not broken.exists()

    def test_provenance_of_wrong_types_is_left_out_and_named(
        self, lake: Lake, lake_url: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        record = next((Path(lake_url) / "provenance").rglob("*.json"))
        record.write_text('{"seconds": "long", "published_at": 7, "run": []}')
        assert len(self.json_of(capsys, "ls")) == 3
        assert "add_up v1" in self.text_of(capsys, "ls")
        assert "holds published_at, run, seconds of a wrong type" in self.text_of(capsys, "verify", code=5)

    def test_show_names_columns_origin_and_files(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        shown = self.json_of(capsys, "show", "test-total")
        assert shown["columns"][0]["name"] == "rows.value"
        assert shown["columns"][0]["rows"] == 1
        assert all(Path(path).is_file() for path in shown["files"].values())
        assert len(shown["inputs"]["parts"]) == 2
        assert "A sum" in self.text_of(capsys, "show", "test-total")

    def test_show_counts_causes(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        import numpy as np

        from flows.lake_commands import _causes
        from schemas.views import Measurability

        nothing = np.zeros(0, np.int32)
        shares = np.array([0.0])
        artefact = Measurability(
            view=nothing, sample=nothing, uncertainty_m=nothing.astype(np.float32), start_m=shares, end_m=shares,
            cause=np.array([0, 2, 2, 5], np.int8),
        )  # fmt: skip
        assert _causes(artefact) == {"samples.cause": {"none": 1, "incidence": 2, "detector occluded": 1}}

    def test_show_counts_collisions_by_body(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        import numpy as np

        from schemas.views import Reachability

        nothing, n_rows = np.zeros(0), np.zeros(0, np.int32)
        blocked_by = np.array([2, -1, 0, 2, -1], np.int32)
        reachability = Reachability(
            view=n_rows, branch=n_rows.astype(np.int8), start_m=nothing, end_m=nothing, q_start_rad=np.zeros((0, 6)),
            outcome=np.where(blocked_by >= 0, 8, 6).astype(np.int8), blocked_by=blocked_by,
            body=("fixture", "fence", "table"),
        )  # fmt: skip
        about = Recipe("follow_sweeps", 1, {}, {})
        lake.publish(about.key, reachability, about)
        shown = self.json_of(capsys, "show", "reachability")
        assert shown["collisions"] == {"table": 2, "fixture": 1}
        assert shown["causes"] == {"views.outcome": {"out of reach": 2, "collision": 3}}
        said = self.text_of(capsys, "show", "reachability")
        assert "collision with table: 2\ncollision with fixture: 1\n" in said
        assert "fence" not in said
        assert self.json_of(capsys, "show", "test-total")["collisions"] == {}

    def test_show_tells_findings(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        from flows.lake_commands import _findings
        from tests.tasks import plan_artefacts as plan

        about = Recipe("find_overlaps", 1, {}, {})
        lake.publish(about.key, plan.overlaps(), about)
        assert "finding: part and table stand in one another, by at least 12.1 mm" in self.text_of(
            capsys, "show", "standing-overlaps"
        )
        assert len(self.json_of(capsys, "show", "standing-overlaps")["findings"]) == 1
        assert self.json_of(capsys, "show", "test-total")["findings"] == []
        left_out = {"left_out_view": np.array([7], np.int32), "left_out_reason": ("no way leads there",)}
        assert _findings(plan.changed(plan.trajectory(), **left_out)) == ["view 7 is left out: no way leads there"]
        replaced = {"replaced_view": np.array([7], np.int32), "replaced_reason": ("no way",)}
        assert _findings(plan.changed(plan.trajectory(), **replaced)) == ["view 7 is replaced by others: no way"]

    def test_a_terminal_of_80_columns_has_room_for_runs_and_a_pipe_gets_whole_rows(
        self, lake: Lake, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        why = "the start configuration collides: " + "word " * 60 + "end"
        name = "0d9d1a2b-6f5c-4a4e-9d8a-0123456789ab"
        facts = {"flow": "inspect", "cell": "grooved cylinder", "host": "elsewhere"}
        lake.record_run(name, {**facts, "state": "failed", "error": why, "steps": [{"cached": True}, {}]})
        lake.record_run("short", {**facts, "state": "finished", "steps": []})
        piped = [line for line in self.text_of(capsys, "runs").splitlines() if name in line]
        assert len(piped) == 1
        assert piped[0].endswith(why)
        assert all(line == line.rstrip() for line in self.text_of(capsys, "runs").splitlines())
        monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
        monkeypatch.setenv("COLUMNS", "80")
        monkeypatch.setenv("TERM", "dumb")
        shown = self.text_of(capsys, "runs").splitlines()
        rows = [line for line in shown if "inspect" in line]
        assert len(rows) == 2
        assert max(len(row.rstrip()) for row in rows) <= 80
        assert "failed    1 of 2" in "\n".join(rows)
        assert shown[-1] == f"{name[:8]}: {why}"

    def test_show_keeps_long_settings_whole_on_a_pipe_and_short_in_a_terminal(
        self, lake: Lake, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        from tests.tasks import plan_artefacts as plan

        words = "x" * 5000
        about = Recipe("find_overlaps", 1, {"long": words}, {})
        lake.publish(about.key, plan.overlaps(), about)
        assert any(words in line for line in self.text_of(capsys, "show", "standing-overlaps").splitlines())
        monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
        shown = self.text_of(capsys, "show", "standing-overlaps")
        assert shown.count("x") < 300
        assert "(5002 letters; --json shows all)" in " ".join(shown.split())

    def test_show_of_something_unknown_ends_with_2(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        assert command_line.main(["lake", "show", "test-totl"]) == 2
        assert "did you mean test-total" in capsys.readouterr().err

    def test_lineage_reaches_the_source(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        lines = self.json_of(capsys, "lineage", "test-total")
        assert [line["stage"] for line in lines] == ["add_up", "count_up", "scale", "count_up"]
        assert "    numbers: test-numbers/" in self.text_of(capsys, "lineage", "test-total")

    def test_sql_answers(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        query = "SELECT kind, count(*) AS n FROM manifests GROUP BY kind ORDER BY kind"
        assert self.json_of(capsys, "sql", query) == [{"kind": "test-numbers", "n": 2}, {"kind": "test-total", "n": 1}]
        assert "test-total" in self.text_of(capsys, "sql", query)

    def test_verify_finds_a_flipped_bit_and_ends_with_5(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        assert self.json_of(capsys, "verify") == {"artefacts": 3, "problems": []}
        (path,) = map(Path, lake.paths(lake.resolve("test-total")).values())
        content = bytearray(path.read_bytes())
        content[-1] ^= 1
        path.chmod(0o644)
        path.write_bytes(content)
        problems = self.json_of(capsys, "verify", code=5)["problems"]
        assert [problem["address"] for problem in problems] == [str(path)]
        assert "1 problems" in self.text_of(capsys, "verify", code=5)

    def test_gc_says_what_would_go_and_deletes_nothing_young(
        self, lake: Lake, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert self.json_of(capsys, "gc")["deleted"] is False
        assert self.json_of(capsys, "gc", "--yes")["deleted"] is True
        assert len(self.json_of(capsys, "ls")) == 3

    def test_gc_forgets_old_runs_but_the_newest(self, lake: Lake, capsys: pytest.CaptureFixture[str]) -> None:
        for name, kind in (("first", "test-numbers"), ("second", "test-total"), ("third", "test-total")):
            lake.record_run(name, {"ref": lake.resolve(kind)})
        assert "recorded runs that keep what they used: 3; --keep-runs N" in self.text_of(capsys, "gc")
        assert self.json_of(capsys, "gc", "--keep-runs", "1")["forgotten_runs"] == []  # none is a day old
        for path in (Path(lake.url) / "runs").iterdir():
            os.utime(path, (0, 0))
        said = self.text_of(capsys, "gc", "--keep-runs", "1")
        assert "would forget 2 runs" in said
        assert "runs/first.json" in said
        assert "add --yes" in said
        assert self.json_of(capsys, "gc", "--keep-runs", "1", "--yes")["forgotten_runs"] == ["second", "first"]
        assert [run["run_id"] for run in lake.runs()] == ["third"]
        assert command_line.main(["lake", "gc", "--keep-runs", "0"]) == 2
        assert "at least 1 must stay" in capsys.readouterr().err
