"""What the command line promises: it answers at once, errors are one message and a code, JSON stays JSON."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
import types
from pathlib import Path
from typing import Any

import pytest

from cellwright.errors import CellwrightError, InfeasibleError, InvalidInputError, LakeError, SolverError
from flows import command_line
from flows.runner import Steps
from storage.lake import Lake
from storage.manifests import Recipe
from tests.flows import small_stages as small
from tests.flows.conftest import PROJECT

HEAVY = {
    "prefect", "numpy", "pydantic", "pyarrow", "rich", "open3d", "pinocchio", "scipy", "numba", "duckdb", "trimesh",
    "matplotlib", "plotly", "highspy", "toppra", "coal", "fcl",
}  # fmt: skip


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={**os.environ, "PYTHONPATH": str(PROJECT), **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_help_imports_nothing_heavy() -> None:
    done = python("""
        import sys
        from flows.command_line import main
        try:
            main(["--help"])
        except SystemExit:
            print("MODULES", *sys.modules)
    """)
    text, _, modules = done.stdout.partition("MODULES ")
    assert "cellwright inspect" in text
    assert HEAVY.isdisjoint(modules.split()), HEAVY & set(modules.split())


def test_help_answers_at_once() -> None:
    best = min(_seconds_of_help() for _ in range(5))
    assert best <= 0.3, f"{best:.2f} s"


def _seconds_of_help() -> float:
    begun = time.monotonic()
    assert python("from flows.command_line import main; main(['--help'])").returncode == 0
    return time.monotonic() - begun


@pytest.mark.parametrize("command", [[], ["inspect"], ["validate"], ["sweep"], ["lake"], ["lake", "sql"], ["server"]])
def test_every_command_explains_itself(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main([*command, "--help"])
    assert left.value.code == 0
    assert "usage: cellwright" in capsys.readouterr().out


@pytest.mark.parametrize(
    "command", [[], ["plan"], ["inspect"], ["lake"], ["lake", "show"], ["inspect", "a", "--seed", "x"]]
)
def test_wrong_arguments_end_with_2(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        command_line.main(command)
    assert left.value.code == 2
    assert "usage: cellwright" in capsys.readouterr().err


def replace_examples(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(*ignored: Any) -> None:
        raise error

    monkeypatch.setattr("flows.examples.examples", fail)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InvalidInputError("unit is 'inchh': did you mean 'inch'?"), 2),
        (InfeasibleError("views reach 91.2% of the samples: add tilts"), 3),
        (SolverError("residual 1e-3 after 500 iterations: start again"), 4),
        (LakeError("mesh/1234 is missing: run again"), 5),
    ],
)
def test_an_expected_error_is_one_message_and_its_code(
    error: CellwrightError, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    replace_examples(monkeypatch, error)
    assert command_line.main(["examples"]) == code
    assert capsys.readouterr().err == f"error: {error}\n"


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_examples(monkeypatch, ZeroDivisionError("a bug"))
    with pytest.raises(ZeroDivisionError):
        command_line.main(["examples"])


def test_an_interrupt_ends_cleanly_with_130() -> None:
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, threading, time\n"
            "import flows.examples\n"
            "from flows import command_line\n"
            "threading.Thread(target=time.sleep, args=(60,)).start()\n"  # a stage that cannot be stopped
            "def wait():\n"
            "    print('ready', flush=True)\n"
            "    time.sleep(60)\n"
            "flows.examples.examples = wait\n"
            "sys.exit(command_line.main(['examples']))\n",
        ],
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "interrupted: what was finished is in the lake" in errors
    assert "Traceback" not in errors


def test_a_direct_run_needs_no_server(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    class Result:
        def show(self, console: Any) -> None:
            console.print("[3 sweeps]")

    def run(path: Path, *, direct: bool, **keywords: Any) -> Result:
        assert direct
        return Result()

    monkeypatch.setattr("flows.server.start", lambda say: pytest.fail("a server was started"))
    monkeypatch.setitem(sys.modules, "flows.study", types.SimpleNamespace(run=run))  # type: ignore[arg-type]
    assert command_line.main(["sweep", "study.yaml", "--direct"]) == 0
    assert capsys.readouterr().out == "[3 sweeps]\n"


@pytest.mark.flow
def test_an_interrupt_stops_a_flow_in_the_middle_of_a_stage(tmp_path: Path, lake_url: str, prefect_server: str) -> None:
    code = f"""
        import sys, types
        import tasks
        from flows import command_line
        from tests.flows import small_stages as small
        tasks.STAGES = small.STAGES

        def run(path, *, lake, watcher, **ignored):
            from prefect import flow
            from flows.runner import Steps, task_runner

            def plan():
                with Steps(lake, watcher=watcher) as step:
                    step(small.wait, {{"seconds": 60}}, numbers=step(small.count_up, {{}}))

            flow(task_runner=task_runner())(plan)()

        sys.modules["flows.study"] = types.SimpleNamespace(run=run)
        sys.exit(command_line.main(["sweep", "study.yaml", "--lake", {lake_url!r}]))
    """
    log = tmp_path / "log"
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={
            **os.environ,
            "PYTHONPATH": str(PROJECT),
            "PREFECT_API_URL": prefect_server,
            "CELLWRIGHT_HOME": str(tmp_path / "home"),
            "SMALL_STAGES_LOG": str(log),
        },
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while not (log.exists() and "wait" in log.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "count_up: " in errors
    assert "interrupted: what was finished is in the lake" in errors
    assert [manifest.about.stage for manifest in Lake(lake_url).manifests()] == ["count_up"]


def test_output_that_nobody_reads_any_more_is_no_traceback(tmp_path: Path) -> None:
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m flows.command_line examples --json | true; exit ${{PIPESTATUS[0]}}"],
        env={**os.environ, "PYTHONPATH": str(PROJECT), "PYTHONUNBUFFERED": "1"},
        capture_output=True,
        text=True,
    )
    assert "Traceback" not in done.stderr
    assert done.returncode in (0, 141)


def test_examples_name_files_that_exist(capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line.main(["examples", "--json"]) == 0
    for path in json.loads(capsys.readouterr().out).values():
        assert Path(path).is_file()


def test_a_missing_cell_file_names_the_examples(capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line.main(["validate", "nowhere.yaml"]) == 2
    assert "there is no cell file nowhere.yaml" in capsys.readouterr().err


def test_an_unreadable_cell_file_is_refused_before_a_server_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("flows.server.start", lambda say: pytest.fail("a server was started"))
    cell = tmp_path / "cell.yaml"
    cell.write_text("cellwright: 1\nprat: {file: a.stl}\n")
    assert command_line.main(["inspect", str(cell)]) == 2
    assert "prat" in capsys.readouterr().err


@pytest.mark.flow
def test_a_flow_gets_what_was_asked_for(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    stages: None,
    prefect_server: str,
) -> None:
    asked: dict[str, Any] = {}

    class Result:
        def as_json(self) -> dict[str, object]:
            return {"coverage": 0.99, "gap": float("nan")}

    def run(path: Path, **keywords: Any) -> Result:
        asked.update(keywords, path=path)
        return Result()

    monkeypatch.setitem(sys.modules, "flows.study", types.SimpleNamespace(run=run))  # type: ignore[arg-type]
    monkeypatch.setenv("PREFECT_API_URL", prefect_server)
    monkeypatch.setenv("CELLWRIGHT_LAKE", str(tmp_path / "elsewhere"))
    assert command_line.main(["sweep", "study.yaml", "--refresh", "scale", "--out", "results", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"coverage": 0.99, "gap": None}
    assert asked["path"] == Path("study.yaml")
    assert asked["lake"] == str(tmp_path / "elsewhere")
    assert asked["refresh"] == {"scale"}
    assert asked["out"] == Path("results")
    assert asked["direct"] is False
    assert command_line.main(["sweep", "study.yaml", "--refresh", "skale"]) == 2
    assert "did you mean 'scale'" in capsys.readouterr().err


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
        said = self.text_of(capsys, "ls", "--lake", str(tmp_path / "none"))
        assert f"{tmp_path / 'none'} is empty, it does not even exist yet: fill it with `cellwright inspect" in said
        assert "is empty: fill it with `cellwright inspect" in self.text_of(capsys, "ls", "--lake", str(tmp_path))
        assert self.json_of(capsys, "ls", "--lake", str(tmp_path)) == []

    @pytest.mark.parametrize("action", ["show", "lineage"])
    def test_what_is_asked_of_an_empty_lake_names_what_to_do(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], action: str
    ) -> None:
        assert command_line.main(["lake", action, "coverage", "--lake", str(tmp_path / "none")]) == 2
        said = capsys.readouterr().err
        assert "no artefact 'coverage'" in said
        assert "does not even exist yet: fill it with `cellwright inspect CELL.yaml`, or name another" in said

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
