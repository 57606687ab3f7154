from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from flows.inspection import RESELECTIONS, connect_sweeps
from flows.requests import InspectionRequest, request_of

EXAMPLE = Path(__file__).parents[2] / "examples" / "grooved_cylinder.yaml"


class Chain:
    """Stands for the steps of a flow and their lake; after round k trajectories leave ``n_left_out[k]`` views out."""

    def __init__(self, *n_left_out: int) -> None:
        self.n_left_out = n_left_out
        self.ran: list[str] = []
        self.min_sweeps: list[int] = []
        self.earlier: list[Any] = []

    def __call__(self, stage: Any, params: Any, label: str = "", **inputs: Any) -> Any:
        name = f"{stage.name} {label}".strip()
        self.ran.append(name)
        made = SimpleNamespace(name=name, ref=lambda: name)
        self.earlier.append(inputs.get("earlier"))
        if stage.name == "stitch_sweeps":
            self.min_sweeps.append(params.min_sweeps)
        return made

    def load(self, name: str) -> Any:
        number = int(name.split()[-1]) - 1 if "round" in name else 0
        return SimpleNamespace(left_out_view=range(self.n_left_out[number]))


def connected(*n_left_out: int) -> tuple[str, str, Chain]:
    chain: Any = Chain(*n_left_out)
    request: InspectionRequest = request_of(EXAMPLE, [])
    inputs: Any = [None, None, None, None, None, SimpleNamespace(name="first selection")]
    selection: Any
    trajectory: Any
    selection, trajectory = connect_sweeps(chain, request, request.stitching, chain, *inputs)
    return selection.name, trajectory.name, chain


def test_without_trouble_there_is_one_stitching_and_no_second_selection() -> None:
    selection, trajectory, chain = connected(0)
    assert (selection, trajectory) == ("first selection", "stitch_sweeps")
    assert chain.ran == ["stitch_sweeps"]


def test_what_is_left_out_is_not_selected_again() -> None:
    selection, trajectory, chain = connected(2, 2)
    assert chain.ran == ["stitch_sweeps", "select_views without unconnected, round 2", "stitch_sweeps round 2"]
    assert (selection, trajectory) == (chain.ran[1], chain.ran[2])
    assert [earlier and earlier.name for earlier in chain.earlier] == [None, "stitch_sweeps", "stitch_sweeps"]


@pytest.mark.parametrize("last", [4, 5])
def test_after_some_rounds_the_plan_stands_with_what_it_leaves_out(last: int) -> None:
    _, trajectory, chain = connected(1, 2, 3, last)
    assert trajectory == f"stitch_sweeps round {RESELECTIONS + 1}"
    assert sum(name.startswith("stitch_sweeps") for name in chain.ran) == RESELECTIONS + 1
    assert chain.min_sweeps == [0] * RESELECTIONS + [1]
