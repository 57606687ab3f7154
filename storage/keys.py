"""Name a result by its recipe: one SHA-256 over stage, version, parameters and the digests of the inputs.

Keys hold input *digests*, not input keys, so a recomputation that ends in the same content stops there and
everything downstream is still found.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from cellwright.errors import InvalidInputError

InputDigests = Mapping[str, str | Sequence[str] | None]
"""Digest of each input by its name: one, several in order, or ``None`` for an input that was left out."""

_HEX = re.compile(r"[0-9a-f]{64}")


def is_hash(text: object) -> bool:
    """Whether a value is the lower-case hex of a SHA-256, the only form that keys and digests take."""
    return isinstance(text, str) and _HEX.fullmatch(text) is not None


def canonical_json(value: Any) -> str:
    """Return the one JSON text of plain values: sorted names, no spaces, ASCII, floats as Python prints them.

    Raises:
        InvalidInputError: If a value has no JSON form (NaN, infinity, an object).
    """
    try:
        return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"parameters cannot be keyed: {error}: use plain, finite JSON values") from error


def plain_inputs(inputs: InputDigests) -> dict[str, str | list[str] | None]:
    """Return the input digests as plain JSON values.

    Raises:
        InvalidInputError: If one of them is not a digest.
    """
    plain: dict[str, str | list[str] | None] = {}
    for name, given in inputs.items():
        several = [given] if isinstance(given, str) else list(given or ())
        for text in several:
            if not is_hash(text):
                raise InvalidInputError(f"input {name!r} is {text!r}, not a digest of 64 hex digits")
        plain[name] = given if given is None or isinstance(given, str) else several
    return plain


def recipe_key(stage: str, version: int, params: Mapping[str, Any], inputs: InputDigests) -> str:
    """Return the key (64 hex digits) of what a stage makes from these parameters and inputs.

    Args:
        stage: Name of the stage.
        version: Its version.
        params: Canonical parameters, `schemas.params.Params.canonical`.
        inputs: Digests of the inputs by name.

    Raises:
        InvalidInputError: If the parameters are not plain JSON or an input is not a digest.
    """
    recipe = {"stage": stage, "version": version, "params": dict(params), "inputs": plain_inputs(inputs)}
    return hashlib.sha256(canonical_json(recipe).encode()).hexdigest()
