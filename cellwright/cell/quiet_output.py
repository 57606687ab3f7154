"""Keep the words of compiled libraries off the terminal, where they would break a program's own output."""

from __future__ import annotations

import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_COLOUR = re.compile(r"\x1b\[[\d;]*m")
_ONE_AT_A_TIME = threading.Lock()


@contextmanager
def quiet_output() -> Iterator[list[str]]:
    """Catch what the process writes to its file descriptors 1 and 2; the list holds the lines after the block.

    Descriptors belong to the whole process. Blocks of several threads wait for one another; what a thread outside
    such a block writes in the meantime is caught too, so blocks must be short.
    """
    lines: list[str] = []
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as caught:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        kept = {number: os.dup(number) for number in (1, 2) if _is_open(number)}
        try:
            for number in kept:
                os.dup2(caught.fileno(), number)
            yield lines
        finally:
            for number, copy in kept.items():
                os.dup2(copy, number)
                os.close(copy)
            caught.seek(0)
            words = _COLOUR.sub("", caught.read(4096).decode(errors="replace")).splitlines()
            lines += [line.strip(" *\t")[:100] for line in words if line.strip(" *\t")]


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True
