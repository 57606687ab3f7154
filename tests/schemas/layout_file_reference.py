"""Write the tables of `docs/layout-file.md` from the models: `python -m tests.schemas.layout_file_reference`."""

from __future__ import annotations

from pathlib import Path

from pydantic.fields import FieldInfo

from schemas.cell_file_fields import Section
from schemas.layout_file import LayoutFile
from tests.schemas.cell_file_reference import _default, _fields, _kind, page_with, section_in

PAGE = Path(__file__).parents[2] / "docs" / "layout-file.md"

_SHARED = {
    "PoseSection": "Poses (`pose`, `base`, `tool`, `offset`, entries of `line` and `path`)",
    "HarnessSection": "`harness`",
    "PlanarSection": "`harness.planar`",
    "DesignJointSection": "`harness.joints`",
    "BoxSection": "`box`",
    "RodSection": "`cylinder` and `capsule`",
    "SphereSection": "`sphere`",
    "MeshSection": "`mesh`",
    "BallSection": "`spheres` of a hull",
}
"""Sections that occur in many places have one table."""
_LISTS = ("stations", "sequence", "obstacles", "walls", "hull", "approaches", "path", "line", "spheres")
_WRITTEN = {
    "sequence": "list of names",
    "cells": "list of 3 whole numbers",
    "normal": "list of 3 numbers",
    "home": "list of angles or lengths",
    "quaternion": "list of 4 numbers",
}


def reference() -> str:
    """Return the tables of all sections as Markdown."""
    sections: dict[type[Section], str] = {}
    _collect(LayoutFile, "", sections)
    return "\n".join(_table(section, title) for section, title in sections.items())


def _collect(section: type[Section], title: str, found: dict[type[Section], str]) -> None:
    if section in found:
        return
    found[section] = title
    for key, field in _fields(section):
        inner = section_in(field.annotation)
        if inner is not None:
            _collect(inner, f"{title}.{key}" if title else key, found)


def _table(section: type[Section], title: str) -> str:
    heading = _SHARED.get(section.__name__, f"`{title}`" if title else "The file")
    doc = " ".join((section.__doc__ or "").split())
    rows = [
        f"| `{key}` | {_written(key, field)} | {_shown(field)} | {field.description} |"
        for key, field in _fields(section)
    ]
    return "\n".join(
        [f"## {heading}", "", doc, "", "| key | written as | default | meaning |", "|---|---|---|---|", *rows, ""]
    )


def _written(key: str, field: FieldInfo) -> str:
    if key in _WRITTEN and not (isinstance(field.json_schema_extra, dict) and "written_as" in field.json_schema_extra):
        return _WRITTEN[key]
    if key in _LISTS and section_in(field.annotation) is not None and "tuple" in str(field.annotation):
        return "list of sections"
    return _kind(field)


def _shown(field: FieldInfo) -> str:
    return _default(field)


if __name__ == "__main__":
    PAGE.write_text(page_with(reference(), PAGE.read_text()))
