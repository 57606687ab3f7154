"""Read a user's file into the lake, byte for byte, checked against the hash by which the stage is keyed.

The key is the hash of the bytes, not the path: a file that moves is not read again, one that changes is.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from pydantic import Field

from cellwright.errors import InvalidInputError
from schemas.params import Params
from schemas.sources import SourceFile
from schemas.stage import stage


class SourceParams(Params):
    """Which file to read."""

    path: str = Field(description="Where the file lies.", json_schema_extra={"keyed": False})
    name: str = Field(min_length=1, description="File name with its suffix; readers choose the format by it.")
    sha256: str = Field(pattern="^[0-9a-f]{64}$", description="SHA-256 of the file's bytes.")

    @classmethod
    def of(cls, path: Path) -> SourceParams:
        """Make the parameters of a file as it is now.

        Raises:
            InvalidInputError: If the file is missing, empty, a folder, or unreadable.
        """
        return cls(path=str(path), name=path.name, sha256=hashlib.sha256(_content(path)).hexdigest())


@stage(version=1)
def read_source(*, params: SourceParams) -> SourceFile:
    """Read the file.

    Raises:
        InvalidInputError: If the file is missing, empty, a folder, unreadable, or not the one that was hashed.
    """
    content = _content(Path(params.path))
    found = hashlib.sha256(content).hexdigest()
    if found != params.sha256:
        raise InvalidInputError(
            f"{params.path} changed while it was in use (sha256 {found[:12]}, expected {params.sha256[:12]}): run again"
        )
    return SourceFile(name=params.name, content=content)


def _content(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise InvalidInputError(f"{path} does not exist: check the path") from error
    except IsADirectoryError as error:
        raise InvalidInputError(f"{path} is a folder: name the file in it") from error
    except OSError as error:
        raise InvalidInputError(f"{path} cannot be read ({error.strerror or error}): check its permissions") from error
    if not content:
        raise InvalidInputError(f"{path} is empty (0 bytes): export it again")
    return content
