"""One server a machine: started once, found again, mended after a kill, stopped."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from flows import server
from tests.flows.conftest import PROJECT


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A state folder of its own; whatever server runs from it is stopped in the end."""
    monkeypatch.setenv("CELLWRIGHT_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    yield tmp_path / "home"
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    server.stop()


def command(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "flows.command_line", "server", *arguments, "--json"],
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        stdout=subprocess.PIPE,
        text=True,
    )


def answer(process: subprocess.Popen[str]) -> Any:
    text, _ = process.communicate(timeout=200)
    assert process.returncode == 0
    return json.loads(text)


@pytest.mark.flow
def test_the_life_of_a_server(home: Path) -> None:
    assert answer(command("status"))["state"] == "stopped"
    # two starts at once yield one server
    first, second = (answer(each) for each in [command("start"), command("start")])
    assert first == second
    assert first["state"] == "running"
    pid, api_url = int(first["pid"]), str(first["api_url"])
    # the page asks the right port, and nothing phones home
    with urllib.request.urlopen(f"{first['ui_url']}/ui-settings", timeout=10) as reply:
        assert json.load(reply)["api_url"] == api_url
    with urllib.request.urlopen(f"{api_url}/admin/settings", timeout=10) as reply:
        assert json.load(reply)["server"]["analytics_enabled"] is False
    # kill -9 is noticed; a port that somebody else has taken since is left to them
    os.kill(pid, signal.SIGKILL)
    deadline = time.monotonic() + 20
    while server.status().state != "stopped":
        assert time.monotonic() < deadline
        time.sleep(0.05)
    said: list[str] = []
    with socket.create_server((server.HOST, int(urllib.parse.urlsplit(api_url).port or 0))):
        again = server.start(said.append)
    assert again.state == "running"
    assert again.api_url != api_url
    assert again.pid != pid
    assert said, "whoever waits is told why"
    # found, not started
    assert server.start(said.append) == again
    assert len(said) == 1
    assert answer(command("stop")) == {"stopped": True}
    assert answer(command("stop")) == {"stopped": False}
    assert server.status().state == "stopped"


def test_the_port_of_last_time_is_taken_again_where_it_is_free() -> None:
    with socket.create_server((server.HOST, 0)) as taken:
        port = taken.getsockname()[1]
        assert server._free_port(port) in server.PORTS
    assert server._free_port(port) == port


def test_a_stale_record_is_nobody(home: Path) -> None:
    home.mkdir()
    (home / "server.json").write_text(json.dumps({"pid": os.getpid(), "port": 4300}))
    assert server.status().state == "stopped"
    assert server.stop() is False


@pytest.mark.parametrize("content", ["", "{", "[]", '{"pid": "x", "port": null}'])
def test_a_torn_record_is_nobody(home: Path, content: str) -> None:
    home.mkdir()
    (home / "server.json").write_text(content)
    assert server.status().state == "stopped"


def test_a_given_server_is_used_and_not_stopped(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PREFECT_API_URL", "http://prefect.example:4200/api/")
    known = server.start(lambda line: None)
    assert (known.state, known.api_url) == ("external", "http://prefect.example:4200/api")
    with pytest.raises(server.ServerError, match="was given by PREFECT_API_URL"):
        server.stop()


def test_a_given_server_that_does_not_answer_is_one_clear_error(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as closed:
        closed.bind((server.HOST, 0))
        url = f"http://{server.HOST}:{closed.getsockname()[1]}/api"
    monkeypatch.setenv("PREFECT_API_URL", url)
    with pytest.raises(server.ServerError, match=f"{url} does not answer"), server.connected(lambda line: None):
        pass


def test_a_state_folder_that_cannot_be_made_is_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("CELLWRIGHT_HOME", str(tmp_path / "file" / "home"))
    with pytest.raises(server.ServerError, match="set CELLWRIGHT_HOME"):
        server.start(lambda line: None)


def test_the_state_folder_follows_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CELLWRIGHT_HOME", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert server.state_home() == tmp_path / "cellwright"
    monkeypatch.setenv("CELLWRIGHT_HOME", str(tmp_path / "own"))
    assert server.state_home() == tmp_path / "own"


def test_a_proxy_is_not_asked_for_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PREFECT_HOME", "DO_NOT_TRACK"):
        monkeypatch.setenv(name, "mine")
    for name in ("NO_PROXY", "no_proxy"):
        monkeypatch.setenv(name, "intranet")
    server.prepare_environment()
    assert os.environ["NO_PROXY"] == "intranet,127.0.0.1,localhost"
    assert os.environ["PREFECT_HOME"] == "mine"
