"""The folder that a person wants results in: checked before anything is computed, filled all at once.

Every file is written beside its place first, and only when all are there they are renamed: a reader never sees half
of one, and a disk that fills up leaves the folder as it was. The renames are many, so one file is the mark: it goes
before the first of them and comes back with the last. A folder that has it holds the results of one run.
"""

from __future__ import annotations

import contextlib
import os
import platform
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

from cellwright.errors import InvalidInputError

_HOST = re.sub(r"[^A-Za-z0-9.]", "_", platform.node())[:80]
_BESIDE = re.compile(rf"\.cellwright-{re.escape(_HOST)}-(\d+)-")
"""Files of this machine that wait beside their places, with the process that wrote them."""


def prepare_folder(folder: Path) -> None:
    """Make a folder, try whether files can be written into it, and clear away what killed processes left there.

    Raises:
        InvalidInputError: If not.
    """
    probe = _beside(folder, "probe")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
        left = [path for path in folder.iterdir() if (found := _BESIDE.match(path.name)) and _is_dead(int(found[1]))]
    except OSError as error:
        raise _refusal(folder, error) from error
    _remove(left)


@contextlib.contextmanager
def prepared(folder: Path | None) -> Iterator[None]:
    """Prepare a folder if there is to be one; where what follows fails and leaves it empty, it goes again.

    Raises:
        InvalidInputError: If files cannot be written into it.
    """
    if folder is None:
        yield
        return
    made = [path for path in (folder, *folder.parents) if not os.path.exists(path)]  # noqa: PTH110  # no error where it may not be looked at
    prepare_folder(folder)
    with contextlib.ExitStack() as undo:
        undo.callback(_remove_empty, made)
        yield
        undo.pop_all()


def _remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders, the innermost first, up to the first that holds something."""
    with contextlib.suppress(OSError):
        for folder in folders:
            folder.rmdir()


def write_files(
    folder: Path, contents: Mapping[str, bytes], *, mark: str | None = None, gone: Collection[str] = ()
) -> None:
    """Write files by their names into a folder, made if it is not there.

    Args:
        folder: The folder.
        contents: What to write, by file name.
        mark: The file that stands only beside all the others of the same call; ``None``: the last one.
        gone: Files of earlier calls that must not stand beside these; a folder of such a name is none of ours.

    Raises:
        InvalidInputError: If the folder cannot be written; the error names the file that is in the way.
    """
    last = mark or list(contents)[-1]
    names = [*(name for name in contents if name != last), last]
    beside = {name: _beside(folder, name) for name in names}
    at = folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in names:
            at = folder / name
            if at.is_dir():
                raise InvalidInputError(
                    f"cannot write {at}: a folder of this name is in the way, nothing was changed: move it away or "
                    "choose another --out"
                )
            beside[name].write_bytes(contents[name])
        (folder / last).unlink(missing_ok=True)
        for at in (folder / name for name in gone if name not in beside):
            if not at.is_dir():
                at.unlink(missing_ok=True)
        for name in names:
            at = folder / name
            beside[name].replace(at)
    except OSError as error:
        raise _refusal(at, error) from error
    finally:
        _remove(beside.values())


def _beside(folder: Path, name: str) -> Path:
    return folder / f".cellwright-{_HOST}-{os.getpid()}-{name}"


def _is_dead(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):
        pass  # somebody else's, or no number of a process
    return False


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        with contextlib.suppress(OSError):  # a folder that has gone meanwhile must not hide why
            path.unlink(missing_ok=True)


def _refusal(path: Path, error: OSError) -> InvalidInputError:
    return InvalidInputError(f"cannot write into {path}: {error.strerror or error}: choose another --out")
