"""Manifests: the small JSON documents that commit artefacts to the lake, and nothing but checked values in them.

A manifest is input from outside like any other: every field is checked before it is used, a key, digest or
checksum is hex, a file's name has no folder in it. So no manifest, whoever wrote it, leads out of the lake.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cellwright.errors import InvalidInputError, LakeError
from schemas.references import Ref
from storage.keys import InputDigests, canonical_json, is_hash, plain_inputs, recipe_key

FORMAT = 1
"""Version of the manifest's own layout."""

_KIND = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,199}")
_SCHEMA = re.compile(r"[0-9a-f]{16}")


@dataclass(frozen=True, slots=True)
class FileEntry:
    """What is known of a stored file: SHA-256 (hex) and size in bytes."""

    sha256: str
    size: int

    @classmethod
    def of(cls, content: bytes) -> FileEntry:
        """Measure a file's bytes."""
        return cls(hashlib.sha256(content).hexdigest(), len(content))


@dataclass(frozen=True, slots=True)
class Recipe:
    """How an artefact was made: stage, version, canonical parameters, digests of the inputs by name."""

    stage: str
    version: int
    params: Mapping[str, Any]
    inputs: InputDigests

    @property
    def key(self) -> str:
        """The key under which the result is found."""
        return recipe_key(self.stage, self.version, self.params, self.inputs)

    def input_digests(self) -> list[tuple[str, str]]:
        """Return ``(name, digest)`` of all inputs in order; the parts of a tuple are ``name[0]``, ``name[1]``, ..."""
        pairs: list[tuple[str, str]] = []
        for name, given in self.inputs.items():
            if isinstance(given, str):
                pairs.append((name, given))
            elif given is not None:
                pairs.extend((f"{name}[{i}]", text) for i, text in enumerate(given))
        return pairs


@dataclass(frozen=True, slots=True)
class Manifest:
    """One committed artefact.

    Attributes:
        kind: Kind of the artefact.
        key: Key of its recipe.
        digest: Digest of its content.
        schema: Fingerprint of the fields that its class had when it was written, `storage.formats.fingerprint`.
        files: What its files must be, by name.
        about: The recipe.
    """

    kind: str
    key: str
    digest: str
    schema: str
    files: Mapping[str, FileEntry]
    about: Recipe

    @property
    def ref(self) -> Ref:
        """The reference that stages pass on."""
        return Ref(self.kind, self.key, self.digest)

    @property
    def folder(self) -> str:
        """Folder of the content inside the lake."""
        return data_folder(self.kind, self.digest)

    def to_json(self) -> bytes:
        """Return the manifest as its JSON file, the same bytes for the same manifest."""
        plain = {
            "format": FORMAT,
            "kind": self.kind,
            "key": self.key,
            "digest": self.digest,
            "schema": self.schema,
            "files": {name: {"sha256": file.sha256, "size": file.size} for name, file in sorted(self.files.items())},
            "about": {
                "stage": self.about.stage,
                "version": self.about.version,
                "params": dict(self.about.params),
                "inputs": plain_inputs(self.about.inputs),
            },
        }
        return json.dumps(plain, indent=1, ensure_ascii=True, allow_nan=False).encode()

    @classmethod
    def from_json(cls, content: bytes, path: str, key: str) -> Manifest:
        """Read and check a manifest that stands at ``path`` under ``key``.

        Raises:
            LakeError: If anything in it is not what a manifest holds.
        """
        try:
            # manifests of any size are read, so a depth bomb must end as an error, not as a crash
            return _checked(json.loads(content), key)
        except (ValueError, RecursionError, InvalidInputError) as error:
            raise LakeError(
                f"manifest {path} is not valid: {error}: run again to make its artefact anew, or delete the file"
            ) from error


def check_kind(kind: str) -> str:
    """Return the kind if it can name a folder.

    Raises:
        InvalidInputError: If it is not words of lower-case letters and digits joined by dashes.
    """
    if _KIND.fullmatch(kind) is None:
        raise InvalidInputError(f"kind {kind!r} must be words of lower-case letters and digits joined by dashes")
    return kind


def check_hash(name: str, text: object) -> str:
    """Return a key or digest if it is one.

    Raises:
        InvalidInputError: If it is not 64 lower-case hex digits.
    """
    if not is_hash(text):
        raise InvalidInputError(f"{name} {str(text)[:80]!r} is not 64 lower-case hex digits")
    return str(text)


def check_file_name(name: str) -> str:
    """Return a file's name if it stays in its folder.

    Raises:
        InvalidInputError: If it holds a separator, ``..`` or other characters than those we write.
    """
    if _FILE_NAME.fullmatch(name) is None or ".." in name:
        raise InvalidInputError(f"file name {name[:80]!r} is not a plain name of letters, digits, '_', '-' and '.'")
    return name


def data_folder(kind: str, digest: str) -> str:
    """Return the folder of a content inside the lake."""
    return f"data/{kind}/{digest}"


def manifest_path(key: str) -> str:
    """Return the path of a key's manifest inside the lake."""
    return f"manifests/{key[:2]}/{key}.json"


def provenance_path(key: str) -> str:
    """Return the path of a key's provenance record inside the lake."""
    return f"provenance/{key[:2]}/{key}.json"


def _checked(plain: Any, key: str) -> Manifest:
    _fields("the manifest", plain, {"format", "kind", "key", "digest", "schema", "files", "about"})
    if plain["format"] != FORMAT:
        raise ValueError(f"its format is {plain['format']!r}, this version reads {FORMAT}")
    if plain["key"] != key:
        raise ValueError(f"it stands under key {key[:12]}... but names {str(plain['key'])[:80]!r}")
    if not isinstance(plain["schema"], str) or _SCHEMA.fullmatch(plain["schema"]) is None:
        raise ValueError("its schema is not 16 hex digits")
    files = plain["files"]
    if not isinstance(files, dict) or not files:
        raise ValueError("its files are missing")
    recipe = _recipe(plain["about"])
    if recipe.key != key:
        raise ValueError("its recipe does not give its key")
    return Manifest(
        check_kind(str(plain["kind"])[:100]),
        check_hash("key", key),
        check_hash("digest", plain["digest"]),
        plain["schema"],
        {check_file_name(name): _entry(name, entry) for name, entry in files.items()},
        recipe,
    )


def _entry(name: str, plain: Any) -> FileEntry:
    _fields(f"file {name!r}", plain, {"sha256", "size"})
    size = plain["size"]
    if type(size) is not int or size < 0:
        raise ValueError(f"file {name!r} has size {size!r}")
    return FileEntry(check_hash("sha256", plain["sha256"]), size)


def _recipe(plain: Any) -> Recipe:
    _fields("about", plain, {"stage", "version", "params", "inputs"})
    if not isinstance(plain["stage"], str) or type(plain["version"]) is not int:
        raise ValueError("its stage or version is malformed")
    if not isinstance(plain["params"], dict) or not isinstance(plain["inputs"], dict):
        raise ValueError("its params or inputs are not objects")
    canonical_json(plain["params"])
    for given in plain["inputs"].values():
        if given is not None and not isinstance(given, str | list):
            raise ValueError("its inputs are not digests")
    return Recipe(plain["stage"], plain["version"], plain["params"], plain_inputs(plain["inputs"]))


def _fields(what: str, plain: Any, names: set[str]) -> None:
    if not isinstance(plain, dict):
        raise ValueError(f"{what} is not an object")
    if plain.keys() != names:
        wrong: Sequence[str] = sorted(plain.keys() ^ names)
        raise ValueError(f"{what} has missing or unknown fields: {', '.join(wrong)[:200]}")
