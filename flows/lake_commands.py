"""The commands that look into a lake: what is there, what it means, where it came from, whether it is whole."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from cellwright.errors import InvalidInputError, LakeError
from flows.output import print_table, write_error, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from schemas.artefact import Artefact
    from storage.lake import Lake
    from storage.manifests import Manifest

_MOST_FACT_LETTERS = 200
_SHORT_RUN = 8
"""Letters of a run's id that a terminal shows."""


def run(
    action: str,
    url: str,
    *,
    subject: str | None,
    delete: bool,
    as_json: bool,
    keep_runs: int | None = None,
    repair: bool = False,
) -> int:
    """Run one of the ``lake`` commands and return its exit code.

    Raises:
        InvalidInputError: If there is no lake at the address, or the subject names no artefact or is no valid SQL.
        LakeError: If the lake cannot be read.
    """
    from storage.lake import Lake

    lake = Lake(url)
    if not lake.place.exists():
        raise InvalidInputError(lake.emptiness())
    if action == "ls":
        return _ls(lake, as_json)
    if action == "runs":
        return _runs(lake, as_json)
    if action == "show":
        return _show(lake, str(subject), as_json)
    if action == "lineage":
        return _lineage(lake, str(subject), as_json)
    if action == "sql":
        return _sql(lake, str(subject), as_json)
    if action == "verify":
        return _verify(lake, repair, as_json)
    return _gc(lake, delete, keep_runs, as_json)


def _ls(lake: Lake, as_json: bool) -> int:
    rows = sorted((_row(lake, manifest) for manifest in lake.manifests()), key=lambda row: str(row["published_at"]))
    if as_json:
        write_json(rows)
    elif not rows:
        sys.stdout.write(f"{lake.emptiness()}\n")
    else:
        table = _table("artefact", "stage", "made at (UTC)", "took", "size")
        for row in rows:
            table.add_row(
                f"{row['kind']}/{row['digest'][:12]}",
                f"{row['stage']} v{row['version']}",
                str(row["published_at"] or "")[:19].replace("T", " "),
                "" if row["seconds"] is None else f"{row['seconds']:.2f} s",
                _size(row["bytes"]),
            )
        print_table(table)
    return 0


def _runs(lake: Lake, as_json: bool) -> int:
    from flows.run_record import state_of

    broken = lake.broken_runs()
    for problem in broken:
        write_error(f"warning: {problem}\n")
    records = [{**record, "state": state_of(record)} for record in reversed(lake.runs())]
    if as_json:
        write_json(records)
        return 0
    if not records:
        unread = f", but {len(broken)} records cannot be read" if broken else ""
        sys.stdout.write(f"no run is recorded in {lake.url}{unread}\n")
        return 0
    if sys.stdout.isatty():
        _print_short_runs(records)
        return 0
    table = _table("run", "flow", "cell", "last heard of (UTC)", "state", "computed", "cached", "why")
    for record in records:
        n_steps, n_cached = _step_counts(record)
        table.add_row(
            str(record["run_id"]),
            *_run_words(record),
            str(n_steps - n_cached),
            str(n_cached),
            " ".join(str(record.get("error", "")).split()),
        )
    print_table(table)
    return 0


def _print_short_runs(records: list[dict[str, Any]]) -> None:
    """Print runs as a terminal of 80 columns has room for them; the reasons of those that failed stand below."""
    table = _table("run", "flow", "cell", "last heard of", "state", "computed")
    for record in records:
        n_steps, n_cached = _step_counts(record)
        flow, cell, heard, state = _run_words(record)
        computed = f"{n_steps - n_cached} of {n_steps}"
        table.add_row(str(record["run_id"])[:_SHORT_RUN], flow, cell, heard[:16], state, computed)
    print_table(table)
    for record in records:
        if record.get("error"):
            sys.stdout.write(f"{str(record['run_id'])[:_SHORT_RUN]}: {record['error']}\n")


def _run_words(record: dict[str, Any]) -> tuple[str, str, str, str]:
    heard = str(record["recorded_at"])[:19].replace("T", " ")
    return str(record.get("flow", "")), str(record.get("cell", "")), heard, str(record["state"])


def _step_counts(record: dict[str, Any]) -> tuple[int, int]:
    """Return how many steps a run had, and how many of them the lake had."""
    steps = [step for step in record.get("steps", ()) if isinstance(step, dict)]
    return len(steps), sum(bool(step.get("cached")) for step in steps)


def _show(lake: Lake, subject: str, as_json: bool) -> int:
    ref = lake.resolve(subject)
    manifest, artefact = lake.manifest(ref), lake.load(ref)
    shown = {
        **_row(lake, manifest),
        "params": dict(manifest.about.params),
        "inputs": dict(manifest.about.inputs),
        "provenance": lake.provenance(ref),
        "columns": list(_columns(artefact)),
        "facts": _facts(artefact),
        "causes": _causes(artefact),
        "collisions": _collisions(artefact),
        "findings": _findings(artefact),
        "files": lake.paths(ref),
    }
    if as_json:
        write_json(shown)
        return 0
    head = _table("", "")
    head.show_header = False
    head.add_row("artefact", f"{ref.kind}/{ref.digest}")
    head.add_row("recipe", f"{manifest.about.stage} v{manifest.about.version}, key {ref.key}")
    for name, digest in manifest.about.input_digests():
        head.add_row(f"input {name}", digest)
    for name, value in manifest.about.params.items():
        head.add_row(f"param {name}", _shortened(json.dumps(value)))
    for name, value in _facts(artefact).items():
        head.add_row(f"fact {name}", str(value))
    for name, path in lake.paths(ref).items():
        head.add_row(f"file {name}", path)
    print_table(head)
    if shown["columns"]:
        columns = _table("column", "rows", "type", "unit", "frame", "meaning")
        for column in _columns(artefact):
            columns.add_row(*(str(value) for value in column.values()))
        print_table(columns)
    for name, counts in _causes(artefact).items():
        causes = _table(name, "rows")
        for cause, count in counts.items():
            causes.add_row(cause, str(count))
        print_table(causes)
    for body, count in _collisions(artefact).items():
        sys.stdout.write(f"collision with {body}: {count}\n")
    for finding in _findings(artefact):
        sys.stdout.write(f"finding: {finding}\n")
    return 0


def _lineage(lake: Lake, subject: str, as_json: bool) -> int:
    lines = lake.lineage(lake.resolve(subject))
    if as_json:
        write_json(
            [
                {
                    "depth": line.depth,
                    "input": line.name,
                    "digest": line.digest,
                    **({} if line.manifest is None else _row(lake, line.manifest)),
                }
                for line in lines
            ]
        )
        return 0
    for line in lines:
        if line.manifest is None:
            origin = f"{line.digest[:12]}, which is not in the lake any more"
        else:
            about = line.manifest.about
            origin = f"{line.manifest.kind}/{line.digest[:12]} by {about.stage} v{about.version}"
        sys.stdout.write(f"{'  ' * line.depth}{f'{line.name}: ' if line.name else ''}{origin}\n")
    return 0


def _sql(lake: Lake, query: str, as_json: bool) -> int:
    answer = lake.query(query)
    rows: list[dict[str, Any]] = answer.to_pylist()
    if as_json:
        write_json(rows)
        return 0
    table = _table(*answer.column_names)
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    print_table(table)
    return 0


def _verify(lake: Lake, repair: bool, as_json: bool) -> int:
    n_artefacts = sum(1 for _ in lake.manifests())
    problems = lake.verify()
    stay = lake.repair(problems) if repair else problems
    if as_json:
        found = [{"address": problem.address, "fact": problem.fact} for problem in problems]
        aside = {"set_aside": len(problems) - len(stay)} if repair else {}
        write_json({"artefacts": n_artefacts, "problems": found, **aside})
    else:
        for problem in problems:
            sys.stdout.write(f"{problem.address}: {problem.fact.partition(': ')[0]}\n" if repair else f"{problem}\n")
        done = f", {len(problems) - len(stay)} set aside: run again to make anew what is needed" if repair else ""
        sys.stdout.write(f"{n_artefacts} artefacts checked, {len(problems)} problems{done if problems else ''}\n")
        if not n_artefacts and not problems:
            sys.stdout.write(f"{lake.emptiness()}\n")
    return LakeError.exit_code if stay else 0


def _gc(lake: Lake, delete: bool, keep_runs: int | None, as_json: bool) -> int:
    swept = lake.gc(dry_run=not delete, keep_runs=keep_runs)
    if as_json:
        write_json(
            {
                "deleted": not swept.dry,
                "forgotten_runs": list(swept.forgotten_runs),
                "files": swept.removed,
                "bytes": swept.n_bytes,
                "kept_files": swept.kept_files,
                "notes": list(swept.notes),
            }
        )
        return 0
    for path, size in swept.removed.items():
        sys.stdout.write(f"{path}  {_size(size)}\n")
    sys.stdout.write(f"{swept}\n")
    if swept.dry and swept.removed:
        sys.stdout.write("nothing was deleted: add --yes to delete it\n")
    if keep_runs is None and (n_runs := len(lake.runs())):
        sys.stdout.write(
            f"recorded runs that keep what they used: {n_runs}; --keep-runs N forgets all but the newest N that "
            "finished and the newest N that did not\n"
        )
    return 0


def _row(lake: Lake, manifest: Manifest) -> dict[str, Any]:
    made = lake.provenance(manifest.key) or {}
    return {
        "kind": manifest.kind,
        "digest": manifest.digest,
        "key": manifest.key,
        "stage": manifest.about.stage,
        "version": manifest.about.version,
        "published_at": made.get("published_at"),
        "seconds": made.get("seconds"),
        "bytes": sum(file.size for file in manifest.files.values()),
    }


def _columns(artefact: Artefact) -> Iterator[dict[str, Any]]:
    from schemas.artefact import held

    for name, spec in held(artefact).items():
        if spec.role != "column":
            continue
        values = getattr(artefact, name)
        width = "" if spec.width is None else f"[{values.shape[1]}]"
        yield {
            "name": f"{spec.table}.{name}",
            "rows": len(values),
            "type": f"{spec.dtype}{width}",
            "unit": spec.unit,
            "frame": spec.frame,
            "meaning": spec.meaning,
        }


def _facts(artefact: Artefact) -> dict[str, Any]:
    from schemas.artefact import specs

    facts: dict[str, Any] = {}
    for name, spec in specs(type(artefact)).items():
        if spec.role == "fact":
            value = getattr(artefact, name)
            long = isinstance(value, str) and len(value) > _MOST_FACT_LETTERS
            facts[name] = f"{value[:_MOST_FACT_LETTERS]}..." if long else value
    return facts


def _causes(artefact: Artefact) -> dict[str, dict[str, int]]:
    """Count the rows of each column of causes: why samples or sweeps fell out."""
    import numpy as np

    from cellwright.causes import Cause
    from schemas.artefact import columns

    counted: dict[str, dict[str, int]] = {}
    for name, spec in columns(type(artefact)).items():
        if name in ("cause", "outcome"):
            codes, counts = np.unique(getattr(artefact, name), return_counts=True)
            counted[f"{spec.table}.{name}"] = {
                Cause(code).label: int(count) for code, count in zip(codes, counts, strict=True)
            }
    return counted


def _collisions(artefact: Artefact) -> dict[str, int]:
    """Count the rows that a body stopped by the body's name, the most first; empty where no bodies are told."""
    from schemas.artefact import columns

    if not {"blocked_by", "body"} <= columns(type(artefact)).keys():
        return {}
    names: tuple[str, ...] = getattr(artefact, "body")  # noqa: B009  # only some classes have it
    rows: list[int] = getattr(artefact, "blocked_by").tolist()  # noqa: B009
    counts = Counter(names[row] for row in rows if row >= 0)
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def _findings(artefact: Artefact) -> list[str]:
    """Return what an artefact has to say in words: of a part's mesh, of what stands where, of sweeps left out."""
    aside = [
        f"view {view} is {what}: {reason}"
        for what, name in (("left out", "left_out"), ("replaced by others", "replaced"))
        for view, reason in zip(getattr(artefact, f"{name}_view", ()), getattr(artefact, f"{name}_reason", ()))
    ]
    words = [text for name in ("finding", "tipping", "note") for text in getattr(artefact, name, ())]
    return [*words, *aside]


def _table(*columns: str) -> Table:
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _shortened(text: str) -> str:
    """Return a text as a terminal has room for it; `--json` and pipes have all of it."""
    if not sys.stdout.isatty() or len(text) <= _MOST_FACT_LETTERS:
        return text
    return f"{text[:_MOST_FACT_LETTERS]}... ({len(text)} letters; --json shows all)"


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:.1f} MB" if n_bytes >= 1e5 else f"{n_bytes / 1e3:.1f} kB"
