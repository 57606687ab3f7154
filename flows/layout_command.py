"""The command ``cellwright layout``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from flows.subcommands import add_run_options, add_set, run_flow


def add_parser(commands: Any) -> None:
    """Add the command to the command line."""
    command = commands.add_parser(
        "layout",
        help="place stations and robot for the shortest cycle time",
        description="Place the stations, or the robot's base, of a layout file so that the robot's true cycle time is "
        "shortest; check it, and report it.",
        epilog="""\
examples:
  cellwright layout four_stations
  cellwright layout layout.yaml --out results --set solver.starts=10
  cellwright layout layout.yaml --set solver.method=second_order --seed 7
""",
    )
    command.add_argument("file", metavar="LAYOUT.yaml", help="the layout file, or the name of a built-in example")
    add_set(command)
    command.add_argument("--seed", type=int, metavar="N", help="seed of all random choices (solver.seed)")
    command.add_argument("--out", type=Path, metavar="DIR", help="write report, recording and figures into this folder")
    add_run_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    from flows.examples import find_cell_file
    from schemas.layout_file import load_layout_file

    overrides = [*options.overrides, *([] if options.seed is None else [f"solver.seed={options.seed}"])]
    file = load_layout_file(find_cell_file(options.file), overrides)  # a mistake shows before a server is started
    return run_flow("layout", options, file)
