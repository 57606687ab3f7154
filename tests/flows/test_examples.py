"""Cell files are found by path, built-in examples by name from any folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellwright.errors import InvalidInputError
from flows import command_line
from flows.examples import examples, examples_folder, find_cell_file
from schemas.cell_file import load_cell_file
from schemas.layout_file import load_layout_file
from schemas.sequence_file import load_sequence_file


@pytest.fixture
def built_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "installed"
    folder.mkdir()
    (folder / "grooved.yaml").write_text("cellwright: 1\n")
    monkeypatch.setattr("flows.examples.examples_folder", lambda: folder)
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.mark.parametrize("text", ["grooved", "grooved.yaml", "examples/grooved.yaml"])
def test_an_example_is_found_by_name_from_any_folder(built_in: Path, text: str) -> None:
    assert find_cell_file(text) == built_in / "grooved.yaml"


def test_a_file_of_ones_own_goes_before_an_example(built_in: Path, tmp_path: Path) -> None:
    (tmp_path / "grooved.yaml").write_text("mine")
    assert find_cell_file("grooved.yaml") == Path("grooved.yaml")


@pytest.mark.parametrize("text", ["elsewhere/grooved.yaml", "groved", "groved.yaml"])
def test_a_near_miss_is_named(built_in: Path, text: str) -> None:
    with pytest.raises(InvalidInputError, match=f"there is no cell file {text}: did you mean the example 'grooved'"):
        find_cell_file(text)


def test_without_a_near_miss_the_examples_are_listed(built_in: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"the built-in examples are grooved \(inspect\)$"):
        find_cell_file("q")


def test_every_shipped_example_names_the_command_that_takes_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert command_line.main(["examples"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(examples()) and len({line.index("/") for line in lines}) == 1  # in columns
    load = {"inspect": load_cell_file, "layout": load_layout_file, "sequence": load_sequence_file}
    for line in lines:
        program, command, name, path = line.split(maxsplit=3)
        assert program == "cellwright" and examples()[name] == Path(path)
        load[command](Path(path))
    with pytest.raises(InvalidInputError, match=r"grooved_cylinder \(inspect\); .* \(layout\); drilling_panel, stud_w"):
        find_cell_file("q")


def test_the_shipped_examples_are_where_they_are_looked_for() -> None:
    assert examples_folder().is_dir()
    assert all(path.is_file() for path in examples().values())
