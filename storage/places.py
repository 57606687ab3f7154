"""Where a lake's bytes live: a local folder, or an object store behind fsspec. Both keep one promise.

A file appears under its name whole or not at all, and stays what it is until it is replaced whole. The local
folder writes to scratch on the same disk, syncs and renames; object stores put whole objects.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import stat
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cellwright.errors import InvalidInputError, LakeError

SCRATCH = ".scratch"
LOCKS = ".locks"
DAMAGED = "damaged"

_FOLDERS = {"data": 2, "manifests": 1, "provenance": 1, "runs": 0, SCRATCH: None, LOCKS: None, DAMAGED: None}
"""How many levels of folders stand below each folder of a lake before its files do; ``None``: it does not matter."""

_LONGEST_WAIT_S = 0.2  # between two looks at a lock that another process holds


@dataclass(frozen=True, slots=True)
class FileState:
    """Size in bytes and time of the last change (seconds since 1970) of a stored file."""

    size: int
    changed_s: float


class Place(Protocol):
    """What the lake needs of its storage. Paths are relative, with forward slashes."""

    url: str
    """Full address of the place; opening it again gives the same place."""

    def address(self, path: str) -> str:
        """Return the full path or URL of a file."""

    def exists(self) -> bool:
        """Whether the place is there; nothing makes it before something is written."""

    def read(self, path: str) -> bytes | None:
        """Return a file's bytes, or ``None`` if there is none.

        Raises:
            LakeError: If it is there but cannot be read.
        """

    def state(self, path: str) -> FileState | None:
        """Return size and age of a file, or ``None`` if there is none."""

    def walk(self, folder: str) -> dict[str, FileState]:
        """Return all files under a folder by path, sorted; empty if there is no such folder."""

    def put(self, folder: str, files: Mapping[str, bytes]) -> None:
        """Write files into a folder, replacing those of the same name.

        Raises:
            LakeError: If the place cannot be written; nothing half-written stays.
        """

    def remove(self, path: str) -> None:
        """Remove a file, if it is there, and its folder if that is empty then."""

    def misfits(self) -> dict[str, str]:
        """Return by path what cannot belong here: a file where a folder must be, or a folder where a file must be."""

    def set_aside(self, path: str) -> None:
        """Move a file or folder to ``damaged``, where nothing finds it any more.

        Raises:
            LakeError: If the place cannot be written.
        """

    def touch(self, path: str) -> None:
        """Note that a file is in use, where the place can."""

    def lock(self, name: str) -> contextlib.AbstractContextManager[None]:
        """Hold a lock among the processes of this machine, where the place can."""


def open_place(url: str) -> Place:
    """Open a local path, ``file://``, ``memory://``, ``s3://`` or any other address that fsspec knows.

    Raises:
        InvalidInputError: If the address cannot be a lake.
    """
    if not url.strip() or "\0" in url:
        raise InvalidInputError(f"{url!r} is not an address for a lake: give its path")
    if "://" not in url:
        return LocalFolder(Path(url))
    if url.startswith("file://"):
        return LocalFolder(Path(url.removeprefix("file://")))
    from storage.object_store import ObjectStore

    return ObjectStore(url)


class LocalFolder:
    """A folder on this machine.

    Raises:
        InvalidInputError: If the path is a file or leads through one.
    """

    def __init__(self, root: Path) -> None:
        try:
            self._root = Path(os.path.abspath(root.expanduser()))  # noqa: PTH100  # keeps links as the user gave them
        except RuntimeError as error:
            raise InvalidInputError(f"lake {str(root)!r} names a home folder that does not exist") from error
        self.url = str(self._root)
        with self._telling("open", ""):
            blocking = [f for f in (self._root, *self._root.parents) if f.exists() and not f.is_dir()]
        if blocking:
            folder = blocking[0]
            raise InvalidInputError(f"lake {self._root} cannot be a folder: {folder} is a file; choose another path")

    def address(self, path: str) -> str:
        """Return the full path of a file."""
        return str(self._root / path)

    def exists(self) -> bool:
        """Whether the folder is there."""
        return self._root.is_dir()

    def read(self, path: str) -> bytes | None:
        """Return a file's bytes, or ``None`` if there is none."""
        with self._telling("read", path):
            try:
                return (self._root / path).read_bytes()
            except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
                return None

    def state(self, path: str) -> FileState | None:
        """Return size and age of a file, or ``None`` if there is none."""
        with self._telling("read", path):
            try:
                found = (self._root / path).stat()
            except (FileNotFoundError, NotADirectoryError):
                return None
            return None if stat.S_ISDIR(found.st_mode) else FileState(found.st_size, found.st_mtime)

    def walk(self, folder: str) -> dict[str, FileState]:
        """Return all files under a folder by path, sorted."""
        found: dict[str, FileState] = {}
        with self._telling("list", folder):
            for parent, _, names in os.walk(self._root / folder):
                for name in names:
                    path = (Path(parent) / name).relative_to(self._root).as_posix()
                    state = self.state(path)
                    if state is not None:
                        found[path] = state
        return dict(sorted(found.items()))

    def put(self, folder: str, files: Mapping[str, bytes]) -> None:
        """Write files to scratch, sync them, and rename them into place."""
        scratch = self._root / SCRATCH / uuid.uuid4().hex
        target = self._root / folder
        n_bytes = sum(len(content) for content in files.values())
        with self._telling("write", folder, n_bytes):
            self._clear_way(SCRATCH, ())
            self._clear_way(folder, files)
            try:
                scratch.mkdir(parents=True)
                for name, content in files.items():
                    _write_synced(scratch / name, content)
                _sync_folder(scratch)
                target.parent.mkdir(parents=True, exist_ok=True)
                _move_in(scratch, target)
            finally:
                shutil.rmtree(scratch, ignore_errors=True)

    def remove(self, path: str) -> None:
        """Remove a file and its folder if that is empty then."""
        full = self._root / path
        with self._telling("remove", path):
            full.unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # not empty, or gone already
                full.parent.rmdir()

    def misfits(self) -> dict[str, str]:
        """Return by path what cannot belong here; names that start with a dot inside are other programs'."""
        found: dict[str, str] = {}
        for top, depth in _FOLDERS.items():
            if (self._root / top).exists() and not (self._root / top).is_dir():
                found[top] = "is a file where a folder belongs"
            if depth is None:
                continue
            with self._telling("list", top):
                for parent, folders, files in os.walk(self._root / top):
                    at = Path(parent).relative_to(self._root)
                    deepest = len(at.parts) > depth
                    wrong = [name for name in (folders if deepest else files) if not name.startswith(".")]
                    fact = "is a folder where a file belongs" if deepest else "is a file where a folder belongs"
                    found |= {(at / name).as_posix(): fact for name in wrong}
                    if deepest:
                        folders.clear()
        return dict(sorted(found.items()))

    def set_aside(self, path: str) -> None:
        """Move a file or folder to ``damaged``; what stands in the place of that folder goes beside it."""
        aside = self._root / aside_path(path, of_file=not (self._root / path).is_dir())
        with self._telling("set aside", path):
            if path == DAMAGED:
                (self._root / path).rename(self._root / f"{DAMAGED}.{uuid.uuid4().hex[:8]}")
                return
            self._clear_way(DAMAGED, ())
            aside.parent.mkdir(parents=True, exist_ok=True)
            (self._root / path).replace(aside)
            with contextlib.suppress(OSError):  # not empty, or gone already
                (self._root / path).parent.rmdir()

    def _clear_way(self, folder: str, names: Iterable[str]) -> None:
        """Set aside files that stand where folders must be for a write, and folders where its files must be."""
        parts = folder.split("/")
        for path in ("/".join(parts[: i + 1]) for i in range(len(parts))):
            full = self._root / path
            if full.exists() and not full.is_dir():
                self.set_aside(path)
        for name in names:
            if (self._root / folder / name).is_dir():
                self.set_aside(f"{folder}/{name}")

    def touch(self, path: str) -> None:
        """Set the file's time to now; a lake that may only be read stays as it is."""
        with contextlib.suppress(OSError):
            os.utime(self._root / path)

    @contextlib.contextmanager
    def lock(self, name: str) -> Iterator[None]:
        """Hold a kernel lock, which a killed process gives back by dying.

        Not reentrant. The lock's file goes with the last holder.
        """
        path = self._root / LOCKS / name
        with self._telling("lock", f"{LOCKS}/{name}"):
            path.parent.mkdir(parents=True, exist_ok=True)
            held = _acquire(path)
        try:
            yield
        finally:
            # unlinked while held: whoever waits sees that its file has lost its name, and opens the new one
            with contextlib.suppress(OSError):
                path.unlink()
            fcntl.flock(held, fcntl.LOCK_UN)
            os.close(held)

    @contextlib.contextmanager
    def _telling(self, doing: str, path: str, n_bytes: int = 0) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise LakeError(f"cannot {doing} {self._root / path}: {self._mend(error, n_bytes)}") from error

    def _mend(self, error: OSError, n_bytes: int) -> str:
        fact = error.strerror or str(error)
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            free = _free_bytes(self._root)
            return (
                f"{fact} ({n_bytes / 1e6:.1f} MB to write, {free / 1e6:.1f} MB free): free some space, "
                "for instance with `cellwright lake gc --keep-runs 5 --yes`, or choose another lake with --lake"
            )
        if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT):
            return f"{fact}: make the folder writable for this user or choose another lake with --lake"
        if error.errno in (errno.EEXIST, errno.ENOTDIR, errno.EISDIR):
            return f"{fact}: `cellwright lake verify --repair` sets aside what is in the way"
        return f"{fact}: mend the disk or choose another lake with --lake"


def aside_path(path: str, *, of_file: bool = True) -> str:
    """Return where something is set aside: a manifest under its key, anything else under a name of its own."""
    if of_file and path.startswith("manifests/") and path.endswith(".json") and path.count("/") == 2:
        return f"{DAMAGED}/{path.rpartition('/')[2]}"
    return f"{DAMAGED}/{path.replace('/', '_')}.{uuid.uuid4().hex[:8]}"


def _write_synced(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _move_in(scratch: Path, target: Path) -> None:
    if not target.exists():
        try:
            scratch.rename(target)
        except OSError as error:
            if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
                raise  # else another process was faster
        else:
            _sync_folder(target.parent)
            return
    target.mkdir(exist_ok=True)  # a sweep may just have taken the empty folder
    for file in sorted(scratch.iterdir()):
        file.replace(target / file.name)
    _sync_folder(target)


def _sync_folder(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _acquire(path: Path) -> int:
    wait_s = 0.005
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            # asked for again and again, not waited for in the kernel, so that an interrupt gets through
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.stat().st_ino == os.fstat(handle).st_ino:
                return handle
        except BlockingIOError:
            time.sleep(wait_s)
            wait_s = min(2 * wait_s, _LONGEST_WAIT_S)
        except FileNotFoundError:
            pass  # its last holder took the file away
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _free_bytes(root: Path) -> int:
    for folder in (root, *root.parents):
        if folder.exists():
            return shutil.disk_usage(folder).free
    return 0
