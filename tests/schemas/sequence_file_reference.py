"""Write the tables of `docs/sequence-file.md` from the models: `python -m tests.schemas.sequence_file_reference`."""

from pathlib import Path

from pydantic_core import PydanticUndefined

from schemas.cell_file_fields import BodySection, PoseSection, Section, TableSection
from schemas.sequence_file import SequenceFile, WorkpieceSection
from tests.schemas import cell_file_reference as cells

PAGE = Path(__file__).parents[2] / "docs" / "sequence-file.md"

_ELSEWHERE = (PoseSection, BodySection, TableSection, WorkpieceSection)
"""Sections whose tables stand in `docs/cell-file.md`."""


def sections() -> dict[str, type[Section]]:
    """Return the sections of the file by their dotted names, the whole file by an empty one."""
    found: dict[str, type[Section]] = {}

    def collect(section: type[Section], title: str) -> None:
        found[title] = section
        for name, field in section.model_fields.items():
            inner, key = cells.section_in(field.annotation), field.alias or name
            if inner is not None and inner not in _ELSEWHERE and not issubclass(inner, BodySection):
                collect(inner, f"{title}.{key}".strip("."))

    collect(SequenceFile, "")
    return found


def reference() -> str:
    """Return the tables of all sections as Markdown."""
    return "\n".join(_table(section, title) for title, section in sections().items())


def _table(section: type[Section], title: str) -> str:
    heading = f"## `{title}`" if title else "## The file"
    doc = " ".join((section.__doc__ or "").split())
    rows = []
    for name, field in section.model_fields.items():
        key = field.alias or name
        default = "required" if field.default is PydanticUndefined else cells._default(field)
        rows.append(f"| `{key}` | {_kind(section, name)} | {default} | {field.description} |")
    return "\n".join([heading, "", doc, "", "| key | written as | default | meaning |", "|---|---|---|---|", *rows, ""])


_KINDS = {
    "direction": "list of 3 numbers",
    "after": "name or list of names",
    "list": "list of tasks",
    "end": "`return`, `anywhere` or list of angles",
    "touches": "list of pairs of names",
    "part": "body, see the [cell file](cell-file.md)",
    "table": "body, see the [cell file](cell-file.md)",
}


def _kind(section: type[Section], name: str) -> str:
    return _KINDS.get(name) or cells._kind(section.model_fields[name])


if __name__ == "__main__":
    PAGE.write_text(cells.page_with(reference(), PAGE.read_text()))
