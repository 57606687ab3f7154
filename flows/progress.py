"""Show the stages of a run on standard error: live bars in a terminal, lines otherwise, nothing if asked."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

from flows.execution import Unwatched, Watcher

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

FIRST_WORD_S = 5.0
"""A log hears of a stage that is still under way after this time,"""

NEXT_WORD_S = 10.0
"""and then again each time that this has passed: who watches a build's log wants to know that it lives."""


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
        with plain.telling():
            yield plain, plain.say


class PlainProgress:
    """One line for each stage that ends, and one now and then while it lasts: for logs and pipes."""

    def __init__(self, stream: TextIO, first_word_s: float = FIRST_WORD_S, next_word_s: float = NEXT_WORD_S) -> None:
        self._stream = stream
        self._lock = threading.Lock()
        self._first_word_s, self._next_word_s = first_word_s, next_word_s
        self._under_way: dict[str, _UnderWay] = {}

    @contextlib.contextmanager
    def telling(self) -> Iterator[None]:
        """Tell of stages that take long, inside the block."""
        ended = threading.Event()
        period = min(self._first_word_s, self._next_word_s) / 10

        def tell() -> None:
            while not ended.wait(period):
                for line in self._due(time.monotonic()):
                    self.say(line)

        thread = threading.Thread(target=tell, name="progress", daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def _due(self, now: float) -> list[str]:
        lines = []
        with self._lock:
            for name, stage in self._under_way.items():
                if now >= stage.next_word:
                    stage.next_word = now + self._next_word_s
                    share = f", {stage.share:.0%} done" if stage.share > 0.0 else ""
                    lines.append(f"{name}: under way for {now - stage.begun:.0f} s{share}")
        return lines

    def say(self, line: str) -> None:
        """Write one line."""
        with self._lock, contextlib.suppress(OSError):  # nobody reads it any more: no reason to stop the work
            self._stream.write(f"{line}\n")
            self._stream.flush()

    def started(self, name: str) -> None:
        """Say nothing yet: most stages are done before a line of them would be read."""
        now = time.monotonic()
        with self._lock:
            self._under_way[name] = _UnderWay(now, now + self._first_word_s)

    def advanced(self, name: str, share: float) -> None:
        """Keep it for the next line."""
        with self._lock:
            if (stage := self._under_way.get(name)) is not None:
                stage.share = min(max(share, 0.0), 1.0)

    def finished(self, name: str, *, cached: bool, seconds: float) -> None:
        """Say what the stage cost."""
        self._forget(name)
        self.say(_ending(name, cached, seconds))

    def failed(self, name: str) -> None:
        """Say that it failed; the error itself comes at the end of the command."""
        self._forget(name)
        self.say(f"{name}: failed")

    def _forget(self, name: str) -> None:
        with self._lock:
            self._under_way.pop(name, None)

    def noted(self, line: str) -> None:
        """Say it."""
        self.say(line)


@dataclass
class _UnderWay:
    """A stage that is computed: when it began, when a line is due, what share of it is done."""

    begun: float
    next_word: float
    share: float = 0.0


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

    def noted(self, line: str) -> None:
        """Say it."""
        self.say(line)

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
