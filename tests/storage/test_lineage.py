from __future__ import annotations

import time

import pytest

from cellwright.errors import InvalidInputError, LakeError
from schemas.references import Ref
from schemas.sources import SourceFile
from storage import lineage
from storage.lake import Lake
from tests.storage.specimens import recipe, tally


@pytest.fixture
def chain(lake: Lake) -> dict[str, Ref]:
    """A source, two results of it, and one that joins them and the source."""
    refs: dict[str, Ref] = {}
    about = recipe("read_source")
    refs["source"] = lake.publish(about.key, SourceFile(name="a", content=b"a"), about)
    for name in ("left", "right"):
        about = recipe(name, {"file": refs["source"].digest})
        refs[name] = lake.publish(about.key, tally(len(name)), about)
    about = recipe("join", {"both": [refs["left"].digest, refs["right"].digest], "file": refs["source"].digest})
    refs["join"] = lake.publish(about.key, tally(0, 0), about)
    return refs


def test_lineage_goes_back_to_the_source_files(lake: Lake, chain: dict[str, Ref]) -> None:
    lines = lake.lineage(chain["join"])
    assert [(line.depth, line.name, line.digest) for line in lines] == [
        (0, "", chain["join"].digest),
        (1, "both[0]", chain["left"].digest),
        (2, "file", chain["source"].digest),
        (1, "both[1]", chain["right"].digest),
        (2, "file", chain["source"].digest),
        (1, "file", chain["source"].digest),
    ]
    assert [line.manifest.about.stage for line in lines if line.manifest is not None][:3] == [
        "join",
        "left",
        "read_source",
    ]


def test_inputs_of_a_shared_ancestor_are_listed_once(lake: Lake, chain: dict[str, Ref]) -> None:
    about = recipe("twice", {"a": chain["left"].digest, "b": chain["left"].digest})
    ref = lake.publish(about.key, tally(9), about)
    assert [line.name for line in lake.lineage(ref)] == ["", "a", "file", "b"]


def test_a_lost_ancestor_is_listed_as_lost(lake: Lake, chain: dict[str, Ref]) -> None:
    lake.place.remove(f"manifests/{chain['left'].key[:2]}/{chain['left'].key}.json")
    lost = [line for line in lake.lineage(chain["join"]) if line.manifest is None]
    assert [(line.name, line.digest) for line in lost] == [("both[0]", chain["left"].digest)]
    with pytest.raises(LakeError, match="is not in the lake"):
        lake.lineage(chain["left"])


def test_an_artefact_is_found_by_what_a_person_writes(lake: Lake, chain: dict[str, Ref]) -> None:
    ref = chain["left"]
    for text in (ref.digest, ref.digest[:8], ref.key, ref.key[:8], str(ref), f"test-tally/{ref.digest[:6]}"):
        assert lake.resolve(text) == ref
    assert lake.resolve("source-file") == chain["source"]


def test_a_kind_means_its_newest_artefact(lake: Lake, chain: dict[str, Ref]) -> None:
    assert lake.resolve("test-tally") == chain["join"]
    time.sleep(0.002)
    about = recipe("right", {"file": chain["source"].digest})
    assert lake.resolve("test-tally") != lake.publish(about.key, tally(5), about)
    time.sleep(0.002)
    assert lake.publish(about.key, tally(5), about) == lake.resolve("test-tally")


def test_of_two_recipes_with_one_result_the_newest_answers(lake: Lake, chain: dict[str, Ref]) -> None:
    time.sleep(0.002)
    about = recipe("left_again", {"file": chain["source"].digest})
    again = lake.publish(about.key, tally(len("left")), about)
    assert again.digest == chain["left"].digest
    assert lake.resolve(again.digest[:12]) == again
    assert lake.resolve(chain["left"].key[:12]) == chain["left"]
    assert lake.lineage(chain["join"])[1].manifest == lake.manifest(again)


def test_what_means_nothing_or_several_things_is_told(lake: Lake, chain: dict[str, Ref]) -> None:
    for text, fact in (
        ("scource-file", r"did you mean source-file\? kinds in the lake: source-file, test-tally"),
        ("trajectory", "no artefact 'trajectory' in .*: kinds in the lake: source-file, test-tally"),
        ("source-file/0000", "no artefact"),
        ("zzzz", "kinds in the lake: source-file, test-tally"),
        (chain["left"].digest[:2], "too short"),
        ("", "too short"),
        (f"source-file/{chain['left'].digest[:8]}", "no artefact"),
    ):
        with pytest.raises(InvalidInputError, match=fact):
            lake.resolve(text)


def test_a_prefix_of_several_artefacts_lists_them(lake: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lineage, "_SHORTEST_PREFIX", 1)
    refs = [lake.publish(recipe(n=n).key, tally(n), recipe(n=n)) for n in range(17)]  # two share a first digit
    digits = [ref.digest[0] for ref in refs]
    shared = max(digits, key=digits.count)
    with pytest.raises(InvalidInputError, match=r"means several artefacts: test-tally/.* give more digits"):
        lake.resolve(shared)


def test_an_empty_lake_says_so(lake: Lake) -> None:
    with pytest.raises(InvalidInputError, match="there is no lake at"):
        lake.resolve("viewpoints")
