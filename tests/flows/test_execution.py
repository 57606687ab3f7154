"""The caching logic itself: plain calls, no Prefect."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from cellwright.errors import InfeasibleError, InvalidInputError, LakeError
from flows import execution
from flows.runner import Steps
from schemas.references import Ref
from storage.lake import Lake
from tests.flows import small_stages as small
from tests.flows.small_stages import calls

pytestmark = pytest.mark.usefixtures("stages")


def chain(lake_url: str, *, n: float = 3, factor: float = 2.0, note: str = "", **options: object) -> Steps:
    with Steps(lake_url, direct=True, **options) as step:  # type: ignore[arg-type]
        numbers = step(small.count_up, {"n": n})
        scaled = step(small.scale, small.FactorParams(factor=factor, note=note), numbers=numbers)
        step(small.add_up, {}, parts=(numbers, scaled), extra=None)
    return step


def states(step: Steps) -> dict[str, str]:
    return {record.name: "cached" if record.cached else "computed" for record in step.records()}


def test_a_second_run_computes_nothing(lake_url: str) -> None:
    first, second = chain(lake_url), chain(lake_url)
    assert set(states(first).values()) == {"computed"}
    assert set(states(second).values()) == {"cached"}
    assert [record.ref for record in first.records()] == [record.ref for record in second.records()]
    assert calls == {"count_up": 1, "scale": 1, "add_up": 1}


def test_only_what_changed_is_recomputed(lake_url: str) -> None:
    chain(lake_url)
    assert states(chain(lake_url, factor=3)) == {"count_up": "cached", "scale": "computed", "add_up": "computed"}


def test_the_same_result_of_other_inputs_stops_the_recomputation(lake_url: str) -> None:
    for n in (5, 2):  # the sums 10 and 1
        with Steps(lake_url, direct=True) as step:
            odd = step(small.parity, {}, numbers=step(small.count_up, {"n": n}))
            step(small.scale, {}, numbers=odd)
    assert calls == {"count_up": 2, "parity": 2, "scale": 2}
    with Steps(lake_url, direct=True) as step:
        odd = step(small.parity, {}, numbers=step(small.count_up, {"n": 6}))  # the sum 15, odd like 1
        step(small.scale, {}, numbers=odd)
    assert calls == {"count_up": 3, "parity": 3, "scale": 2}


@pytest.mark.parametrize("same", ["3", 3, 3.0])
def test_parameters_are_checked_before_they_are_keyed(lake_url: str, same: object) -> None:
    chain(lake_url, n=3)
    with Steps(lake_url, direct=True) as step:
        step(small.count_up, {"n": same})
    assert states(step) == {"count_up": "cached"}


def test_an_unkeyed_parameter_changes_nothing(lake_url: str) -> None:
    chain(lake_url, note="one")
    assert states(chain(lake_url, note="another"))["scale"] == "cached"


def test_a_refreshed_stage_is_computed_again_and_the_rest_is_found(lake_url: str) -> None:
    chain(lake_url)
    again = chain(lake_url, refresh={"scale"})
    assert states(again) == {"count_up": "cached", "scale": "computed", "add_up": "cached"}


def test_refreshing_an_unknown_stage_is_refused_with_the_likely_one(lake_url: str) -> None:
    with pytest.raises(InvalidInputError, match="no stage 'scal': did you mean 'scale'"):
        Steps(lake_url, refresh={"scal"})


def test_bad_parameters_name_the_field_and_the_value(lake_url: str) -> None:
    with Steps(lake_url, direct=True) as step:
        with pytest.raises(InvalidInputError, match=r"parameters of count_up: n: .*greater than or equal to 1.*0\.5"):
            step(small.count_up, {"n": 0.5})
        with pytest.raises(InvalidInputError, match="m: Extra inputs"):
            step(small.count_up, {"m": 1})


def test_a_flow_that_hands_over_the_wrong_input_is_told_at_once(lake_url: str) -> None:
    with Steps(lake_url, direct=True) as step:
        total = step(small.add_up, {}, parts=(step(small.count_up, {}),))
        with pytest.raises(TypeError, match="input 'numbers' of scale is a test-numbers, not a test-total"):
            step(small.scale, {}, numbers=total)
        with pytest.raises(TypeError, match="scale has no input mesh"):
            step(small.scale, {}, mesh=total)
        with pytest.raises(TypeError, match="scale needs the input 'numbers'"):
            step(small.scale, {})
        with pytest.raises(TypeError, match="add_up takes several as input 'parts'"):
            step(small.add_up, {}, parts=step(small.count_up, {}))


def test_an_optional_input_given_and_left_out_are_two_results(lake_url: str) -> None:
    with Steps(lake_url, direct=True) as step:
        numbers = step(small.count_up, {})
        without = step(small.add_up, {}, parts=(numbers,))
        given = step(small.add_up, {}, parts=(numbers,), extra=numbers)
    assert without.ref() != given.ref()
    assert [record.name for record in step.records()] == ["count_up", "add_up", "add_up 2"]


def test_a_stage_that_returns_something_else_publishes_nothing(lake_url: str) -> None:
    with Steps(lake_url, direct=True) as step:
        numbers = step(small.count_up, {})
        with pytest.raises(TypeError, match="stage lie returned a Numbers, not a Total"):
            step(small.lie, {}, numbers=numbers)
    assert {manifest.kind for manifest in Lake(lake_url).manifests()} == {"test-numbers"}


def test_the_error_of_the_stage_surfaces_and_is_not_retried(lake_url: str) -> None:
    with Steps(lake_url, direct=True) as step, pytest.raises(InfeasibleError, match="the sum is 3"):
        step(small.refuse, {}, numbers=step(small.count_up, {}))
    assert calls["refuse"] == 1


def test_a_lake_error_is_tried_again(lake_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "RETRY_DELAY_S", 0.0)
    with Steps(lake_url, direct=True) as step:
        step(small.lose, {}, numbers=step(small.count_up, {}))
    assert calls["lose"] == 3


def test_a_lake_error_that_stays_is_final(lake_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "RETRY_DELAY_S", 0.0)
    with Steps(lake_url, direct=True) as step:
        numbers = step(small.count_up, {})
        calls["lose"] = -10
        with pytest.raises(LakeError, match="went away"):
            step(small.lose, {}, numbers=numbers)
    assert calls["lose"] == -10 + 1 + execution.RETRIES


def test_a_damaged_artefact_is_one_error_and_a_rerun_mends_it(lake_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "RETRY_DELAY_S", 0.0)
    first = chain(lake_url)
    lake = Lake(lake_url)
    for path in map(Path, lake.paths(first.records()[0].ref).values()):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 0xFF
        path.chmod(0o644)
        path.write_bytes(content)
    with pytest.raises(LakeError, match="damaged"):
        chain(lake_url, factor=5)
    assert states(chain(lake_url, factor=5)) == {"count_up": "computed", "scale": "computed", "add_up": "computed"}
    assert not lake.verify()


def test_two_runs_at_once_compute_a_key_once(lake_url: str) -> None:
    barrier = threading.Barrier(2)

    def run() -> Ref:
        barrier.wait()
        with Steps(lake_url, direct=True) as step:
            return step(small.wait, {"seconds": 0.2}, numbers=step(small.count_up, {})).ref()

    with ThreadPoolExecutor(2) as pool:
        first, second = (future.result() for future in [pool.submit(run), pool.submit(run)])
    assert first == second
    assert calls == {"count_up": 1, "wait": 1}


def test_what_happens_is_reported_in_order(lake_url: str) -> None:
    events: list[tuple[object, ...]] = []

    class Listener:
        def started(self, name: str) -> None:
            events.append(("started", name))

        def advanced(self, name: str, share: float) -> None:
            events.append(("advanced", name, share))

        def finished(self, name: str, *, cached: bool, seconds: float) -> None:
            events.append(("finished", name, cached))

        def failed(self, name: str) -> None:
            events.append(("failed", name))

    for _ in range(2):
        with Steps(lake_url, direct=True, watcher=Listener()) as step:
            step(small.wait, {}, label="twice", numbers=step(small.count_up, {}))
    with pytest.raises(InfeasibleError), Steps(lake_url, direct=True, watcher=Listener()) as step:
        step(small.refuse, {}, numbers=step(small.count_up, {}))
    assert events == [
        ("started", "count_up"),
        ("finished", "count_up", False),
        ("started", "wait twice"),
        ("advanced", "wait twice", 0.0),
        ("advanced", "wait twice", 1.0),
        ("finished", "wait twice", False),
        ("finished", "count_up", True),
        ("finished", "wait twice", True),
        ("finished", "count_up", True),
        ("started", "refuse"),
        ("failed", "refuse"),
    ]


def test_how_long_a_stage_took_and_where_stands_beside_it_not_in_it(lake_url: str) -> None:
    ref = chain(lake_url).records()[0].ref
    made = Lake(lake_url).provenance(ref)
    assert made is not None
    assert made["seconds"] >= 0
    assert made["host"]


def test_the_versions_that_made_a_result_stand_beside_it(lake_url: str) -> None:
    made = Lake(lake_url).provenance(chain(lake_url).records()[0].ref)
    assert made is not None
    assert made["versions"].keys() == {
        "python", "cellwright", "numpy", "scipy", "numba", "pinocchio", "coal", "python-fcl", "highspy", "open3d",
        "casadi",
    }  # fmt: skip
    assert made["versions"]["numpy"] == np.__version__
    assert "unknown" not in made["versions"].values()
