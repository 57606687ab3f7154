"""What the documents say is so: commands parse, files load, code runs, links lead somewhere, tables are complete."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

import tasks
from cellwright.causes import Cause
from flows import command_line
from schemas.cell_file import CellFile, load_cell_file
from schemas.layout_file import load_layout_file
from schemas.sequence_file import SequenceFile, load_sequence_file
from schemas.study_file import COLUMNS, LAYOUT_COLUMNS, FigureSection, StudyFile, grid, load_study_file

PROJECT = Path(__file__).parents[1]
DOCUMENTS = [PROJECT / "README.md", *sorted((PROJECT / "docs").glob("*.md"))]


def blocks(document: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", document.read_text(), flags=re.M | re.S)


def commands(document: Path) -> Iterator[list[str]]:
    """Yield the arguments of every `cellwright` command in a document's shell blocks."""
    for block in blocks(document, "sh"):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            if words[:1] == ["cellwright"]:
                yield words[1:]


def table_of(document: str, head: str) -> dict[str, list[str]]:
    """Return a table's code words by row: those of the first column, by their own names."""
    text = (PROJECT / "docs" / document).read_text()
    table = text[text.index(head) :].split("\n\n")[0]
    return {row: re.findall(r"`([^`]+)`", row.split("|")[1]) for row in table.splitlines()[2:]}


ALL_COMMANDS = [(document.name, words) for document in DOCUMENTS for words in commands(document)]


@pytest.mark.parametrize(("document", "words"), ALL_COMMANDS, ids=lambda value: str(value)[:60])
def test_every_command_in_the_documents_is_one(document: str, words: list[str]) -> None:
    assert command_line.parser().parse_args(words).run


def test_the_readme_shows_the_commands_that_matter() -> None:
    shown = [words[0] for words in commands(PROJECT / "README.md")]
    assert {"validate", "inspect", "lake"} <= set(shown)


@pytest.mark.parametrize("command", ["inspect", "validate", "sweep", "lake show", "lake sql"])
def test_examples_in_help_texts_are_commands(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command_line.main([*command.split(), "--help"])
    lines = [line.strip() for line in capsys.readouterr().out.splitlines() if line.startswith("  cellwright ")]
    assert lines
    for line in lines:
        assert command_line.parser().parse_args(shlex.split(line)[1:]).run


@pytest.fixture
def users_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the README's cell file and a part beside it."""
    import trimesh

    monkeypatch.chdir(tmp_path)
    trimesh.creation.box(extents=(120, 80, 60)).export(tmp_path / "bracket.stl")
    (tmp_path / "bracket.step").write_bytes(b"")  # loaded by stages, not by the cell file
    (tmp_path / "cell.yaml").write_text(blocks(PROJECT / "README.md", "yaml")[0])
    return tmp_path


def test_the_cell_file_of_the_readme_is_valid(users_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in commands(PROJECT / "README.md"):
        if words[0] == "validate":
            assert command_line.main(words) == 0
            assert "cell.yaml is valid" in capsys.readouterr().out
        if words[0] == "inspect":
            load_cell_file(Path(words[1]), command_line.parser().parse_args(words).overrides)


def test_every_cell_file_and_study_in_the_documents_is_valid(users_folder: Path) -> None:
    n_files = 0
    for document in DOCUMENTS:
        for number, block in enumerate(blocks(document, "yaml")):
            path = users_folder / f"{document.stem}_{number}.yaml"
            path.write_text(block)
            data = yaml.safe_load(block)
            if "stations" in data:
                load_layout_file(path)
                n_files += 1
            elif "tasks" in data:
                load_sequence_file(path)
                n_files += 1
            elif "cellwright" in data:
                load_cell_file(path)
                n_files += 1
            elif "cellwright-study" in data:
                for point in grid(load_study_file(path)):
                    load_cell_file(PROJECT / "examples" / "grooved_cylinder.yaml", point.overrides)
                n_files += 1
    assert n_files >= 3


def test_python_in_the_readme_runs() -> None:
    found = blocks(PROJECT / "README.md", "python")
    assert found
    for block in found:
        exec(compile(block, "README.md", "exec"), {})


def test_make_targets_in_the_documents_exist() -> None:
    makefile = (PROJECT / "Makefile").read_text()
    named = {name for document in DOCUMENTS for name in re.findall(r"\bmake ([a-z-]+)\b", "\n".join(
        blocks(document, "sh") + re.findall(r"`([^`]*)`", document.read_text())))}  # fmt: skip
    assert {"demo", "test"} <= named
    for name in named:
        assert re.search(rf"^{name}:", makefile, flags=re.M), f"make {name}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_to_files(document: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", document.read_text()):
        if "://" not in target:
            assert (document.parent / target).exists(), target


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_settings_in_the_documents_exist(document: Path) -> None:
    for path in set(re.findall(r"\b(planner(?:\.[a-z_]+)+)\b", document.read_text())):
        model: object = SequenceFile if document.name in ("sequence.md", "sequence-file.md") else CellFile
        for name in path.split("."):
            fields = {field.alias or key: field for key, field in model.model_fields.items()}  # type: ignore[attr-defined]
            assert name in fields, path
            model = fields[name].annotation


def test_the_readme_is_short() -> None:
    assert len((PROJECT / "README.md").read_text().splitlines()) < 150


@pytest.mark.parametrize("document", ["inspect.md", "architecture.md"])
def test_every_stage_is_in_the_table_of_stages(document: str) -> None:
    named = [name for names in table_of(document, "| stage").values() for name in names]
    assert [name for name in named if name in tasks.STAGES] == list(tasks.STAGES)


def test_every_cause_is_explained() -> None:
    text = (PROJECT / "docs" / "inspect.md").read_text().replace("\n", " ")
    for cause in Cause:
        assert cause is Cause.NONE or cause.label in text


def test_every_key_and_column_of_a_study_is_documented() -> None:
    keys = {name for names in table_of("study.md", "| key | meaning").values() for name in names}
    assert keys == {field.alias or name for name, field in StudyFile.model_fields.items()} - {"__path__"}
    figure = {names[0] for names in table_of("study.md", "| key of a figure").values()}
    assert figure == set(FigureSection.model_fields)
    named = {name for names in table_of("study.md", "| column | meaning").values() for name in names}
    assert named == COLUMNS | {"STAGE [s]"}
    of_layouts = {name for names in table_of("study.md", "| column of layouts").values() for name in names}
    assert of_layouts == LAYOUT_COLUMNS
