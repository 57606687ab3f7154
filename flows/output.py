"""Write results on standard output: JSON for machines, tables for people."""

from __future__ import annotations

import json
import math
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_PIPE_WIDTH = 1000
"""Columns of a pipe or file: rows are not folded there, so that other programs can read them."""


def write_json(value: Any) -> None:
    """Print a value as JSON; what JSON has no word for (NaN, infinity) becomes ``null``."""
    sys.stdout.write(json.dumps(_plain(value), indent=1, ensure_ascii=False, allow_nan=False, default=str) + "\n")


def stdout_console() -> Console:
    """Return a console for standard output that takes text as it is."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else _PIPE_WIDTH
    return Console(width=width, markup=False, highlight=False, emoji=False)


def stderr_console() -> Console:
    """Return a console for standard error that takes text as it is."""
    from rich.console import Console

    width = None if sys.stderr.isatty() else _PIPE_WIDTH
    return Console(file=sys.stderr, width=width, markup=False, highlight=False, emoji=False)


def print_table(table: Table) -> None:
    """Print a table on standard output."""
    stdout_console().print(table)


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
