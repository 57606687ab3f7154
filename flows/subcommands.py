"""What the subcommands of the command line share: their options, and how a flow is run and its summary printed."""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

from flows.output import stdout_console, write_json

if TYPE_CHECKING:
    from rich.console import Console

LAKE_HELP = "folder or address of the lake (default: $CELLWRIGHT_LAKE, else ./lake)"


class Summary(Protocol):
    """What a flow hands back to the command line."""

    def as_json(self) -> Mapping[str, Any]:
        """Return the result as plain values."""

    def show(self, console: Console) -> None:
        """Print the result for a person."""


class Parser(argparse.ArgumentParser):
    """A parser that keeps descriptions and examples as they are written."""

    def __init__(self, prog: str = "", description: str = "", epilog: str = "", **keywords: Any) -> None:
        super().__init__(
            prog,
            description=description,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            **keywords,
        )


def default_lake() -> str:
    """Return the lake that is used without ``--lake``: ``CELLWRIGHT_LAKE``, else the folder ``lake`` here."""
    return os.environ.get("CELLWRIGHT_LAKE") or "lake"


def lake_of(options: argparse.Namespace) -> str:
    """Return the lake that the options name, or the default one."""
    return default_lake() if options.lake is None else str(options.lake)  # an empty one is refused, not replaced


def add_set(command: argparse.ArgumentParser) -> None:
    """Add ``--set``."""
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        dest="overrides",
        help="lay a setting over the file, e.g. part.scale=0.5; may be repeated",
    )


def add_run_options(command: argparse.ArgumentParser) -> None:
    """Add what every command that runs a flow takes: ``--lake``, ``--refresh``, ``--direct``, ``--json``."""
    command.add_argument("--lake", metavar="DIR", help=LAKE_HELP)
    command.add_argument(
        "--refresh",
        action="append",
        default=[],
        metavar="STAGE",
        help="compute this stage although the lake has it; may be repeated",
    )
    command.add_argument("--direct", action="store_true", help="run without Prefect: no server, one stage at a time")
    command.add_argument("--json", action="store_true", help="print the summary as JSON, and no progress")


def run_flow(module: str, options: argparse.Namespace, *arguments: Any, **keywords: Any) -> int:
    """Run ``flows.<module>.run`` with progress, and a server unless ``--direct``; print its summary and return 0.

    With the summary goes the time that the run took, apart from the start-up before it: the imports, the cell file,
    finding the server (or starting it).

    Raises:
        CellwrightError: What the flow raises; also if ``--refresh`` names no stage or the server does not start.
    """
    from importlib import import_module

    from flows import server
    from flows.execution import open_lake, stage_named
    from flows.progress import stage_progress

    for name in options.refresh:
        stage_named(name)
    lake = lake_of(options)
    open_lake(lake)  # an address that cannot be one shows before a server is started
    with (
        stage_progress(quiet=options.json) as (watcher, say),
        contextlib.nullcontext() if options.direct else server.connected(say),
    ):
        run = import_module(f"flows.{module}").run
        import_module("storage.parquet")  # each run reads tables: start-up, as all imports
        begun = time.monotonic()
        summary: Summary = run(
            *arguments,
            **keywords,
            lake=lake,
            refresh=frozenset(options.refresh),
            out=options.out,
            watcher=watcher,
            direct=options.direct,
        )
    took_s = time.monotonic() - begun  # with handing the records over to the server
    print_summary(summary, as_json=options.json, took_s=took_s)
    return 0


def print_summary(summary: Summary, *, as_json: bool, took_s: float | None = None) -> None:
    """Print a summary for a person, or as JSON; with the time that the run took, if there was one."""
    if as_json:
        write_json({**summary.as_json(), **({} if took_s is None else {"took_s": round(took_s, 3)})})
        return
    summary.show(stdout_console())
    if took_s is not None:
        stdout_console().print(f"The run took {took_s:.1f} s, start-up apart.")
