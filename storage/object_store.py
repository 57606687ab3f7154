"""A lake's bytes in an object store behind fsspec: whole objects, no locks, no renames."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from typing import Any

from cellwright.errors import InvalidInputError, LakeError
from storage.places import FileState, aside_path


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

    def misfits(self) -> dict[str, str]:
        """Return nothing: an object store has no folders that could stand in the way of files."""
        return {}

    def set_aside(self, path: str) -> None:
        """Move an object to ``damaged``."""
        content = self.read(path)
        if content is not None:
            folder, _, name = aside_path(path).rpartition("/")
            self.put(folder, {name: content})
            self.remove(path)

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
