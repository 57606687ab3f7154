"""Look after a lake: check every hash, and sweep out what nothing reaches."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cellwright.errors import CellwrightError, InvalidInputError, LakeError
from schemas.artefact import digest
from schemas.stage import Progress, no_progress
from storage.formats import fingerprint, format_of, known_class
from storage.keys import is_hash
from storage.manifests import FileEntry, Manifest, manifest_path
from storage.places import DAMAGED, SCRATCH, FileState, Place, aside_path
from storage.records import MEND, Problem, provenance_problems, read_runs, run_path

if TYPE_CHECKING:
    from storage.lake import Lake

DAY_S = 86400.0
"""Nothing younger is ever swept: it may belong to a run that is still going on."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """What a sweep takes, or would take.

    Attributes:
        removed: Size in bytes of every file by its path inside the lake.
        kept_files: How many files of data stay.
        dry: Whether nothing was really removed.
        notes: What kept the sweep from taking more, in words.
        forgotten_runs: Ids of the runs whose records are among the files, the newest first.
    """

    removed: dict[str, int]
    kept_files: int
    dry: bool
    notes: tuple[str, ...]
    forgotten_runs: tuple[str, ...] = ()

    @property
    def n_bytes(self) -> int:
        """Bytes that the removed files take."""
        return sum(self.removed.values())

    def __str__(self) -> str:
        doing = "would remove" if self.dry else "removed"
        text = f"{doing} {len(self.removed)} files, {self.n_bytes / 1e6:.1f} MB; {self.kept_files} files of data stay"
        if self.forgotten_runs:
            n_runs = len(self.forgotten_runs)
            text = f"{'would forget' if self.dry else 'forgot'} {n_runs} run{'s' if n_runs > 1 else ''}, {text}"
        return "; ".join([text, *self.notes])


def damaged_path(key: str) -> str:
    """Return where a damaged artefact's manifest is set aside."""
    return aside_path(manifest_path(key))


def read_manifest(place: Place, path: str) -> Manifest | Problem | None:
    """Return the manifest at a path, what is wrong with it, or ``None`` if it has just gone."""
    content = place.read(path)
    if content is None:
        return None
    folder, _, name = path.rpartition("/")
    key = name.removesuffix(".json")
    if not is_hash(key) or folder != f"manifests/{key[:2]}":
        return Problem(place.address(path), "is no manifest's path", path)
    try:
        return Manifest.from_json(content, place.address(path), key)
    except LakeError as error:
        return Problem(place.address(path), str(error), path)


def repair(lake: Lake, problems: Iterable[Problem]) -> list[Problem]:
    """Set aside under ``damaged`` what is behind problems that `verify` found; the next run makes anew what it needs.

    Returns:
        The problems that stay.

    Raises:
        LakeError: If the lake cannot be written.
    """
    stay: list[Problem] = []
    done: set[str] = set()
    for problem in problems:
        if not problem.mended_by:
            stay.append(problem)
        elif problem.mended_by not in done:
            lake.place.set_aside(problem.mended_by)
            done.add(problem.mended_by)
    return stay


def verify(lake: Lake, progress: Progress = no_progress) -> list[Problem]:
    """Check every manifest, every file's size and SHA-256, the digest of every content, and the records beside them.

    Changes nothing; `repair` does. Reads the whole lake: a few hundred megabytes a second.

    Raises:
        LakeError: If the lake cannot be read.
    """
    misfits = lake.place.misfits()
    problems = [Problem(lake.place.address(path), f"{fact}: {MEND}", path) for path, fact in misfits.items()]
    problems += read_runs(lake.place)[1]
    paths = [path for path in lake.place.walk("manifests") if not _inside(path, misfits)]
    checked: dict[tuple[str, str], FileEntry] = {}
    for i, path in enumerate(paths):
        manifest = read_manifest(lake.place, path)
        if isinstance(manifest, Problem):
            problems.append(manifest)
        elif manifest is not None:
            problems += _content_problems(lake.place, manifest, checked)
            problems += provenance_problems(lake.place, manifest.key)
        progress((i + 1) / len(paths))
    return problems


def _inside(path: str, folders: Iterable[str]) -> bool:
    return any(path == folder or path.startswith(f"{folder}/") for folder in folders)


def _content_problems(place: Place, manifest: Manifest, checked: dict[tuple[str, str], FileEntry]) -> list[Problem]:
    if all(checked.get((manifest.folder, name)) == entry for name, entry in manifest.files.items()):
        return []  # another recipe's manifest names the same content
    path = manifest_path(manifest.key)
    files: dict[str, bytes] = {}
    for name, entry in manifest.files.items():
        address = place.address(f"{manifest.folder}/{name}")
        content = place.read(f"{manifest.folder}/{name}")
        if content is None:
            return [Problem(address, f"is missing (manifest {manifest.key[:12]}): run again to make it anew", path)]
        if len(content) != entry.size:
            return [Problem(address, f"has {len(content)} bytes, not {entry.size}: run again to make it anew", path)]
        if FileEntry.of(content) != entry:
            return [Problem(address, f"does not match its SHA-256 (manifest {manifest.key[:12]}): {MEND}", path)]
        files[name] = content
    problem = _digest_problem(manifest, files)
    if problem is not None:
        return [Problem(place.address(manifest.folder), f"{problem}: {MEND}", path)]
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


def sweep(
    lake: Lake,
    older_than_s: float = DAY_S,
    dry_run: bool = True,
    keep_runs: int | None = None,
    now_s: float | None = None,
) -> Sweep:
    """Remove what nothing reaches: data that no manifest names, scratch and manifests set aside that are old.

    Where runs are recorded, also the manifests that no run and no lineage of a run's artefacts reaches, with
    their data. While a manifest cannot be understood all data stays, for nobody knows what it names; while a
    run's record cannot, all manifests.

    Every age is looked at again right before its file goes, and the manifests are listed again before data does,
    so that what a run has found or published meanwhile stays.

    Args:
        lake: The lake.
        older_than_s: Least age of what goes, in seconds; a day or more.
        dry_run: Say what would go, remove nothing.
        keep_runs: Forget all recorded runs but the newest so many that finished and the newest so many that did not,
            where they are old enough; ``None``: forget none.
        now_s: The present, seconds since 1970; the clock's by default.

    Raises:
        InvalidInputError: If the age is less than a day, or no run would be kept.
        LakeError: If the lake cannot be read or written.
    """
    if not older_than_s >= DAY_S:
        raise InvalidInputError(f"older_than_s is {older_than_s:g}, but nothing younger than {DAY_S:g} s may be swept")
    if keep_runs is not None and keep_runs < 1:
        raise InvalidInputError(f"{keep_runs} runs to keep, but at least 1 must stay: to empty a lake, delete it")
    place = lake.place
    broom = _Broom(place, (time.time() if now_s is None else now_s) - older_than_s, dry_run)
    if keep_runs is not None:
        _forget_runs(lake, keep_runs, broom)
    forgotten = tuple(path.removeprefix("runs/").removesuffix(".json") for path in broom.taken)
    for folder in (SCRATCH, DAMAGED):
        broom.take(place.walk(folder))
    read = _read_manifests(place, {})
    reached, riddle = _reached(lake, [found for _, found in read.values() if isinstance(found, Manifest)], broom)
    if reached is not None:
        broom.take(
            {
                path: state
                for path, (state, found) in read.items()
                if isinstance(found, Manifest) and found.key not in reached
            }
        )
    data = place.walk("data")
    standing = {path: found for path, (_, found) in _read_manifests(place, read).items() if not broom.would_take(path)}
    unreadable = [found for found in standing.values() if isinstance(found, Problem)]
    n_kept = len(data)
    if not unreadable:
        valid = [found for found in standing.values() if isinstance(found, Manifest)]
        n_kept -= _take_data(data, {f"{found.folder}/{name}" for found in valid for name in found.files}, broom)
        kept_keys = {found.key for found in valid}
        broom.take({path: state for path, state in place.walk("provenance").items() if _key(path) not in kept_keys})
    notes = [f"no data was taken because a manifest is unreadable: {problem}" for problem in unreadable[:1]]
    return Sweep(broom.taken, n_kept, dry_run, (*riddle, *notes), forgotten)


class _Broom:
    """Takes files that were old when they were listed and are still old; a dry one only notes them."""

    def __init__(self, place: Place, latest_s: float, dry: bool) -> None:
        self.place = place
        self.latest_s = latest_s
        self.dry = dry
        self.taken: dict[str, int] = {}

    def is_old(self, state: FileState | None) -> bool:
        return state is not None and state.changed_s <= self.latest_s

    def would_take(self, path: str) -> bool:
        """Whether a file stands only because the broom is dry."""
        return self.dry and path in self.taken

    def take(self, files: Mapping[str, FileState]) -> None:
        for path, state in files.items():
            if not self.is_old(state):
                continue
            if not self.dry:
                if not self.is_old(self.place.state(path)):
                    continue  # somebody has found or written it since it was listed
                self.place.remove(path)
            self.taken[path] = state.size


def _forget_runs(lake: Lake, keep_runs: int, broom: _Broom) -> None:
    """Forget old runs; those that failed never push a finished one out, and are not kept for ever themselves."""
    states = lake.place.walk("runs")
    records = lake.runs()
    finished = [record for record in records if record.get("state", "finished") == "finished"]
    others = [record for record in records if record.get("state", "finished") != "finished"]
    kept = {run_path(record) for record in (*finished[:keep_runs], *others[:keep_runs])}
    paths = [path for path in map(run_path, records) if path not in kept]
    broom.take({path: states[path] for path in paths if path in states})


def _take_data(data: Mapping[str, FileState], named: set[str], broom: _Broom) -> int:
    """Take the files that no manifest names and return how many; a folder's youngest file tells its age."""
    folders: dict[str, dict[str, FileState]] = {}
    for path, state in data.items():
        folders.setdefault(path.rpartition("/")[0], {})[path] = state
    n_before = len(broom.taken)
    for folder, files in folders.items():
        going = {path: state for path, state in files.items() if path not in named}
        if not going or not all(broom.is_old(state) for state in files.values()):
            continue
        if broom.dry or all(broom.is_old(state) for state in broom.place.walk(folder).values()):
            broom.take(going)
    return len(broom.taken) - n_before


def _read_manifests(
    place: Place, before: Mapping[str, tuple[FileState, Manifest | Problem | None]]
) -> dict[str, tuple[FileState, Manifest | Problem | None]]:
    """Read all manifests; those that are as they were before are not read again."""
    return {
        path: before[path] if path in before and before[path][0] == state else (state, read_manifest(place, path))
        for path, state in place.walk("manifests").items()
    }


def _key(path: str) -> str:
    return path.rpartition("/")[2].removesuffix(".json")


def _reached(lake: Lake, manifests: list[Manifest], broom: _Broom) -> tuple[set[str] | None, list[str]]:
    """Return the keys that a recorded run reaches, itself or through lineage, and what is in the way.

    A run also reaches what it made: a process killed right after it published has not recorded that yet.
    ``None`` if no run is recorded, or a record cannot be read: then every manifest stays.
    """
    states = lake.place.walk("runs")
    everything = lake.runs()
    unreadable = sorted(states.keys() - {run_path(record) for record in everything})
    if unreadable:
        address = lake.place.address(unreadable[0])
        return None, [f"no result was taken because a run's record is unreadable: {address}: delete it"]
    runs = [record for record in everything if not broom.would_take(run_path(record))]
    if not runs:
        return None, []
    makers: dict[str, list[Manifest]] = {}
    for manifest in manifests:
        makers.setdefault(manifest.digest, []).append(manifest)
        makers.setdefault(manifest.key, []).append(manifest)
    reached: set[str] = set()
    ids = {str(record.get("run_id")) for record in runs}
    open_hashes = [text for record in runs for text in _hashes(record)]
    open_hashes += [manifest.key for manifest in manifests if (lake.provenance(manifest.key) or {}).get("run") in ids]
    while open_hashes:
        for manifest in makers.get(open_hashes.pop(), []):
            if manifest.key not in reached:
                reached.add(manifest.key)
                open_hashes += [digest for _, digest in manifest.about.input_digests()]
    return reached, []


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
