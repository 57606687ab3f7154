"""Benchmarks keep up with the code: they reach into kernels that may be renamed."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.py")))
def test_a_benchmark_finds_what_it_measures(name: str) -> None:
    assert importlib.import_module(f"benchmarks.{name}").__doc__


def test_a_kernel_that_calls_something_else_by_now_is_told() -> None:
    bare_kernels = importlib.import_module("benchmarks.bare_kernels")
    from cellwright.solvers.state_tests import arm_state

    with pytest.raises(SystemExit, match="arm_state calls no renamed: bring this benchmark up to date"):
        bare_kernels._recompiled(arm_state, renamed=None)
