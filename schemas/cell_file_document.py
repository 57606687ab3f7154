"""Read a cell file's YAML into plain data that remembers where each value was written.

Only plain YAML is read (no tags that construct objects). Keys must be text and may not repeat. Settings from the
command line (``path.to.field=value``) are laid over the data before anything is validated, so they are checked
like the file itself.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from cellwright.errors import InvalidInputError

Location = tuple[str | int, ...]
"""Path of a value in the document: keys of mappings and numbers of list entries."""

_MAX_BYTES = 4_000_000
_MAX_NODES = 200_000
_MAX_DEPTH = 60
_PLAIN_TAGS = {
    f"tag:yaml.org,2002:{name}" for name in ("map", "seq", "str", "int", "float", "bool", "null", "timestamp")
}
_SEGMENT = re.compile(r"[^\s=.\[\]]+")


@dataclass
class Document:
    """The data of a cell file and the origin of each value.

    Attributes:
        path: The file.
        data: Nested dicts, lists and plain values.
        origins: Where a value was written: a line number, or the text of the setting that gave it.
    """

    path: Path
    data: dict[str, Any]
    origins: dict[Location, int | str] = field(default_factory=dict)

    def origin(self, location: Location) -> str:
        """Say where a value, or the closest section around it, was written."""
        for length in range(len(location), -1, -1):
            found = self.origins.get(location[:length])
            if found is not None:
                return f"line {found}" if isinstance(found, int) else f"--set {found}"
        return "line 1"

    def line(self, location: Location) -> int:
        """Return the line by which an error is sorted; settings come after all lines."""
        for length in range(len(location), -1, -1):
            found = self.origins.get(location[:length])
            if found is not None:
                return found if isinstance(found, int) else 10**9
        return 0

    def value(self, location: Location) -> Any:
        """Return the value at a location, ``None`` if there is none."""
        here: Any = self.data
        for key in location:
            entries = dict(enumerate(here)) if isinstance(here, list) else here
            if not isinstance(entries, dict) or key not in entries:
                return None
            here = entries[key]
        return here


def read_document(path: Path, kind: str = "cell file", first_line: str = "cellwright: 1") -> Document:
    """Read a cell file, or another ``kind`` of file in YAML; ``first_line`` is what such a file begins with.

    Raises:
        InvalidInputError: If the file is missing, unreadable, empty, or not plain YAML with unique text keys.
    """
    document = Document(path, {})
    try:
        data = _parsed(_read_text(path, kind), document)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f", line {mark.line + 1}" if mark else ""
        raise InvalidInputError(
            f"{path}{where}: not readable as YAML ({error.problem or error.context}): correct it"
        ) from error
    except yaml.YAMLError as error:
        raise InvalidInputError(
            f"{path} is not readable as YAML: it holds control characters: is it a {kind}?"
        ) from error
    except RecursionError as error:
        raise InvalidInputError(f"{path} is nested too deeply: flatten it to {_MAX_DEPTH} levels") from error
    if data is None:
        raise InvalidInputError(f"{path} is empty: write a {kind}, starting with `{first_line}`")
    if not isinstance(data, dict):
        raise InvalidInputError(f"{path}, line 1: a {kind} is a list of `key: value` lines, not {_shown(data)}")
    document.data = data
    return document


def _parsed(text: str, document: Document) -> Any:
    loader: Any = yaml.SafeLoader(text)
    try:
        node = loader.get_single_node()
        return None if node is None else _Builder(loader, document).build(node, ())
    finally:
        loader.dispose()


def apply_overrides(document: Document, overrides: Sequence[str]) -> None:
    """Lay settings (``path.to.field=value``, the value in YAML) over a document.

    Entries of a list are chosen by number, counted from 0, or by their ``name``.

    Raises:
        InvalidInputError: If a setting has no ``=``, a malformed path or value, or goes through a plain value.
    """
    for text in overrides:
        name, equals, written = text.partition("=")
        segments = name.strip().split(".")
        if not equals or not all(_SEGMENT.fullmatch(segment) for segment in segments):
            raise InvalidInputError(f"--set {text}: not a setting: write path.to.field=value")
        _put(document, text, segments, _setting_value(text, written))


def _put(document: Document, text: str, segments: list[str], value: Any) -> None:
    here: Any = document.data
    location: Location = ()
    for number, segment in enumerate(segments):
        key: str | int = segment
        if isinstance(here, list):
            key = _entry(here, segment, f"--set {text}: {'.'.join(map(str, location))}")
        elif not isinstance(here, dict):
            raise InvalidInputError(
                f"--set {text}: {'.'.join(segments[:number])} is {_shown(here)}, not a section: it has no {segment!r}"
            )
        location = (*location, key)
        if number == len(segments) - 1:
            here[key] = value
            for old in [known for known in document.origins if known[: len(location)] == location]:
                del document.origins[old]
            document.origins[location] = text
            return
        if isinstance(here, dict) and here.get(segment) is None and segments[number + 1].isdecimal():
            named = ".".join(segments[: number + 1])
            raise InvalidInputError(
                f"--set {text}: {named} has no entries, so there is no {segments[number + 1]!r}: "
                f"set the whole list, {named}=[...]"
            )
        if isinstance(here, dict) and here.get(segment) is None:
            here[segment] = {}
            document.origins[location] = text
        here = here[key]


def _entry(entries: list[Any], segment: str, where: str) -> int:
    if segment.isdecimal() and int(segment) < len(entries):
        return int(segment)
    names = [entry.get("name") if isinstance(entry, dict) else None for entry in entries]
    if segment in names:
        return names.index(segment)
    known = ", ".join(str(name) for name in names if name) or "no names"
    raise InvalidInputError(
        f"{where} has {len(entries)} entries ({known}) and no {segment!r}: count from 0 or name one"
    )


def _setting_value(text: str, written: str) -> Any:
    try:
        return _parsed(written, Document(Path("--set"), {}))
    except (yaml.YAMLError, RecursionError) as error:
        raise InvalidInputError(f"--set {text}: the value is not readable as YAML: quote it") from error


class _Builder:
    """Turns YAML nodes into fresh plain data; shared anchors are copied, so that a setting changes one place."""

    def __init__(self, loader: Any, document: Document) -> None:
        self.loader = loader
        self.document = document
        self.n_nodes = 0

    def build(self, node: yaml.Node, location: Location) -> Any:
        self.n_nodes += 1
        line = node.start_mark.line + 1
        if self.n_nodes > _MAX_NODES or len(location) > _MAX_DEPTH:
            raise InvalidInputError(
                f"{self.document.path}, line {line}: more than {_MAX_NODES} values or {_MAX_DEPTH} levels: "
                "is an anchor (&name) used inside itself?"
            )
        if node.tag not in _PLAIN_TAGS:
            raise InvalidInputError(
                f"{self.document.path}, line {line}: the tag {node.tag} is not plain YAML: remove it"
            )
        self.document.origins.setdefault(location, line)
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, location)
        if isinstance(node, yaml.SequenceNode):
            return [self.build(child, (*location, number)) for number, child in enumerate(node.value)]
        try:
            return self.loader.construct_object(node, deep=True)
        except ValueError as error:
            raise InvalidInputError(f"{self.document.path}, line {line}: {node.value!r} is not readable") from error

    def _mapping(self, node: yaml.MappingNode, location: Location) -> dict[str, Any]:
        first_lines: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise InvalidInputError(f"{self.document.path}, line {line}: a key must be text")
            if key.value in first_lines:
                raise InvalidInputError(
                    f"{self.document.path}, line {line}: {_dotted((*location, key.value))} is given twice, "
                    f"first in line {first_lines[key.value]}: remove one"
                )
            first_lines[key.value] = line
        self.loader.flatten_mapping(node)  # `<<: *anchor`; what the mapping itself says comes last and wins
        built: dict[str, Any] = {}
        for key, child in node.value:
            self.document.origins[(*location, key.value)] = key.start_mark.line + 1
            built[key.value] = self.build(child, (*location, key.value))
        return built


def _read_text(path: Path, kind: str) -> str:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InvalidInputError(f"{path} is {path.stat().st_size / 1e6:.0f} MB long: is it a {kind}?")
        with path.open("rb") as file:  # a device has no size and may have no end
            content = file.read(_MAX_BYTES + 1)
        if len(content) > _MAX_BYTES:
            raise InvalidInputError(f"{path} is more than {_MAX_BYTES / 1e6:.0f} MB long: is it a {kind}?")
        return content.decode("utf-8-sig")
    except FileNotFoundError as error:
        raise InvalidInputError(f"{kind} {path} does not exist: check the path") from error
    except IsADirectoryError as error:
        raise InvalidInputError(f"{kind} {path} is a folder: name the .yaml file in it") from error
    except OSError as error:
        raise InvalidInputError(f"{kind} {path} cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InvalidInputError(
            f"{path} is not a text file (byte {error.start} is not UTF-8): is it a {kind}?"
        ) from error


def _dotted(location: Location) -> str:
    return ".".join(str(key) for key in location)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
