"""What a user may rely on when stages run as Prefect tasks."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cellwright.errors import InfeasibleError
from schemas.references import Ref
from storage.lake import Lake
from tests.flows import small_stages as small
from tests.flows.conftest import PROJECT
from tests.flows.small_stages import calls

pytestmark = [pytest.mark.flow, pytest.mark.usefixtures("stages", "prefect_server")]


def as_flow(body: Callable[[], Any]) -> Any:
    """Run a function as a flow with our task runner."""
    from prefect import flow

    from flows.runner import task_runner

    return flow(task_runner=task_runner(), name=body.__name__)(body)()


def chain(lake_url: str, factor: float = 2.0, refresh: frozenset[str] = frozenset()) -> dict[str, bool]:
    """Run three stages, the first of which feeds both others; return which of them were cached."""
    from flows.runner import Steps

    def run() -> dict[str, bool]:
        with Steps(lake_url, refresh=refresh) as step:
            numbers = step(small.count_up, small.CountParams())
            scaled = step(small.scale, small.FactorParams(factor=factor), numbers=numbers)
            step(small.add_up, {}, parts=(numbers, scaled))
        return {record.name: record.cached for record in step.records()}

    return dict(as_flow(run))


def test_only_what_changed_is_recomputed(lake_url: str) -> None:
    assert chain(lake_url) == {"count_up": False, "scale": False, "add_up": False}
    assert chain(lake_url) == {"count_up": True, "scale": True, "add_up": True}
    assert chain(lake_url, factor=3) == {"count_up": True, "scale": False, "add_up": False}
    assert chain(lake_url, refresh=frozenset({"add_up"})) == {"count_up": True, "scale": True, "add_up": False}
    assert calls == {"count_up": 1, "scale": 2, "add_up": 3}


def test_a_run_without_prefect_finds_what_a_flow_made(lake_url: str) -> None:
    from flows.runner import Steps

    chain(lake_url)
    with Steps(lake_url, direct=True) as step:
        step(small.scale, {}, numbers=step(small.count_up, {}))
    assert all(record.cached for record in step.records())


def test_prefect_shows_each_stage_by_name_as_completed_or_cached(lake_url: str) -> None:
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import TaskRunFilter, TaskRunFilterFlowRunId
    from prefect.events.worker import EventsWorker
    from prefect.runtime import flow_run

    from flows.runner import Steps

    def run() -> Any:
        with Steps(lake_url) as step:
            numbers = step(small.count_up, {})
            step(small.scale, {}, label="first", numbers=numbers)
        return flow_run.id

    for expected in ("Completed", "Cached"):
        run_id = as_flow(run)
        EventsWorker.drain_all()
        shown: dict[str, str] = {}
        deadline = time.monotonic() + 20
        while len(shown) < 2 and time.monotonic() < deadline:  # the server writes task runs down a little later
            with get_client(sync_client=True) as client:
                runs = client.read_task_runs(
                    task_run_filter=TaskRunFilter(flow_run_id=TaskRunFilterFlowRunId(any_=[run_id]))
                )
            shown = {each.name: each.state_name for each in runs if each.state_name in ("Completed", "Cached")}
            time.sleep(0.1)
        assert shown == {"count_up": expected, "scale first": expected}


def test_the_failing_stage_raises_its_own_error_and_not_that_of_its_victim(lake_url: str) -> None:
    from flows.runner import Steps

    def run() -> None:
        with Steps(lake_url) as step:
            refused = step(small.refuse, {}, numbers=step(small.count_up, {}))
            total = step(small.add_up, {}, parts=(step(small.scale, {}, numbers=refused),))
            total.ref()

    with pytest.raises(InfeasibleError, match=r"^the sum is 3 but must be 4: add 1$"):
        as_flow(run)
    assert calls == {"count_up": 1, "refuse": 1}


def test_a_failure_nobody_asks_for_still_fails_the_run(lake_url: str) -> None:
    from flows.runner import Steps

    def run() -> None:
        with Steps(lake_url) as step:
            step(small.refuse, {}, numbers=step(small.count_up, {}))

    with pytest.raises(InfeasibleError):
        as_flow(run)


def test_a_run_that_failed_stays_failed_when_a_slower_step_ends_after_it(lake_url: str) -> None:
    from flows.runner import Steps

    slow_began = threading.Event()

    class Waiting:
        def started(self, name: str) -> None:
            if name == "wait":
                slow_began.set()
            else:
                assert name != "refuse" or slow_began.wait(20)

        def advanced(self, name: str, share: float) -> None: ...

        def finished(self, name: str, *, cached: bool, seconds: float) -> None: ...

        def failed(self, name: str) -> None: ...

    def run() -> None:
        with Steps(lake_url, run_id="slow", watcher=Waiting()) as step:
            numbers = step(small.count_up, {})
            step(small.wait, {"seconds": 1.0}, numbers=numbers)
            step(small.refuse, {}, numbers=numbers).ref()

    with pytest.raises(InfeasibleError):
        as_flow(run)
    (record,) = Lake(lake_url).runs()
    assert (record["state"], record["failed_step"]) == ("failed", "refuse")
    assert record["error"] == "the sum is 3 but must be 4: add 1"
    assert [step["name"] for step in record["steps"]] == ["count_up", "wait"], "the slow one ended after the failure"


def test_a_step_that_is_tried_again_is_not_the_one_that_failed(lake_url: str) -> None:
    from flows.runner import Steps

    def run() -> None:
        with Steps(lake_url, run_id="retried") as step:
            numbers = step(small.count_up, {})
            step(small.refuse, {}, numbers=step(small.lose, {}, numbers=numbers))

    with pytest.raises(InfeasibleError):
        as_flow(run)
    (record,) = Lake(lake_url).runs()
    assert record["failed_step"] == "refuse"


def test_a_bug_keeps_its_own_type_and_place(lake_url: str) -> None:
    from flows.runner import Steps

    def run() -> None:
        with Steps(lake_url) as step:
            step(small.crash, {}, numbers=step(small.count_up, {}))

    with pytest.raises(ZeroDivisionError, match="a bug") as caught:
        as_flow(run)
    assert caught.traceback[-1].path.name == "small_stages.py"
    assert calls["crash"] == 1


def test_a_lake_error_is_retried(lake_url: str) -> None:
    from flows.runner import Steps

    def run() -> Ref:
        with Steps(lake_url) as step:
            return step(small.lose, {}, numbers=step(small.count_up, {})).ref()

    assert as_flow(run).kind == "test-numbers"
    assert calls == {"count_up": 1, "lose": 3}


def test_steps_that_do_not_wait_for_each_other_run_side_by_side(lake_url: str) -> None:
    from flows.runner import Steps

    together = threading.Barrier(2, timeout=20)

    class Meeting:
        def started(self, name: str) -> None:
            if name.startswith("wait"):
                together.wait()

        def advanced(self, name: str, share: float) -> None: ...

        def finished(self, name: str, *, cached: bool, seconds: float) -> None: ...

        def failed(self, name: str) -> None: ...

    def run() -> None:
        with Steps(lake_url, watcher=Meeting()) as step:
            numbers = step(small.count_up, {})
            left = step(small.wait, {"addend": 1}, label="left", numbers=numbers)
            right = step(small.wait, {"addend": 2}, label="right", numbers=numbers)
            step(small.add_up, {}, parts=(left, right))

    as_flow(run)
    assert calls == {"count_up": 1, "wait": 2, "add_up": 1}


_RUN = """
import sys, tasks
from tests.flows import small_stages as small
from tests.flows.conftest import PROJECT
tasks.STAGES = small.STAGES
from flows.server import prepare_environment
prepare_environment()
from prefect import flow
from flows.runner import Steps, task_runner

@flow(task_runner=task_runner())
def run():
    with Steps(sys.argv[1]) as step:
        numbers = step(small.count_up, {"n": 4})
        step(small.scale, {}, numbers=step(small.wait, {"seconds": float(sys.argv[2])}, numbers=numbers))

run()
"""


def in_another_process(lake_url: str, seconds: float, server: str, log: Path, home: Path) -> subprocess.Popen[bytes]:
    environment = {
        **os.environ,
        "PYTHONPATH": str(PROJECT),
        "PREFECT_API_URL": server,
        "CELLWRIGHT_HOME": str(home),
        "SMALL_STAGES_LOG": str(log),
    }
    return subprocess.Popen([sys.executable, "-c", _RUN, lake_url, str(seconds)], env=environment)


def until(happened: Callable[[], bool], seconds: float = 60) -> None:
    deadline = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


def logged(log: Path) -> list[str]:
    return log.read_text().split() if log.exists() else []


def test_a_run_killed_in_the_middle_of_a_stage_is_completed_by_a_rerun(
    lake_url: str, prefect_server: str, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    victim = in_another_process(lake_url, 60, prefect_server, log, tmp_path)
    until(lambda: "wait" in logged(log))
    victim.send_signal(signal.SIGKILL)
    victim.wait()
    assert {manifest.about.stage for manifest in Lake(lake_url).manifests()} == {"count_up"}
    # the killed stage's own lock is free again: waiting for it for a minute would fail the test
    rerun = in_another_process(lake_url, 0, prefect_server, log, tmp_path)
    assert rerun.wait(timeout=60) == 0
    assert logged(log) == ["count_up", "wait", "wait", "scale"]
    assert not Lake(lake_url).verify()


def test_two_runs_at_once_compute_a_stage_once(lake_url: str, prefect_server: str, tmp_path: Path) -> None:
    log = tmp_path / "log"
    runs = [in_another_process(lake_url, 2, prefect_server, log, tmp_path) for _ in range(2)]
    assert [run.wait(timeout=120) for run in runs] == [0, 0]
    assert sorted(logged(log)) == ["count_up", "scale", "wait"]
