"""Write results on standard output: JSON for machines, tables for people. What reads them may be gone, or full."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import math
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

READER_GONE = 128 + signal.SIGPIPE
"""Exit code when the reader of standard output went away before the end, as `head` does."""

NOT_WRITTEN = 1
"""Exit code when standard output could not be written for another reason: its disk is full."""

_FAILURES = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG, errno.EBADF)

_PIPE_WIDTH = 1000
"""Columns of a pipe or file for what is no table."""

_WIDEST = 1_000_000
"""Columns of a pipe or file for tables: their rows are not folded there, so that other programs can read them."""


def prepare_streams() -> None:
    """Make standard output and error take everything: letters that their encoding lacks, and all if they are closed."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by who started us, as `>&-` does: nobody wants what we say
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115  # open to the end
        elif isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
            stream.reconfigure(errors="replace")


def run_writing(command: Callable[[], int]) -> int:
    """Run a command and return its exit code, or what it means that standard output could not be written."""
    try:
        code = command()
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        _discard(sys.stdout)
        return READER_GONE
    except OSError as error:
        if error.filename is not None or error.errno not in _FAILURES:
            raise
        _discard(sys.stdout)
        write_error(f"error: cannot write standard output: {error.strerror}: what the command did stays done\n")
        return NOT_WRITTEN


def write_error(text: str) -> None:
    """Write on standard error, if anybody still reads it."""
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except OSError:
        _discard(sys.stderr)


def try_json(value: Any) -> None:
    """Print a value as JSON if anybody still reads it, so that an error keeps its own exit code."""
    try:
        write_json(value)
        sys.stdout.flush()
    except OSError:
        _discard(sys.stdout)


def write_json(value: Any) -> None:
    """Print a value as JSON; what JSON has no word for (NaN, infinity) becomes ``null``."""
    only_ascii = (sys.stdout.encoding or "utf-8").lower().replace("-", "") != "utf8"  # escaped, nothing is lost
    text = json.dumps(_plain(value), indent=1, ensure_ascii=only_ascii, allow_nan=False, default=str)
    sys.stdout.write(text + "\n")


def stdout_console() -> Console:
    """Return a console for standard output that takes text as it is."""
    return _console(sys.stdout)


def stderr_console() -> Console:
    """Return a console for standard error that takes text as it is."""
    return _console(sys.stderr)


def print_table(table: Table) -> None:
    """Print a table on standard output: folded to a terminal's width, a whole row a line where something else reads."""
    if sys.stdout.isatty():
        stdout_console().print(table)
        return
    from rich.console import Console

    wide = Console(file=io.StringIO(), width=_WIDEST, markup=False, highlight=False, emoji=False)
    rendered = wide.render_lines(table, pad=False)
    sys.stdout.writelines("".join(segment.text for segment in line).rstrip() + "\n" for line in rendered)


def _console(stream: TextIO) -> Console:
    from rich.console import Console

    class Plain(Console):
        def on_broken_pipe(self) -> None:
            raise  # rich calls this from its handler, and would end the process with code 1

    width = None if stream.isatty() else _PIPE_WIDTH
    return Plain(file=stream, width=width, markup=False, highlight=False, emoji=False)


def _discard(stream: TextIO) -> None:
    """Send what is left of a stream nowhere, so that its closing does not fail once more."""
    with contextlib.suppress(OSError, ValueError):  # a stream of a test may stand on no file
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
