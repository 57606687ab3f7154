"""Errors of stages end in a line of the cell file."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import tasks
from cellwright.errors import InfeasibleError, SolverError, UnsafePlanError
from flows.cell_keys import _KEY, KEYS, METHODS, _values, with_keys
from flows.examples import find_cell_file
from schemas.cell_file import CellFile, load_cell_file
from schemas.stage import Stage
from tests.flows.conftest import PROJECT

NOT_SETTABLE = {
    "base_link",
    "flange_link",
    "max_exact_checks",
    "weld_tolerance_m",
    "up_part",
}
"""Fields that the cell file leaves at their defaults, that flows fill in, or whose names are also those of links."""

EXAMPLE = find_cell_file("grooved_cylinder")


@pytest.fixture(scope="module")
def cell() -> CellFile:
    return load_cell_file(EXAMPLE, ["planner.reachability.clearance=6 mm", "robot.max_velocity=[90 deg/s]"])


def test_a_parameter_becomes_the_key_with_its_value_and_the_file(cell: CellFile) -> None:
    error = with_keys(InfeasibleError("no way to sweep 3: raise roadmap_nodes, lower clearance_m, or move it"), cell)
    assert type(error) is InfeasibleError
    assert str(error) == (
        "no way to sweep 3: raise planner.stitching.roadmap_nodes, lower planner.reachability.clearance, or move it "
        f"(in {EXAMPLE}: planner.stitching.roadmap_nodes = 1000 by default; planner.reachability.clearance = 6 mm)"
    )


def test_a_key_in_the_message_gets_its_value_too(cell: CellFile) -> None:
    error = with_keys(SolverError("lower planner.sampling.density."), cell)
    assert str(error).endswith("(in " + str(EXAMPLE) + ": planner.sampling.density = 0.005 /mm^2)")


def test_lists_and_what_is_not_set_are_written_as_in_the_file(cell: CellFile) -> None:
    said = str(with_keys(InfeasibleError("raise max_velocity_rad_s, node_limit or standoff_m"), cell))
    assert "robot.max_velocity = [90 deg/s]; " in said
    assert "planner.selection.node_limit = not set by default" in said
    assert "planner.viewpoints.standoffs = [best] by default" in said


def test_the_method_is_that_of_the_stage(cell: CellFile) -> None:
    error = InfeasibleError("too many sweeps: use `method` best")
    for stage, key in METHODS.items():
        assert f"use {key} best" in str(with_keys(error, cell, stage))
    assert with_keys(error, cell, "read_source").args[0].startswith("too many sweeps: use method best")


@pytest.mark.parametrize("text", ["part.stl is empty: export it again", "a robot of the table", "see planner.stl"])
def test_a_message_without_keys_stays_as_it_is(text: str, cell: CellFile) -> None:
    error = InfeasibleError(text)
    assert with_keys(error, cell) is error


def test_the_moment_at_which_a_plan_fails_and_the_notes_stay_with_the_error() -> None:
    error = UnsafePlanError("it touches: plan again with more clearance_m", 1.5)
    error.add_note("seen in a picture")
    told = with_keys(error, load_cell_file(EXAMPLE))
    assert isinstance(told, UnsafePlanError) and "planner.reachability.clearance" in str(told)
    assert (told.time_s, told.__notes__) == (1.5, ["seen in a picture"])


def test_every_key_exists_and_has_a_value(cell: CellFile) -> None:
    for key in (*KEYS.values(), *METHODS.values()):
        assert list(_values(cell, key)), key


def inspecting() -> list[Stage]:
    """Return the stages whose parameters come from this kind of cell file: behind the report stand other flows'."""
    names = list(tasks.STAGES)
    return [tasks.STAGES[name] for name in (*names[: names.index("write_report") + 1], "explain_samples")]


def test_every_field_that_an_error_names_has_a_key() -> None:
    fields = {name for stage in inspecting() for name in stage.params_class.model_fields if "_" in name}
    named: dict[str, str] = {}
    for folder in ("tasks", "cellwright"):
        for path in sorted((PROJECT / folder).rglob("*.py")):
            for text in _raised(path):
                named |= dict.fromkeys(re.findall(r"(?<![\w.])\w+_\w+(?![\w.(])", text), f"{path}: {text}")
    without = {name: where for name, where in named.items() if name in fields - KEYS.keys() - NOT_SETTABLE}
    assert not without
    assert {"clearance_m", "min_coverage", "start_rad"} <= named.keys(), "the search finds nothing any more"


def test_no_stage_names_a_key_of_the_cell_file(cell: CellFile) -> None:
    def keys_in(texts: list[str]) -> set[str]:
        return {key for text in texts for key in _KEY.findall(text) if any(_values(cell, key))}

    named = {
        path.name: keys
        for folder in ("tasks", "cellwright")
        for path in sorted((PROJECT / folder).rglob("*.py"))
        if (keys := keys_in(_texts(path)))
    }
    assert not named, "use the parameters' names: the flow writes the keys"
    seen = {"planner.sampling.density", "robot.start"}
    assert keys_in(["lower planner.sampling.density or", "choose another robot.start, or"]) == seen


def test_what_was_noted_on_an_error_stays_with_it(cell: CellFile) -> None:
    error = InfeasibleError("lower clearance_m")
    error.add_note("explaining it failed: no space left")
    told = with_keys(error, cell)
    assert told is not error
    assert told.__notes__ == ["explaining it failed: no space left"]


def _texts(path: Path) -> list[str]:
    """Return all texts of a module but its docstrings."""
    tree = ast.parse(path.read_text())
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone
    ]


def _raised(path: Path) -> list[str]:
    raises = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Raise)]
    return [
        each.value
        for node in raises
        for each in ast.walk(node)
        if isinstance(each, ast.Constant) and isinstance(each.value, str)
    ]
