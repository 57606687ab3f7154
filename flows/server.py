"""The one Prefect server of this machine: used if given, else started once, found again, and stopped on request.

``PREFECT_API_URL`` decides if it is set. Otherwise a local server runs detached, with its database, settings and log
in cellwright's own state folder, on a port that is chosen free and kept. The server process holds a kernel lock on
a file for as long as it lives, so that "is it alive" has an exact answer: also after ``kill -9``, after a reboot,
and when its process number has long been given to somebody else. Two starts at once yield one server.

Nothing is sent to the internet: analytics of server and client are switched off. POSIX only.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from cellwright.errors import CellwrightError

HOST = "127.0.0.1"
PORTS = range(4300, 4400)
"""Where a free port is looked for: below the range that systems hand out to outgoing connections."""

START_PATIENCE_S = 120.0
"""A fresh database takes 10 s on a quiet machine and several times that on a loaded one."""

ANSWER_PATIENCE_S = 30.0
"""A living server that does not answer for so long is taken for stuck and is replaced."""

STOP_PATIENCE_S = 10.0

Say = Callable[[str], None]
"""Takes one line for the person who waits."""


class ServerError(CellwrightError):
    """The Prefect server cannot be started or reached."""

    exit_code: ClassVar[int] = 1


@dataclass(frozen=True, slots=True)
class ServerStatus:
    """What is known of the server.

    Attributes:
        state: ``running`` answers; ``starting`` lives but does not answer (yet); ``stopped`` does not live;
            ``external`` is given by ``PREFECT_API_URL`` and not ours to start or stop.
        api_url: Where its API is, empty when stopped.
        pid: Its process, 0 if it is not ours or does not live.
        home: Folder of its database, settings and log.
    """

    state: Literal["running", "starting", "stopped", "external"]
    api_url: str
    pid: int
    home: Path

    @property
    def ui_url(self) -> str:
        """Where a browser finds the runs."""
        return self.api_url.removesuffix("/api")

    def as_json(self) -> dict[str, str | int]:
        """Return the status as plain values."""
        return {**dataclasses.asdict(self), "home": str(self.home), "ui_url": self.ui_url}


def state_home() -> Path:
    """Return cellwright's state folder: ``CELLWRIGHT_HOME``, else ``$XDG_STATE_HOME/cellwright``."""
    if home := os.environ.get("CELLWRIGHT_HOME"):
        return Path(home).expanduser().absolute()
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state).expanduser().absolute() / "cellwright"


def prepare_environment() -> None:
    """Set what Prefect reads from the environment when it is imported: call this first. What is set stays."""
    defaults = {
        "PREFECT_HOME": str(state_home() / "prefect"),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "DO_NOT_TRACK": "1",
        # errors reach the person as one line and the server as logs; the console handler would print them again
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL",
        "PREFECT_LOGGING_TO_API_WHEN_MISSING_FLOW": "ignore",
        # a forgotten server would silently become a temporary one that loses its task records
        "PREFECT_SERVER_EPHEMERAL_ENABLED": "false",
    }
    for name, value in defaults.items():
        os.environ.setdefault(name, value)
    for name in ("NO_PROXY", "no_proxy"):  # the client would ask a web proxy for this machine's own server
        hosts = [host for host in os.environ.get(name, "").split(",") if host]
        os.environ[name] = ",".join(dict.fromkeys([*hosts, HOST, "localhost"]))


@contextlib.contextmanager
def connected(say: Say) -> Iterator[str]:
    """Have a server for the flows run inside: the given one or this machine's; yields its API address.

    The heartbeat thread is off (each flow run would wait a second for it to end). On leaving, the records of the
    runs are handed over completely.

    Raises:
        ServerError: If no server can be started or reached, or it goes away meanwhile.
    """
    prepare_environment()
    try:
        _make_home(state_home())  # Prefect warns if it cannot make its own folder, also when the server is elsewhere
        url = start(say).api_url
    except ServerError as error:
        raise ServerError(f"{error}; or run without a server: --direct") from error
    import fastapi.encoders  # noqa: F401  # Prefect imports it when a flow begins: start-up, and no part of the run
    import httpx
    from prefect import flow, task  # noqa: F401  # they too
    from prefect.events.worker import EventsWorker
    from prefect.logging.handlers import APILogWorker
    from prefect.settings import (
        PREFECT_API_URL,
        PREFECT_FLOWS_HEARTBEAT_FREQUENCY,
        PREFECT_SERVER_EPHEMERAL_ENABLED,
        temporary_settings,
    )

    settings = {
        PREFECT_API_URL: url,
        PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None,
        PREFECT_SERVER_EPHEMERAL_ENABLED: False,
    }
    with temporary_settings(settings):
        _require_answer(url)
        try:
            yield url
        except httpx.TransportError as error:
            raise ServerError(
                f"the Prefect server at {url} stopped answering during the run ({error}): run again, what was "
                "finished is in the lake; --direct runs without it"
            ) from error
        finally:
            EventsWorker.drain_all()
            APILogWorker.drain_all()


def _require_answer(url: str) -> None:
    from prefect.client.orchestration import get_client

    with get_client(sync_client=True) as client:
        if (fault := client.api_healthcheck()) is not None:
            raise ServerError(
                f"the Prefect server at {url} does not answer ({fault}): start it or unset PREFECT_API_URL; or run "
                "without a server: --direct"
            ) from fault


def start(say: Say) -> ServerStatus:
    """Return the running server; start it if there is none, wait until it answers.

    Raises:
        ServerError: If it does not come up, with the end of its log.
    """
    if (known := status()).state in ("running", "external"):
        return known
    home = state_home()
    _make_home(home)
    with _exclusive(home / "start.lock"):
        deadline = time.monotonic() + ANSWER_PATIENCE_S
        while (known := status()).state == "starting" and time.monotonic() < deadline:
            time.sleep(0.1)  # another command died while it waited for this server
        if known.state == "running":
            return known
        if known.state == "starting":
            say(f"the Prefect server (process {known.pid}) does not answer: starting it anew")
            _end(known.pid, home)
        return _start_fresh(home, say)


def stop() -> bool:
    """Stop this machine's own server; return whether one was running.

    Raises:
        ServerError: If the server in use is not ours, or cannot be stopped.
    """
    known = status()
    if known.state == "external":
        raise ServerError(f"the server at {known.api_url} was given by PREFECT_API_URL: stop it where it was started")
    if known.state == "stopped":
        return False
    with _exclusive(known.home / "start.lock"):
        if (known := status()).state == "stopped":
            return False
        _end(known.pid, known.home)
    return True


def status() -> ServerStatus:
    """Say whether there is a server, without starting one. Costs milliseconds."""
    home = state_home()
    if url := os.environ.get("PREFECT_API_URL"):
        return ServerStatus("external", url.rstrip("/"), 0, home)
    if not _is_alive(home) or (record := _read_record(home)) is None:
        return ServerStatus("stopped", "", 0, home)
    pid, port = record
    url = f"http://{HOST}:{port}/api"
    return ServerStatus("running" if _answers(home, port) else "starting", url, pid, home)


def _start_fresh(home: Path, say: Say) -> ServerStatus:
    say("starting the Prefect server (once a machine; the first start takes about 10 s) ...")
    deadline = time.monotonic() + START_PATIENCE_S
    record = _read_record(home)
    preferred = record[1] if record else PORTS.start
    while True:
        port = _free_port(preferred)
        process = _spawn(home, port)
        while process.poll() is None and not _answers(home, port):
            if time.monotonic() > deadline:
                _end(process.pid, home)
                raise ServerError(
                    f"the Prefect server did not answer within {START_PATIENCE_S:.0f} s on port {port}: "
                    f"see {home / 'server.log'}, which ends in {_log_end(home)!r}"
                )
            time.sleep(0.05)
        if process.poll() is None:
            process.returncode = 0  # it lives on by itself; without this Popen warns that it was left running
            return ServerStatus("running", f"http://{HOST}:{port}/api", process.pid, home)
        if _is_free(port):  # it did not lose the port to somebody else: another port would not help
            raise ServerError(
                f"the Prefect server stopped with exit code {process.returncode}: "
                f"see {home / 'server.log'}, which ends in {_log_end(home)!r}"
            )
        preferred = port + 1


def _spawn(home: Path, port: int) -> subprocess.Popen[bytes]:
    log = home / "server.log"
    if log.exists():
        log.replace(home / "server.log.old")
    environment = {
        **os.environ,
        "PREFECT_HOME": str(home / "prefect"),
        "PREFECT_SERVER_API_HOST": HOST,
        "PREFECT_SERVER_API_PORT": str(port),
        "PREFECT_SERVER_UI_API_URL": f"http://{HOST}:{port}/api",  # else the page looks at port 4200
        "PREFECT_SERVER_UI_SHOW_PROMOTIONAL_CONTENT": "false",
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "PREFECT_SERVER_LOGGING_LEVEL": "WARNING",
        "PREFECT_CLI_PROMPT": "false",
        "DO_NOT_TRACK": "1",
    }
    environment.pop("PREFECT_PROFILE", None)  # profiles of another home do not exist in this one
    with log.open("wb") as output:
        return subprocess.Popen(
            # by its path, so that it is found from any folder; -P keeps this folder's names off its imports
            [sys.executable, "-P", str(Path(__file__).with_name("server_process.py")), str(home), str(port)],
            env=environment,
            cwd=home,  # Prefect reads settings files of the folder it starts in: not those of the user's project
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def _end(pid: int, home: Path) -> None:
    for sign in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, sign)
        deadline = time.monotonic() + STOP_PATIENCE_S
        while time.monotonic() < deadline:
            if not _is_alive(home):
                return
            time.sleep(0.05)
    raise ServerError(f"the Prefect server (process {pid}) does not stop: end it by hand")


def _is_alive(home: Path) -> bool:
    try:
        with (home / "server.json").open() as record:
            fcntl.flock(record, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (FileNotFoundError, NotADirectoryError):
        return False
    except BlockingIOError:
        return True
    except PermissionError as error:
        raise ServerError(f"cannot read {home}: set CELLWRIGHT_HOME to a folder of your own") from error
    return False


def _answers(home: Path, port: int) -> bool:
    """Whether the server of this home answers: another one on that port is somebody else's."""
    connection = http.client.HTTPConnection(HOST, port, timeout=5)
    try:
        connection.request("GET", "/api/admin/settings")
        answer = connection.getresponse()
        return answer.status == 200 and bool(json.load(answer)["home"] == str(home / "prefect"))
    except (OSError, http.client.HTTPException, ValueError, KeyError, TypeError):
        return False
    finally:
        connection.close()


def _free_port(preferred: int) -> int:
    candidates: list[int] = [preferred, *PORTS]
    for port in candidates:
        if _is_free(port):
            return port
    raise ServerError(f"no port between {PORTS.start} and {PORTS.stop - 1} is free for the Prefect server")


def _is_free(port: int) -> bool:
    with contextlib.closing(socket.socket()) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port in TIME_WAIT is free
        try:
            probe.bind((HOST, port))
        except OSError:
            return False
    return True


def _read_record(home: Path) -> tuple[int, int] | None:
    try:
        record = json.loads((home / "server.json").read_text())
        return int(record["pid"]), int(record["port"])
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None


def _log_end(home: Path) -> str:
    with contextlib.suppress(FileNotFoundError):
        lines = (home / "server.log").read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""
    return ""


def _make_home(home: Path) -> None:
    try:
        (home / "prefect").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ServerError(
            f"cannot make the state folder {home} ({error.strerror}): set CELLWRIGHT_HOME to a folder you may write to"
        ) from error
    if not os.access(home, os.W_OK | os.X_OK):
        raise ServerError(f"cannot write to the state folder {home}: set CELLWRIGHT_HOME to a folder of your own")


@contextlib.contextmanager
def _exclusive(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
