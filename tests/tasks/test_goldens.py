"""Every stage has a golden digest, and a changed result without a new version fails."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

import tasks
from schemas.sources import SourceFile
from tests.tasks.goldens import GOLDENS, check_golden, rounded
from tests.tasks.plate_scene import points_on_top


@pytest.mark.parametrize("name", tasks.STAGES)
def test_every_stage_compares_its_result_with_a_golden_digest(name: str) -> None:
    module = importlib.import_module(f"tests.tasks.test_{name}")
    test = module.test_the_result_is_the_one_of_this_version
    assert module.check_golden is check_golden and getattr(module, name) is tasks.STAGES[name]
    assert {"check_golden", name} <= set(test.__code__.co_names)


@pytest.mark.parametrize("name", tasks.STAGES)
def test_a_new_version_has_its_own_golden_digest(name: str) -> None:
    assert GOLDENS[name][0] == tasks.STAGES[name].version


def test_no_digest_is_left_of_a_stage_that_is_gone() -> None:
    assert set(GOLDENS) == set(tasks.STAGES)


def test_another_result_of_the_same_version_fails() -> None:
    with pytest.raises(AssertionError, match=r"the result changed to [0-9a-f]+: raise the version of read_source"):
        check_golden(tasks.read_source, SourceFile(name="part.stl", content=b"other"))


def test_another_version_asks_for_its_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(GOLDENS, "read_source", (0, "of an earlier version"))
    with pytest.raises(AssertionError, match=r"read_source has version \d+: store its digest [0-9a-f]{64}"):
        check_golden(tasks.read_source, SourceFile(name="part.stl", content=b"other"))


def test_last_bits_do_not_reach_the_digest() -> None:
    samples = points_on_top((0.1, 0.2))
    moved = points_on_top((0.1 + 1e-16, -0.0 + 0.2 - 1e-16))
    assert np.array_equal(rounded(samples).points_m, rounded(moved).points_m)
    assert str(rounded(points_on_top((-1e-12, 0.0))).points_m[0, 0]) == "0.0"
