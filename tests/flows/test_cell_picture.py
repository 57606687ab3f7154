"""``cellwright validate``: what a run would refuse is refused, the cell is drawn on request, and nothing is planned."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from PIL import Image

from flows import command_line
from tests.small_inspection import write_cell


def validate(folder: Path, *words: str) -> int:
    return command_line.main(["validate", str(write_cell(folder)), *words])


def test_the_cell_is_drawn_and_nothing_is_planned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "cell.png"
    assert validate(tmp_path, "--picture", str(file), "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["picture"], told["attention"]) == (str(file), [])
    with Image.open(io.BytesIO(file.read_bytes())) as image:
        assert min(image.size) > 800


BLOCK = "obstacles=[{name: block, box: {size: [1 m, 1 m, 1 m]}, pose: {position: [0 mm, 0 mm, 900 mm]}}]"
"""A cell in which no robot can start."""


def test_a_cell_that_collides_at_its_start_is_drawn_and_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "cell.png"
    assert validate(tmp_path, "--picture", str(file), "--set", BLOCK) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: the start configuration collides")
    assert "'block'" in said
    assert f"note: the cell is drawn in {file}" in said
    assert file.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ([BLOCK], "the start configuration collides"),
        (["part.pose.position=[691 mm, 19 mm, 587 mm]", "part.rests_on=null"], "the start configuration brings"),
        (["part.scale=1000"], "but a part must be at most 5 m"),
        (["part.unit=m"], "but a part must be at most 5 m"),
        (["part.file=garbage.stl"], "garbage.stl"),
        (["part.file=empty.step"], "empty.step"),
    ],
)
def test_what_a_run_would_refuse_is_refused_with_the_same_words(
    settings: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = write_cell(tmp_path)
    (tmp_path / "garbage.stl").write_bytes(bytes(range(256)) * 8)
    (tmp_path / "empty.step").write_bytes(b"")
    words = [str(cell), *(word for setting in settings for word in ("--set", setting))]
    assert command_line.main(["validate", *words]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert "Traceback" not in said
    assert command_line.main(["inspect", *words, "--direct", "--json", "--lake", str(tmp_path / "lake")]) == 2
    assert capsys.readouterr().err == said


def test_a_part_that_would_tip_is_told_without_a_picture_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = "table.box.size=[300 mm, 300 mm, 200 mm]"
    edge = ["--set", table, "--set", "part.pose.position=[845 mm, 0 mm]"]
    assert validate(tmp_path, *edge, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["attention"] == []
    assert told["notes"][0].startswith("the part reaches ")
    far = ["--set", "part.pose.position=[860 mm, 0 mm, 200 mm]", "--set", "part.rests_on=null"]
    assert validate(tmp_path, *far) == 0
    shown = capsys.readouterr().out
    assert "Attention: the part would tip: its centre of mass lies 10.0 mm outside" in shown
    assert "Note:" not in shown


def test_a_part_in_its_table_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sunk = "obstacles=[{name: block, box: {size: [90 mm, 90 mm, 90 mm]}, pose: {position: [700 mm, 0 mm, 220 mm]}}]"
    assert validate(tmp_path, "--picture", str(tmp_path / "cell.png"), "--set", sunk) == 0
    assert "part and block stand in one another" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("cell.jpg", "let the name end in .png"),
        ("nowhere/cell.png", "there is no folder"),
        ("taken.png", "cannot write"),
    ],
)
def test_a_picture_that_cannot_be_written_is_refused(
    name: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken.png").mkdir()
    assert validate(tmp_path, "--picture", str(tmp_path / name)) == 2
    assert words in capsys.readouterr().err


def test_a_run_that_fails_at_its_start_leaves_the_picture_beside_its_findings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    block = "obstacles=[{name: block, box: {size: [1 m, 1 m, 1 m]}, pose: {position: [0 mm, 0 mm, 900 mm]}}]"
    words = ["--direct", "--lake", str(tmp_path / "lake"), "--out", str(tmp_path / "out"), "--set", block]
    assert command_line.main(["inspect", str(write_cell(tmp_path)), *words]) == 2
    assert "findings_cell.png" in capsys.readouterr().err
    assert (tmp_path / "out" / "findings_cell.png").stat().st_size > 10_000
    assert "The whole cell: robot" in (tmp_path / "out" / "findings.html").read_text("utf-8")
