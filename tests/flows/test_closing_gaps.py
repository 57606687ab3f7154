from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from flows.requests import InspectionRequest, request_of
from flows.selection_rounds import Candidates, Choice, close_gaps

EXAMPLE = Path(__file__).parents[2] / "examples" / "grooved_cylinder.yaml"


@dataclass(frozen=True)
class Made:
    """What a stage made, by name: its own reference, and its own artefact in the lake."""

    name: str
    n_gaps: int = 0

    def ref(self) -> Made:
        return self


class Chain:
    """Stands for the steps of a flow and their lake; the selection of round k leaves ``n_gaps[k]`` gaps."""

    def __init__(self, *n_gaps: int) -> None:
        self.n_gaps = n_gaps
        self.ran: list[str] = []

    def __call__(self, stage: Any, params: Any, label: str = "", **inputs: Any) -> Made:
        self.ran.append(f"{stage.name} {label}".strip())
        if stage.name == "find_gaps":
            return Made("gaps", self.n_gaps[len(inputs["earlier"])])
        return Made(self.ran[-1])

    def load(self, made: Made) -> Any:
        return SimpleNamespace(point=range(made.n_gaps))


def closed(rounds: int, *n_gaps: int) -> tuple[str, list[str]]:
    """Return the selection that is kept, and what ran."""
    chain: Any = Chain(*n_gaps)
    request: InspectionRequest = request_of(EXAMPLE, [f"planner.refinement.rounds={rounds}"])
    made: Any = {name: Made(name) for name in ("cell", "mesh", "surroundings", "viewpoints", "reachability")}
    first: Any = Made("first selection"), Made("measurable")
    choice: Any = close_gaps(chain, request, chain, Candidates(**made), Choice(*first))
    kept, made_of = choice.selection.ref(), choice.measurable.ref()
    assert made_of.name == kept.name.replace("select_views", "extend_measurability").replace(
        "first selection", "measurable"
    )
    return kept.name, chain.ran


@pytest.mark.parametrize(
    ("n_gaps", "kept"),
    [
        ((19, 17, 19, 2), "select_views round 3"),
        ((56, 48, 4, 25), "select_views round 2"),
        ((3, 9, 9, 9), "first selection"),
        ((5, 4, 4, 4), "select_views round 1"),
    ],
)
def test_the_selection_with_the_fewest_gaps_is_kept_and_the_earliest_of_several(
    n_gaps: tuple[int, ...], kept: str
) -> None:
    assert closed(3, *n_gaps)[0] == kept


def test_rounds_end_when_no_gap_is_left() -> None:
    kept, ran = closed(3, 7, 0)
    assert kept == "select_views round 1"
    assert [name for name in ran if name.startswith("find_gaps")] == ["find_gaps round 1", "find_gaps round 2"]


def test_without_rounds_nothing_is_done() -> None:
    assert closed(0) == ("first selection", [])
