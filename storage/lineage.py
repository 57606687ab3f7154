"""What an artefact was made from, back to the source files, and which artefact a person means by a few letters."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from cellwright.errors import InvalidInputError, listed
from schemas.references import Ref
from storage.manifests import Manifest

if TYPE_CHECKING:
    from storage.lake import Lake

_SHORTEST_PREFIX = 4
_MOST_KINDS = 40
"""More than a lake of all flows has, so that none is kept from who guesses."""


class Ancestor(NamedTuple):
    """One line of a lineage, in the order in which a tree is printed.

    Attributes:
        manifest: How the artefact was made; ``None`` if the lake has lost it.
        depth: Steps from the artefact that was asked for, itself 0.
        name: Name of the input that it is; empty for the artefact itself.
        digest: Its digest.
    """

    manifest: Manifest | None
    depth: int
    name: str
    digest: str


def trace(lake: Lake, ref: Ref) -> list[Ancestor]:
    """List an artefact, its inputs, their inputs and so on, depth first.

    An artefact that several ways lead to is listed each time, its own inputs the first time only. Of several
    recipes with the same result the one made last is followed.

    Raises:
        LakeError: If the artefact itself is not in the lake.
    """
    makers = by_digest(lake)
    lines: list[Ancestor] = []
    open_lines = [Ancestor(lake.manifest(ref), 0, "", ref.digest)]
    expanded: set[str] = set()
    while open_lines:
        line = open_lines.pop()
        lines.append(line)
        if line.manifest is None or line.digest in expanded:
            continue
        expanded.add(line.digest)
        for name, digest in reversed(line.manifest.about.input_digests()):
            made = makers.get(digest)
            open_lines.append(Ancestor(newest(lake, made) if made else None, line.depth + 1, name, digest))
    return lines


def by_digest(lake: Lake) -> dict[str, list[Manifest]]:
    """Return all manifests by the digest of their content."""
    found: dict[str, list[Manifest]] = {}
    for manifest in lake.manifests():
        found.setdefault(manifest.digest, []).append(manifest)
    return found


def newest(lake: Lake, manifests: Iterable[Manifest]) -> Manifest:
    """Return the manifest that was published last, by provenance."""

    def published(manifest: Manifest) -> tuple[str, str]:
        return str((lake.provenance(manifest.key) or {}).get("published_at", "")), manifest.key

    several = list(manifests)
    return several[0] if len(several) == 1 else max(several, key=published)


def resolve(lake: Lake, text: str) -> Ref:
    """Find an artefact by ``kind/digest``, a digest or a key, each by its first letters, or a kind: its newest.

    Raises:
        InvalidInputError: If nothing matches, and which kinds there are, or several things match, and which.
    """
    everything = list(lake.manifests())
    of_kind = [manifest for manifest in everything if manifest.kind == text]
    if of_kind:
        return newest(lake, of_kind).ref
    kind, _, prefix = text.rpartition("/")
    if len(prefix) < _SHORTEST_PREFIX and any(
        m.digest.startswith(prefix) or m.key.startswith(prefix) for m in everything
    ):
        raise InvalidInputError(f"{text!r} is too short: give at least {_SHORTEST_PREFIX} digits of the digest or key")
    found = [m for m in everything if m.digest.startswith(prefix) and kind in ("", m.kind)]
    if not found and not kind:
        found = [m for m in everything if m.key.startswith(prefix)]
    contents = {manifest.digest for manifest in found}
    if len(contents) == 1:
        return newest(lake, found).ref
    if found:
        shown = listed(sorted({str(manifest.ref) for manifest in found}))
        raise InvalidInputError(f"{text!r} means several artefacts: {shown}: give more digits")
    kinds = sorted({manifest.kind for manifest in everything})
    if not kinds:
        raise InvalidInputError(f"no artefact {text!r}: {lake.emptiness()}")
    near = difflib.get_close_matches(kind or text, kinds, n=3)
    hint = f"did you mean {listed(near)}? " if near else ""
    raise InvalidInputError(
        f"no artefact {text!r} in {lake.url}: {hint}kinds in the lake: {listed(kinds, _MOST_KINDS)}"
    )
