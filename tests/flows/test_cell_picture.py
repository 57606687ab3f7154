"""``cellwright validate --picture``: the cell is drawn without planning, and what stands wrong is told."""

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


def test_a_cell_that_collides_at_its_start_is_drawn_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "cell.png"
    block = "obstacles=[{name: block, box: {size: [1 m, 1 m, 1 m]}, pose: {position: [0 mm, 0 mm, 900 mm]}}]"
    assert validate(tmp_path, "--picture", str(file), "--set", block) == 0
    printed = capsys.readouterr().out
    assert "Attention: the start configuration collides" in printed
    assert "block" in printed
    assert file.stat().st_size > 10_000


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
