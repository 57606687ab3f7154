from pathlib import Path

from schemas.cell_file import load_cell_file
from tests.schemas.cell_file_reference import PAGE, page_with, reference


def test_the_page_lists_every_key_with_its_default() -> None:
    page = PAGE.read_text()
    assert page_with(reference(), page) == page, "run: python -m tests.schemas.cell_file_reference"


def test_the_pages_example_is_a_valid_cell_file(tmp_path: Path) -> None:
    text = PAGE.read_text().split("```yaml\n")[1].split("```")[0]
    (tmp_path / "bracket.yaml").write_text(text)
    (tmp_path / "bracket.step").write_text("ISO-10303-21;")
    assert load_cell_file(tmp_path / "bracket.yaml").planner.sampling.density_per_m2 == 1e4


def test_every_default_on_the_page_is_accepted_as_it_is_written(tmp_path: Path) -> None:
    (tmp_path / "part.stl").write_bytes(b"x")
    (tmp_path / "cell.yaml").write_text("cellwright: 1\npart: {file: part.stl}\n")
    plain = load_cell_file(tmp_path / "cell.yaml")
    settings: list[str] = []
    section: str | None = None
    for line in PAGE.read_text().splitlines():
        if line.startswith("## "):
            section = line.strip("# `") if line.startswith("## `") else None
        cells = [cell.strip() for cell in line.split("|")]
        has_default = len(cells) == 6 and cells[1].startswith("`") and cells[3].startswith("`")
        if has_default and section and section.split(".")[0] in ("robot", "scanner", "part", "planner"):
            settings.append(f"{section}.{cells[1].strip('`')}={cells[3].strip('`')}")
    assert len(settings) > 30
    spelled_out = load_cell_file(tmp_path / "cell.yaml", settings)
    for name in ("robot", "scanner", "part", "planner"):
        assert getattr(spelled_out, name) == getattr(plain, name)
