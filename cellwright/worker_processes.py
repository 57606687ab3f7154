"""Call one object in several processes, for work that holds the interpreter's lock; threads serve for all other.

Results come back in the order of the work, so the number of processes cannot change them. A process begins with the
first piece of work that finds no idle one, and imports what it needs but not the main module of the program: neither
scripts without a main guard nor processes that must not fork have to care. Each takes a second or two to begin.
"""

from __future__ import annotations

import os
import pickle
import queue
import subprocess
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any

from cellwright.errors import CellwrightError, SolverError
from cellwright.threads import n_usable_cores

_BEGIN = "import sys; sys.path[:] = {path!r}; from cellwright.worker_processes import serve; serve()"


class WorkerProcesses:
    """Processes that each build an object once and call it with every piece of work.

    Args:
        build: A function at the top of a module that returns a callable.
        arguments: What it is called with in each process; picklable, as are pieces of work and results.
        n_processes: At most so many; ``None`` takes the cores that this process may use.
    """

    def __init__(self, build: Callable[..., Callable[..., Any]], arguments: tuple[Any, ...], n_processes: int | None):
        self.n_processes = n_usable_cores() if n_processes is None else n_processes
        self._order = pickle.dumps((build, arguments))
        self._started: list[subprocess.Popen[bytes]] = []
        self._idle: queue.SimpleQueue[subprocess.Popen[bytes]] = queue.SimpleQueue()
        self._threads = ThreadPoolExecutor(self.n_processes)

    def __enter__(self) -> WorkerProcesses:
        """Begin no process yet."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all processes."""
        self._threads.shutdown(cancel_futures=True)
        for each in self._started:
            if each.stdin is not None and each.stdout is not None:
                each.stdin.close()  # what has no more work ends by itself
                each.wait()
                each.stdout.close()

    @property
    def n_begun(self) -> int:
        """How many processes have begun."""
        return len(self._started)

    def map(self, work: Iterable[tuple[Any, ...]]) -> list[Any]:
        """Return what the object returns when called with each tuple of ``work``, in order.

        Raises:
            SolverError: If a process ended before its work.
            CellwrightError: Whatever the object itself raises on purpose.
        """
        return list(self._threads.map(self._one, work))

    def _one(self, work: tuple[Any, ...]) -> Any:
        try:
            worker = self._idle.get_nowait()
        except queue.Empty:
            worker = self._begun()
        succeeded, result = _answer(worker, pickle.dumps(work))
        self._idle.put(worker)
        if not succeeded:
            raise result
        return result

    def _begun(self) -> subprocess.Popen[bytes]:
        worker = subprocess.Popen(
            [sys.executable, "-c", _BEGIN.format(path=sys.path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self._started.append(worker)
        _send(worker, self._order)
        return worker


def _send(worker: subprocess.Popen[bytes], message: bytes) -> None:
    if worker.stdin is None:
        raise SolverError("a worker process has no input: run on one process")
    try:
        worker.stdin.write(message)
        worker.stdin.flush()
    except BrokenPipeError as error:
        raise SolverError(f"a worker process ended early (exit code {worker.wait()}): run on one process") from error


def _answer(worker: subprocess.Popen[bytes], message: bytes) -> tuple[bool, Any]:
    """Return whether the call succeeded, and its result or its exception."""
    _send(worker, message)
    if worker.stdout is None:
        raise SolverError("a worker process has no output: run on one process")
    try:
        succeeded, result = pickle.load(worker.stdout)  # noqa: S301 - from a process that this one began
    except (EOFError, pickle.UnpicklingError) as error:
        raise SolverError(f"a worker process ended early (exit code {worker.wait()}): run on one process") from error
    return bool(succeeded), result


def serve() -> None:
    """Build what the first message says, then answer one call after the other until the input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever prints must not end up between answers
    calls = sys.stdin.buffer
    try:
        build, arguments = pickle.load(calls)  # noqa: S301 - from the process that began this one
        called = build(*arguments)
        while True:
            work = pickle.load(calls)  # noqa: S301 - as above
            try:
                answer = (True, called(*work))
            except CellwrightError as error:
                answer = (False, error)
            pickle.dump(answer, answers)
            answers.flush()
    except (EOFError, BrokenPipeError, KeyboardInterrupt):
        return
