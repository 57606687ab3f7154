"""The records beside the artefacts: of runs, and of when and where an artefact was made. Read with suspicion.

Nothing depends on them but what people are shown and what a sweep keeps, so a malformed one is left out and named.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cellwright.errors import LakeError
from storage.manifests import provenance_path
from storage.places import Place

MEND = "`cellwright lake verify --repair` sets it aside, then run again to make it anew"
"""What to do about something damaged."""

_PROVENANCE: dict[str, tuple[type, ...]] = {"published_at": (str,), "run": (str,), "seconds": (int, float)}
"""Types of the fields of provenance that are read again."""


@dataclass(frozen=True, slots=True)
class Problem:
    """Something in the lake that is not what it should be.

    Attributes:
        address: Where it is.
        fact: What it is.
        mended_by: Path inside the lake of what `repair` sets aside, after which it is made anew or not missed.
    """

    address: str
    fact: str
    mended_by: str = ""

    def __str__(self) -> str:
        return f"{self.address}: {self.fact}"


def run_path(record: Mapping[str, Any]) -> str:
    """Return where a run's record stands inside the lake."""
    return f"runs/{record.get('run_id')}.json"


def read_runs(place: Place) -> tuple[list[dict[str, Any]], list[Problem]]:
    """Return the records of all runs, newest first, and those that are no records.

    Raises:
        LakeError: If the lake cannot be listed.
    """
    records: list[dict[str, Any]] = []
    problems: list[Problem] = []
    for path in place.walk("runs"):
        try:
            content = place.read(path)
            if content is not None:
                records.append(_run(json.loads(content), path))
        except (ValueError, RecursionError) as error:
            fact = f"is no record of a run: {error}: set it aside with `cellwright lake verify --repair`"
            problems.append(Problem(place.address(path), fact, path))
        except LakeError as error:
            problems.append(Problem(place.address(path), str(error)))
    return sorted(records, key=lambda record: str(record["recorded_at"]), reverse=True), problems


def _run(record: Any, path: str) -> dict[str, Any]:
    if not isinstance(record, dict):
        raise ValueError("not an object")
    if not isinstance(record.get("run_id"), str) or run_path(record) != path:
        raise ValueError(f"run_id is {str(record.get('run_id'))[:80]!r}, not the file's name")
    if not isinstance(record.get("recorded_at"), str):
        raise ValueError("recorded_at is no text")
    steps = record.get("steps", [])
    if not isinstance(steps, list) or not all(isinstance(step, dict) for step in steps):
        raise ValueError("steps is no list of objects")
    return record


def plain_provenance(record: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return a provenance record without the fields that are not of their type, and the names of those."""
    wrong = [name for name, kinds in _PROVENANCE.items() if name in record and type(record[name]) not in kinds]
    return {name: value for name, value in record.items() if name not in wrong}, wrong


def provenance_problems(place: Place, key: str) -> list[Problem]:
    """Return what is wrong with a key's record of provenance, if there is one."""
    path = provenance_path(key)
    content = place.read(path)
    if content is None:
        return []
    try:
        record = json.loads(content)
        if not isinstance(record, dict):
            raise ValueError("not an object")
    except (ValueError, RecursionError) as error:
        return [Problem(place.address(path), f"is no record of an origin: {error}: {MEND}", path)]
    wrong = plain_provenance(record)[1]
    return [Problem(place.address(path), f"holds {', '.join(wrong)} of a wrong type: {MEND}", path)] if wrong else []
