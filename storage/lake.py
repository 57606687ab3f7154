"""The lake: every result under the key of its recipe, every content once under its digest.

``data/<kind>/<digest>/<files>`` holds the content, ``manifests/<key[:2]>/<key>.json`` commits it. Files go first,
the manifest last, each whole or not at all, so whatever a manifest names was complete when it was written. What
time or a faulty disk did to it since is found: a missing or short file makes `Lake.find` answer "not there", a
changed one makes `Lake.load` raise and sets the manifest aside, and either way the stage runs again and mends it.

`find` costs one small file and a look at the sizes; `load` reads, hashes and checks everything.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from cellwright.errors import InvalidInputError, LakeError
from schemas.artefact import Artefact, digest
from schemas.references import Ref
from schemas.stage import Progress, no_progress
from storage import lineage as tracing
from storage import upkeep
from storage.formats import fingerprint, format_of, known_class
from storage.manifests import (
    FileEntry,
    Manifest,
    Recipe,
    check_hash,
    check_kind,
    data_folder,
    manifest_path,
    provenance_path,
)
from storage.places import Place, open_place
from storage.records import Problem, plain_provenance, read_runs

_RUN_ID = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")


class Lake:
    """A lake at an address: a local folder, ``file://``, ``memory://`` or ``s3://``.

    Nothing is created before something is written. Pickles by its address.

    Raises:
        InvalidInputError: If the address cannot be a lake.
    """

    def __init__(self, url: str) -> None:
        self.place: Place = open_place(str(url))
        self.url = self.place.url

    def __reduce__(self) -> tuple[type[Lake], tuple[str]]:
        return Lake, (self.url,)

    def __repr__(self) -> str:
        return f"Lake({self.url!r})"

    def find(self, key: str) -> Ref | None:
        """Return the result under a key, or ``None`` if it is not there whole.

        Also ``None``, because the stage that runs again will mend it: a manifest that cannot be understood, a
        missing or short file, an artefact written under other declarations of its class.

        Raises:
            LakeError: If the lake cannot be read.
            InvalidInputError: If the key is malformed.
        """
        path = manifest_path(check_hash("key", key))
        content = self.place.read(path)
        if content is None:
            return None
        try:
            manifest = Manifest.from_json(content, self.place.address(path), key)
            current = fingerprint(known_class(manifest.kind))
        except (LakeError, InvalidInputError):
            return None
        if manifest.schema != current:
            return None
        for name, entry in manifest.files.items():
            state = self.place.state(f"{manifest.folder}/{name}")
            if state is None or state.size != entry.size:
                return None
        self.place.touch(path)
        return manifest.ref

    def load(self, ref: Ref) -> Artefact:
        """Read an artefact, checking every file's SHA-256, units and frames, and the digest of the content.

        If something is missing or does not match, the manifest is set aside under ``damaged/``, so that the next
        run does not find the artefact and makes it anew. A read that fails (disk, network, too many open files)
        says nothing about the content: it is raised, and the next `load` may succeed.

        Raises:
            LakeError: If the artefact is missing, unreadable or not what its manifest says.
            InvalidInputError: If its kind is not known.
        """
        manifest = self.manifest(ref)
        if manifest.digest != ref.digest:
            raise LakeError(
                f"{ref} was made again with another content, {manifest.ref}: run again to use the newer one"
            )
        kind = known_class(manifest.kind)
        if manifest.schema != fingerprint(kind):
            raise LakeError(f"{ref} was written under other declarations of {kind.__name__}: run again to make it anew")
        read = {name: self._read_file(manifest, name) for name in manifest.files}
        try:
            files = {name: self._checked_file(manifest, name, content) for name, content in read.items()}
            artefact = format_of(kind).decode(kind, files)
            found = digest(artefact)
            if found != manifest.digest:
                raise LakeError(f"its content has digest {found[:12]}")
        except LakeError as error:
            raise self._damaged(manifest, error) from error
        return artefact

    def publish(self, key: str, artefact: Artefact, about: Recipe, provenance: Mapping[str, Any] | None = None) -> Ref:
        """Store an artefact under the key of its recipe: files first, manifest last.

        Content that is there already is checked and kept, or mended where it is torn.

        Args:
            key: The recipe's key.
            artefact: What the stage returned.
            about: The recipe.
            provenance: Time, host, run, duration, ...: facts about this making that are in no key and no digest.

        Raises:
            LakeError: If the lake cannot be written (permissions, full disk); nothing half-written stays.
            InvalidInputError: If the key is not the recipe's, or a value has no stored form.
        """
        if about.key != key:
            raise InvalidInputError(f"key {key[:12]} is not that of its recipe, {about.key[:12]}")
        kind = check_kind(artefact.KIND)
        files = format_of(type(artefact)).encode(artefact)
        content = digest(artefact)
        folder = data_folder(kind, content)
        entries = {name: FileEntry.of(file) for name, file in files.items()}
        present = self._present(type(artefact), content, entries)
        if present is None:
            self.place.put(folder, files)
        else:
            entries = present
            for name in entries:  # or a sweep for old, unnamed data might take it before the manifest names it
                self.place.touch(f"{folder}/{name}")
        self._put_json(provenance_path(key), {"published_at": _now(), **(provenance or {})})
        manifest = Manifest(kind, key, content, fingerprint(type(artefact)), entries, about)
        self._put(manifest_path(key), manifest.to_json())
        return manifest.ref

    @contextlib.contextmanager
    def alone(self, key: str) -> Iterator[None]:
        """Be the only maker of a key on this machine; waits for the other one. Nothing on object stores.

        Raises:
            LakeError: If the lake cannot be written.
        """
        with self.place.lock(f"{check_hash('key', key)}.lock"):
            yield

    def manifest(self, of: Ref | str) -> Manifest:
        """Return the manifest of a reference or key.

        Raises:
            LakeError: If it is missing or not valid.
        """
        key = check_hash("key", of.key if isinstance(of, Ref) else of)
        path = manifest_path(key)
        content = self.place.read(path)
        if content is None:
            shown = str(of) if isinstance(of, Ref) else f"key {key[:12]}"
            if self.place.state(upkeep.damaged_path(key)) is not None:
                raise LakeError(f"{shown} was damaged and is set aside in {self.url}: run again to make it anew")
            raise LakeError(f"{shown} is not in the lake {self.url}: run again to make it")
        return Manifest.from_json(content, self.place.address(path), key)

    def manifests(self) -> Iterator[Manifest]:
        """Yield every valid manifest, by key. `verify` names those that are not."""
        for path in self.place.walk("manifests"):
            manifest = upkeep.read_manifest(self.place, path)
            if isinstance(manifest, Manifest):
                yield manifest

    def provenance(self, of: Ref | str) -> dict[str, Any] | None:
        """Return when, where and in which run an artefact was made, if that is recorded."""
        key = check_hash("key", of.key if isinstance(of, Ref) else of)
        record = self._json(provenance_path(key))
        return None if record is None else plain_provenance(record)[0]  # `verify` names what is left out

    def paths(self, ref: Ref) -> dict[str, str]:
        """Return the full path or URL of each of an artefact's files by name.

        Raises:
            LakeError: If the artefact is not there.
        """
        manifest = self.manifest(ref)
        return {name: self.place.address(f"{manifest.folder}/{name}") for name in manifest.files}

    def read(self, ref: Ref, name: str) -> bytes:
        """Return one of an artefact's files as it was published; one that does not match is set aside as by `load`.

        Raises:
            LakeError: If the artefact or the file is not there, cannot be read, or does not match its SHA-256.
        """
        manifest = self.manifest(ref)
        content = self._read_file(manifest, name)
        try:
            return self._checked_file(manifest, name, content)
        except LakeError as error:
            raise self._damaged(manifest, error) from error

    def resolve(self, text: str) -> Ref:
        """Find the artefact that a person means, see `storage.lineage.resolve`."""
        return tracing.resolve(self, text)

    def lineage(self, ref: Ref) -> list[tracing.Ancestor]:
        """List an artefact and everything it was made from, see `storage.lineage.trace`."""
        return tracing.trace(self, ref)

    def record_run(self, run_id: str, record: Mapping[str, Any]) -> None:
        """Write down a run, again and again while it lasts: a `Ref` anywhere in the record keeps its artefact.

        Raises:
            InvalidInputError: If the id cannot name a file or the record has no JSON form.
            LakeError: If the lake cannot be written.
        """
        if _RUN_ID.fullmatch(run_id) is None:
            raise InvalidInputError(f"run id {run_id!r} must be up to 100 letters, digits, '_', '-' or '.'")
        self._put_json(f"runs/{run_id}.json", {**record, "run_id": run_id, "recorded_at": _now()})

    def runs(self) -> list[dict[str, Any]]:
        """Return the records of all runs, newest first, each with ``run_id`` and ``recorded_at``.

        What is no record is left out: `broken_runs` and `verify` name it.
        """
        return read_runs(self.place)[0]

    def broken_runs(self) -> list[Problem]:
        """Return what stands among the records of runs but cannot be read as one."""
        return read_runs(self.place)[1]

    def forget_run(self, run_id: str) -> None:
        """Remove a run's record, so that `gc` may take what only this run reached."""
        if _RUN_ID.fullmatch(run_id) is None or self.place.state(f"runs/{run_id}.json") is None:
            raise InvalidInputError(f"no run {run_id!r} is recorded in {self.url}")
        self.place.remove(f"runs/{run_id}.json")

    def verify(self, progress: Progress = no_progress) -> list[Problem]:
        """Check every hash, see `storage.upkeep.verify`."""
        return upkeep.verify(self, progress)

    def repair(self, problems: Iterable[Problem]) -> list[Problem]:
        """Set aside what `verify` found damaged, see `storage.upkeep.repair`."""
        return upkeep.repair(self, problems)

    def gc(
        self, older_than_s: float = upkeep.DAY_S, dry_run: bool = True, keep_runs: int | None = None
    ) -> upkeep.Sweep:
        """Remove what nothing reaches, see `storage.upkeep.sweep`."""
        return upkeep.sweep(self, older_than_s, dry_run, keep_runs)

    def emptiness(self) -> str:
        """Say why a lake without artefacts has none, and what to do about it."""
        if self.place.walk("manifests") or self.place.misfits():
            return f"the lake {self.url} holds nothing readable: `cellwright lake verify` names what is wrong"
        fact = f"the lake {self.url} is empty" if self.place.exists() else f"there is no lake at {self.url}"
        return f"{fact}: fill it with `cellwright inspect CELL.yaml`, or name another with --lake or CELLWRIGHT_LAKE"

    def query(self, sql: str) -> Any:
        """Answer SQL over the lake's tables as a ``pyarrow.Table``, see `storage.query.query`."""
        from storage.query import query  # DuckDB only where it is asked for

        return query(self, sql)

    def _read_file(self, manifest: Manifest, name: str) -> bytes | None:
        for _ in range(2):  # a second look tells a damaged file from one that was being replaced
            content = self.place.read(f"{manifest.folder}/{name}")
            if content is not None and FileEntry.of(content) == manifest.files[name]:
                break
        return content

    def _checked_file(self, manifest: Manifest, name: str, content: bytes | None) -> bytes:
        address = self.place.address(f"{manifest.folder}/{name}")
        entry = manifest.files[name]
        if content is None:
            raise LakeError(f"{address} is missing")
        if FileEntry.of(content) != entry:
            raise LakeError(f"{address} ({len(content)} bytes, manifest: {entry.size}) does not match its SHA-256")
        return content

    def _damaged(self, manifest: Manifest, fact: LakeError) -> LakeError:
        try:
            self._put(upkeep.damaged_path(manifest.key), manifest.to_json())
            self.place.remove(manifest_path(manifest.key))
        except LakeError as error:
            return LakeError(f"{manifest.ref} is damaged: {fact}; it could not be set aside either: {error}")
        return LakeError(f"{manifest.ref} is damaged and was set aside: {fact}: run again to make it anew")

    def _present(
        self, kind: type[Artefact], content: str, entries: Mapping[str, FileEntry]
    ) -> dict[str, FileEntry] | None:
        """Return what is there of a content, if it is whole; another version of a library may have written it."""
        files: dict[str, bytes] = {}
        for name in entries:
            file = self.place.read(f"{data_folder(kind.KIND, content)}/{name}")
            if file is None:
                return None
            files[name] = file
        found = {name: FileEntry.of(file) for name, file in files.items()}
        if found == entries:
            return found
        try:
            return found if digest(format_of(kind).decode(kind, files)) == content else None
        except LakeError:
            return None

    def _put(self, path: str, content: bytes) -> None:
        folder, _, name = path.rpartition("/")
        self.place.put(folder, {name: content})

    def _put_json(self, path: str, record: Mapping[str, Any]) -> None:
        try:
            text = json.dumps(record, indent=1, default=_plain, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InvalidInputError(f"the record for {path} is not plain JSON: {error}") from error
        self._put(path, text.encode())

    def _json(self, path: str) -> dict[str, Any] | None:
        content = self.place.read(path)
        if content is None:
            return None
        try:
            record = json.loads(content)
        except (ValueError, RecursionError):
            return None
        return record if isinstance(record, dict) else None


def _plain(value: object) -> Any:
    if isinstance(value, Ref):
        return {"kind": value.kind, "key": value.key, "digest": value.digest}
    raise TypeError(f"{type(value).__name__} has no JSON form")


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="microseconds")
