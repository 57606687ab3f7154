"""Which file format holds which artefact: motion in MCAP, everything else in Parquet.

The formats load their libraries when first used, so that a lake can be opened at no cost.
"""

from __future__ import annotations

import hashlib
import importlib
import pkgutil
from collections.abc import Mapping
from typing import Protocol, cast

import schemas
from cellwright.errors import InvalidInputError
from schemas.artefact import Artefact, artefact_class, specs
from schemas.motion import Recording

_MODULES: dict[type[Artefact], str] = {Recording: "storage.mcap"}
_DEFAULT_MODULE = "storage.parquet"


class Format(Protocol):
    """A file format: artefact to files and back, the same bytes for the same artefact."""

    def encode(self, artefact: Artefact) -> dict[str, bytes]:
        """Return the artefact's files by name."""

    def decode(self, kind: type[Artefact], files: Mapping[str, bytes]) -> Artefact:
        """Return the artefact that the files hold."""


def format_of(kind: type[Artefact]) -> Format:
    """Return the format in which an artefact class is stored."""
    return cast(Format, importlib.import_module(_MODULES.get(kind, _DEFAULT_MODULE)))


def known_class(kind: str) -> type[Artefact]:
    """Look an artefact class up, importing what `schemas` declares if need be.

    Raises:
        InvalidInputError: If no such kind is declared.
    """
    try:
        return artefact_class(kind)
    except InvalidInputError:
        for module in pkgutil.iter_modules(schemas.__path__):
            importlib.import_module(f"schemas.{module.name}")
        return artefact_class(kind)


def fingerprint(kind: type[Artefact]) -> str:
    """Return 16 hex digits that change when the class's fields, their units or frames change.

    An artefact of another fingerprint is not found again, so that changed declarations never meet old files.
    The words of a meaning are left out: they may be bettered at no cost.
    """
    declared = [
        (name, spec.role, spec.dtype, spec.width, spec.unit, spec.frame, spec.table, spec.suffix)
        + (("optional",) if spec.optional else ())
        for name, spec in specs(kind).items()
    ]
    return hashlib.sha256(repr(declared).encode()).hexdigest()[:16]
