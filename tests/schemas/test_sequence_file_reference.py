from pathlib import Path

from schemas.sequence_file import load_sequence_file
from tests.schemas.cell_file_reference import page_with
from tests.schemas.sequence_file_reference import PAGE, reference, sections


def test_the_page_lists_every_key_with_its_default() -> None:
    page = PAGE.read_text()
    assert page_with(reference(), page) == page, "run: python -m tests.schemas.sequence_file_reference"


def test_the_tables_name_every_section_of_the_file() -> None:
    assert set(sections()) == {
        "", "robot", "tool", "tool.payload", "tasks", "tasks.list", "planner", "planner.weights", "report",
    }  # fmt: skip


def test_the_pages_example_is_a_valid_sequence_file(tmp_path: Path) -> None:
    text = PAGE.read_text().split("```yaml\n")[1].split("```")[0]
    (tmp_path / "studs.yaml").write_text(text)
    file = load_sequence_file(tmp_path / "studs.yaml")
    assert [task.name for task in file.tasks.list] == ["left", "right"] and file.tasks.list[1].after == ("left",)
