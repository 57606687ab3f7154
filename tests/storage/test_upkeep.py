from __future__ import annotations

import os
import time
from typing import Any

import pytest

from cellwright.errors import InvalidInputError
from schemas.references import Ref
from storage.lake import Lake
from storage.places import LocalFolder
from storage.upkeep import DAY_S, sweep
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
