"""Say what is wrong in a cell file: where, which value, and how to mend it."""

from __future__ import annotations

import difflib
import types
import typing
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from cellwright.errors import InvalidInputError, listed
from schemas.cell_file_document import Document, Location

_MOST_SHOWN = 5


def refusal(document: Document, faults: list[tuple[Location, str]]) -> InvalidInputError:
    """Make one error of all faults, the first five shown in the order of the file."""
    ordered = sorted(faults, key=lambda item: document.line(item[0]))
    lines = [f"{document.origin(location)}, {_dotted(location)}: {message}" for location, message in ordered]
    if len(lines) == 1:
        return InvalidInputError(f"{document.path}, {lines[0]}")
    shown = [f"  {line}" for line in lines[:_MOST_SHOWN]]
    if len(lines) > _MOST_SHOWN:
        shown.append(f"  and {len(lines) - _MOST_SHOWN} more")
    return InvalidInputError("\n".join([f"{document.path} has {len(lines)} errors:", *shown]))


def faults_of(error: ValidationError, model: type[BaseModel], document: Document) -> list[tuple[Location, str]]:
    """Turn a validation error into located messages in our words."""
    faults: list[tuple[Location, str]] = []
    for details in error.errors(include_url=False):
        location = _file_location(details["loc"], document)
        if details["type"] == "too_short" and any(known[: len(location)] == location for known, _ in faults):
            continue  # entries are missing because they were refused above
        fault = (location, _message(details, location, model, document))
        if fault not in faults:
            faults.append(fault)
    return faults


def did_you_mean(wrong: str, known: typing.Iterable[str]) -> str:
    """Suggest the closest known word, or list them all."""
    words = list(known)
    close = difflib.get_close_matches(wrong, words, n=1, cutoff=0.6)
    return f"did you mean {close[0]}?" if close else f"known are {listed(words, 12)}"


def _closest(wrong: str, known: list[str]) -> str:
    close = difflib.get_close_matches(wrong, known, n=1, cutoff=0.6)
    return f"did you mean {close[0]}?" if close else "write one of them"


def _message(details: ErrorDetails, location: Location, model: type[BaseModel], document: Document) -> str:
    kind, value = details["type"], details["input"]
    context: dict[str, Any] = details.get("ctx") or {}
    if kind == "cell_file":
        return details["msg"]
    if kind == "extra_forbidden":
        keys = _keys(_section_at(model, location[:-1]))
        return f"unknown key {str(location[-1])!r}: {did_you_mean(str(location[-1]), keys)}"
    if kind == "missing":
        return f"is missing: add it{_example(model, location)}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        keys = _keys(_section_at(model, location))
        hint = f" ({listed(keys, 8)})" if keys else ""
        return f"{_shown(value)} is not a section: write its keys{hint} below it"
    if kind in ("tuple_type", "list_type"):
        return f"{_shown(value)} is not a list: write [{_plain(value)}, ...]"
    if kind in ("too_short", "too_long"):
        bound, word = (context["min_length"], "at least") if kind == "too_short" else (context["max_length"], "at most")
        return f"has {context['actual_length']} entries but needs {word} {bound}: write that many"
    if kind == "literal_error":
        choices = [word.strip(" '\"") for word in str(context["expected"]).replace(" or ", ", ").split(",")]
        return f"{_shown(value)} is not one of {', '.join(choices)}: {_closest(str(value), choices)}"
    if kind.startswith("int_"):
        return f"{_shown(value)} is not a whole number: write one without unit"
    if kind.startswith("bool_"):
        return f"{_shown(value)} is neither true nor false: write true or false"
    if kind in ("string_type", "string_too_short", "string_too_long"):
        return f"{_shown(value)} is not a text of 1 to 200 characters: write one"
    for limit, phrase in (("ge", "at least"), ("gt", "above"), ("le", "at most"), ("lt", "below")):
        if limit in context:
            return f"{_shown(value)} must be {phrase} {context[limit]}: write a value in that range"
    return f"{_shown(value)}: {details['msg']}: correct it"


def _file_location(loc: tuple[int | str, ...], document: Document) -> Location:
    """Drop the parts of a pydantic location that name union branches and stand nowhere in the file."""
    kept: list[int | str] = []
    for number, part in enumerate(loc):
        parent = document.value(tuple(kept))
        if isinstance(part, int):
            stands = isinstance(parent, list)
        else:  # the last part may be a key that is missing
            stands = isinstance(parent, dict) and (part in parent or number == len(loc) - 1)
        if stands:
            kept.append(part)
    return tuple(kept)


def _section_at(model: type[BaseModel], location: Location) -> type[BaseModel] | None:
    section: type[BaseModel] | None = model
    for key in location:
        if isinstance(key, int):
            continue
        if section is None:
            return None
        fields = {field.alias or name: field.annotation for name, field in section.model_fields.items()}
        section = _section_in(fields.get(key))
    return section


def _section_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in (typing.Union, types.UnionType, tuple, list):
        for member in typing.get_args(annotation):
            found = _section_in(member)
            if found is not None:
                return found
    return None


def _keys(section: type[BaseModel] | None) -> list[str]:
    return [] if section is None else [field.alias or name for name, field in section.model_fields.items()]


def _example(model: type[BaseModel], location: Location) -> str:
    section = _section_at(model, location[:-1])
    for name, field in () if section is None else section.model_fields.items():
        if (field.alias or name) == location[-1] and field.examples:
            return f", like `{location[-1]}: {field.examples[0]}`"
    return ""


def _dotted(location: Location) -> str:
    return ".".join(str(key) for key in location) or "the file"


def _plain(value: object) -> str:
    return _shown(value) if not isinstance(value, str) else value[:40]


def _shown(value: object) -> str:
    if value is None:
        return "an empty value"
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
