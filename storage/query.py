"""SQL over a lake: DuckDB with a view for every table of every kind of artefact.

The view of table ``views`` of kind ``viewpoints`` is ``viewpoints_views``: all artefacts of the kind that a
manifest commits, one below the other, with the column ``digest`` in front. Dashes become underscores; the facts are
the table ``facts``. Beside them stand ``manifests``, ``inputs`` (one row an input), ``runs``, ``fields`` (unit, frame
and meaning of every column) and ``causes`` (the names of the codes in columns called ``cause``). Only what a statement
names is opened.

Statements read, nothing else: what could write, attach or set is refused by its kind before it runs, and DuckDB is
locked to the files that the views name.
"""

from __future__ import annotations

import difflib
import json
import re
from typing import TYPE_CHECKING, Any

import duckdb
import pyarrow as pa

from cellwright.causes import Cause
from cellwright.errors import InvalidInputError, LakeError
from schemas.artefact import specs
from storage.formats import known_class
from storage.manifests import Manifest
from storage.object_store import ObjectStore

if TYPE_CHECKING:
    from storage.lake import Lake

_ALL = re.compile(r"\b(show|summarize|information_schema|duckdb_\w+|pragma\w*)\b", re.IGNORECASE)
_NO_TABLE = re.compile(r"Table with name (\S+) does not exist")
_MOST_NEAR = 4
_EXPLAIN = re.compile(r"\s*explain(\s+analyze\b|\s*\([^()]*\))?", re.IGNORECASE)

_MANIFESTS = pa.schema(
    [
        ("kind", pa.string()),
        ("digest", pa.string()),
        ("key", pa.string()),
        ("stage", pa.string()),
        ("version", pa.int64()),
        ("params", pa.string()),
        ("n_bytes", pa.int64()),
        ("published_at", pa.string()),
        ("provenance", pa.string()),
    ]
)
_INPUTS = pa.schema(
    [("key", pa.string()), ("digest", pa.string()), ("name", pa.string()), ("input_digest", pa.string())]
)
_RUNS = pa.schema([("run_id", pa.string()), ("recorded_at", pa.string()), ("record", pa.string())])
_CAUSES = pa.schema([("cause", pa.int64()), ("name", pa.string())])
_FIELDS = pa.schema([(name, pa.string()) for name in ("view", "field", "dtype", "unit", "frame", "meaning")])


def query(lake: Lake, sql: str) -> Any:
    """Answer SQL with a ``pyarrow.Table``; an empty one for a statement without an answer.

    Raises:
        InvalidInputError: If DuckDB cannot understand or answer the statement; its message says where. If it is
            not one that reads.
        LakeError: If the lake cannot be read.
    """
    manifests = sorted(lake.manifests(), key=lambda manifest: manifest.key)
    with duckdb.connect(":memory:") as connection:
        if isinstance(lake.place, ObjectStore):
            connection.register_filesystem(lake.place.file_system)
        try:
            _require_reading(connection, sql)
            _lock(connection, lake, _offer(connection, lake, manifests, sql))
            answer: Any = connection.sql(sql)
            return pa.table({}) if answer is None else answer.to_arrow_table()
        except duckdb.IOException as error:
            raise LakeError(
                f"files cannot be read: {error}: set aside what is damaged with `cellwright lake verify --repair`, "
                "then run again to make it anew"
            ) from error
        except duckdb.Error as error:
            raise InvalidInputError(f"SQL: {_explained(str(error), names(manifests))}") from error


def _explained(fault: str, tables: list[str]) -> str:
    """Return DuckDB's words with the nearest of our tables in place of its own guess, and where all are listed."""
    all_of_them = f'"SHOW TABLES" lists all {len(tables)} tables, "FROM fields" their columns'
    unknown = _NO_TABLE.search(fault)
    if unknown is None:
        return f"{fault}\n{all_of_them}"  # DuckDB shows the statement with a mark under it
    asked = unknown[1].lower()
    within = [name for name in tables if asked in name or name in asked]
    near = [*difflib.get_close_matches(asked, tables, n=_MOST_NEAR), *within]
    near = list(dict.fromkeys(near))[:_MOST_NEAR]
    guess = f"did you mean {', '.join(near)}? " if near else ""
    return f"there is no table {unknown[1]!r}: {guess}{all_of_them}"


def _require_reading(connection: Any, sql: str) -> None:
    """Refuse statements that could change anything; EXPLAIN ANALYZE runs what it explains."""
    for statement in connection.extract_statements(sql):
        kind, text = statement.type, statement.query
        if kind == duckdb.StatementType.EXPLAIN and (head := _EXPLAIN.match(text)) is not None:
            kind = connection.extract_statements(text[head.end() :])[0].type
        if kind != duckdb.StatementType.SELECT:
            raise InvalidInputError(
                f"SQL: a lake is only read here, but this is a statement of the kind {kind.name}: write SELECT, FROM, "
                "WITH, SHOW, DESCRIBE, SUMMARIZE or EXPLAIN, and save the answer with --json"
            )


def _lock(connection: Any, lake: Lake, addresses: list[str]) -> None:
    """Let the connection open these files and no others of this machine, and keep it so."""
    if isinstance(lake.place, ObjectStore):  # whose addresses DuckDB's list of permitted paths does not know
        connection.execute("SET disabled_filesystems = 'LocalFileSystem'")
    else:
        connection.execute(f"SET allowed_paths = [{', '.join(map(_quoted, addresses))}]")
        connection.execute("SET enable_external_access = false")
    connection.execute("SET lock_configuration = true")


def names(manifests: list[Manifest]) -> list[str]:
    """Return the names of all tables and views over these manifests."""
    return ["manifests", "inputs", "runs", "fields", "causes", *sorted(_tables(manifests))]


def _offer(connection: Any, lake: Lake, manifests: list[Manifest], sql: str) -> list[str]:
    """Register what the statement names; returns the addresses of the files behind it."""
    opened: list[str] = []
    everything = _ALL.search(sql) is not None
    words = {word.lower() for word in re.findall(r"\w+", sql)}

    def wanted(name: str) -> bool:
        return everything or name in words

    if wanted("manifests"):
        connection.register("manifests", _manifests(lake, manifests))
    if wanted("inputs"):
        rows = [(m.key, m.digest, *pair) for m in manifests for pair in m.about.input_digests()]
        connection.register("inputs", _table(rows, _INPUTS))
    if wanted("runs"):
        records = [(run["run_id"], run["recorded_at"], json.dumps(run)) for run in lake.runs()]
        connection.register("runs", _table(records, _RUNS))
    if wanted("causes"):
        connection.register("causes", _table([(int(cause), cause.label) for cause in Cause], _CAUSES))
    if wanted("fields"):
        connection.register("fields", _fields(manifests))
    for name, paths in _tables(manifests).items():
        if wanted(name):
            opened += [lake.place.address(path) for path in paths]
            files = ", ".join(_quoted(lake.place.address(path)) for path in paths)
            connection.execute(
                f"CREATE VIEW {name} AS SELECT regexp_extract(path_of_row, '([0-9a-f]{{64}})[^0-9a-f/]*/[^/]*$', 1) "
                f"AS digest, * EXCLUDE (path_of_row) "
                f"FROM read_parquet([{files}], filename = 'path_of_row', union_by_name = true)"
            )
    return opened


def _tables(manifests: list[Manifest]) -> dict[str, list[str]]:
    found: dict[str, dict[str, None]] = {}  # ordered sets: several recipes may share a content
    for manifest in manifests:
        for file in manifest.files:
            if file.endswith(".parquet"):
                found.setdefault(_view(manifest.kind, file.removesuffix(".parquet")), {})[
                    f"{manifest.folder}/{file}"
                ] = None
    return {name: list(paths) for name, paths in sorted(found.items())}


def _view(kind: str, table: str) -> str:
    return re.sub(r"\W", "_", f"{kind}_{table}").lower()


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _manifests(lake: Lake, manifests: list[Manifest]) -> Any:
    rows = []
    for manifest in manifests:
        provenance = lake.provenance(manifest.key) or {}
        rows.append(
            (
                manifest.kind,
                manifest.digest,
                manifest.key,
                manifest.about.stage,
                manifest.about.version,
                json.dumps(dict(manifest.about.params)),
                sum(file.size for file in manifest.files.values()),
                str(provenance.get("published_at", "")),
                json.dumps(provenance),
            )
        )
    return _table(rows, _MANIFESTS)


def _fields(manifests: list[Manifest]) -> Any:
    rows = []
    for kind in sorted({manifest.kind for manifest in manifests}):
        try:
            declared = specs(known_class(kind))
        except InvalidInputError:
            continue  # written by another version, which alone knows its fields
        for name, spec in declared.items():
            if spec.role != "blob":
                dtype = spec.dtype if spec.width is None else f"{spec.dtype}[{spec.width if spec.width > 0 else ''}]"
                table = spec.table if spec.role == "column" else "facts"
                rows.append((_view(kind, table), name, dtype, spec.unit, spec.frame, spec.meaning))
    return _table(rows, _FIELDS)


def _table(rows: list[tuple[Any, ...]], schema: Any) -> Any:
    columns = list(zip(*rows)) or [()] * len(schema)
    return pa.table([pa.array(column, type=field.type) for column, field in zip(columns, schema)], schema=schema)
