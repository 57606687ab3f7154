from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flows.requests import InspectionRequest, request_of
from flows.selection_rounds import RESELECTIONS, Candidates, Choice, connect_sweeps
from tests.tasks import plan_artefacts as plan

EXAMPLE = Path(__file__).parents[2] / "examples" / "grooved_cylinder.yaml"
ROUNDS = ["stitch_sweeps", *(f"stitch_sweeps round {number}" for number in range(2, RESELECTIONS + 2))]


@dataclass(frozen=True)
class Round:
    """What one round executes and leaves out; view v measures sample v alone, if no other entries are given."""

    executed: tuple[int, ...]
    left_out: tuple[int, ...] = ()


@dataclass
class Chain:
    """Stands for the steps of a flow and their lake."""

    rounds: tuple[Round, ...]
    ran: list[str] = field(default_factory=list)
    min_sweeps: list[int] = field(default_factory=list)
    earlier: list[str | None] = field(default_factory=list)
    made: dict[str, Any] = field(default_factory=dict)

    def __call__(self, stage: Any, params: Any, label: str = "", **inputs: Any) -> Any:
        name = f"{stage.name} {label}".strip()
        self.ran.append(name)
        before = inputs.get("earlier")
        self.earlier.append(before and before.name)
        if stage.name == "stitch_sweeps":
            self.min_sweeps.append(params.min_sweeps)
            now = self.rounds[len(self.min_sweeps) - 1]
            replaced = [view for number in range(len(self.min_sweeps) - 1) for view in self.rounds[number].left_out]
            self.made[name] = plan.changed(
                plan.trajectory(),
                view=np.resize(np.array(now.executed or (-1,), np.int32), 4),
                left_out_view=np.array(now.left_out, np.int32),
                left_out_reason=("walled in",) * len(now.left_out),
                replaced_view=np.array(replaced, np.int32),
                replaced_reason=("walled in",) * len(replaced),
            )
        return made(name)

    def load(self, name: str) -> Any:
        if name == "measurable":
            views = np.arange(10, dtype=np.int32)
            return SimpleNamespace(view=views, sample=views, cause=np.zeros(10, np.int8))
        return self.made[name]


def made(name: str) -> Any:
    return SimpleNamespace(name=name, ref=lambda: name)


def connected(*rounds: Round) -> tuple[str, str, Chain]:
    chain: Any = Chain(rounds)
    request: InspectionRequest = request_of(EXAMPLE, [])
    candidates = Candidates(*(made(name) for name in ("cell", "mesh", "surroundings", "viewpoints", "reachability")))
    choice = Choice(made("first selection"), made("measurable"))
    found: Any = connect_sweeps(chain, request, chain, candidates, choice, request.stitching)
    selection, trajectory, _ = found
    return selection.name, trajectory.name, chain


def test_without_trouble_there_is_one_stitching_and_no_second_selection() -> None:
    selection, trajectory, chain = connected(Round((0, 1)))
    assert (selection, trajectory) == ("first selection", "stitch_sweeps")
    assert chain.ran == ["stitch_sweeps"]


def test_what_is_left_out_is_not_selected_again() -> None:
    selection, trajectory, chain = connected(Round((0,), (1,)), Round((0, 2)))
    assert chain.ran == ["stitch_sweeps", "select_views without unconnected, round 2", "stitch_sweeps round 2"]
    assert (selection, trajectory) == (chain.ran[1], chain.ran[2])
    assert chain.earlier == [None, "stitch_sweeps", "stitch_sweeps"]


@pytest.mark.parametrize(
    ("rounds", "kept"),
    [
        ((Round((0, 1, 2), (3,)), Round((0, 1), (4,)), Round((0,), (5,)), Round((0, 1), (6,))), 0),
        ((Round((0,), (3,)), Round((0, 1, 2), (4,)), Round((0, 1), (5,)), Round((0, 1), (6,))), 1),
        ((Round((0, 1), (3,)), Round((0, 2), (4,)), Round((0, 1)), Round(())), 2),
        ((Round((0, 1), (3, 4)), Round((0, 2), (5,)), Round((1, 2), (6,)), Round((0,), (7,))), 1),
        ((Round((0,), (3,)), Round((1,), (4,)), Round((2,), (5,)), Round((1, 2), (6,))), 3),
    ],
    ids=["the first", "the most samples", "nothing left out", "the earliest with the fewest left out", "the last"],
)
def test_the_round_whose_executed_sweeps_measure_most_is_kept(rounds: tuple[Round, ...], kept: int) -> None:
    selection, trajectory, _ = connected(*rounds)
    assert trajectory == ROUNDS[kept]
    wanted = f"select_views without unconnected, round {kept + 1}" if kept else "first selection"
    assert selection == wanted


def test_only_where_no_round_executes_anything_the_last_one_must() -> None:
    _, _, chain = connected(Round((), (0,)), Round((), (1,)), Round((), (2,)), Round((3,), (4,)))
    assert chain.min_sweeps == [0] * RESELECTIONS + [1]
    _, trajectory, chain = connected(Round((8,), (0,)), Round((), (1,)), Round((), (2,)), Round((), (3,)))
    assert (trajectory, chain.min_sweeps) == ("stitch_sweeps", [0] * (RESELECTIONS + 1))


def test_nothing_is_selected_again_where_every_view_has_been_left_out_and_a_plan_is_there() -> None:
    _, trajectory, chain = connected(Round((0,), tuple(range(1, 10))), Round((), (0,)))
    assert trajectory == "stitch_sweeps"
    assert len(chain.min_sweeps) == 2
