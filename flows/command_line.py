"""The command line: ``cellwright inspect | layout | sequence | validate | sweep | lake | server | examples``.

Arguments are read before anything heavy is imported, so that ``--help`` answers at once. An expected error is one
message on standard error and an exit code by its class; an unexpected one keeps its traceback, as it is a bug.
"""

from __future__ import annotations

import argparse
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from cellwright.errors import CellwrightError
from flows import layout_command, sequence_command, spherize_command
from flows.interrupts import FAREWELL, INTERRUPTED, leave_now_if_busy, stopping_at_interrupt
from flows.output import (
    prepare_streams,
    run_writing,
    stderr_console,
    try_json,
    write_error,
    write_json,
)
from flows.subcommands import LAKE_HELP, Parser, add_run_options, add_set, lake_of, print_summary, run_flow

if TYPE_CHECKING:
    from flows.findings import Findings

_EPILOG = """\
examples:
  cellwright inspect examples/grooved_cylinder.yaml
  cellwright inspect cell.yaml --set part.file=bracket.stl --set planner.selection.min_coverage=0.98
  cellwright lake ls

exit codes:
  0  done
  1  the Prefect server does not start or answer, standard output cannot be written, or a bug (with its traceback)
  2  a file, parameter or argument is malformed
  3  the question has no answer: the message says which constraint blocks it
  4  a numerical method stopped short
  5  the lake is missing something, damaged, or cannot be written
  130  interrupted
  141  the reader of standard output went away, as `head` does
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    prepare_streams()

    def command() -> int:
        options = parser().parse_args(arguments)
        with stopping_at_interrupt() as ended:
            return _run(options, ended)

    return run_writing(command)


def _run(options: argparse.Namespace, ended: threading.Event) -> int:
    try:
        return int(options.run(options))
    except CellwrightError as error:
        notes = list(getattr(error, "__notes__", ()))
        write_error("\n".join([f"error: {error}", *(f"note: {note}" for note in notes)]) + "\n")
        if getattr(options, "json", False):
            found = getattr(options, "findings", None)
            told = {} if found is None else {"findings": found.as_json()}
            told |= {"notes": notes} if notes else {}
            try_json({"error": str(error), "exit_code": error.exit_code, **told})
        return error.exit_code
    except KeyboardInterrupt:
        ended.set()
        write_error(FAREWELL)
        leave_now_if_busy(INTERRUPTED)
        return INTERRUPTED


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    whole = Parser("cellwright", "Plan robot cells: from a part file and a cell file to a verified scan.", _EPILOG)
    whole.add_argument("--version", action=_Version)
    commands = whole.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=Parser)
    _add_inspect(commands)
    _add_validate(commands)
    layout_command.add_parser(commands)
    spherize_command.add_parser(commands)
    sequence_command.add_parser(commands)
    _add_sweep(commands)
    _add_lake(commands)
    _add_server(commands)
    examples = commands.add_parser("examples", help="list the built-in examples, each with the command that takes it")
    examples.add_argument("--json", action="store_true", help="print JSON")
    examples.set_defaults(run=_examples)
    return whole


class _Version(argparse.Action):
    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="print the version")

    def __call__(self, parser: argparse.ArgumentParser, *ignored: Any) -> NoReturn:
        from importlib.metadata import version  # 20 ms that --help need not wait for

        parser.exit(0, f"cellwright {version('cellwright')}\n")


def _add_inspect(commands: Any) -> None:
    command = commands.add_parser(
        "inspect",
        help="plan a laser-scan inspection and verify it",
        description="Plan a laser-scan inspection of the part in a cell file, verify it, and report what it sees.",
        epilog="""\
examples:
  cellwright inspect grooved_cylinder
  cellwright inspect cell.yaml --out results --seed 7
  cellwright inspect cell.yaml --set planner.sampling.density="0.005 /mm^2" --refresh select_views
""",
    )
    command.add_argument("cell", metavar="CELL.yaml", help="the cell file, or the name of a built-in example")
    add_set(command)
    command.add_argument(
        "--seed", type=int, metavar="N", help="seed of samples, selection, roadmap and noise (planner.seed)"
    )
    command.add_argument("--out", type=Path, metavar="DIR", help="write report, plan and figures into this folder")
    add_run_options(command)
    command.set_defaults(run=_inspect)


def _add_validate(commands: Any) -> None:
    command = commands.add_parser(
        "validate",
        help="check a cell file, layout file or sequence file and show what it says",
        description="Check a file without planning anything: read all it names, look whether the robot may start "
        "there and whether everything can stand where it is put, and show the cell. Layout files and sequence files "
        "are told apart by what they hold.",
        epilog="examples:\n  cellwright validate cell.yaml --set part.unit=in\n"
        "  cellwright validate cell.yaml --picture cell.png\n",
    )
    command.add_argument("cell", metavar="FILE.yaml", help="the file, or the name of a built-in example")
    add_set(command)
    command.add_argument(
        "--picture",
        type=Path,
        metavar="FILE.png",
        help="draw the cell too, also where bodies collide at the start",
    )
    command.add_argument("--json", action="store_true", help="print the whole cell as JSON, in SI units")
    command.set_defaults(run=_validate)


def _add_sweep(commands: Any) -> None:
    command = commands.add_parser(
        "sweep",
        help="run a flow over a grid of parameters and draw the picture",
        description="Run the flow of a study file over its grid; runs share every stage that does not differ.",
        epilog="example:\n  cellwright sweep studies/coverage_vs_density.yaml --out results\n",
    )
    command.add_argument("study", metavar="STUDY.yaml", type=Path, help="the study file")
    command.add_argument("--out", type=Path, metavar="DIR", help="write table and figures into this folder")
    add_run_options(command)
    command.set_defaults(run=_sweep)


def _add_lake(commands: Any) -> None:
    lake = commands.add_parser("lake", help="look into the lake, check it, sweep it")
    actions = lake.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=Parser)
    for action, argument, meaning, example in _LAKE_COMMANDS:
        command = actions.add_parser(
            action, help=meaning, description=f"{meaning[0].upper()}{meaning[1:]}.", epilog=f"example:\n  {example}\n"
        )
        if argument:
            command.add_argument("subject", metavar=argument.upper())
        if action == "verify":
            command.add_argument(
                "--repair", action="store_true", help="set aside what is damaged, so that the next run makes it anew"
            )
        if action == "gc":
            command.add_argument("--yes", action="store_true", help="delete it; without this only say what would go")
            command.add_argument(
                "--keep-runs",
                type=int,
                metavar="N",
                help="first forget all recorded runs but the newest N that finished and the newest N that did not; "
                "none younger than a day",
            )
        command.add_argument("--lake", metavar="DIR", help=LAKE_HELP)
        command.add_argument("--json", action="store_true", help="print JSON")
        command.set_defaults(run=_lake, action=action, subject=None)


_LAKE_COMMANDS = (
    ("ls", "", "list the artefacts, the newest last", "cellwright lake ls --json"),
    ("runs", "", "list the runs, the newest last: finished, failed or interrupted", "cellwright lake runs"),
    ("show", "ref", "show one artefact: columns, units, facts, causes, files, origin", "cellwright lake show coverage"),
    ("lineage", "ref", "list everything an artefact was made from", "cellwright lake lineage trajectory"),
    (
        "sql",
        "query",
        "ask a question in SQL over the tables of all artefacts",
        'cellwright lake sql "SELECT kind, count(*) FROM manifests GROUP BY kind"',
    ),
    ("verify", "", "check every file in the lake against its hash", "cellwright lake verify"),
    (
        "gc",
        "",
        "find what no run reaches any more, and delete it on request",
        "cellwright lake gc --keep-runs 10 --yes",
    ),
)


def _add_server(commands: Any) -> None:
    server = commands.add_parser(
        "server",
        help="start, stop or look at this machine's Prefect server",
        description="The server that shows runs in a browser. Commands that need it start it by themselves, once.",
    )
    actions = server.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=Parser)
    for action, meaning in (
        ("start", "start the server, or find the running one, and print its address"),
        ("stop", "stop the server"),
        ("status", "say whether it runs, and where"),
    ):
        command = actions.add_parser(action, help=meaning, description=f"{meaning[0].upper()}{meaning[1:]}.")
        command.add_argument("--json", action="store_true", help="print JSON")
        command.set_defaults(run=_server, action=action)


def _inspect(options: argparse.Namespace) -> int:
    from flows.examples import find_cell_file
    from schemas.cell_file import load_cell_file

    overrides = [*options.overrides, *([] if options.seed is None else [f"planner.seed={options.seed}"])]
    cell = load_cell_file(find_cell_file(options.cell), overrides)  # a mistake shows before a server is started

    def explain(found: Findings) -> None:
        options.findings = found
        if not options.json:
            found.show(stderr_console())

    return run_flow("inspection", options, cell, explain=explain)


def _sweep(options: argparse.Namespace) -> int:
    return run_flow("study", options, options.study)


def _validate(options: argparse.Namespace) -> int:
    from flows.caches import use_own_caches
    from flows.cell_summary import CellSummary
    from flows.examples import find_cell_file
    from flows.file_summary import checked_layout, checked_sequence, kind_of
    from schemas.cell_file import load_cell_file

    path = find_cell_file(options.cell)
    kind = kind_of(path)
    if kind != "cell":
        use_own_caches()
        check = checked_sequence if kind == "sequence" else checked_layout
        print_summary(check(path, options.overrides, options.picture), as_json=options.json)
        return 0
    cell = load_cell_file(path, options.overrides)
    from flows.cell_picture import check_cell

    use_own_caches()
    stands = check_cell(cell, options.picture)
    summary = CellSummary(cell, options.picture, stands.attention, stands.note)
    print_summary(summary, as_json=options.json)
    return 0


def _lake(options: argparse.Namespace) -> int:
    from flows import lake_commands

    return lake_commands.run(
        options.action,
        lake_of(options),
        subject=options.subject,
        delete=getattr(options, "yes", False),
        keep_runs=getattr(options, "keep_runs", None),
        repair=getattr(options, "repair", False),
        as_json=options.json,
    )


def _server(options: argparse.Namespace) -> int:
    from flows import server_commands

    return server_commands.run(options.action, as_json=options.json)


def _examples(options: argparse.Namespace) -> int:
    from flows.examples import commands, examples

    taken, files = commands(), examples()
    if options.json:
        write_json({name: {"command": taken[name], "file": str(path)} for name, path in files.items()})
    else:
        width = max((len(f"{command} {name}") for name, command in taken.items()), default=0)
        for name, path in files.items():
            sys.stdout.write(f"cellwright {f'{taken[name]} {name}':{width}}  {path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
