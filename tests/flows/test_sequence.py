"""`cellwright sequence` from the command line: results, files, and what it says of bad input."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from flows import command_line, sequence
from flows.examples import examples, find_cell_file
from schemas.sequence_file import load_sequence_file
from tests.small_sequence import CELL, write_cell


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict[str, Any], str]:
    code = command_line.main(["sequence", *arguments, "--direct", "--json"])
    out, error = capsys.readouterr()
    return code, json.loads(out), error


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("lake"))


def test_a_station_is_sequenced_verified_and_written(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = write_cell(tmp_path)
    code, told, _ = run(capsys, str(cell), "--lake", lake, "--out", str(tmp_path / "out"))
    assert code == 0
    assert sorted(told["summary"]["sequence"]) == ["a", "b", "c", "d"]
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        "report.html", "sequence.mcap", "trajectory.parquet", "segments.parquet", "stops.parquet", "summary.json",
        "path.png", "orders.png", "plan.png",
    }  # fmt: skip
    written = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert written["summary"] == told["summary"]
    assert "<h2>Stages</h2>" in (tmp_path / "out" / "report.html").read_text()


def efforts(path: Path) -> tuple[int, Any]:
    """Return how many joint states of a recording tell an effort, and the efforts of all, read by the mcap library."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        joints = [decoded.joints for *_, decoded in reader.iter_decoded_messages(topics=["/joint_states"])]
    told = sum(joint.HasField("effort") for each in joints for joint in each)
    return told, np.array([[joint.effort for joint in each] for each in joints])


def test_torques_stand_in_table_and_recording_where_dynamics_count(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = write_cell(tmp_path, CELL.replace("  touches:", "  payload: {mass: 4 kg}\n  touches:"))
    weighed, plain = tmp_path / "weighed", tmp_path / "plain"
    assert run(capsys, str(cell), "--lake", lake, "--set", "planner.weights={}", "--out", str(weighed))[0] == 0
    states = pq.read_table(weighed / "trajectory.parquet")
    torque = np.array(states["torque_nm"].to_pylist())
    assert torque.shape == (states.num_rows, 6) and np.isfinite(torque).all() and np.abs(torque).max() > 20.0
    assert states.schema.field("torque_nm").metadata[b"unit"] == b"N m"
    n_told, effort = efforts(weighed / "sequence.mcap")
    assert n_told == torque.size and np.array_equal(effort, torque)

    assert run(capsys, str(cell), "--lake", lake, "--out", str(plain))[0] == 0
    without = pq.read_table(plain / "trajectory.parquet")
    assert [name for name in states.column_names if name != "torque_nm"] == without.column_names
    assert without["position_rad"].equals(states["position_rad"]), "weights price the motion, they do not change it"
    assert efforts(plain / "sequence.mcap")[0] == 0


def test_only_what_changed_is_recomputed(tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]) -> None:
    cell = write_cell(tmp_path)
    run(capsys, str(cell), "--lake", lake)
    _, told, _ = run(capsys, str(cell), "--lake", lake, "--set", "report.notes=again")
    assert {step["name"] for step in told["steps"] if not step["cached"]} == {"write_sequence_report"}


def refused(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str], text: str, *arguments: str
) -> tuple[int, str]:
    code, told, error = run(capsys, str(write_cell(tmp_path, text)), "--lake", lake, *arguments)
    assert told["exit_code"] == code and error == f"error: {told['error']}\n"
    return code, told["error"]


def test_a_task_out_of_reach_is_infeasible_and_named(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text, out = CELL.replace("-300 mm, 100 mm]", "-3000 mm, 100 mm]"), tmp_path / "out"
    code, said = refused(tmp_path, lake, capsys, text, "--out", str(out))
    assert code == 3 and "cannot do task 'a': out of reach" in said and not out.exists()


def test_a_tool_that_collides_at_the_start_is_named_with_the_key_that_mends_it(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said = refused(tmp_path, lake, capsys, CELL.replace("[740 mm, 0 mm, 400 mm]", "[480 mm, -150 mm, 500 mm]"))
    assert code == 2 and "the start configuration collides" in said and "robot.start" in said and "'post'" in said


def test_a_contradiction_in_the_file_stops_before_anything_is_computed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = CELL.replace("direction: [1, 0, 0]}", "direction: [1, 0, 0], after: [d]}", 1)
    code, said = refused(tmp_path, str(tmp_path / "no lake"), capsys, text)
    assert code == 2 and "contradicts itself: 'a' after 'd' after 'a'" in said
    assert not (tmp_path / "no lake").exists()


def test_a_missing_table_of_tasks_is_named(tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = refused(tmp_path, lake, capsys, CELL.replace("  rotations: 4", "  file: holes.csv"))
    assert code == 2 and "holes.csv' does not exist" in said


def test_a_time_limit_is_no_option_of_a_station(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, told, _ = run(capsys, str(write_cell(tmp_path)), "--time-limit", "5")
    assert code == 2 and "planner.max_motions" in told["error"]


def test_the_words_of_stages_become_keys_of_the_file() -> None:
    for field, key in sequence.KEYS.items():
        assert sequence._FIELD.sub(lambda found: sequence.KEYS[found[1]], f"lower {field}") == f"lower {key}"


def test_the_shipped_example_is_valid_and_found_by_its_name() -> None:
    assert "drilling_panel" in examples()
    file = load_sequence_file(find_cell_file("drilling_panel"))
    assert len(file.tasks.list) == 20


def test_the_public_drilling_targets_are_all_reached(tmp_path: Path) -> None:
    import tasks as stages
    from flows.sequence_requests import sequence_request

    cell = Path(__file__).parents[1] / "cells" / "drilling_targets.yaml"
    targets = cell.parents[3] / "shared" / "data" / "sequencing" / "robotsp-245-targets.hdf5"
    if not targets.is_file():
        pytest.skip("the public drilling targets are not beside the project")
    request = sequence_request(load_sequence_file(cell))
    model = stages.assemble_cell((), params=request.cell)
    listed = stages.list_tasks(stages.read_source(params=request.table), params=request.tasks)
    few = request.alternatives.model_copy(update={"max_alternatives": 1})
    found = stages.generate_alternatives(model, listed, params=few)
    assert sorted(set(found.task.tolist())) == list(range(245))


@pytest.mark.flow
def test_prefect_runs_the_same_sequence(tmp_path: Path, lake: str, prefect_server: str) -> None:
    cell = write_cell(tmp_path)
    direct = sequence.run(cell, lake=lake, direct=True)
    by_prefect = sequence.run(cell, lake=str(tmp_path / "lake"))
    assert by_prefect.refs == direct.refs


def test_validate_shows_sequence_and_layout_files_without_planning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "station.png"
    cell = write_cell(tmp_path)
    assert command_line.main(["validate", str(cell), "--picture", str(picture), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["valid"] and told["sequence"]["name"] == "small station" and picture.stat().st_size > 10_000
    assert command_line.main(["validate", "two_machines"]) == 0
    assert "stations" in capsys.readouterr().out


def test_validate_says_what_collides_at_the_start_in_the_words_of_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = write_cell(tmp_path, CELL.replace("[740 mm, 0 mm, 400 mm]", "[480 mm, -150 mm, 500 mm]"))
    assert command_line.main(["validate", str(cell)]) == 2
    assert "robot.start" in capsys.readouterr().err


def test_dynamics_of_a_file_reach_the_stages_that_need_them(tmp_path: Path) -> None:
    from flows.sequence_requests import sequence_request

    text = CELL.replace("  touches:", "  payload: {mass: 4 kg, centre: [0 mm, 0 mm, 50 mm]}\n  touches:")
    cell = write_cell(tmp_path, text)
    weights = "planner.weights={time: 2 /s, torque: 1e-3 /N^2/m^2/s, speed: 0.5 s/rad^2}"
    plain = sequence_request(load_sequence_file(cell))
    assert plain.sequence.dynamics is None and not plain.verification.by_torque
    priced = sequence_request(load_sequence_file(cell, [weights, "planner.steps=12"]))
    weighed = priced.sequence.dynamics
    assert weighed is not None and weighed.payload is not None and weighed.payload.centre_m == (0.0, 0.0, 0.05)
    assert (weighed.time_per_s, weighed.effort, weighed.velocity, weighed.n_steps) == (2.0, 1e-3, 0.5, 12)
    assert not priced.sequence.optimal_motions and priced.verification.payload is None
    optimal = sequence_request(load_sequence_file(cell, ["planner.cost=optimal_control"]))
    assert optimal.sequence.dynamics is not None and optimal.sequence.dynamics.effort == 1e-6
    assert optimal.verification.by_torque and optimal.verification.payload is not None
    assert not optimal.sequence.keep_accelerations and not optimal.verification.keep_accelerations
    both = sequence_request(
        load_sequence_file(cell, ["planner.cost=optimal_control", "planner.keep_accelerations=true"])
    )
    assert both.sequence.keep_accelerations and both.verification.keep_accelerations


def test_a_payload_that_nothing_asks_for_is_told_with_what_asks_for_it(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from flows.sequence_requests import sequence_request

    cell = write_cell(tmp_path, CELL.replace("  touches:", "  payload: {mass: 4 kg}\n  touches:"))
    code, told, _ = run(capsys, str(cell), "--lake", lake)
    assert code == 0 and told["notes"][0].startswith(f"{cell}, tool.payload: 4 kg change nothing")
    assert "write planner.weights" in told["notes"][0]
    assert command_line.main(["sequence", str(cell), "--lake", lake, "--direct"]) == 0
    assert f"warning: {told['notes'][0]}" in capsys.readouterr().err
    assert command_line.main(["validate", str(cell)]) == 0
    assert "tool.payload: 4 kg change nothing" in " ".join(capsys.readouterr().out.split())
    for mend in ("planner.weights={}", "planner.cost=optimal_control", "planner.motions=optimal_control"):
        assert not sequence_request(load_sequence_file(cell, [mend])).notes
    assert not sequence_request(load_sequence_file(write_cell(tmp_path, CELL))).notes


def test_the_terminal_tells_what_the_cost_is_what_was_left_out_and_what_asks_for_too_much(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = CELL.replace("  touches:", "  payload: {mass: 11 kg, centre: [0 mm, 0 mm, 150 mm]}\n  touches:")
    text = text.replace("model: ur10e\n", "model: ur10e\n  max_acceleration: 60 rad/s^2\n")
    cell = write_cell(tmp_path, text)
    weights = "planner.weights={time: 1 /s}"
    asked = [str(cell), "--lake", lake, "--direct", "--set", weights, "--set", "planner.cost=velocity"]
    assert command_line.main(["sequence", *asked]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "ordered by │ the slowest joint at full speed; not the cycle time" in told
    assert "ordering cost: sequence" in told and "further ways of 4 tasks left out untried" in told
    assert "Attention: the largest torque is" in told and "of its limit, since motions in time" in told
