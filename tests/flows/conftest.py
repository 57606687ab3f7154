"""One Prefect server for all flow tests of a session, and the small stages in place of the real ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import tasks
from tests.flows import small_stages

PROJECT = Path(__file__).parents[2]
"""The project's root, which runs in other processes need on their path."""


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep all flow tests on one worker: each worker would start its own server, 10 s and 250 MB."""
    for item in items:
        if item.get_closest_marker("flow"):
            item.add_marker(pytest.mark.xdist_group("flow"))


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(tasks, "STAGES", small_stages.STAGES, raising=False)
    small_stages.calls.clear()
    yield
    small_stages.calls.clear()


@pytest.fixture
def lake_url(tmp_path: Path) -> str:
    return str(tmp_path / "lake")


@pytest.fixture(scope="session")
def prefect_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server in memory: a file database locks up under a burst of tasks and costs seconds of waiting."""
    home = tmp_path_factory.mktemp("prefect-home")
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("CELLWRIGHT_HOME", str(home))
        environment.delenv("PREFECT_API_URL", raising=False)
        from flows import server

        server.prepare_environment()
        from prefect.events.worker import EventsWorker
        from prefect.server.api.server import SubprocessASGIServer
        from prefect.settings import (
            PREFECT_API_URL,
            PREFECT_FLOWS_HEARTBEAT_FREQUENCY,
            PREFECT_LOGGING_TO_API_ENABLED,
            PREFECT_SERVER_ANALYTICS_ENABLED,
            PREFECT_SERVER_DATABASE_CONNECTION_URL,
            temporary_settings,
        )

        memory = "sqlite+aiosqlite:///file::memory:?cache=shared&uri=true&check_same_thread=false"
        settings = {
            PREFECT_SERVER_DATABASE_CONNECTION_URL: memory,
            PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None,
            PREFECT_LOGGING_TO_API_ENABLED: False,
            PREFECT_SERVER_ANALYTICS_ENABLED: False,
        }
        with temporary_settings(settings):
            process = SubprocessASGIServer()
            process.start(timeout=120)
            with temporary_settings({PREFECT_API_URL: process.api_url}):
                yield process.api_url
                EventsWorker.drain_all()
            process.stop()
