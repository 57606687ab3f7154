"""The command ``cellwright spherize``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from flows.subcommands import LAKE_HELP, lake_of, print_summary

MOST = 200
"""Spheres of a mesh, or of a link on average."""
_UNITS = ("um", "mm", "cm", "m", "in", "ft")


def add_parser(commands: Any) -> None:
    """Add the command to the command line."""
    command = commands.add_parser(
        "spherize",
        help="cover a robot or a mesh with few spheres, proven to hold it",
        description="Cover every link of a robot, or a mesh, with few spheres; it is proven that nothing sticks out of "
        "them.",
        epilog="""\
examples:
  cellwright spherize ur10e --out ur10e_spheres.urdf
  cellwright spherize robot.urdf --spheres 12 --out robot_spheres.urdf
  cellwright spherize bracket.stl --unit mm --out bracket.json
  cellwright spherize bracket.stl --curve 5,10,20,40 --out bracket_curve.json
""",
    )
    command.add_argument("subject", metavar="ROBOT.urdf|MESH", help="a URDF or mesh file, or a built-in robot's name")
    command.add_argument(
        "--spheres",
        type=int,
        default=20,
        metavar="N",
        help="spheres of the mesh, or of a link on average (default: 20)",
    )
    command.add_argument(
        "--curve",
        type=_numbers,
        metavar="N,N,...",
        help="measure a mesh's hulls of these numbers of spheres instead; --out writes the metrics and two pictures",
    )
    command.add_argument("--unit", choices=_UNITS, help="unit of a mesh that carries none (default: mm)")
    command.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all random choices (default: 0)")
    command.add_argument(
        "--package",
        action="append",
        default=[],
        metavar="NAME=FOLDER",
        help="folder of a package that the URDF names; may be repeated",
    )
    command.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="write the spherized URDF, with an SRDF beside it, or a mesh's spheres as JSON; and a picture",
    )
    command.add_argument("--lake", metavar="DIR", help=LAKE_HELP)
    command.add_argument(
        "--refresh", action="append", default=[], metavar="STAGE", help="compute this stage although the lake has it"
    )
    command.add_argument("--json", action="store_true", help="print the metrics as JSON, and no progress")
    command.set_defaults(run=run)


def expanded(path: str | Path) -> Path:
    """Return a path with the home folder that it begins with.

    Raises:
        InvalidInputError: If it is the home folder of somebody unknown.
    """
    from cellwright.errors import InvalidInputError

    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise InvalidInputError(
            f"{path} begins with the home folder of somebody unknown here: write the whole path"
        ) from error


def _numbers(text: str) -> list[int]:
    """Return numbers of spheres written with commas between them."""
    try:
        numbers = [int(each) for each in text.split(",")]
    except ValueError:
        numbers = [0]
    if not all(1 <= number <= MOST for number in numbers):
        raise argparse.ArgumentTypeError(f"{text!r} are no numbers from 1 to {MOST} with commas between them")
    return numbers


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    from cellwright.errors import InvalidInputError
    from flows import spherize, spherize_curve
    from flows.progress import stage_progress

    if not 1 <= options.spheres <= MOST or options.seed < 0:
        raise InvalidInputError(
            f"--spheres {options.spheres} --seed {options.seed}: give 1 to {MOST} spheres and a seed from 0 up"
        )
    packages: dict[str, Path] = {}
    for text in options.package:
        name, equals, folder = text.partition("=")
        if not (name and equals and folder):
            raise InvalidInputError(f"--package {text}: write NAME=FOLDER")
        packages[name] = expanded(folder)
    subject, out = str(expanded(options.subject)), None if options.out is None else expanded(options.out)
    if options.curve:
        with stage_progress(quiet=options.json) as (watcher, _):
            curve = spherize_curve.run(
                subject,
                options.curve,
                unit=options.unit,
                seed=options.seed,
                lake=lake_of(options),
                refresh=frozenset(options.refresh),
                out=out,
                watcher=watcher,
            )
        print_summary(curve, as_json=options.json)
        return 0
    with stage_progress(quiet=options.json) as (watcher, _):
        summary = spherize.run(
            subject,
            n_spheres=options.spheres,
            unit=options.unit,
            seed=options.seed,
            packages=packages,
            lake=lake_of(options),
            refresh=frozenset(options.refresh),
            out=out,
            watcher=watcher,
        )
    print_summary(summary, as_json=options.json)
    return 0
