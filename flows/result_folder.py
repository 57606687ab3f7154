"""The folder that a person wants results in: checked before anything is computed, filled file by file.

Each file is written beside its place and renamed, so that a reader never sees half of one.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from cellwright.errors import InvalidInputError


def prepare_folder(folder: Path) -> None:
    """Make a folder and try whether files can be written into it.

    Raises:
        InvalidInputError: If not.
    """
    probe = folder / f".cellwright.{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise _refusal(folder, error) from error


def write_files(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files by their names into a folder, made if it is not there.

    Raises:
        InvalidInputError: If the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            _write(folder / name, content)
    except OSError as error:
        raise _refusal(folder, error) from error


def _write(path: Path, content: bytes) -> None:
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_bytes(content)
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def _refusal(folder: Path, error: OSError) -> InvalidInputError:
    return InvalidInputError(f"cannot write into {folder}: {error.strerror or error}: choose another --out")
