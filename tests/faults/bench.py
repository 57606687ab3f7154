"""A folder with a small cell file, and what a refusal must look like."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from flows import command_line
from storage.lake import Lake
from tests.small_inspection import write_cell

MALFORMED, NO_ANSWER, LAKE = 2, 3, 5


@dataclass(frozen=True)
class Bench:
    """A folder with a small cell file, and a lake that the tests of this module share."""

    folder: Path
    lake: str
    capsys: pytest.CaptureFixture[str]

    def refused(self, code: int, *arguments: str, cell: Path | None = None, lake: str | None = None) -> str:
        """Run `inspect`, check that it ends in this code with one message, and return the message."""
        cell = cell or write_cell(self.folder)
        found = command_line.main(["inspect", str(cell), "--direct", "--lake", lake or self.lake, "--json", *arguments])
        printed = self.capsys.readouterr()
        assert found == code, printed.err
        told = json.loads(printed.out)
        assert printed.err.startswith("error: ")
        assert "Traceback" not in printed.err
        assert Lake(self.lake).verify() == []
        said = printed.err.removeprefix("error: ").rstrip("\n")
        assert (told["error"], told["exit_code"]) == (said, code)
        return said

    def refused_setting(self, code: int, *settings: str) -> str:
        """Run `inspect` with settings, see `refused`."""
        return self.refused(code, *(word for setting in settings for word in ("--set", setting)))
