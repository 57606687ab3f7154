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
import time
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from cellwright.errors import InvalidInputError, LakeError

SCRATCH = ".scratch"
LOCKS = ".locks"

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
            except (FileNotFoundError, NotADirectoryError):
                return None

    def state(self, path: str) -> FileState | None:
        """Return size and age of a file, or ``None`` if there is none."""
        with self._telling("read", path):
            try:
                found = (self._root / path).stat()
            except (FileNotFoundError, NotADirectoryError):
                return None
            return FileState(found.st_size, found.st_mtime)

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
        return f"{fact}: mend the disk or choose another lake with --lake"


class ObjectStore:
    """An object store or any other file system that fsspec opens, ``memory://`` among them.

    Storage options (keys, endpoint) come from fsspec's own configuration. Correct without conditional writes:
    the same name always means the same bytes. A ``memory://`` lake lives and dies with its process.

    Raises:
        InvalidInputError: If the address names no known protocol, or its library is not installed.
    """

    def __init__(self, url: str) -> None:
        import fsspec  # here, so that a local lake does not pay for it

        protocol, _, rest = url.partition("://")
        if not rest.strip("/"):
            raise InvalidInputError(f"lake {url!r} names no bucket or folder: write {protocol}://bucket/folder")
        try:
            # a cached listing would hide what another process has just written
            self._files: Any = fsspec.filesystem(protocol, use_listings_cache=False)
        except ImportError as error:
            extra = "s3" if protocol in ("s3", "s3a") else protocol
            raise InvalidInputError(
                f"lake {url!r} needs a library that is not installed: pip install 'cellwright[{extra}]'"
                if extra == "s3"
                else f"lake {url!r} needs a library that is not installed: {error}"
            ) from error
        except ValueError as error:
            raise InvalidInputError(f"lake {url!r}: {error}: use a folder, memory:// or s3://") from error
        self.protocol = protocol
        self._root = str(self._files._strip_protocol(url)).rstrip("/")
        self.url = f"{protocol}://{self._root.lstrip('/')}"
        self._failures = _failures(protocol)

    @property
    def file_system(self) -> Any:
        """The fsspec file system, for readers that take one."""
        return self._files

    def address(self, path: str) -> str:
        """Return the URL of a file."""
        return f"{self.url}/{path}"

    def exists(self) -> bool:
        """Whether anything is stored under the address."""
        with self._telling("list", ""):
            return bool(self._files.exists(self._root))

    def read(self, path: str) -> bytes | None:
        """Return an object's bytes, or ``None`` if there is none."""
        with self._telling("read", path):
            try:
                return bytes(self._files.cat_file(f"{self._root}/{path}"))
            except FileNotFoundError:
                return None

    def state(self, path: str) -> FileState | None:
        """Return size and age of an object, or ``None`` if there is none."""
        with self._telling("read", path):
            try:
                return _object_state(self._files.info(f"{self._root}/{path}"))
            except FileNotFoundError:
                return None

    def walk(self, folder: str) -> dict[str, FileState]:
        """Return all objects under a folder by path, sorted."""
        with self._telling("list", folder):
            try:
                found = self._files.find(f"{self._root}/{folder}", detail=True)
            except FileNotFoundError:
                return {}
        return {str(name)[len(self._root) + 1 :]: _object_state(info) for name, info in sorted(found.items())}

    def put(self, folder: str, files: Mapping[str, bytes]) -> None:
        """Put the files one by one; each appears whole."""
        with self._telling("write", folder):
            for name, content in files.items():
                self._files.pipe_file(f"{self._root}/{folder}/{name}", content)

    def remove(self, path: str) -> None:
        """Remove an object, if it is there."""
        with self._telling("remove", path), contextlib.suppress(FileNotFoundError):
            self._files.rm_file(f"{self._root}/{path}")

    def touch(self, path: str) -> None:
        """Do nothing: objects have no time that can be set without writing them again."""

    def lock(self, name: str) -> contextlib.AbstractContextManager[None]:
        """Hold nothing: two makers write the same bytes under the same names, which is harmless."""
        return contextlib.nullcontext()

    @contextlib.contextmanager
    def _telling(self, doing: str, path: str) -> Iterator[None]:
        try:
            yield
        except self._failures as error:
            raise LakeError(
                f"cannot {doing} {self.address(path)}: {error}: check the address, the permissions and the network"
            ) from error


def _failures(protocol: str) -> tuple[type[Exception], ...]:
    if protocol not in ("s3", "s3a"):
        return (OSError,)
    from botocore.exceptions import BotoCoreError, ClientError  # type: ignore[import-not-found, unused-ignore]

    return (OSError, BotoCoreError, ClientError)


def _object_state(info: Mapping[str, Any]) -> FileState:
    changed: Any = info.get("LastModified") or info.get("mtime") or info.get("created")
    if hasattr(changed, "timestamp"):
        changed = changed.timestamp()
    # an object whose age nobody tells counts as new, so that nothing removes it for its age
    return FileState(int(info["size"]), time.time() if changed is None else float(changed))


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
