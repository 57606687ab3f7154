"""A run is on record from its first moment, however it ends, and what it computed stays while its record does."""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from cellwright.errors import InfeasibleError
from flows import command_line
from flows.execution import Outcome
from flows.run_record import RunRecord, state_of
from flows.runner import Steps
from schemas.references import Ref
from storage.lake import Lake
from storage.upkeep import DAY_S, sweep
from tests.flows import small_stages as small
from tests.flows.conftest import PROJECT

pytestmark = pytest.mark.usefixtures("stages")


def swept_tomorrow(lake: Lake, keep_runs: int | None = None) -> None:
    sweep(lake, dry_run=False, keep_runs=keep_runs, now_s=time.time() + 2 * DAY_S)


def test_a_finished_run_names_what_it_used(lake_url: str) -> None:
    with Steps(lake_url, direct=True, run_id="run-1", facts={"flow": "chain"}) as step:
        numbers = step(small.count_up, {})
        step(small.add_up, {}, parts=(numbers, step(small.scale, {}, numbers=numbers)))
    (record,) = Lake(lake_url).runs()
    assert (record["flow"], record["state"], state_of(record)) == ("chain", "finished", "finished")
    assert [each["name"] for each in record["steps"]] == ["count_up", "scale", "add_up"]
    assert record["steps"][2]["digest"] == step.records()[2].ref.digest


def test_a_failed_run_says_why_and_keeps_what_it_had(lake_url: str) -> None:
    with pytest.raises(InfeasibleError), Steps(lake_url, direct=True, run_id="run-1") as step:
        numbers = step(small.count_up, {})
        step(small.refuse, {}, numbers=numbers)
    lake = Lake(lake_url)
    (record,) = lake.runs()
    assert (record["state"], record["error"]) == ("failed", "the sum is 3 but must be 4: add 1")
    assert [each["name"] for each in record["steps"]] == ["count_up"]
    swept_tomorrow(lake)
    assert lake.find(numbers.ref().key) is not None


def test_what_the_lake_had_already_is_on_the_record_of_a_failed_run_too(lake_url: str) -> None:
    for run_id in ("first", "second"):
        with pytest.raises(InfeasibleError), Steps(lake_url, direct=True, run_id=run_id) as step:
            step(small.refuse, {}, numbers=step(small.scale, {}, numbers=step(small.count_up, {})))
    lake = Lake(lake_url)
    assert [len(record["steps"]) for record in lake.runs()] == [2, 2]


def test_a_bug_is_on_the_record_as_a_failure_and_ctrl_c_as_an_interruption(lake_url: str) -> None:
    for run_id, error in (("bug", ZeroDivisionError("a bug")), ("stopped", KeyboardInterrupt())):
        with pytest.raises(type(error)), Steps(lake_url, direct=True, run_id=run_id):
            raise error
    records = {record["run_id"]: record for record in Lake(lake_url).runs()}
    assert (records["bug"]["state"], records["bug"]["error"]) == ("failed", "ZeroDivisionError: a bug")
    assert (records["stopped"]["state"], "error" in records["stopped"]) == ("interrupted", False)


def test_a_step_that_ends_after_the_run_failed_joins_it_and_leaves_it_failed(lake_url: str) -> None:
    lake = Lake(lake_url)
    for run_id, error in (("failed", InfeasibleError("no way")), ("interrupted", KeyboardInterrupt())):
        record = RunRecord(lake, run_id, {})
        record.begin()
        record.fail(error, "refuse")
        record.add("wait", small.wait, Outcome(Ref("test-numbers", "0" * 64, "1" * 64), cached=False, seconds=1.0))
        (written,) = [each for each in lake.runs() if each["run_id"] == run_id]
        assert (written["state"], [step["name"] for step in written["steps"]]) == (run_id, ["wait"])
        if run_id == "failed":
            assert (written["error"], written["failed_step"]) == ("no way", "refuse")


def test_the_failed_step_is_the_one_whose_error_surfaced_and_none_that_recovered(lake_url: str) -> None:
    with pytest.raises(InfeasibleError), Steps(lake_url, direct=True, run_id="run-1") as step:
        numbers = step(small.count_up, {})
        step(small.refuse, {}, numbers=step(small.lose, {}, numbers=numbers))  # `lose` fails twice before
    with pytest.raises(ZeroDivisionError), Steps(lake_url, direct=True, run_id="run-2") as step:
        step(small.lose, {}, numbers=step(small.count_up, {}))
        raise ZeroDivisionError("of no step")
    records = {record["run_id"]: record for record in Lake(lake_url).runs()}
    assert (records["run-1"]["failed_step"], records["run-2"]["failed_step"]) == ("refuse", "")


def test_a_run_without_a_name_leaves_no_record(lake_url: str) -> None:
    with Steps(lake_url, direct=True) as step:
        step(small.count_up, {})
    assert Lake(lake_url).runs() == []


_CHAIN = """
    import tasks
    from flows.runner import Steps
    from tests.flows import small_stages as small
    tasks.STAGES = small.STAGES
    with Steps({lake!r}, direct=True, run_id="killed", facts={{"cell": "bracket"}}) as step:
        scaled = step(small.scale, {{"factor": 3}}, numbers=step(small.count_up, {{}}))
        step(small.wait, {{"seconds": 60}}, numbers=scaled)
"""


def test_a_killed_run_keeps_what_it_computed_and_a_rerun_goes_on_from_there(
    lake_url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Steps(lake_url, direct=True, run_id="other") as step:  # so that results of no run are swept at all
        step(small.count_up, {"n": 9})
    log = tmp_path / "log"
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(_CHAIN.format(lake=lake_url))],
        env={**os.environ, "PYTHONPATH": str(PROJECT), "SMALL_STAGES_LOG": str(log)},
    )
    deadline = time.monotonic() + 60
    while not (log.exists() and "wait" in log.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert state_of(Lake(lake_url).runs()[0]) == "running"
    process.send_signal(signal.SIGKILL)
    process.wait()
    lake = Lake(lake_url)
    assert command_line.main(["lake", "runs", "--lake", lake_url, "--json"]) == 0
    shown = {run["run_id"]: run for run in json.loads(capsys.readouterr().out)}
    assert {name: run["state"] for name, run in shown.items()} == {"other": "finished", "killed": "interrupted"}
    assert [each["name"] for each in shown["killed"]["steps"]] == ["count_up", "scale"]
    assert command_line.main(["lake", "runs", "--lake", lake_url]) == 0
    assert "bracket" in capsys.readouterr().out
    swept_tomorrow(lake)
    assert lake.verify() == []
    with Steps(lake_url, direct=True, run_id="rerun") as step:
        scaled = step(small.scale, {"factor": 3}, numbers=step(small.count_up, {}))
        step(small.wait, {"seconds": 0}, numbers=scaled)
    assert [record.cached for record in step.records()] == [True, True, False]


def test_what_was_published_right_before_the_kill_is_kept_by_who_made_it(lake_url: str) -> None:
    lake = Lake(lake_url)
    with Steps(lake_url, direct=True, run_id="one") as step:
        made = step(small.count_up, {}).ref()
    lake.record_run("one", {"state": "running", "steps": []})  # the stage's own line was not written any more
    swept_tomorrow(lake)
    assert lake.find(made.key) == made


def test_runs_that_did_not_finish_push_no_finished_one_out(lake_url: str) -> None:
    lake = Lake(lake_url)
    for number in range(5):
        lake.record_run(f"finished-{number}", {"state": "finished"})
    for number in range(5):
        lake.record_run(f"failed-{number}", {"state": "failed" if number % 2 else "running"})
    swept_tomorrow(lake, keep_runs=2)
    assert [run["run_id"] for run in lake.runs()] == ["failed-4", "failed-3", "finished-4", "finished-3"]


def test_a_process_that_got_the_number_of_a_killed_one_does_not_stand_for_it() -> None:
    ours = {"state": "running", "host": platform.node(), "process": os.getpid()}
    assert state_of({**ours, "process_started": "1"}) == "interrupted"
    assert state_of({**ours, "process": "x"}) == "interrupted"
    assert state_of({**ours, "host": "elsewhere"}) == "running"
    assert state_of({}) == "finished"
