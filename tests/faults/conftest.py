"""The bench of all faults; what a module computes it computes once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.bench import Bench


@pytest.fixture(scope="module")
def shared_lake(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("faults") / "lake")


@pytest.fixture
def bench(tmp_path: Path, shared_lake: str, capsys: pytest.CaptureFixture[str]) -> Bench:
    return Bench(tmp_path, shared_lake, capsys)
