"""Which tasks come before which, by their names: unknown ones, doubled ones and contradictions are said in words."""

from __future__ import annotations

from collections.abc import Sequence

from cellwright.errors import InvalidInputError
from schemas.cell_file_messages import did_you_mean


def order_faults(tasks: Sequence[tuple[str, Sequence[str]]]) -> list[tuple[int, str, str]]:
    """Return what is wrong with names of tasks and of those that come before them: row, ``name`` or ``after``, words.

    Args:
        tasks: Name of each task, and the names of the tasks that come before it.
    """
    first: dict[str, int] = {}
    faults: list[tuple[int, str, str]] = []
    for row, (name, _) in enumerate(tasks):
        if name in first:
            faults.append((row, "name", f"{name!r} names task {first[name] + 1} too: choose another"))
        first.setdefault(name, row)
    for row, (name, after) in enumerate(tasks):
        for other in after:
            if other == name:
                faults.append((row, "after", f"{name!r} cannot come after itself: remove it"))
            elif other not in first:
                faults.append((row, "after", f"{other!r} is no task: {did_you_mean(other, first)}"))
    if not faults:
        loop = _loop({name: list(after) for name, after in tasks})
        if loop:
            words = " after ".join(repr(name) for name in loop)
            faults.append((first[loop[0]], "after", f"contradicts itself: {words}: drop one of these"))
    return faults


def task_order(
    tasks: Sequence[tuple[str, Sequence[str]]], places: Sequence[str] | None = None
) -> list[tuple[int, int]]:
    """Return the pairs (i, j) of tasks, i somewhere before j.

    Args:
        tasks: As for `order_faults`.
        places: Where each task is written, for messages.

    Raises:
        InvalidInputError: If names are not unique or unknown, or they contradict themselves.
    """
    faults = order_faults(tasks)
    if faults:
        row, field, words = faults[0]
        place = f"task {row + 1} ({tasks[row][0]})" if places is None else places[row]
        raise InvalidInputError(f"{place}, {field}: {words}")
    rows = {name: row for row, (name, _) in enumerate(tasks)}
    return sorted((rows[other], row) for row, (_, after) in enumerate(tasks) for other in after)


def _loop(after: dict[str, list[str]]) -> list[str]:
    """Return the names along a contradiction, the first and the last the same; none if there is none."""
    done: set[str] = set()
    for root in after:
        path: list[str] = []
        stack: list[tuple[str, bool]] = [(root, True)]
        while stack:
            name, enters = stack.pop()
            if not enters:
                done.add(path.pop())
                continue
            if name in path:
                return [*path[path.index(name) :], name]
            if name in done:
                continue
            path.append(name)
            stack.append((name, False))
            stack += [(other, True) for other in after[name]]
    return []
