"""Stop a command at Ctrl-C: in order if that is quick, at once if not.

The first Ctrl-C raises `KeyboardInterrupt` in the main thread and makes stages in other threads end at their next
report of progress. Python hears of signals only between its own instructions, which a compiled kernel or a thread
pool can keep off for many seconds; so a thread of its own hears of them too, and ends the process when it has not
come to an end by itself in `PATIENCE_S`. The lake is whole at every moment, so that this loses the stage under way
and nothing else. A second Ctrl-C leaves at once.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130
"""The exit code."""

PATIENCE_S = 1.2
"""Time to unwind and to write down that the run was interrupted: well below what a person takes for hanging."""

FAREWELL = "interrupted: what was finished is in the lake, a rerun goes on from there\n"
_SHOW_CURSOR = b"\x1b[?25h"


@contextlib.contextmanager
def stopping_at_interrupt() -> Iterator[threading.Event]:
    """Watch for Ctrl-C inside the block; set the yielded event once the main thread has come to an end by itself.

    Does nothing in a thread: only the main thread may say what signals do.
    """
    ended = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield ended
        return
    if execution := sys.modules.get("flows.execution"):
        execution.INTERRUPTED.clear()  # of an earlier command in this process

    def interrupt(number: int, frame: FrameType | None) -> NoReturn:
        signal.signal(signal.SIGINT, lambda number, frame: os._exit(INTERRUPTED))
        raise KeyboardInterrupt

    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    before = signal.signal(signal.SIGINT, interrupt)
    woken_before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(reading, ended), name="interrupts", daemon=True).start()
    try:
        yield ended
    finally:
        ended.set()
        signal.set_wakeup_fd(woken_before)
        signal.signal(signal.SIGINT, before)
        os.close(writing)  # the watching thread reads the end, and ends


def leave_now_if_busy(code: int) -> None:
    """Do not wait at exit for threads that are still in a kernel: the lake is whole at every moment."""
    busy = [each for each in threading.enumerate() if each is not threading.main_thread() and not each.daemon]
    if busy:
        sys.stderr.flush()
        os._exit(code)


def _watch(reading: int, ended: threading.Event) -> None:
    with os.fdopen(reading, "rb", buffering=0) as signals:
        while (byte := signals.read(1)) and byte[0] != signal.SIGINT:
            pass
        if not byte:
            return
        if execution := sys.modules.get("flows.execution"):  # no stage runs where it is not even imported
            execution.INTERRUPTED.set()
        _say(b"\nstopping; press Ctrl-C again to leave at once\n")
        threading.Thread(target=_leave_at_second, args=(os.dup(reading),), daemon=True).start()
        if not ended.wait(PATIENCE_S):
            _say((_SHOW_CURSOR if sys.stderr.isatty() else b"") + FAREWELL.encode())
            os._exit(INTERRUPTED)


def _leave_at_second(reading: int) -> None:
    with os.fdopen(reading, "rb", buffering=0) as signals:
        while byte := signals.read(1):
            if byte[0] == signal.SIGINT:
                os._exit(INTERRUPTED)


def _say(text: bytes) -> None:
    with contextlib.suppress(OSError, ValueError):  # nobody may be listening any more
        os.write(sys.stderr.fileno(), text)
