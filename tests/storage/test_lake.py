from __future__ import annotations

import errno
import importlib.util
import pickle
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellwright.errors import InvalidInputError, LakeError
from schemas import artefact as artefacts
from schemas.artefact import digest
from schemas.references import Ref
from schemas.sources import SourceFile
from storage import parquet
from storage.lake import Lake
from storage.manifests import FileEntry
from storage.places import LocalFolder
from tests.storage.specimens import Tally, TallyInDozens, recipe, same, tally
from tests.storage.test_mcap import plan


def _overwrite(lake: Lake, path: str, content: bytes) -> None:
    folder, _, name = path.rpartition("/")
    lake.place.put(folder, {name: content})


def _fail_once(lake: Lake, failure: OSError, patch: pytest.MonkeyPatch) -> list[str]:
    """Let the next read of data fail below the lake's place, where disks and networks fail; lists what was read."""
    read: list[str] = []
    local = isinstance(lake.place, LocalFolder)
    owner: Any = Path if local else type(lake.place.file_system)  # type: ignore[attr-defined, unused-ignore]
    name = "read_bytes" if local else "cat_file"
    whole = getattr(owner, name)

    def reading(*arguments: Any, **keywords: Any) -> bytes:
        path = str(arguments[0 if local else 1])
        if "/data/" in path:
            read.append(path)
            if len(read) == 1:
                raise failure
        return bytes(whole(*arguments, **keywords))

    patch.setattr(owner, name, reading)
    return read


def _only_file(lake: Lake, ref: Ref) -> str:
    (path,) = lake.place.walk(f"data/{ref.kind}/{ref.digest}")
    return path


class TestLakeContract:
    """What every backend promises."""

    def test_a_key_that_was_never_published_is_not_found(self, lake: Lake) -> None:
        assert lake.find(recipe().key) is None
        assert list(lake.manifests()) == []
        assert lake.runs() == []
        assert lake.verify() == []

    def test_what_was_published_is_found_and_loaded(self, lake: Lake) -> None:
        about = recipe(seed=1)
        ref = lake.publish(about.key, tally(1, 2, 3), about)
        assert ref == Ref("test-tally", about.key, digest(tally(1, 2, 3)))
        assert lake.find(about.key) == ref
        assert same(lake.load(ref), tally(1, 2, 3))
        assert lake.manifest(ref).about == about
        assert lake.manifest(about.key) == lake.manifest(ref)
        assert lake.verify() == []

    def test_motion_is_stored_as_mcap(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, plan(), recipe())
        assert list(lake.paths(ref)) == ["recording.mcap"]
        assert same(lake.load(ref), plan())

    def test_a_blob_is_stored_byte_for_byte(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, SourceFile(name="part.stl", content=b"solid\0"), recipe())
        assert lake.place.read(f"data/source-file/{ref.digest}/content.source") == b"solid\0"
        assert lake.paths(ref)["content.source"] == f"{lake.url}/data/source-file/{ref.digest}/content.source"

    def test_two_recipes_with_one_result_share_it(self, lake: Lake) -> None:
        one, other = recipe(seed=1), recipe(seed=2)
        refs = [lake.publish(about.key, tally(5), about) for about in (one, other)]
        assert refs[0].digest == refs[1].digest
        assert len(lake.place.walk("data")) == 1
        assert lake.find(one.key) == refs[0]
        assert lake.find(other.key) == refs[1]

    def test_publishing_again_changes_no_byte_of_the_content(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, tally(5), recipe())
        before = lake.place.read(_only_file(lake, ref))
        assert lake.publish(recipe().key, tally(5), recipe()) == ref
        assert lake.place.read(_only_file(lake, ref)) == before

    def test_a_deleted_file_is_not_there_until_published_again(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, tally(5), recipe())
        lake.place.remove(_only_file(lake, ref))
        assert lake.find(ref.key) is None
        with pytest.raises(LakeError, match="is missing"):
            lake.load(ref)
        self._mends(lake, ref)

    def test_a_torn_file_is_not_there_until_published_again(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, tally(5), recipe())
        content = lake.place.read(_only_file(lake, ref))
        assert content is not None
        _overwrite(lake, _only_file(lake, ref), content[:-1])
        assert lake.find(ref.key) is None
        self._mends(lake, ref)

    def test_a_single_file_is_read_as_it_was_published_or_not_at_all(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, tally(*range(100)), recipe())
        path = _only_file(lake, ref)
        whole = lake.place.read(path) or b""
        assert lake.read(ref, path.rpartition("/")[2]) == whole != b""
        _overwrite(lake, path, whole[:-1] + bytes([whole[-1] ^ 1]))
        with pytest.raises(LakeError, match="does not match its SHA-256: run again to make it anew"):
            lake.read(ref, path.rpartition("/")[2])
        assert lake.find(ref.key) is None

    def test_a_flipped_byte_is_found_when_loaded_and_mended_by_the_next_run(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, tally(*range(100)), recipe())
        path = _only_file(lake, ref)
        content = bytearray(lake.place.read(path) or b"")
        content[len(content) // 2] ^= 1
        _overwrite(lake, path, bytes(content))
        assert [problem.address for problem in lake.verify()] == [lake.place.address(path)]
        assert lake.find(ref.key) == ref  # sizes alone do not tell
        with pytest.raises(LakeError, match="does not match its SHA-256") as caught:
            lake.load(ref)
        assert lake.place.address(path) in str(caught.value)
        assert "run again" in str(caught.value)
        assert lake.find(ref.key) is None
        with pytest.raises(LakeError, match="was damaged and is set aside"):
            lake.load(ref)
        assert lake.publish(ref.key, tally(*range(100)), recipe()) == ref
        assert same(lake.load(ref), tally(*range(100)))
        assert lake.verify() == []

    @pytest.mark.parametrize(
        "failure",
        [
            OSError(errno.EIO, "Input/output error"),
            OSError(errno.EMFILE, "Too many open files"),
            PermissionError(errno.EACCES, "Permission denied"),
            TimeoutError("Read timed out"),
        ],
        ids=["disk", "handles", "permission", "network"],
    )
    def test_a_read_that_fails_once_is_no_damage_and_the_next_load_succeeds(
        self, lake: Lake, failure: OSError, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        ref = lake.publish(recipe().key, tally(5), recipe())
        read = _fail_once(lake, failure, monkeypatch)
        with pytest.raises(LakeError, match="cannot read") as caught:
            lake.load(ref)
        assert "damaged" not in str(caught.value)
        assert len(read) == 1
        assert lake.place.walk("damaged") == {}
        assert lake.find(ref.key) == ref
        assert same(lake.load(ref), tally(5))

    def test_an_artefact_in_an_empty_lake_names_what_to_do(self, lake: Lake) -> None:
        with pytest.raises(InvalidInputError, match=r"there is no lake at .*: fill it with .*--lake"):
            lake.resolve("coverage")
        lake.record_run("one", {})
        with pytest.raises(InvalidInputError, match="is empty: fill it with"):
            lake.resolve("coverage")
        _overwrite(lake, f"manifests/00/{'0' * 64}.json", b"{")
        with pytest.raises(InvalidInputError, match="nothing readable: `cellwright lake verify`"):
            lake.resolve("coverage")

    def test_content_under_a_wrong_digest_is_refused(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, tally(5), recipe())
        files = parquet.encode(tally(6))
        manifest = lake.manifest(ref)
        lake.place.put(manifest.folder, files)
        forged = type(manifest)(
            manifest.kind,
            manifest.key,
            manifest.digest,
            manifest.schema,
            {name: FileEntry.of(content) for name, content in files.items()},
            manifest.about,
        )
        _overwrite(lake, f"manifests/{ref.key[:2]}/{ref.key}.json", forged.to_json())
        assert ["digest" in problem.fact for problem in lake.verify()] == [True]
        with pytest.raises(LakeError, match="its content has digest"):
            lake.load(ref)
        self._mends(lake, ref)

    def test_bytes_of_another_library_version_are_kept_if_they_hold_the_same_content(
        self, lake: Lake, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        old = lake.publish(recipe(seed=1).key, tally(*range(50)), recipe(seed=1))
        before = lake.place.read(_only_file(lake, old))
        monkeypatch.setattr(parquet, "_ZSTD_LEVEL", 19)
        monkeypatch.setattr(parquet, "_encoding", lambda field: [])
        new = lake.publish(recipe(seed=2).key, tally(*range(50)), recipe(seed=2))
        assert parquet.encode(tally(*range(50)))["counts.parquet"] != before
        assert lake.place.read(_only_file(lake, old)) == before
        assert same(lake.load(old), lake.load(new))
        assert lake.verify() == []

    def test_a_changed_declaration_is_not_found_again(self, lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
        ref = lake.publish(recipe().key, tally(5), recipe())
        monkeypatch.setitem(artefacts._KINDS, Tally.KIND, TallyInDozens)
        assert lake.find(ref.key) is None
        with pytest.raises(LakeError, match="other declarations"):
            lake.load(ref)
        assert lake.verify() == []

    def test_an_unknown_kind_is_not_found(self, lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
        ref = lake.publish(recipe().key, tally(5), recipe())
        monkeypatch.delitem(artefacts._KINDS, Tally.KIND)
        assert lake.find(ref.key) is None
        with pytest.raises(InvalidInputError, match="unknown artefact kind"):
            lake.load(ref)
        assert lake.verify() == []

    def test_a_reference_to_an_older_content_of_a_key_is_refused(self, lake: Lake) -> None:
        old = lake.publish(recipe().key, tally(1), recipe())
        new = lake.publish(recipe().key, tally(2), recipe())
        with pytest.raises(LakeError, match="made again with another content"):
            lake.load(old)
        assert same(lake.load(new), tally(2))

    def test_a_key_that_is_not_the_recipes_is_refused(self, lake: Lake) -> None:
        with pytest.raises(InvalidInputError, match="not that of its recipe"):
            lake.publish(recipe(seed=1).key, tally(1), recipe(seed=2))
        assert lake.place.walk("") == {}

    def test_a_value_without_a_stored_form_is_refused_before_anything_is_written(self, lake: Lake) -> None:
        with pytest.raises(InvalidInputError, match="name"):
            lake.publish(recipe().key, SourceFile(name="\ud800", content=b""), recipe())
        assert lake.place.walk("") == {}

    @pytest.mark.parametrize("key", ["", "../../etc/passwd", "A" * 64, "0" * 63, "0" * 64 + "\n"])
    def test_a_malformed_key_is_refused(self, lake: Lake, key: str) -> None:
        for use in (lake.find, lake.manifest, lake.provenance):
            with pytest.raises(InvalidInputError, match="not 64"):
                use(key)  # type: ignore[operator]

    def test_provenance_stands_beside_the_manifest_and_enters_no_key(self, lake: Lake) -> None:
        one, other = recipe(seed=1), recipe(seed=2)
        first = lake.publish(one.key, tally(1), one, {"host": "here", "duration_s": 1.5})
        second = lake.publish(other.key, tally(1), other, {"host": "there"})
        assert first.digest == second.digest
        record = lake.provenance(first)
        assert record is not None
        assert (record["host"], record["duration_s"]) == ("here", 1.5)
        assert record["published_at"] < (lake.provenance(second) or {})["published_at"]
        assert lake.provenance(recipe(seed=3).key) is None

    def test_runs_are_recorded_newest_first(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, tally(1), recipe())
        lake.record_run("one", {"refs": [ref]})
        lake.record_run("two", {"refs": []})
        lake.record_run("one", {"refs": [ref], "state": "completed"})
        assert [(run["run_id"], run.get("state")) for run in lake.runs()] == [("one", "completed"), ("two", None)]
        assert lake.runs()[0]["refs"] == [{"kind": ref.kind, "key": ref.key, "digest": ref.digest}]
        lake.forget_run("one")
        assert [run["run_id"] for run in lake.runs()] == ["two"]

    @pytest.mark.parametrize("run_id", ["", "../x", "a/b", ".hidden", "x" * 101])
    def test_a_run_id_that_leaves_the_folder_is_refused(self, lake: Lake, run_id: str) -> None:
        with pytest.raises(InvalidInputError, match="run id"):
            lake.record_run(run_id, {})

    def test_a_record_without_a_json_form_is_refused(self, lake: Lake) -> None:
        with pytest.raises(InvalidInputError, match="not plain JSON"):
            lake.record_run("one", {"array": np.zeros(2)})

    def test_it_pickles_by_its_address(self, lake: Lake) -> None:
        ref = lake.publish(recipe().key, tally(1), recipe())
        again = pickle.loads(pickle.dumps(lake))
        assert again.url == lake.url
        assert again.find(ref.key) == ref

    def test_alone_can_be_taken_again(self, lake: Lake) -> None:
        for _ in range(2):
            with lake.alone(recipe().key):
                assert lake.find(recipe().key) is None

    def _mends(self, lake: Lake, ref: Ref) -> None:
        assert lake.publish(ref.key, tally(5), recipe()) == ref
        assert lake.find(ref.key) == ref
        assert same(lake.load(ref), tally(5))
        assert lake.verify() == []


def test_a_lock_keeps_threads_apart_and_leaves_no_file(tmp_path: Path) -> None:
    lake = Lake(str(tmp_path))
    inside: list[int] = []
    most: list[int] = []

    def work() -> None:
        for _ in range(20):
            with lake.alone(recipe().key):
                inside.append(1)
                most.append(len(inside))
                inside.pop()

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert max(most) == 1
    assert len(most) == 80
    assert list((tmp_path / ".locks").iterdir()) == []


def test_a_lake_creates_nothing_until_it_is_written(tmp_path: Path) -> None:
    lake = Lake(str(tmp_path / "a" / "lake"))
    assert lake.find(recipe().key) is None
    assert list(tmp_path.iterdir()) == []


def test_addresses_of_one_folder_are_one_lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    urls = {
        Lake(url).url for url in ("lake", "./x/../lake", "~/lake", str(tmp_path / "lake"), f"file://{tmp_path}/lake")
    }
    assert urls == {str(tmp_path / "lake")}


def test_a_file_is_no_lake(tmp_path: Path) -> None:
    (tmp_path / "part.stl").write_bytes(b"")
    for path in ("part.stl", "part.stl/lake"):
        with pytest.raises(InvalidInputError, match=r"part\.stl is a file; choose another path"):
            Lake(str(tmp_path / path))


@pytest.mark.parametrize(
    ("url", "fact"),
    [
        ("", "give its path"),
        ("  ", "give its path"),
        ("a\0b", "give its path"),
        ("nowhere://x/y", "Protocol not known"),
        ("memory://", "names no bucket or folder"),
        ("s3://", "names no bucket or folder"),
        ("~nobody-of-this-name/lake", "home folder"),
    ],
)
def test_an_address_that_is_none_is_refused(url: str, fact: str) -> None:
    with pytest.raises(InvalidInputError, match=fact):
        Lake(url)


@pytest.mark.skipif(importlib.util.find_spec("s3fs") is not None, reason="s3fs is installed")
def test_a_missing_s3_library_names_the_extra_to_install() -> None:
    with pytest.raises(InvalidInputError, match=r"pip install 'cellwright\[s3\]'"):
        Lake("s3://bucket/lake")


def test_loading_reads_no_pickle(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise AssertionError("something was unpickled")

    refs = [
        lake.publish(about.key, made, about) for about, made in ((recipe(seed=1), tally(1)), (recipe(seed=2), plan()))
    ]
    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    for ref in refs:
        lake.load(ref)
