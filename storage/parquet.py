"""Artefacts as Parquet: one file a table, one row of facts, blobs as they are.

The Arrow schema comes from the declarations in `schemas.columns`: unit, frame and meaning stand in the metadata
of every field. Vectors are fixed-size lists whose child is named ``element``, as Parquet would rename it anyway.
Nothing may be null, so arrays come back without a copy; an optional column that an artefact leaves out is no column
of its file. Values round-trip bit for bit, NaN payloads and the sign of zero included, and the same artefact gives the
same bytes with the same pyarrow.

Integers are delta-packed, floats byte-stream-split, both under zstd: four million rows of two int32 and one
float32 column take about a tenth of a second either way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cellwright.errors import InvalidInputError, LakeError
from schemas.artefact import Artefact, held, specs
from schemas.columns import ANY_WIDTH, FieldSpec

FACTS = "facts"
"""Name of the table that holds the facts, one row."""

_ZSTD_LEVEL = 1  # level 3 gains 2 % on float columns and takes twice as long


def encode(artefact: Artefact) -> dict[str, bytes]:
    """Return the artefact's files by name.

    Raises:
        InvalidInputError: If a value does not fit what its declaration says.
    """
    kind = type(artefact)
    files: dict[str, bytes] = {}
    stored = held(artefact).keys()
    for table, declared in tables(kind).items():
        fields = {name: spec for name, spec in declared.items() if name in stored}
        arrays = {name: _array(f"{kind.KIND}.{name}", spec, getattr(artefact, name)) for name, spec in fields.items()}
        schema = pa.schema(
            [_field(name, spec, arrays[name].type) for name, spec in fields.items()],
            metadata={"kind": kind.KIND, "table": table},
        )
        files[f"{table}.parquet"] = _parquet(pa.Table.from_arrays(list(arrays.values()), schema=schema))
    for name, spec in specs(kind).items():
        if spec.role == "blob":
            files[f"{name}{spec.suffix}"] = getattr(artefact, name)
    return files


def decode(kind: type[Artefact], files: Mapping[str, bytes]) -> Artefact:
    """Return the artefact that the files hold.

    Raises:
        LakeError: If the files do not fit the declarations of the class.
    """
    values: dict[str, Any] = {}
    try:
        for table, fields in tables(kind).items():
            values |= _columns(f"{kind.KIND}/{table}.parquet", fields, _read(files, f"{table}.parquet"))
        for name, spec in specs(kind).items():
            if spec.role == "blob":
                values[name] = _file(files, f"{name}{spec.suffix}")
        return kind(**values)
    except (InvalidInputError, UnicodeDecodeError) as error:
        raise LakeError(f"stored {kind.KIND} does not fit its declaration: {error}") from error


def tables(kind: type[Artefact]) -> dict[str, dict[str, FieldSpec]]:
    """Return the declared fields of every table of an artefact class; the facts are one more table.

    Raises:
        InvalidInputError: If a table of columns is called ``facts``.
    """
    found: dict[str, dict[str, FieldSpec]] = {}
    for name, spec in specs(kind).items():
        if spec.role == "column":
            if spec.table == FACTS:
                raise InvalidInputError(f"{kind.KIND}.{name}: a table of columns cannot be called {FACTS!r}")
            found.setdefault(spec.table, {})[name] = spec
        elif spec.role == "fact":
            found.setdefault(FACTS, {})[name] = spec
    return found


def _array(name: str, spec: FieldSpec, value: Any) -> Any:
    try:
        if spec.role == "fact":
            return pa.array([value], type=_scalar_type(spec))
        if spec.dtype == "str":
            return pa.array(value, type=pa.string())
    except (pa.ArrowException, OverflowError, UnicodeError) as error:
        raise InvalidInputError(f"{name} does not fit {spec.dtype}: {error}") from error
    if spec.width is None:
        return pa.array(value, type=_scalar_type(spec))
    if value.shape[1] == 0:
        if len(value):
            raise InvalidInputError(f"{name} has shape {value.shape}: rows without a value cannot be stored")
        return pa.array([], type=_list_type(spec, 0))  # from_arrays divides by the width and kills the process
    flat = pa.array(value.reshape(-1), type=_scalar_type(spec))
    return pa.FixedSizeListArray.from_arrays(flat, type=_list_type(spec, value.shape[1]))


def _scalar_type(spec: FieldSpec) -> Any:
    if spec.dtype == "str":
        return pa.string()
    # a fact is a Python float, whatever it is declared as
    return pa.float64() if spec.role == "fact" and "float" in spec.dtype else pa.from_numpy_dtype(np.dtype(spec.dtype))


def _list_type(spec: FieldSpec, width: int) -> Any:
    return pa.list_(pa.field("element", _scalar_type(spec), nullable=False), width)


def _field(name: str, spec: FieldSpec, type_: Any) -> Any:
    metadata = {"unit": spec.unit, "frame": spec.frame, "meaning": spec.meaning}
    return pa.field(name, type_, nullable=False, metadata=metadata)


def _parquet(table: Any) -> bytes:
    sink = pa.BufferOutputStream()
    encodings = {path: encoding for field in table.schema for path, encoding in _encoding(field)}
    words = [field.name for field in table.schema if pa.types.is_string(field.type)]
    pq.write_table(
        table,
        sink,
        compression="zstd",
        compression_level=_ZSTD_LEVEL,
        use_dictionary=words or False,
        column_encoding=encodings or None,
    )
    return bytes(sink.getvalue())


def _encoding(field: Any) -> list[tuple[str, str]]:
    is_list = pa.types.is_fixed_size_list(field.type)
    type_ = field.type.value_type if is_list else field.type
    path = f"{field.name}.list.element" if is_list else field.name
    if pa.types.is_integer(type_):
        return [(path, "DELTA_BINARY_PACKED")]
    if pa.types.is_float32(type_) or pa.types.is_float64(type_):
        return [(path, "BYTE_STREAM_SPLIT")]
    return []


def _read(files: Mapping[str, bytes], name: str) -> Any:
    try:
        return pq.read_table(pa.BufferReader(_file(files, name)))
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        raise LakeError(f"{name} is not a readable Parquet file: {error}") from error


def _file(files: Mapping[str, bytes], name: str) -> bytes:
    if name not in files:
        raise LakeError(f"{name} is missing among the files {sorted(files)}")
    return files[name]


def _columns(path: str, fields: Mapping[str, FieldSpec], table: Any) -> dict[str, Any]:
    there = set(table.column_names)
    expected = [name for name, spec in fields.items() if name in there or not spec.optional]
    if table.column_names != expected:
        raise LakeError(f"{path} has columns {table.column_names}, expected {expected}")
    return {name: _values(path, name, fields[name], table) for name in expected}


def _values(path: str, name: str, spec: FieldSpec, table: Any) -> Any:
    field, column = table.schema.field(name), table.column(name)
    width = field.type.list_size if pa.types.is_fixed_size_list(field.type) else None
    wanted = _scalar_type(spec) if spec.width is None else _list_type(spec, _width(spec, width))
    if field.type != wanted or field.nullable or column.null_count:
        raise LakeError(f"{path} column {name!r} is {field.type}, expected {wanted} without nulls")
    _check_contract(f"{path} column {name!r}", spec, field.metadata or {})
    if spec.role == "fact":
        if len(column) != 1:
            raise LakeError(f"{path} has {len(column)} rows, expected one row of facts")
        return column[0].as_py()
    if spec.dtype == "str":
        return tuple(column.to_pylist())
    if width == 0:
        return np.zeros((len(column), 0), spec.dtype)
    flat = column.combine_chunks()
    if width is None:
        return flat.to_numpy(zero_copy_only=False)
    return flat.flatten().to_numpy(zero_copy_only=False).reshape(len(column), width)


def _width(spec: FieldSpec, width: int | None) -> int:
    return spec.width if spec.width not in (None, ANY_WIDTH) else (width or 0)


def _check_contract(what: str, spec: FieldSpec, metadata: Mapping[bytes, bytes]) -> None:
    for label, wanted in (("unit", spec.unit), ("frame", spec.frame)):
        found = metadata.get(label.encode(), b"").decode(errors="replace")
        if found != wanted:
            raise LakeError(f"{what} has {label} {found!r}, expected {wanted!r}: it was written by another version")
