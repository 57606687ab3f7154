"""Every error that cellwright raises on purpose, classed by what the runner and the person do next.

A message is the fact with its numbers, then the mend. Errors pickle, so they cross process boundaries whole.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar


class CellwrightError(Exception):
    """Base of all expected errors; ``exit_code`` is what the command line returns for it."""

    exit_code: ClassVar[int] = 1


class InvalidInputError(CellwrightError):
    """A file, parameter or artefact is malformed. Never retried."""

    exit_code = 2


class InfeasibleError(CellwrightError):
    """The question is well posed and has no answer: a finding, with the constraint that blocks it."""

    exit_code = 3


class UnsafePlanError(InfeasibleError):
    """A finished plan fails its verification; ``time_s`` is the moment of its motion, if the check has one."""

    def __init__(self, message: str, time_s: float | None = None) -> None:
        super().__init__(message)
        self.time_s = time_s


class SolverError(CellwrightError):
    """A numerical method stopped short; another start may work."""

    exit_code = 4


class LakeError(CellwrightError):
    """An artefact is missing, unreadable, or does not match its digest. Retried, then final."""

    exit_code = 5


def listed(items: Iterable[object], most: int = 5) -> str:
    """Join items for an error message, cut after ``most`` of them.

    >>> listed(["a", "b", "c"], most=2)
    'a, b and 1 more'
    """
    texts = [str(item) for item in items]
    shown = ", ".join(texts[:most])
    return shown if len(texts) <= most else f"{shown} and {len(texts) - most} more"
