"""The command ``cellwright sequence``: stations with tasks at poses, and GTSPLIB files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cellwright.errors import InvalidInputError
from flows.subcommands import add_run_options, add_set, run_flow

GTSPLIB_SUFFIXES = (".gtsp", ".agtsp", ".pcglns")


def add_parser(commands: Any) -> None:
    """Add the command to the command line."""
    command = commands.add_parser(
        "sequence",
        help="order tasks and choose how the robot performs each",
        description="Find the sequence of the tasks in a sequence file, the arm's configuration at each, and the "
        "collision-free motion through all of them; verify it, and report it. GTSPLIB files (.gtsp, .pcglns) are "
        "solved as they are.",
        epilog="""\
examples:
  cellwright sequence drilling_panel
  cellwright sequence station.yaml --out results --set planner.end=anywhere
  cellwright sequence 39rat195.gtsp --out tour.txt --time-limit 60
""",
    )
    command.add_argument(
        "file", metavar="FILE", help="the sequence file, the name of a built-in example, or a GTSPLIB file"
    )
    add_set(command)
    command.add_argument("--seed", type=int, metavar="N", help="seed of all random choices (planner.seed)")
    command.add_argument(
        "--out", type=Path, metavar="PATH", help="folder for report, recording and figures; of a GTSPLIB file the tour"
    )
    command.add_argument(
        "--time-limit", type=float, metavar="S", help="of a GTSPLIB file: seconds after which the best tour is taken"
    )
    add_run_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    if Path(options.file).suffix.lower() in GTSPLIB_SUFFIXES:
        from flows.gtsplib_command import solve_file

        return solve_file(options)
    if options.time_limit is not None:
        raise InvalidInputError(
            "--time-limit is for GTSPLIB files: a sequence is limited by its work, which is the same on every machine: "
            "--set planner.max_motions=200"
        )
    from flows.examples import find_cell_file
    from schemas.sequence_file import load_sequence_file

    overrides = [*options.overrides, *([] if options.seed is None else [f"planner.seed={options.seed}"])]
    file = load_sequence_file(find_cell_file(options.file), overrides)  # a mistake shows before a server is started
    return run_flow("sequence", options, file)
