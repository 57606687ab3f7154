from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellwright.errors import InvalidInputError
from schemas.cell_file_sequencing import SequencingSection, WeightsSection
from schemas.sequence_file import SequencePlannerSection, TaskWeightsSection, load_sequence_file
from tests.small_sequence import CELL, write_cell

TASK = "    - {name: a, position: [0 mm, -300 mm, 100 mm], direction: [1, 0, 0]}"


def refusal(folder: Path, old: str = "", new: str = "", *overrides: str) -> str:
    """Return what is said of the small station with one place in its file changed."""
    assert old in CELL
    with pytest.raises(InvalidInputError) as caught:
        load_sequence_file(write_cell(folder, CELL.replace(old, new, 1)), overrides)
    return str(caught.value)


def test_tasks_stand_in_the_parts_frame(tmp_path: Path) -> None:
    file = load_sequence_file(write_cell(tmp_path))
    assert np.allclose(file.T_world_tasks()[:3, 3], [0.8, 0.0, 0.45])
    assert [task.name for task in file.tasks.list] == ["a", "b", "c", "d"]
    assert file.tasks.list[3].after == ("a",) and file.tasks.list[2].dwell_s == 1.0


def test_settings_reach_a_task_by_its_name(tmp_path: Path) -> None:
    file = load_sequence_file(write_cell(tmp_path), ["tasks.list.b.dwell=2 s", "planner.end=anywhere"])
    assert file.tasks.list[1].dwell_s == 2.0 and file.planner.end == "anywhere"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("planner:", "planer:", "unknown key 'planer': did you mean planner?"),
        ("  dwell: 500 ms", "  dwell: 500", "500"),
        ("  approach: 30 mm", "  approach: -30 mm", "must be at least 0"),
        (TASK, TASK.replace("name: a", "name: b"), "'b' names task 1 too"),
        ("after: [a]", "after: [d]", "'d' cannot come after itself"),
        ("after: [a]", "after: [aa]", "'aa' is no task: did you mean a?"),
        (TASK, TASK.replace("0]}", "0], after: d}"), "contradicts itself: 'a' after 'd' after 'a'"),
        (TASK, TASK.replace("[1, 0, 0]", "[0, 0, 0]"), "has no length"),
        (TASK, TASK.replace("[1, 0, 0]", "[.nan, 0, 0]"), "nan"),
        (TASK, TASK.replace(", direction: [1, 0, 0]", ""), "has no direction"),
        (TASK, TASK.replace("direction:", "rotation: [0 deg, 0 deg, 0 deg], direction:"), "direction and rotation"),
        ("touches: [[bit, wall]]", "touches: [[bit, wal]]", "tool.touches.0: 'wal' is no body and no link"),
        ("name: post", "name: bit", "'bit' names another body too"),
        ("  model: ur10e", "  model: ur10", "did you mean ur10e?"),
        ("rotations: 4", "rotations: 0", "must be at least 1"),
        ("cellwright: 1", "cellwright: 2", "this release reads cellwright: 1"),
        ("  frame: part", "  frame: prt", "not one of world, part"),
        ("max_motions: 60", "end: home", "'home' is no end: write return, anywhere"),
        ("max_motions: 60", "end: [0 deg, 0 deg]", "has 2 entries but the robot has 6 joints"),
        ("max_motions: 60", "start: anywhere", "a round trip that starts anywhere has no first task"),
        ("max_motions: 60", "max_motions: true", "true is not a whole number"),
        ("max_motions: 60", "dynamics: {time: 1 /s}", "'dynamics': known are cost, motions, weights, steps"),
        ("max_motions: 60", "weights: {effort: 1 /N^2/m^2/s}", "unknown key 'effort': known are time, torque, speed"),
        ("max_motions: 60", "weights: {velocity: 1 s/rad^2}", "unknown key 'velocity': known are time, torque, speed"),
        (
            "max_motions: 60",
            "weights: {speed: 1}",
            "planner.weights.speed: 1 has no unit but a weight of squared speed needs one",
        ),
        ("max_motions: 60", "steps: 3", "planner.steps: 3 must be at least 4"),
    ],
)
def test_a_fault_names_line_key_value_and_mend(tmp_path: Path, old: str, new: str, words: str) -> None:
    said = refusal(tmp_path, old, new)
    assert words in said
    assert "line " in said or "station.yaml" in said


def test_weights_and_steps_are_written_as_in_a_cell_file() -> None:
    weights = zip(TaskWeightsSection.model_fields.items(), WeightsSection.model_fields.items(), strict=True)
    steps = (("steps", section.model_fields["steps"]) for section in (SequencePlannerSection, SequencingSection))
    for (own, field), (other, cells) in [*weights, (next(steps), next(steps))]:
        assert own == other and field.alias == cells.alias and field.description == cells.description
        assert field.annotation == cells.annotation and field.metadata == cells.metadata
    assert TaskWeightsSection.__doc__ == WeightsSection.__doc__
    assert TaskWeightsSection().speed_s_per_rad2 == 1.0 and WeightsSection().speed_s_per_rad2 == 0.01


def test_a_file_without_tasks_says_what_it_may_be_for(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("cellwright: 1\nscanner: {}\npart: {file: part.stl}\n")
    with pytest.raises(InvalidInputError, match="cellwright inspect"):
        load_sequence_file(tmp_path / "cell.yaml")


def test_an_empty_list_of_tasks_is_refused(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text("cellwright: 1\ntasks: {}\n")
    with pytest.raises(InvalidInputError, match="holds no task"):
        load_sequence_file(tmp_path / "cell.yaml")


def test_tasks_in_the_frame_of_a_part_that_is_not_there_are_refused(tmp_path: Path) -> None:
    (tmp_path / "cell.yaml").write_text(
        "cellwright: 1\ntasks: {frame: part, list: [{name: a, position: [1 m, 0 m, 0 m], direction: [0, 0, 1]}]}\n"
    )
    with pytest.raises(InvalidInputError, match="there is no part"):
        load_sequence_file(tmp_path / "cell.yaml")


def test_a_table_of_another_type_is_refused(tmp_path: Path) -> None:
    (tmp_path / "tasks.xlsx").write_bytes(b"")
    (tmp_path / "cell.yaml").write_text("cellwright: 1\ntasks: {file: tasks.xlsx}\n")
    with pytest.raises(InvalidInputError, match=r"use one of \.csv, \.hdf5, \.h5"):
        load_sequence_file(tmp_path / "cell.yaml")
