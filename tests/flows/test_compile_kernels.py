from __future__ import annotations

from collections import defaultdict
from typing import Any

import numba
import numpy as np
import pytest

from cellwright.cell import branch_tracking, general_arm
from flows.compile_kernels import follow_calibrated_arm
from tests.tasks.test_follow_sweeps import reached_by_a_calibrated_arm


def test_set_up_compiles_what_a_plan_with_a_general_arm_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    called: dict[str, set[tuple[Any, ...]]] = defaultdict(set)
    for module, name in ((branch_tracking, "_follow_stretches"), (general_arm, "_polish")):
        kernel = getattr(module, name)

        def noted(*arguments: Any, name: str = name, kernel: Any = kernel) -> Any:
            called[name].add(tuple(numba.typeof(argument) for argument in arguments))
            return kernel(*arguments)

        monkeypatch.setattr(module, name, noted)
    q = follow_calibrated_arm()
    assert np.isfinite(q).all(axis=2).sum(axis=1).tolist() == [8] * len(q)
    compiled, called = called, defaultdict(set)
    reached_by_a_calibrated_arm.__wrapped__()
    assert called.keys() == {"_follow_stretches", "_polish"}
    assert compiled == called
