"""Ctrl-C: the command stops within two seconds, says so once, and leaves a whole lake."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from storage.lake import Lake
from tests.flows.conftest import PROJECT


def test_an_interrupt_ends_cleanly_with_130() -> None:
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, threading, time\n"
            "import flows.examples\n"
            "from flows import command_line\n"
            "threading.Thread(target=time.sleep, args=(60,)).start()\n"  # a stage that cannot be stopped
            "def wait():\n"
            "    print('ready', flush=True)\n"
            "    time.sleep(60)\n"
            "flows.examples.examples = wait\n"
            "sys.exit(command_line.main(['examples']))\n",
        ],
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "interrupted: what was finished is in the lake" in errors
    assert "Traceback" not in errors


BUSY = """
import hashlib, sys
import flows.examples
from flows import command_line

def busy():
    print("ready", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2_000_000_000)  # minutes in one compiled call

flows.examples.examples = busy
sys.exit(command_line.main(["examples"]))
"""


@pytest.mark.parametrize("presses", [1, 2])
def test_a_kernel_that_hears_of_no_signal_does_not_keep_the_command(presses: int) -> None:
    environment = {**os.environ, "PYTHONPATH": str(PROJECT)}
    command = [sys.executable, "-c", BUSY]
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.2)  # so that it is inside the call
        pressed = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.stderr.readline() == "\n"
        assert "press Ctrl-C again" in process.stderr.readline()
        if presses == 2:
            process.send_signal(signal.SIGINT)
        said = process.stderr.read()
        assert process.wait(timeout=20) == 130
        assert time.monotonic() - pressed < 3.0
    assert said.count("interrupted: ") == (1 if presses == 1 else 0)


@pytest.mark.flow
def test_an_interrupt_stops_a_flow_in_the_middle_of_a_stage(tmp_path: Path, lake_url: str, prefect_server: str) -> None:
    code = f"""
        import sys, types
        import tasks
        from flows import command_line
        from tests.flows import small_stages as small
        tasks.STAGES = small.STAGES

        def run(path, *, lake, watcher, **ignored):
            from prefect import flow
            from flows.runner import Steps, task_runner

            def plan():
                with Steps(lake, watcher=watcher) as step:
                    step(small.wait, {{"seconds": 60}}, numbers=step(small.count_up, {{}}))

            flow(task_runner=task_runner())(plan)()

        sys.modules["flows.study"] = types.SimpleNamespace(run=run)
        sys.exit(command_line.main(["sweep", "study.yaml", "--lake", {lake_url!r}]))
    """
    log = tmp_path / "log"
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={
            **os.environ,
            "PYTHONPATH": str(PROJECT),
            "PREFECT_API_URL": prefect_server,
            "CELLWRIGHT_HOME": str(tmp_path / "home"),
            "SMALL_STAGES_LOG": str(log),
        },
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60
    while not (log.exists() and "wait" in log.read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "count_up: " in errors
    assert "interrupted: what was finished is in the lake" in errors
    assert [manifest.about.stage for manifest in Lake(lake_url).manifests()] == ["count_up"]
