"""Look after a lake: check every hash, and sweep out what nothing reaches."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cellwright.errors import CellwrightError, InvalidInputError, LakeError
from schemas.artefact import digest
from schemas.stage import Progress, no_progress
from storage.formats import fingerprint, format_of, known_class
from storage.keys import is_hash
from storage.manifests import FileEntry, Manifest
from storage.places import SCRATCH, FileState, Place

if TYPE_CHECKING:
    from storage.lake import Lake

DAY_S = 86400.0
"""Nothing younger is ever swept: it may belong to a run that is still going on."""


@dataclass(frozen=True, slots=True)
class Problem:
    """Something in the lake that is not what it should be: where, and what."""

    address: str
    fact: str

    def __str__(self) -> str:
        return f"{self.address}: {self.fact}"


@dataclass(frozen=True, slots=True)
class Sweep:
    """What a sweep takes, or would take.

    Attributes:
        removed: Size in bytes of every file by its path inside the lake.
        kept_files: How many files of data stay.
        dry: Whether nothing was really removed.
        notes: What kept the sweep from taking more, in words.
    """

    removed: dict[str, int]
    kept_files: int
    dry: bool
    notes: tuple[str, ...]

    @property
    def n_bytes(self) -> int:
        """Bytes that the removed files take."""
        return sum(self.removed.values())

    def __str__(self) -> str:
        doing = "would remove" if self.dry else "removed"
        text = f"{doing} {len(self.removed)} files, {self.n_bytes / 1e6:.1f} MB; {self.kept_files} files of data stay"
        return "; ".join([text, *self.notes])


def damaged_path(key: str) -> str:
    """Return where a damaged artefact's manifest is set aside."""
    return f"damaged/{key}.json"


def read_manifest(place: Place, path: str) -> Manifest | Problem | None:
    """Return the manifest at a path, what is wrong with it, or ``None`` if it has just gone."""
    content = place.read(path)
    if content is None:
        return None
    folder, _, name = path.rpartition("/")
    key = name.removesuffix(".json")
    if not is_hash(key) or folder != f"manifests/{key[:2]}":
        return Problem(place.address(path), "is no manifest's path")
    try:
        return Manifest.from_json(content, place.address(path), key)
    except LakeError as error:
        return Problem(place.address(path), str(error))


def verify(lake: Lake, progress: Progress = no_progress) -> list[Problem]:
    """Check every manifest, every file's size and SHA-256, and the digest of every content.

    Changes nothing. Reads the whole lake: a few hundred megabytes a second.

    Raises:
        LakeError: If the lake cannot be read.
    """
    problems: list[Problem] = []
    paths = list(lake.place.walk("manifests"))
    checked: dict[tuple[str, str], FileEntry] = {}
    for i, path in enumerate(paths):
        manifest = read_manifest(lake.place, path)
        if isinstance(manifest, Problem):
            problems.append(manifest)
        elif manifest is not None:
            problems += _content_problems(lake.place, manifest, checked)
        progress((i + 1) / len(paths))
    return problems


def _content_problems(place: Place, manifest: Manifest, checked: dict[tuple[str, str], FileEntry]) -> list[Problem]:
    if all(checked.get((manifest.folder, name)) == entry for name, entry in manifest.files.items()):
        return []  # another recipe's manifest names the same content
    files: dict[str, bytes] = {}
    for name, entry in manifest.files.items():
        address = place.address(f"{manifest.folder}/{name}")
        content = place.read(f"{manifest.folder}/{name}")
        if content is None:
            return [Problem(address, f"is missing (manifest {manifest.key[:12]}): run again to make it anew")]
        if len(content) != entry.size:
            return [Problem(address, f"has {len(content)} bytes, not {entry.size}: run again to make it anew")]
        if FileEntry.of(content) != entry:
            return [
                Problem(address, "does not match its SHA-256: run again, the first stage that reads it sets it aside")
            ]
        files[name] = content
    problem = _digest_problem(manifest, files)
    if problem is not None:
        return [Problem(place.address(manifest.folder), problem)]
    checked.update({(manifest.folder, name): entry for name, entry in manifest.files.items()})
    return []


def _digest_problem(manifest: Manifest, files: dict[str, bytes]) -> str | None:
    try:
        kind = known_class(manifest.kind)
    except InvalidInputError:
        return None  # another version's kind: its files are whole, more cannot be said
    if manifest.schema != fingerprint(kind):
        return None  # written under other declarations: not found again, but whole
    try:
        found = digest(format_of(kind).decode(kind, files))
    except CellwrightError as error:
        return f"cannot be read: {error}"
    return None if found == manifest.digest else f"holds a content of digest {found[:12]}, not {manifest.digest[:12]}"


def sweep(lake: Lake, older_than_s: float = DAY_S, dry_run: bool = True, now_s: float | None = None) -> Sweep:
    """Remove what nothing reaches: data that no manifest names, scratch and manifests set aside that are old.

    Where runs are recorded, also the manifests that no run and no lineage of a run's artefacts reaches, with
    their data. While a manifest cannot be understood all data stays, for nobody knows what it names.

    Args:
        lake: The lake.
        older_than_s: Least age of what goes, in seconds; a day or more.
        dry_run: Say what would go, remove nothing.
        now_s: The present, seconds since 1970; the clock's by default.

    Raises:
        InvalidInputError: If the age is less than a day.
        LakeError: If the lake cannot be read or written.
    """
    if not older_than_s >= DAY_S:
        raise InvalidInputError(f"older_than_s is {older_than_s:g}, but nothing younger than {DAY_S:g} s may be swept")
    place = lake.place
    latest_s = (time.time() if now_s is None else now_s) - older_than_s
    going: dict[str, FileState] = {}
    for folder in (SCRATCH, "damaged"):
        going |= _old(place.walk(folder), latest_s)
    read = {path: (state, read_manifest(place, path)) for path, state in place.walk("manifests").items()}
    valid = {path: found for path, (_, found) in read.items() if isinstance(found, Manifest)}
    unreadable = [found for _, found in read.values() if isinstance(found, Problem)]
    reached = _reached(lake, list(valid.values()))
    unreached = {
        path: read[path][0] for path, found in valid.items() if reached is not None and found.key not in reached
    }
    gone = _old(unreached, latest_s)
    named = {(found.folder, name) for path, found in valid.items() if path not in gone for name in found.files}
    data = place.walk("data")
    if not unreadable:
        # a folder goes whole: its youngest file tells its age
        youngest: dict[str, float] = {}
        for path, state in data.items():
            folder = path.rpartition("/")[0]
            youngest[folder] = max(youngest.get(folder, 0.0), state.changed_s)
        going_data = {
            path: state
            for path, state in data.items()
            if (path.rpartition("/")[0], path.rpartition("/")[2]) not in named
            and youngest[path.rpartition("/")[0]] <= latest_s
        }
    else:
        going_data = {}
    kept_keys = {found.key for path, found in valid.items() if path not in gone}
    records = {
        path: state
        for path, state in _old(place.walk("provenance"), latest_s).items()
        if path.rpartition("/")[2].removesuffix(".json") not in kept_keys
    }
    going |= gone | going_data | (records if not unreadable else {})
    if not dry_run:
        # manifests first, so that none is left without its data
        for path in [*gone, *(path for path in going if path not in gone)]:
            place.remove(path)
    notes = tuple(f"no data was taken because a manifest is unreadable: {problem}" for problem in unreadable[:1])
    return Sweep({path: state.size for path, state in going.items()}, len(data) - len(going_data), dry_run, notes)


def _old(files: dict[str, FileState], latest_s: float) -> dict[str, FileState]:
    return {path: state for path, state in files.items() if state.changed_s <= latest_s}


def _reached(lake: Lake, manifests: list[Manifest]) -> set[str] | None:
    """Return the keys that a recorded run reaches, itself or through lineage; ``None`` if no run is recorded."""
    runs = lake.runs()
    if not runs:
        return None
    makers: dict[str, list[Manifest]] = {}
    for manifest in manifests:
        makers.setdefault(manifest.digest, []).append(manifest)
        makers.setdefault(manifest.key, []).append(manifest)
    reached: set[str] = set()
    open_hashes = [text for record in runs for text in _hashes(record)]
    while open_hashes:
        for manifest in makers.get(open_hashes.pop(), []):
            if manifest.key not in reached:
                reached.add(manifest.key)
                open_hashes += [digest for _, digest in manifest.about.input_digests()]
    return reached


def _hashes(value: Any) -> Iterator[str]:
    if isinstance(value, str) and is_hash(value):
        yield value
    elif isinstance(value, dict):
        for name, item in value.items():
            yield from _hashes(name)
            yield from _hashes(item)
    elif isinstance(value, list):
        for item in value:
            yield from _hashes(item)
