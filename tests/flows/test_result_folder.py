"""The folder of results: all of one run, or without its mark."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cellwright.errors import InfeasibleError, InvalidInputError
from flows.result_folder import prepare_folder, prepared, write_files
from tests.flows.conftest import PROJECT

OLD = {"summary.json": b"old", "plan.mcap": b"old", "scan.parquet": b"old"}
NEW = {"plan.mcap": b"new", "summary.json": b"new", "scan.parquet": b"new"}


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_folder_in_the_place_of_a_file_is_named_and_nothing_changes(tmp_path: Path) -> None:
    write_files(tmp_path, OLD, mark="summary.json")
    (tmp_path / "scan.parquet").unlink()
    (tmp_path / "scan.parquet").mkdir()
    with pytest.raises(InvalidInputError, match=r"scan\.parquet: a folder of this name is in the way"):
        write_files(tmp_path, NEW, mark="summary.json")
    assert contents(tmp_path) == {"summary.json": b"old", "plan.mcap": b"old"}


def test_what_must_not_stand_beside_goes_and_a_folder_of_that_name_stays(tmp_path: Path) -> None:
    (tmp_path / "findings.html").write_bytes(b"of an earlier run")
    (tmp_path / "findings.json").mkdir()
    write_files(tmp_path, NEW, mark="summary.json", gone=("findings.html", "findings.json", "scan.parquet"))
    assert contents(tmp_path) == NEW
    assert (tmp_path / "findings.json").is_dir()


def test_what_a_killed_process_left_is_cleared_away_and_what_a_living_one_writes_is_not(tmp_path: Path) -> None:
    script = (
        "import os, pathlib, sys; from flows.result_folder import write_files\n"
        "pathlib.Path.replace = lambda *paths: os.kill(os.getpid(), 9)\n"
        "write_files(pathlib.Path(sys.argv[1]), {'plan.mcap': b'half', 'summary.json': b'half'})"
    )
    killed = subprocess.run([sys.executable, "-c", script, str(tmp_path)], cwd=PROJECT, check=False)
    assert killed.returncode == -9
    left = sorted(path.name for path in tmp_path.iterdir())
    assert len(left) == 2
    ours = tmp_path / re.sub(r"-\d+-", f"-{os.getpid()}-", left[0])
    elsewhere = tmp_path / ".cellwright-elsewhere-1-plan.mcap"
    users = tmp_path / ".hidden.12345"
    for each in (ours, elsewhere, users):
        each.write_bytes(b"")
    prepare_folder(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {ours.name, elsewhere.name, users.name}


class Killed(BaseException):
    """Stands for the end of the process."""


@pytest.mark.parametrize("error", [InfeasibleError("no way"), KeyboardInterrupt()])
def test_a_run_without_result_leaves_no_empty_folder(tmp_path: Path, error: BaseException) -> None:
    with pytest.raises(type(error)), prepared(tmp_path / "new" / "out"):
        assert (tmp_path / "new" / "out").is_dir()
        raise error
    assert not contents(tmp_path) and not (tmp_path / "new").exists()


def test_a_folder_that_stood_there_or_holds_something_stays(tmp_path: Path) -> None:
    with pytest.raises(Killed), prepared(tmp_path):
        raise Killed
    filled = tmp_path / "filled"
    with pytest.raises(Killed), prepared(filled):
        (filled / "picture.png").write_bytes(b"")
        raise Killed
    assert contents(filled) == {"picture.png": b""}


@pytest.mark.parametrize("n_steps", range(8))
def test_whoever_is_killed_leaves_one_run_or_no_mark(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n_steps: int
) -> None:
    write_files(tmp_path, OLD, mark="summary.json")
    left = n_steps

    def counted(name: str) -> None:
        real = getattr(Path, name)

        def step(self: Path, *arguments: object, **keywords: object) -> object:
            nonlocal left
            if not left:
                raise Killed
            left -= 1
            return real(self, *arguments, **keywords)

        patch.setattr(Path, name, step)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        for name in ("write_bytes", "replace", "unlink"):
            counted(name)
        write_files(tmp_path, NEW, mark="summary.json")
    found = {name: content for name, content in contents(tmp_path).items() if not name.startswith(".")}
    if "summary.json" in found:
        assert found in (OLD, NEW)
