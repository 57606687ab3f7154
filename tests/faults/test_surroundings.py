"""Places that cannot be read or written, full disks, servers that go away: one error, nothing torn."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from flows import command_line, server
from storage.lake import Lake
from tests.faults.bench import LAKE, MALFORMED, Bench
from tests.small_inspection import write_cell
from tests.unprivileged import without_privileges


@pytest.mark.parametrize(
    ("lake", "code", "says"),
    [
        ("plate.stl", MALFORMED, "plate.stl is a file; choose another path"),
        ("plate.stl/lake", MALFORMED, "plate.stl is a file; choose another path"),
        ("x" * 300, LAKE, "File name too long"),
    ],
)
def test_a_place_that_cannot_be_a_lake_is_refused(lake: str, code: int, says: str, bench: Bench) -> None:
    assert says in bench.refused(code, lake=str(bench.folder / lake))


@pytest.fixture
def closed_folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in which this process cannot write."""
    folder = tmp_path / "closed"
    folder.mkdir()
    folder.chmod(0o555)
    for each in tmp_path.parents:  # pytest keeps its folders to their owner, who is somebody else below
        if "pytest-of-" in str(each):
            each.chmod(0o755)
    tmp_path.chmod(0o755)
    try:
        with without_privileges():
            yield folder
    finally:
        folder.chmod(0o755)


def test_a_lake_that_cannot_be_written_is_told(
    tmp_path: Path, closed_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell, acting = tmp_path / "cell.yaml", os.geteuid()
    os.seteuid(os.getuid())
    write_cell(tmp_path)
    os.seteuid(acting)
    assert (
        command_line.main(["inspect", str(cell), "--direct", "--json", "--lake", str(closed_folder / "lake")]) == LAKE
    )
    said = capsys.readouterr().err
    assert "Permission denied: make the folder writable for this user or choose another lake with --lake" in said
    assert list(closed_folder.iterdir()) == []


STUDY = """\
cellwright-study: 1
name: tiny
cell: cell.yaml
axes: {seed: {"0": {planner.seed: 0}}}
figures: [{title: Sweeps, x: seed, y: sweeps}]
"""


@pytest.mark.parametrize("command", ["inspect", "sweep"])
@pytest.mark.parametrize("lake", ["", " "])
def test_an_empty_address_is_no_lake_and_starts_no_server(
    command: str, lake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CELLWRIGHT_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    cell = write_cell(tmp_path)
    study = tmp_path / "study.yaml"
    study.write_text(STUDY)
    before = sorted(tmp_path.rglob("*"))
    assert command_line.main([command, str(study if command == "sweep" else cell), "--lake", lake]) == MALFORMED
    printed = capsys.readouterr()
    assert printed.err == f"error: {lake!r} is not an address for a lake: give its path\n"
    assert printed.out == ""
    assert sorted(tmp_path.rglob("*")) == before


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Take the right to write anywhere in a folder from this process."""
    entries = [folder, *folder.rglob("*")]
    modes = [entry.stat().st_mode for entry in entries]
    for entry in entries:
        entry.chmod(0o555 if entry.is_dir() else 0o444)
    for each in folder.parents:  # pytest keeps its folders to their owner, who is somebody else below
        if "pytest-of-" in str(each):
            each.chmod(0o755)
    try:
        with without_privileges():
            yield
    finally:
        for entry, mode in zip(entries, modes, strict=True):
            entry.chmod(mode)


def test_a_read_only_lake_that_has_everything_gives_the_plan_and_says_that_the_run_is_not_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell, lake, out = write_cell(tmp_path), tmp_path / "lake", tmp_path / "out"
    command = ["inspect", str(cell), "--direct", "--lake", str(lake)]
    assert command_line.main([*command, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    out.mkdir()
    out.chmod(0o777)
    files = sorted(lake.rglob("*"))
    with read_only(lake):
        assert command_line.main([*command, "--json", "--out", str(out)]) == 0
        printed = capsys.readouterr()
        again = json.loads(printed.out)
        assert command_line.main(command) == 0
        said = capsys.readouterr().err
        assert command_line.main([*command, "--json", "--set", "planner.selection.min_coverage=0.5"]) == LAKE
        refused = capsys.readouterr().err
    assert all(step["cached"] for step in again["steps"])
    assert again["artefacts"] == made["artefacts"]
    assert (out / "report.html").stat().st_size > 1000
    (note,) = again["notes"]
    assert note.startswith("this run is not on record")
    assert "Permission denied" in note
    assert [line for line in said.splitlines() if line.startswith("warning: ")] == [f"warning: {note}"]
    assert refused.startswith("error: cannot ")
    assert "Permission denied" in refused
    assert len(refused.splitlines()) == 1
    assert sorted(lake.rglob("*")) == files
    assert len(Lake(str(lake)).runs()) == 1


def test_a_full_disk_is_told_and_leaves_only_whole_artefacts(bench: Bench) -> None:
    disk = bench.folder / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=60k", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small disk is not permitted here")
    try:
        said = bench.refused(LAKE, lake=str(disk / "lake"))
        assert "No space left on device" in said
        assert "free some space" in said
        assert Lake(str(disk / "lake")).verify() == []
        assert len(list(Lake(str(disk / "lake")).manifests())) >= 1
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_result_folder_that_cannot_be_written_is_refused_before_planning(bench: Bench) -> None:
    write_cell(bench.folder)
    said = bench.refused(MALFORMED, "--out", str(bench.folder / "plate.stl" / "out"), lake=str(bench.folder / "new"))
    assert "plate.stl" in said
    assert "--out" in said
    assert not (bench.folder / "new").exists()


def test_an_unknown_stage_to_refresh_is_refused(bench: Bench) -> None:
    assert "did you mean 'select_views'?" in bench.refused(MALFORMED, "--refresh", "select_view")


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["show", "coverage"], MALFORMED, "no artefact 'coverage'"),
        (["show", "abc"], MALFORMED, "abc"),
        (["lineage", "nope"], MALFORMED, "no artefact 'nope'"),
        (["sql", "selec 1"], MALFORMED, "syntax error"),
        (["sql", "select * from nope"], MALFORMED, "nope"),
    ],
)
def test_a_lake_command_about_nothing_is_refused(arguments: list[str], code: int, says: str, bench: Bench) -> None:
    empty = bench.folder / "none"
    empty.mkdir()
    assert command_line.main(["lake", *arguments, "--lake", str(empty)]) == code
    said = bench.capsys.readouterr().err
    assert says in said
    assert "Traceback" not in said


def test_a_server_that_goes_away_during_a_run_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    gone = server.ServerStatus("running", "http://127.0.0.1:9/api", 1, tmp_path)
    monkeypatch.setenv("CELLWRIGHT_HOME", str(tmp_path))
    monkeypatch.setattr(server, "start", lambda say: gone)
    monkeypatch.setattr(server, "_require_answer", lambda url: None)
    with pytest.raises(server.ServerError, match=r"stopped answering .* run again"), server.connected(print):
        raise httpx.ConnectError("[Errno 111] Connection refused")
