"""Write the tables of `docs/cell-file.md` from the models: `python -m tests.schemas.cell_file_reference`."""

import types
import typing
from pathlib import Path
from typing import Any

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from cellwright import quantities
from schemas.cell_file import CellFile
from schemas.cell_file_fields import Quantity, Section, TableSection

PAGE = Path(__file__).parents[2] / "docs" / "cell-file.md"
BEGIN, END = "<!-- tables: begin -->\n", "<!-- tables: end -->\n"

_SHARED = ("pose", "box", "cylinder", "sphere", "capsule", "mesh")
"""Sections that occur in many places have one table."""


def reference() -> str:
    """Return the tables of all sections as Markdown."""
    sections: dict[type[Section], str] = {}
    _collect(CellFile, "", sections)
    return "\n".join(_table(section, title) for section, title in sections.items())


def _collect(section: type[Section], title: str, found: dict[type[Section], str]) -> None:
    if section in found or section is TableSection:  # a table is a body with a name of its own
        return
    found[section] = title
    for key, field in _fields(section):
        inner = section_in(field.annotation)
        if inner is not None:
            name = key if not title or key in _SHARED else f"{title}.{key}"
            _collect(inner, "pose" if inner.__name__ == "PoseSection" else name, found)


def _fields(section: type[Section]) -> list[tuple[str, FieldInfo]]:
    return [(field.alias or name, field) for name, field in section.model_fields.items()]


def section_in(annotation: Any) -> type[Section] | None:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return annotation
    found = (section_in(member) for member in typing.get_args(annotation))
    return next((section for section in found if section is not None), None)


def _table(section: type[Section], title: str) -> str:
    named = {
        "": "## The file",
        "pose": "## Poses (`pose`, `base`, `mount`)",
        "body": "## Bodies (`table`, entries of `fixture`, `obstacles`, `scanner.housing`)",
    }
    if section.__name__ == "BodySection":
        title = "body"
    doc = " ".join((section.__doc__ or "").split())
    rows = [
        f"| `{key}` | {_kind(field)} | {_default(field)} | {field.description} |" for key, field in _fields(section)
    ]
    heading = named.get(title, f"## `{title}`")
    return "\n".join([heading, "", doc, "", "| key | written as | default | meaning |", "|---|---|---|---|", *rows, ""])


def quantity_of(field: FieldInfo) -> Quantity | None:
    """Return the quantity behind a field or behind the entries of its list."""

    def search(annotation: Any) -> Quantity | None:
        for item in (*getattr(annotation, "__metadata__", ()), *typing.get_args(annotation)):
            if isinstance(item, Quantity):
                return item
            inner = search(item)
            if inner is not None:
                return inner
        return None

    direct = [item for item in field.metadata if isinstance(item, Quantity)]
    return direct[0] if direct else search(field.annotation)


def _kind(field: FieldInfo) -> str:
    if isinstance(field.json_schema_extra, dict) and "written_as" in field.json_schema_extra:
        return str(field.json_schema_extra["written_as"])
    annotation, quantity, text = field.annotation, quantity_of(field), str(field.annotation)
    is_list = "tuple[" in text
    inner = section_in(annotation)
    if inner is not None:
        return "list of bodies" if is_list else "section"
    if is_list and "Literal" in text:
        return "list of words or lengths"
    if quantity is not None:
        noun = quantity.dimension.name.split(" ", 1)[1]
        n = 0 if "..." in text else text.count("Quantity(")
        return noun if not is_list else f"list of {n} {noun}s" if n > 1 else f"list of {noun}s"
    choices = _choices(annotation)
    if choices:
        return " or ".join(f"`{choice}`" for choice in choices)
    if "dict[" in text:
        return "name: folder"
    if "Path" in text:
        return "path"
    if "bool" in text:
        return "`true` or `false`"
    if is_list:
        return "list of pairs of names"
    return "whole number" if "int" in text else "text"


def _choices(annotation: Any) -> tuple[object, ...]:
    if typing.get_origin(annotation) is typing.Literal:
        return typing.get_args(annotation)
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return next((found for member in typing.get_args(annotation) if (found := _choices(member))), ())
    return ()


def _default(field: FieldInfo) -> str:
    value, quantity = field.default, quantity_of(field)
    if value is PydanticUndefined:
        return "required"
    if value is None or value in ((), {}):
        return "none"
    if isinstance(value, Section) or (isinstance(value, tuple) and isinstance(value[0], Section)):
        return "the T-SCAN's" if isinstance(value, tuple) else "see below"
    if isinstance(value, tuple):
        return f"`[{', '.join(_written(item, quantity) for item in value)}]`"
    return f"`{_written(value, quantity)}`"


def _written(value: object, quantity: Quantity | None) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and quantity is not None:
        return quantities.format_quantity(value, quantity.dimension)
    return str(value)


def page_with(tables: str, page: str) -> str:
    """Return the page with its tables replaced."""
    head, rest = page.split(BEGIN)
    return head + BEGIN + tables + rest[rest.index(END) :]


if __name__ == "__main__":
    PAGE.write_text(page_with(reference(), PAGE.read_text()))
