"""Show the stages of a run on standard error: live bars in a terminal, one line a stage otherwise, nothing if asked."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, TextIO

from flows.execution import Unwatched, Watcher

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


@contextlib.contextmanager
def stage_progress(*, quiet: bool, stream: TextIO | None = None) -> Iterator[tuple[Watcher, Callable[[str], None]]]:
    """Yield a watcher for the run's stages and a function that says one line in between.

    Args:
        quiet: Show nothing at all.
        stream: Where to write; standard error if left out.
    """
    stream = stream or sys.stderr
    if quiet:
        yield Unwatched(), lambda line: None
    elif stream.isatty():
        with _terminal(stream) as shown:
            yield shown
    else:
        plain = PlainProgress(stream)
        yield plain, plain.say


class PlainProgress:
    """One line for each stage that ends: for logs and pipes."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lock = threading.Lock()

    def say(self, line: str) -> None:
        """Write one line."""
        with self._lock, contextlib.suppress(OSError):  # nobody reads it any more: no reason to stop the work
            self._stream.write(f"{line}\n")
            self._stream.flush()

    def started(self, name: str) -> None:
        """Say nothing: the line comes with the end."""

    def advanced(self, name: str, share: float) -> None:
        """Say nothing."""

    def finished(self, name: str, *, cached: bool, seconds: float) -> None:
        """Say what the stage cost."""
        self.say(_ending(name, cached, seconds))

    def failed(self, name: str) -> None:
        """Say that it failed; the error itself comes at the end of the command."""
        self.say(f"{name}: failed")


class LiveProgress:
    """A bar for each stage that is under way, a line for each that is done."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._bars: dict[str, TaskID] = {}
        self._lock = threading.Lock()

    def say(self, line: str) -> None:
        """Write one line above the bars."""
        self._progress.console.print(line, markup=False, highlight=False)

    def started(self, name: str) -> None:
        """Open a bar, which pulses until the stage reports a share."""
        with self._lock:
            self._bars[name] = self._progress.add_task(name, total=None)

    def advanced(self, name: str, share: float) -> None:
        """Move the bar."""
        with self._lock:
            if (bar := self._bars.get(name)) is not None:
                self._progress.update(bar, total=1.0, completed=min(max(share, 0.0), 1.0))

    def finished(self, name: str, *, cached: bool, seconds: float) -> None:
        """Turn the bar into a line."""
        self._close(name)
        self.say(_ending(name, cached, seconds))

    def failed(self, name: str) -> None:
        """Turn the bar into a line."""
        self._close(name)
        self.say(f"{name}: failed")

    def _close(self, name: str) -> None:
        with self._lock:
            if (bar := self._bars.pop(name, None)) is not None:
                self._progress.remove_task(bar)


@contextlib.contextmanager
def _terminal(stream: TextIO) -> Iterator[tuple[Watcher, Callable[[str], None]]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    layout = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*layout, console=Console(file=stream), transient=True) as progress:
        live = LiveProgress(progress)
        yield live, live.say


def _ending(name: str, cached: bool, seconds: float) -> str:
    return f"{name}: cached" if cached else f"{name}: {seconds:.2f} s"
