"""What the command line promises: it answers at once, errors are one message and a code, JSON stays JSON."""

from __future__ import annotations

import json
import os
import re
import shlex
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


def test_help_lists_the_exit_codes_that_the_documents_list(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command_line.main(["--help"])
    told = re.findall(r"^  (\d+)  \S", capsys.readouterr().out, re.MULTILINE)
    page = (PROJECT / "docs" / "running.md").read_text("utf-8")
    assert told == re.findall(r"^\| (\d+) \|", page, re.MULTILINE)
    assert "1" in told


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
    shown, took = capsys.readouterr().out.splitlines()
    assert shown == "[3 sweeps]"
    assert re.fullmatch(r"The run took \d+\.\d s, start-up apart\.", took)


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
    for example in json.loads(capsys.readouterr().out).values():
        assert Path(example["file"]).is_file() and example["command"] in ("inspect", "layout", "sequence")


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
    told = json.loads(capsys.readouterr().out)
    assert 0.0 <= told.pop("took_s") < 60.0
    assert told == {"coverage": 0.99, "gap": None}
    assert asked["path"] == Path("study.yaml")
    assert asked["lake"] == str(tmp_path / "elsewhere")
    assert asked["refresh"] == {"scale"}
    assert asked["out"] == Path("results")
    assert asked["direct"] is False
    assert command_line.main(["sweep", "study.yaml", "--refresh", "skale"]) == 2
    assert "did you mean 'scale'" in capsys.readouterr().err


def shell(tail: str, *command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command line with its streams redirected by a shell, and print its exit code last on standard error."""
    words = shlex.join([sys.executable, "-m", "flows.command_line", *command])
    return subprocess.run(
        ["/bin/bash", "-c", tail.replace("CELLWRIGHT", words)],
        env={**os.environ, "PYTHONPATH": str(PROJECT), **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


MISSING = ("lake", "ls", "--json", "--lake", "/nowhere/at/all")


@pytest.mark.parametrize(
    ("tail", "command", "code"),
    [
        ("CELLWRIGHT >/dev/full", ("examples",), 1),
        ("CELLWRIGHT >/dev/full", MISSING, 2),
        ("CELLWRIGHT >&-", ("examples",), 0),
        ("CELLWRIGHT >&-", MISSING, 2),
        ("CELLWRIGHT 2>&-", MISSING, 2),
        ("CELLWRIGHT 2>/dev/full", MISSING, 2),
        ("CELLWRIGHT | true; exit ${PIPESTATUS[0]}", MISSING, 2),
        ("CELLWRIGHT | true; exit ${PIPESTATUS[0]}", ("examples",), 141),
        ("CELLWRIGHT | true; exit ${PIPESTATUS[0]}", ("validate", "grooved_cylinder"), 141),
        ("CELLWRIGHT >/dev/full", ("validate", "grooved_cylinder"), 1),
        ("CELLWRIGHT >&-", ("validate", "grooved_cylinder"), 0),
    ],
)
def test_streams_that_take_nothing_end_in_a_code_without_a_traceback(
    tail: str, command: tuple[str, ...], code: int
) -> None:
    done = shell(tail, *command)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


@pytest.mark.parametrize(
    "environment",
    [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}],
)
def test_letters_that_a_stream_lacks_are_replaced_and_json_keeps_them(environment: dict[str, str]) -> None:
    code = r"from flows.output import *; prepare_streams(); print('60 \u00b5m'); write_json(['\u00b5m'])"
    done = python(code, **environment)
    assert done.returncode == 0, done.stderr
    said, _, document = done.stdout.partition("\n")
    assert said == "60 ?m"
    assert json.loads(document) == ["\u00b5m"]
