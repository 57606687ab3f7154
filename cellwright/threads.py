"""Run a kernel that releases the interpreter lock over slices of rows, on as many threads as there are cores.

Slices depend on the amount of work alone, never on the number of threads, and results come back in the order of
the slices: the number of threads cannot change a result.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")


def n_usable_cores() -> int:
    """Return the number of cores that the process may use."""
    # not every system can tell the cores of a process from those of the machine
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def slices_of(n_rows: int, size: int) -> Iterator[slice]:
    """Cut ``range(n_rows)`` into slices of at most ``size`` rows."""
    for begin in range(0, n_rows, size):
        yield slice(begin, min(begin + size, n_rows))


def map_slices(
    work: Callable[[slice], Result], n_rows: int, size: int, *, n_threads: int | None = None
) -> Iterator[Result]:
    """Yield ``work(rows)`` for each slice of at most ``size`` rows, in order.

    Args:
        work: Called from several threads at once; must not change shared state.
        n_rows: Rows in all.
        size: Rows a call, at least 1.
        n_threads: Threads; ``None`` takes the cores that the process may use.
    """
    wanted = n_usable_cores() if n_threads is None else n_threads
    pieces = list(slices_of(n_rows, size))
    if wanted <= 1 or len(pieces) <= 1:
        yield from map(work, pieces)
        return
    with ThreadPoolExecutor(min(wanted, len(pieces))) as pool:
        yield from pool.map(work, pieces)
