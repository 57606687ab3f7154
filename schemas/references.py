"""References to stored artefacts: what travels between stages instead of the data."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Ref:
    """A stored artefact: its kind, the key of the recipe that made it, the digest of its content.

    Not iterable on purpose: a task runner that maps over its arguments must not take it apart.
    """

    kind: str
    key: str
    digest: str

    def __str__(self) -> str:
        return f"{self.kind}/{self.digest[:12]}"
