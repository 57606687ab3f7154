from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cellwright.errors import InvalidInputError
from schemas.references import Ref
from storage.lake import Lake
from storage.places import FileState, LocalFolder
from storage.upkeep import DAY_S, Sweep, sweep
from tests.storage.specimens import recipe, same, tally

LATER_S = 2 * DAY_S


def _publish(lake: Lake, *counts: int, inputs: dict[str, Any] | None = None, **params: Any) -> Ref:
    about = recipe("count", inputs, **params)
    return lake.publish(about.key, tally(*counts), about)


def _later(lake: Lake, dry_run: bool = False) -> set[str]:
    return set(sweep(lake, dry_run=dry_run, now_s=time.time() + LATER_S).removed)


def test_a_whole_lake_has_no_problems_and_tells_its_progress(lake: Lake) -> None:
    for number in range(4):
        _publish(lake, number, number=number)
    shares: list[float] = []
    assert lake.verify(shares.append) == []
    assert shares == [0.25, 0.5, 0.75, 1.0]


def test_verify_names_every_kind_of_damage_once(lake: Lake) -> None:
    gone, torn, flipped, whole = (_publish(lake, *range(n, 50), number=n) for n in range(4))
    shared = _publish(lake, *range(2, 50), number=99)
    assert shared.digest == flipped.digest
    path = f"data/test-tally/{gone.digest}/counts.parquet"
    lake.place.remove(path)
    for ref, damage in ((torn, lambda content: content[:-3]), (flipped, lambda content: b"X" + content[1:])):
        content = lake.place.read(f"data/test-tally/{ref.digest}/counts.parquet")
        lake.place.put(f"data/test-tally/{ref.digest}", {"counts.parquet": damage(content or b"")})
    facts = sorted(problem.fact.split(":")[0].split(" (")[0] for problem in lake.verify())
    assert len(facts) == 4  # the flipped file under both of its keys
    assert facts[:2] == ["does not match its SHA-256"] * 2
    assert "bytes, not" in facts[2]
    assert facts[3] == "is missing"
    assert same(lake.load(whole), tally(*range(3, 50)))
    assert lake.find(flipped.key) == flipped  # verify changes nothing


def test_nothing_young_is_swept(lake: Lake) -> None:
    _publish(lake, 1)
    lake.place.put("data/test-tally/" + "0" * 64, {"counts.parquet": b"orphan"})
    lake.place.put(".scratch/leftover", {"counts.parquet": b"half"})
    lake.record_run("one", {})
    before = lake.place.walk("")
    assert lake.gc(dry_run=False).removed == {}
    assert lake.place.walk("").keys() == before.keys()


def test_sweeping_younger_than_a_day_is_refused(lake: Lake) -> None:
    for age_s in (0.0, DAY_S - 1, -1.0, float("nan")):
        with pytest.raises(InvalidInputError, match="nothing younger than 86400 s"):
            lake.gc(older_than_s=age_s)


def test_old_orphans_and_scratch_are_swept_and_what_is_named_stays(lake: Lake) -> None:
    ref = _publish(lake, 1)
    orphan, scratch = "data/test-tally/" + "0" * 64, ".scratch/leftover"
    lake.place.put(orphan, {"counts.parquet": b"orphan", "more.parquet": b""})
    lake.place.put(scratch, {"counts.parquet": b"half"})
    expected = {f"{orphan}/counts.parquet", f"{orphan}/more.parquet", f"{scratch}/counts.parquet"}
    assert _later(lake, dry_run=True) == expected
    assert lake.place.state(f"{orphan}/counts.parquet") is not None  # it only said so
    report = sweep(lake, dry_run=False, now_s=time.time() + LATER_S)
    assert set(report.removed) == expected
    assert report.n_bytes == 10
    assert str(report) == "removed 3 files, 0.0 MB; 1 files of data stay"
    assert expected.isdisjoint(lake.place.walk(""))
    assert same(lake.load(ref), tally(1))
    assert _later(lake) == set()


def test_without_recorded_runs_every_manifest_stays(lake: Lake) -> None:
    ref = _publish(lake, 1)
    assert _later(lake) == set()
    assert lake.find(ref.key) == ref


def test_what_a_run_reaches_stays_with_its_whole_lineage(lake: Lake) -> None:
    source = _publish(lake, 1, name="source")
    middle = _publish(lake, 2, inputs={"source": source.digest})
    result = _publish(lake, 3, inputs={"middle": [middle.digest], "left_out": None})
    stray = _publish(lake, 4, inputs={"middle": middle.digest})
    lake.record_run("one", {"stages": [{"name": "count", "ref": result}]})
    removed = _later(lake)
    assert removed == {
        f"manifests/{stray.key[:2]}/{stray.key}.json",
        f"provenance/{stray.key[:2]}/{stray.key}.json",
        f"data/test-tally/{stray.digest}/counts.parquet",
    }
    for ref in (source, middle, result):
        assert lake.find(ref.key) == ref
    assert lake.find(stray.key) is None
    assert lake.verify() == []


def test_content_that_another_manifest_names_stays(lake: Lake) -> None:
    kept = _publish(lake, 1, number=1)
    stray = _publish(lake, 1, number=2)
    lake.record_run("one", {"ref": kept.key})
    _later(lake)
    assert lake.find(stray.key) is None
    assert same(lake.load(kept), tally(1))


def test_a_forgotten_run_keeps_nothing(lake: Lake) -> None:
    one, two = _publish(lake, 1, number=1), _publish(lake, 2, number=2)
    lake.record_run("one", {"ref": one})
    lake.record_run("two", {"ref": two})
    lake.forget_run("one")
    _later(lake)
    assert lake.find(one.key) is None
    assert lake.find(two.key) == two


def _runs(lake: Lake, *names: str) -> dict[str, Ref]:
    """Record a run for each name, the newest last, each with a result of its own."""
    made = {}
    for number, name in enumerate(names):
        made[name] = _publish(lake, number, number=number)
        lake.record_run(name, {"ref": made[name]})
    return made


def test_runs_beyond_those_to_keep_are_forgotten_with_what_only_they_used(lake: Lake) -> None:
    made = _runs(lake, "one", "two", "three")
    lake.record_run("four", {"ref": made["one"]})  # the newest run used what the oldest made
    later_s = time.time() + LATER_S
    said = sweep(lake, keep_runs=2, now_s=later_s)
    assert said.forgotten_runs == ("two", "one")
    assert str(said).startswith("would forget 2 runs, would remove ")
    assert len(lake.runs()) == 4  # it only said so
    assert same(lake.load(made["two"]), tally(1))
    done = sweep(lake, dry_run=False, keep_runs=2, now_s=later_s)
    assert (done.removed, done.forgotten_runs, done.kept_files) == (said.removed, ("two", "one"), 2)
    assert str(done).startswith("forgot 2 runs, removed ")
    assert [run["run_id"] for run in lake.runs()] == ["four", "three"]
    assert lake.find(made["two"].key) is None
    assert lake.place.walk(f"data/test-tally/{made['two'].digest}") == {}
    assert same(lake.load(made["three"]), tally(2))
    assert same(lake.load(made["one"]), tally(0))
    assert lake.verify() == []
    assert sweep(lake, keep_runs=2, now_s=later_s).removed == {}


def test_no_run_younger_than_a_day_is_forgotten(lake: Lake) -> None:
    _runs(lake, "one", "two", "three")
    swept = lake.gc(dry_run=False, keep_runs=1)
    assert (swept.removed, swept.forgotten_runs) == ({}, ())
    assert len(lake.runs()) == 3


@pytest.mark.parametrize("keep_runs", [0, -1])
def test_forgetting_every_run_is_refused(lake: Lake, keep_runs: int) -> None:
    with pytest.raises(InvalidInputError, match="at least 1 must stay"):
        lake.gc(keep_runs=keep_runs)


def test_no_result_is_swept_while_a_run_cannot_be_understood(lake: Lake) -> None:
    made = _runs(lake, "one", "two")
    lake.place.put("runs", {"one.json": b"{"})
    swept = sweep(lake, dry_run=False, now_s=time.time() + LATER_S)
    assert swept.removed == {}
    assert "no result was taken because a run's record is unreadable" in str(swept)
    assert lake.place.address("runs/one.json") in str(swept)
    assert lake.find(made["one"].key) == made["one"]


def _make_old(lake: Lake) -> None:
    if not isinstance(lake.place, LocalFolder):
        pytest.skip("objects have no time that can be set")
    for path in lake.place.walk(""):
        os.utime(lake.place.address(path), (0, 0))


class TestWhatIsUsedDuringASweep:
    """Ages are taken when files are listed; a run may find or publish something before it goes."""

    def sweep_while(self, lake: Lake, patch: pytest.MonkeyPatch, folder: str, use: Callable[[], object]) -> Sweep:
        """Make everything old, sweep, and do something right after a folder was listed for the first time."""
        _make_old(lake)
        place, walk = lake.place, lake.place.walk
        listed: list[str] = []

        def walking(wanted: str) -> dict[str, FileState]:
            found = walk(wanted)
            if wanted == folder and not listed:
                listed.append(folder)
                use()
            return found

        patch.setattr(place, "walk", walking)
        swept = lake.gc(dry_run=False, keep_runs=1)
        assert listed
        return swept

    def test_a_result_that_is_found_stays_with_its_data(self, lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
        made = _runs(lake, "one", "two")
        swept = self.sweep_while(lake, monkeypatch, "manifests", lambda: lake.find(made["one"].key))
        assert swept.removed.keys() == {"runs/one.json"}
        assert same(lake.load(made["one"]), tally(0))

    def test_data_that_is_published_again_stays(self, lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
        made = _runs(lake, "one", "two")
        lake.place.remove(f"manifests/{made['one'].key[:2]}/{made['one'].key}.json")
        self.sweep_while(lake, monkeypatch, "data", lambda: _publish(lake, 0, number=0))
        assert same(lake.load(made["one"]), tally(0))

    def test_data_that_is_about_to_be_named_stays(self, lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
        made = _runs(lake, "one", "two")
        lake.place.remove(f"manifests/{made['one'].key[:2]}/{made['one'].key}.json")
        data = f"data/test-tally/{made['one'].digest}/counts.parquet"
        swept = self.sweep_while(lake, monkeypatch, "data", lambda: lake.place.touch(data))
        assert data not in swept.removed
        assert lake.place.state(data) is not None

    def test_a_run_that_is_recorded_again_keeps_what_it_used(self, lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
        made = _runs(lake, "one", "two")
        _make_old(lake)
        recorded = lake.runs()

        def recording() -> list[dict[str, Any]]:
            monkeypatch.setattr(lake, "runs", runs)
            lake.record_run("one", {"ref": made["one"]})
            return recorded  # as they were before

        runs = lake.runs
        monkeypatch.setattr(lake, "runs", recording)
        swept = lake.gc(dry_run=False, keep_runs=1)
        assert swept.forgotten_runs == ()
        assert "manifests" not in "".join(swept.removed)
        assert same(lake.load(made["one"]), tally(0))


def test_no_data_is_swept_while_a_manifest_cannot_be_understood(lake: Lake) -> None:
    ref = _publish(lake, 1)
    lake.place.put(f"manifests/{ref.key[:2]}", {f"{ref.key}.json": b"{"})
    report = sweep(lake, dry_run=False, now_s=time.time() + LATER_S)
    assert report.removed == {}
    assert "no data was taken because a manifest is unreadable" in str(report)
    assert lake.place.state(f"data/test-tally/{ref.digest}/counts.parquet") is not None


def test_finding_an_artefact_keeps_it_young_where_files_have_times(lake: Lake) -> None:
    ref = _publish(lake, 1)
    lake.record_run("other", {})
    path = f"manifests/{ref.key[:2]}/{ref.key}.json"
    if not isinstance(lake.place, LocalFolder):
        pytest.skip("objects have no time that can be set")
    os.utime(lake.place.address(path), (0, 0))
    assert path in lake.gc().removed
    assert lake.find(ref.key) == ref
    assert path not in lake.gc().removed


class TestThingsInTheWay:
    """Files where a lake has folders, and folders where it has files: on disks only, stores have no folders."""

    @pytest.fixture
    def root(self, tmp_path: Path) -> Path:
        return tmp_path / "lake"

    @pytest.mark.parametrize(
        "where", ["data", "data/test-tally", "data/test-tally/{digest}", "manifests", "provenance"]
    )
    def test_a_file_in_the_place_of_a_folder_is_named_and_the_next_run_mends_it(self, root: Path, where: str) -> None:
        lake = Lake(str(root))
        ref = _publish(lake, 1, 2)
        path = root / where.format(digest=ref.digest)
        shutil.rmtree(path)
        path.write_bytes(b"in the way")
        assert (str(path), "is a file where a folder belongs") in _told(lake)
        if where != "provenance":
            assert lake.find(ref.key) is None
        assert same(lake.load(_publish(lake, 1, 2)), tally(1, 2))
        assert lake.verify() == []
        assert [file.read_bytes() for file in (root / "damaged").iterdir()] == [b"in the way"]

    def test_folders_in_the_place_of_files_are_named_and_the_next_run_mends_them(self, root: Path) -> None:
        lake = Lake(str(root))
        ref = _publish(lake, 1, 2)
        paths = [
            root / f"manifests/{ref.key[:2]}/{ref.key}.json",
            root / f"data/test-tally/{ref.digest}/counts.parquet",
        ]
        for path in paths:
            path.unlink()
            (path / "inside").mkdir(parents=True)
        assert {(str(path), "is a folder where a file belongs") for path in paths} <= _told(lake)
        assert lake.find(ref.key) is None
        assert same(lake.load(_publish(lake, 1, 2)), tally(1, 2))
        assert lake.verify() == []

    @pytest.mark.parametrize("name", ["manifests", "runs", ".scratch", ".locks", "damaged"])
    def test_repair_sets_aside_what_is_in_the_way(self, root: Path, name: str) -> None:
        lake = Lake(str(root))
        _publish(lake, 1, 2)
        shutil.rmtree(root / name, ignore_errors=True)
        (root / name).write_bytes(b"in the way")
        assert lake.repair(lake.verify()) == []
        assert lake.verify() == []
        ref = _publish(lake, 1, 2)
        assert lake.find(ref.key) == ref


def _told(lake: Lake) -> set[tuple[str, str]]:
    return {(problem.address, problem.fact.split(":")[0]) for problem in lake.verify()}


def test_repair_sets_aside_every_manifest_of_a_damaged_content(lake: Lake) -> None:
    first, second, whole = _publish(lake, 1, 2, number=1), _publish(lake, 1, 2, number=2), _publish(lake, 3)
    folder = f"data/test-tally/{first.digest}"
    content = lake.place.read(f"{folder}/counts.parquet") or b""
    lake.place.put(folder, {"counts.parquet": b"X" + content[1:]})
    problems = lake.verify()
    assert len(problems) == 2
    assert lake.repair(problems) == []
    assert [lake.find(ref.key) for ref in (first, second, whole)] == [None, None, whole]
    assert lake.verify() == []
    assert same(lake.load(_publish(lake, 1, 2, number=1)), tally(1, 2))
