"""Find the examples that come with cellwright, in a checkout and in an installed wheel, and the cell files of users."""

from __future__ import annotations

import difflib
from pathlib import Path

import cellwright
from cellwright.errors import InvalidInputError, listed

COMMANDS = {"cell": "inspect", "layout": "layout", "sequence": "sequence"}
"""The command by the kind of file that it takes."""


def examples_folder() -> Path:
    """Return the folder of the built-in examples: inside the installed package, else beside it in the checkout."""
    package = Path(cellwright.__file__).parent
    installed = package / "examples"
    return installed if installed.is_dir() else package.parent / "examples"


def examples() -> dict[str, Path]:
    """Return the built-in example cell files by name."""
    return {path.stem: path for path in sorted(examples_folder().glob("*.yaml"))}


def commands() -> dict[str, str]:
    """Return the command that takes each built-in example, by the example's name."""
    from flows.file_summary import kind_of

    return {name: COMMANDS[kind_of(path)] for name, path in examples().items()}


def find_cell_file(text: str) -> Path:
    """Return the file that a person means: a path, else the name of a built-in example.

    Raises:
        InvalidInputError: If there is neither.
    """
    path = Path(text).expanduser()
    if path.exists():
        return path
    known = examples()
    name = path.name.removesuffix(".yaml")
    if name in known and (text in (name, f"{name}.yaml", f"examples/{name}.yaml")):
        return known[name]
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean the example {near[0]!r}?" if near else f"the built-in examples are {_offered()}"
    raise InvalidInputError(f"there is no cell file {text}: {hint}")


def _offered() -> str:
    """Return all examples, each with the command that takes it."""
    taken = commands()
    return "; ".join(
        f"{listed([name for name in taken if taken[name] == command], 12)} ({command})"
        for command in COMMANDS.values()
        if command in taken.values()
    )
