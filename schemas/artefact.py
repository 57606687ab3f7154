"""The base of all artefacts: immutable, typed, self-describing values that stages hand to each other.

An artefact checks its own arrays when it is made (dtype, width, equal lengths within a table) and freezes
them. Its digest is a hash of the content alone: field names, dtypes, shapes and values, never file bytes.
"""

from __future__ import annotations

import dataclasses
import hashlib
import numbers
import struct
from typing import Any, ClassVar

import numpy as np

from cellwright.arrays import AnyArray
from cellwright.errors import InvalidInputError
from schemas.columns import ANY_WIDTH, FieldSpec, spec_of

_KINDS: dict[str, type[Artefact]] = {}


class Artefact:
    """Base class; subclasses are ``@dataclass(frozen=True, eq=False)`` with a ``KIND`` and declared fields.

    Raises:
        InvalidInputError: If an array does not fit its declaration.
    """

    KIND: ClassVar[str]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        known = _KINDS.setdefault(cls.KIND, cls)
        if known.__qualname__ != cls.__qualname__:
            raise TypeError(f"artefact kind {cls.KIND!r} is declared by {known.__name__} and {cls.__name__}")

    def __post_init__(self) -> None:
        lengths: dict[str, int] = {}
        for name, spec in specs(type(self)).items():
            value = getattr(self, name)
            object.__setattr__(self, name, _checked(f"{self.KIND}.{name}", spec, value, lengths))

    def __repr__(self) -> str:
        lengths = {spec.table: len(getattr(self, name)) for name, spec in columns(type(self)).items()}
        shown = ", ".join(f"{table}: {length}" for table, length in lengths.items())
        return f"{type(self).__name__}({shown})"


def specs(kind: type[Artefact]) -> dict[str, FieldSpec]:
    """Return the declared fields of an artefact class in order."""
    return {
        field.name: spec
        for field in dataclasses.fields(kind)  # type: ignore[arg-type]  # every subclass is a dataclass
        if (spec := spec_of(field)) is not None
    }


def columns(kind: type[Artefact]) -> dict[str, FieldSpec]:
    """Return the declared columns of an artefact class in order."""
    return {name: spec for name, spec in specs(kind).items() if spec.role == "column"}


def held(artefact: Artefact) -> dict[str, FieldSpec]:
    """Return the declared fields of an artefact in order, without the optional columns that it leaves out."""
    return {
        name: spec
        for name, spec in specs(type(artefact)).items()
        if not (spec.optional and getattr(artefact, name).shape[1] == 0)
    }


def artefact_class(kind: str) -> type[Artefact]:
    """Look an artefact class up by its kind.

    Raises:
        InvalidInputError: If no such kind is declared.
    """
    if kind not in _KINDS:
        raise InvalidInputError(f"unknown artefact kind {kind!r}: this lake was written by another version")
    return _KINDS[kind]


def digest(artefact: Artefact) -> str:
    """Return the SHA-256 (hex) of an artefact's content."""
    sha = hashlib.sha256(artefact.KIND.encode())
    for name, spec in held(artefact).items():
        value = getattr(artefact, name)
        sha.update(f"\0{name}\0{spec.dtype}\0".encode())
        if isinstance(value, np.ndarray):
            sha.update(repr(value.shape).encode())
            sha.update(np.ascontiguousarray(value).data)
        else:
            sha.update(_scalar_bytes(value))
    return sha.hexdigest()


def _scalar_bytes(value: object) -> bytes:
    if isinstance(value, tuple):
        texts = [str(item).encode() for item in value]
        return struct.pack("<q", len(texts)) + b"".join(struct.pack("<q", len(raw)) + raw for raw in texts)
    if isinstance(value, bytes):
        return struct.pack("<q", len(value)) + value
    if isinstance(value, float):
        return struct.pack("<d", value)
    return repr(value).encode()


def _checked(name: str, spec: FieldSpec, value: Any, lengths: dict[str, int]) -> Any:
    if spec.role == "blob":
        if not isinstance(value, bytes):
            raise InvalidInputError(f"{name} must be bytes, not {type(value).__name__}")
        return value
    if spec.role == "fact":
        return _fact(name, spec, value)
    if spec.optional:
        value = _or_left_out(spec, value, lengths.get(spec.table, 0))
    checked = _texts(name, value) if spec.dtype == "str" else _frozen(name, spec, value)
    length = lengths.setdefault(spec.table, len(checked))
    if len(checked) != length:
        raise InvalidInputError(f"{name} has {len(checked)} rows but table {spec.table!r} has {length}")
    return checked


def _or_left_out(spec: FieldSpec, value: Any, n_rows: int) -> Any:
    """Return an optional column, without width and as long as its table where it is left out, or has no rows at all."""
    is_empty = value is None or np.shape(value)[1:] == (0,) or n_rows == len(value) == 0
    return np.zeros((n_rows, 0), spec.dtype) if is_empty else value


def _fact(name: str, spec: FieldSpec, value: Any) -> str | bool | int | float:
    fits: bool
    plain: type[str | bool | int | float]
    if spec.dtype == "str":
        fits, plain = isinstance(value, str), str
    elif spec.dtype == "bool":
        fits, plain = isinstance(value, bool | np.bool_), bool
    elif "float" in spec.dtype:
        fits, plain = isinstance(value, numbers.Real) and not isinstance(value, bool), float
    else:
        fits, plain = isinstance(value, numbers.Integral) and not isinstance(value, bool), int
    if not fits:
        raise InvalidInputError(f"{name} is {value!r}, which is no {spec.dtype}")
    return plain(value)


def _texts(name: str, value: Any) -> tuple[str, ...]:
    texts = (value,) if isinstance(value, str) else tuple(value)
    if isinstance(value, str) or not all(isinstance(text, str) for text in texts):
        raise InvalidInputError(f"{name} must be a sequence of texts, not {value!r}")
    return tuple(str(text) for text in texts)  # NumPy's own texts become plain ones


def _frozen(name: str, spec: FieldSpec, value: Any) -> AnyArray:
    given = np.asarray(value)
    wanted = np.dtype(spec.dtype)
    if given.dtype != wanted and not np.can_cast(given.dtype, wanted, casting="same_kind"):
        raise InvalidInputError(f"{name} has dtype {given.dtype}, which does not fit {wanted}")
    if given.size and wanted.kind == "i" and not np.can_cast(given.dtype, wanted):
        least, most, limits = int(given.min()), int(given.max()), np.iinfo(wanted)
        if least < limits.min or most > limits.max:  # the cast would wrap around in silence
            raise InvalidInputError(f"{name} holds {least} to {most}, which does not fit {wanted}")
    array = np.ascontiguousarray(given, dtype=wanted)
    if spec.width is None and array.ndim != 1:
        raise InvalidInputError(f"{name} has shape {array.shape}, not (rows,)")
    if spec.width is not None and (array.ndim != 2 or spec.width not in (ANY_WIDTH, array.shape[1])):
        raise InvalidInputError(f"{name} has shape {array.shape}, not (rows, {spec.width})")
    view = array.view()
    view.flags.writeable = False
    return view
