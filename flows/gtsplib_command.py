"""Solve a GTSPLIB file from the command line: cost, bound, gap, tour."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from cellwright.errors import InvalidInputError
from flows.progress import FIRST_WORD_S, NEXT_WORD_S
from flows.result_folder import prepare_folder, write_files
from flows.subcommands import print_summary

if TYPE_CHECKING:
    from rich.console import Console

    from cellwright.solvers.gtsp.problem import SequencingResult

UNLIMITED_ROUNDS = 10**9
SHARE_OF_PROOF, SHARE_OF_BOUNDS = 0.9, 0.4
"""Share of the time limit after which work on the bound ends, where a proof is likely and where it is not."""
STOPS = {"stop": "the time limit", "work": "the limit of work", "memory": "the limit of memory"}
"""What ended the search, in words."""


@dataclass(frozen=True)
class SolvedFile:
    """A solved GTSPLIB file, ready to be shown; nodes and sets are counted from 1, as in the file."""

    file: Path
    result: SequencingResult
    seconds: float
    tour_file: Path | None

    def as_json(self) -> Mapping[str, Any]:
        """Return the result as plain values."""
        result = self.result
        return {
            "file": str(self.file),
            "cost": result.cost,
            "lower_bound": result.lower_bound,
            "gap": result.gap,
            "proven": result.proven,
            "stopped_by": result.stopped_by,
            "seconds": self.seconds,
            "tour": [int(node) + 1 for node in result.nodes],
            "sets": [int(cluster) + 1 for cluster in result.clusters],
            "tour_file": None if self.tour_file is None else str(self.tour_file),
        }

    def show(self, console: Console) -> None:
        """Print cost, bound and tour."""
        result = self.result
        stopped = STOPS.get(result.stopped_by, result.stopped_by)
        proof = "proven cheapest" if result.proven else f"gap {result.gap:.2%}, stopped by {stopped}"
        console.print(f"{self.file.name}: cost {result.cost:g}, lower bound {result.lower_bound:g} ({proof})")
        console.print(f"found in {self.seconds:.1f} s")
        console.print(f"tour: {' '.join(str(int(node) + 1) for node in result.nodes)}", soft_wrap=True)
        if self.tour_file is not None:
            console.print(f"written: {self.tour_file}", soft_wrap=True)


def solve_file(options: argparse.Namespace) -> int:
    """Read and solve a GTSPLIB file, print the tour, write it if asked for; return the exit code.

    Raises:
        InvalidInputError: If the file or an option is malformed, or the tour cannot be written.
    """
    import numpy as np

    from cellwright.solvers.gtsp.gtsplib import read_gtsplib
    from cellwright.solvers.sequencing import DEFAULT_ROUNDS, EXACT_UP_TO, solve_sequence
    from flows.caches import use_own_caches

    if options.overrides:
        raise InvalidInputError("--set lays settings over a sequence file, and a GTSPLIB file has none: leave it out")
    limit, seed = options.time_limit, 0 if options.seed is None else options.seed
    if limit is not None and not (limit > 0.0 and math.isfinite(limit)):
        raise InvalidInputError(f"--time-limit {limit:g}: give seconds above 0, a finite number, or leave it out")
    if seed < 0:
        raise InvalidInputError(f"--seed {seed}: give a whole number of at least 0")
    use_own_caches()
    path = Path(options.file).expanduser()
    if not path.is_file():
        raise InvalidInputError(f"there is no GTSPLIB file {path}: check the path")
    problem = read_gtsplib(path)
    if options.out is not None and options.out.is_dir():
        raise InvalidInputError(f"--out {options.out} is a folder: name the file that the tour is written to")
    if options.out is not None:
        if options.out.exists() and options.out.samefile(path):
            raise InvalidInputError(f"--out {options.out} is the GTSPLIB file itself: name another file for the tour")
        prepare_folder(options.out.parent)
    begun = time.monotonic()
    share = SHARE_OF_PROOF if problem.n_clusters <= EXACT_UP_TO else SHARE_OF_BOUNDS
    with contextlib.nullcontext() if options.json else telling(path.name, limit):
        result = solve_sequence(
            problem,
            np.random.default_rng(seed),
            n_rounds=DEFAULT_ROUNDS if limit is None else UNLIMITED_ROUNDS,
            stop=None if limit is None else lambda: time.monotonic() - begun > limit,
            stop_bounds=None if limit is None else lambda: time.monotonic() - begun > share * limit,
        )
    seconds = time.monotonic() - begun
    if options.out is not None:
        write_files(options.out.parent, {options.out.name: _tour_text(path, result).encode()})
    print_summary(SolvedFile(path, result, seconds, options.out), as_json=options.json)
    sys.stdout.flush()
    return 0


@contextlib.contextmanager
def telling(
    name: str,
    limit: float | None,
    stream: TextIO | None = None,
    first_word_s: float = FIRST_WORD_S,
    next_word_s: float = NEXT_WORD_S,
) -> Iterator[None]:
    """Write a line to ``stream`` (standard error if left out) now and then while the block lasts, so that it is alive.

    ``limit`` is the time limit in s, which the line names; the first line comes after ``first_word_s``, the next ones
    every ``next_word_s``.
    """
    stream = stream or sys.stderr
    ended, begun = threading.Event(), time.monotonic()
    of = "" if limit is None else f" of {limit:g} s at most"

    def tell() -> None:
        wait = first_word_s
        while not ended.wait(wait):
            with contextlib.suppress(OSError, ValueError):  # nobody reads it: no reason to stop
                print(f"{name}: searching for {time.monotonic() - begun:.0f} s{of}", file=stream, flush=True)
            wait = next_word_s

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        ended.set()
        teller.join()


def _tour_text(path: Path, result: SequencingResult) -> str:
    """Return the tour in the words of TSPLIB: nodes counted from 1, -1 at the end."""
    lines = [
        f"NAME : {path.stem}.tour",
        f"COMMENT : cost {result.cost:g}, lower bound {result.lower_bound:g}",
        "TYPE : TOUR",
        f"DIMENSION : {len(result.nodes)}",
        "TOUR_SECTION",
        *(str(int(node) + 1) for node in result.nodes),
        "-1",
        "EOF",
    ]
    return "\n".join(lines) + "\n"
