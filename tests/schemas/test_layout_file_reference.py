"""The reference of the layout file's keys is the one that the models have."""

from __future__ import annotations

from tests.schemas.cell_file_reference import page_with
from tests.schemas.layout_file_reference import PAGE, reference


def test_the_reference_lists_every_key() -> None:
    page = PAGE.read_text()
    assert page_with(reference(), page) == page, "run: python -m tests.schemas.layout_file_reference"
