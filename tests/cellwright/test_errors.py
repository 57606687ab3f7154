"""Errors: one class for each thing that a person or a runner does next."""

from __future__ import annotations

import pickle

import pytest

from cellwright import errors
from cellwright.causes import Cause
from cellwright.errors import CellwrightError, listed

CLASSES = [errors.InvalidInputError, errors.InfeasibleError, errors.SolverError, errors.LakeError]


def test_exit_codes_are_those_that_the_command_line_promises() -> None:
    assert [kind.exit_code for kind in CLASSES] == [2, 3, 4, 5]
    assert len({kind.exit_code for kind in (*CLASSES, CellwrightError)}) == 5


@pytest.mark.parametrize("kind", [*CLASSES, CellwrightError])
def test_an_error_crosses_a_process_boundary_whole(kind: type[CellwrightError]) -> None:
    sent = pickle.loads(pickle.dumps(kind("views reach 91.2% of the samples: add tilts")))
    assert type(sent) is kind
    assert str(sent) == "views reach 91.2% of the samples: add tilts"


@pytest.mark.parametrize(
    ("n", "text"),
    [(0, ""), (1, "0"), (5, "0, 1, 2, 3, 4"), (6, "0, 1, 2, 3, 4 and 1 more"), (9, "0, 1, 2, 3, 4 and 4 more")],
)
def test_long_lists_are_cut_at_five(n: int, text: str) -> None:
    assert listed(iter(range(n))) == text


def test_causes_keep_their_numbers_which_lakes_hold() -> None:
    assert [cause.label for cause in Cause] == [
        "none", "field of view", "incidence", "uncertainty", "emitter occluded", "detector occluded", "out of reach",
        "joint limit", "collision", "joint speed", "too short", "not selected", "not scanned", "not connected",
    ]  # fmt: skip
    assert [int(cause) for cause in Cause] == list(range(14))
