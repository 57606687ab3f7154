from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InvalidInputError, LakeError
from storage.lake import Lake
from storage.manifests import FileEntry, Manifest, Recipe, check_file_name, check_kind, manifest_path
from tests.storage.specimens import recipe, tally

DIGEST = hashlib.sha256(b"content").hexdigest()


def _manifest() -> Manifest:
    about = recipe("sample", {"mesh": DIGEST, "parts": [DIGEST, DIGEST], "scan": None}, density_per_m2=0.1, seed=3)
    return Manifest("test-tally", about.key, DIGEST, "0" * 16, {"a.parquet": FileEntry(DIGEST, 7)}, about)


def test_a_manifest_comes_back_from_its_json() -> None:
    manifest = _manifest()
    assert Manifest.from_json(manifest.to_json(), "here", manifest.key) == manifest
    assert manifest.ref.digest == DIGEST
    assert manifest.about.input_digests() == [("mesh", DIGEST), ("parts[0]", DIGEST), ("parts[1]", DIGEST)]


def _set(*path: str) -> Callable[[dict[str, Any], Any], None]:
    def change(plain: dict[str, Any], value: Any) -> None:
        for name in path[:-1]:
            plain = plain[name]
        plain[path[-1]] = value

    return change


def _name(plain: dict[str, Any], value: Any) -> None:
    plain["files"] = {value: plain["files"]["a.parquet"]}


HOSTILE = [
    *[(_name, name) for name in ("../a", "/etc/passwd", "..", ".", "a/b", "a\\b", ".hidden", "", "a\0", "a..b", "ä")],
    *[(_set("kind"), kind) for kind in ("../../etc", "", "A", "a/b", "a_b", "-a", None, ["a"], {})],
    *[
        (_set("digest"), value)
        for value in ("..", DIGEST.upper(), DIGEST[:-1], DIGEST + "\n", None, 7, "../" * 21 + "x")
    ],
    *[(_set("files", "a.parquet", "sha256"), value) for value in ("x", None, DIGEST + "0")],
    *[(_set("files", "a.parquet", "size"), value) for value in (-1, True, 1.0, "7", None)],
    *[(_set("files"), value) for value in ({}, [], None, {"a.parquet": None}, {"a.parquet": {"size": 1}})],
    *[(_set("schema"), value) for value in ("", None, "0" * 15, "../../../../../..")],
    *[(_set("format"), value) for value in (2, "1", None)],
    *[(_set("key"), value) for value in (DIGEST, "..", None)],
    *[(_set("about", "params"), value) for value in ([], None, {"density_per_m2": float("nan")}, {"seed": 4})],
    *[
        (_set("about", "inputs"), value)
        for value in ([], {"mesh": "x"}, {"mesh": 7}, {"mesh": [[DIGEST]]}, {"mesh": {}})
    ],
    *[(_set("about", "version"), value) for value in (True, "1", 2)],
    (_set("about", "stage"), 7),
    (_set("about"), None),
    (_set("more"), 1),
]


@pytest.mark.parametrize(("change", "value"), HOSTILE)
def test_a_manifest_with_a_wrong_value_is_refused(change: Callable[[dict[str, Any], Any], None], value: Any) -> None:
    plain = json.loads(_manifest().to_json())
    change(plain, value)
    with pytest.raises(LakeError, match="manifest over/here is not valid"):
        Manifest.from_json(json.dumps(plain).encode(), "over/here", _manifest().key)


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b"null", b"\xff", b"[" * 100_000, b"7" * 10_000, _manifest().to_json()[:-20]]
)
def test_what_is_no_manifest_is_refused(content: bytes) -> None:
    with pytest.raises(LakeError, match="not valid"):
        Manifest.from_json(content, "here", _manifest().key)


@given(st.text(max_size=30))
@settings(max_examples=200)
def test_no_accepted_name_leaves_its_folder(name: str) -> None:
    for check in (check_file_name, check_kind):
        try:
            check(name)
        except InvalidInputError:
            continue
        assert name not in ("", ".", "..")
        assert not set(name) & set("/\\\0:")


def test_a_hostile_manifest_in_a_lake_is_not_found_and_reported(lake: Lake) -> None:
    ref = lake.publish(recipe().key, tally(1), recipe())
    path = manifest_path(ref.key)
    content = lake.place.read(path)
    assert content is not None
    plain = json.loads(content)
    plain["files"]["../../secret"] = plain["files"].pop("counts.parquet")
    lake.place.put(path.rpartition("/")[0], {path.rpartition("/")[2]: json.dumps(plain).encode()})
    assert lake.find(ref.key) is None
    with pytest.raises(LakeError, match="not a plain name"):
        lake.load(ref)
    with pytest.raises(LakeError, match=ref.key):
        lake.paths(ref)
    assert list(lake.manifests()) == []
    assert ["not a plain name" in str(problem) for problem in lake.verify()] == [True]
    lake.publish(ref.key, tally(1), recipe())
    assert lake.find(ref.key) == ref
    assert lake.verify() == []


def test_a_recipe_knows_its_key() -> None:
    about = Recipe("count", 2, {"a": 1}, {})
    assert about.key == Recipe("count", 2, {"a": 1}, {}).key != recipe().key
