"""The folder of results: all of one run, or without its mark."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellwright.errors import InvalidInputError
from flows.result_folder import write_files

OLD = {"summary.json": b"old", "plan.mcap": b"old", "scan.parquet": b"old"}
NEW = {"plan.mcap": b"new", "summary.json": b"new", "scan.parquet": b"new"}


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_folder_in_the_place_of_a_file_is_named_and_nothing_changes(tmp_path: Path) -> None:
    write_files(tmp_path, OLD, mark="summary.json")
    (tmp_path / "scan.parquet").unlink()
    (tmp_path / "scan.parquet").mkdir()
    with pytest.raises(InvalidInputError, match=r"scan\.parquet: a folder of this name is in the way"):
        write_files(tmp_path, NEW, mark="summary.json")
    assert contents(tmp_path) == {"summary.json": b"old", "plan.mcap": b"old"}


class Killed(BaseException):
    """Stands for the end of the process."""


@pytest.mark.parametrize("n_steps", range(8))
def test_whoever_is_killed_leaves_one_run_or_no_mark(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, n_steps: int
) -> None:
    write_files(tmp_path, OLD, mark="summary.json")
    left = n_steps

    def counted(name: str) -> None:
        real = getattr(Path, name)

        def step(self: Path, *arguments: object, **keywords: object) -> object:
            nonlocal left
            if not left:
                raise Killed
            left -= 1
            return real(self, *arguments, **keywords)

        patch.setattr(Path, name, step)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        for name in ("write_bytes", "replace", "unlink"):
            counted(name)
        write_files(tmp_path, NEW, mark="summary.json")
    found = {name: content for name, content in contents(tmp_path).items() if not name.startswith(".")}
    if "summary.json" in found:
        assert found in (OLD, NEW)
