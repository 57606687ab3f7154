"""Work comes back in order from as many processes as are needed; what goes wrong there is told here."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cellwright.errors import InvalidInputError, SolverError
from cellwright.worker_processes import WorkerProcesses


class Squares:
    """Squares of numbers plus an offset; refuses negative ones, and dies of 13."""

    def __init__(self, offset: int) -> None:
        self.offset = offset

    def __call__(self, number: int) -> int:
        sys.stdout.write("chatter\n")  # must not end up between answers
        if number < 0:
            raise InvalidInputError(f"{number} is negative: give another")
        if number == 13:
            os._exit(3)
        return self.offset + number**2


def test_results_come_in_order_from_processes_that_begin_when_needed() -> None:
    with WorkerProcesses(Squares, (1,), 2) as workers:
        assert workers.n_begun == 0
        assert workers.map((n,) for n in range(12)) == [1 + n**2 for n in range(12)]
        begun = workers.n_begun
        assert begun in (1, 2)  # an idle one is asked before another begins
        assert workers.map([(5,)]) == [26]
        assert workers.n_begun == begun


def test_an_error_comes_through_and_the_processes_go_on() -> None:
    with WorkerProcesses(Squares, (0,), 1) as workers:
        with pytest.raises(InvalidInputError, match="-2 is negative"):
            workers.map([(-2,)])
        assert workers.map([(3,)]) == [9]


def test_a_process_that_dies_is_an_error_and_not_a_wait() -> None:
    with WorkerProcesses(Squares, (0,), 1) as workers, pytest.raises(SolverError, match=r"ended early \(exit code 3\)"):
        workers.map([(13,)])


def test_a_script_without_a_main_guard_may_use_them(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from cellwright.worker_processes import WorkerProcesses\n"
        "from tests.cellwright.test_worker_processes import Squares\n"
        "with WorkerProcesses(Squares, (0,), 2) as workers:\n"
        "    print(workers.map([(4,), (5,)]))\n"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, script],
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "[16, 25]\n"
