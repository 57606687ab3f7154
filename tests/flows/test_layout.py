"""`cellwright layout`: a gated layout with its report, or one message that says what blocks it and by how much."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import yaml

from flows import command_line, layout
from flows.execution import Unwatched
from schemas.layout_file import load_layout_file
from storage.lake import Lake
from tests.every_stage import LAYOUT
from tests.small_layout import CYCLE_S, document, gripper_urdf, gripping, table, write_layout

FAR = {"harness": None, "pose": {"position": ["1.5 m", "0 m", "0 m"]}}
ROBOT = document()["robot"]


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("layout") / "lake")


def said(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, str, str]:
    """Run a command; return its exit code and what it wrote."""
    code = command_line.main(list(map(str, words)))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_a_layout_is_optimised_recorded_and_reported(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results"
    words = ("layout", write_layout(tmp_path), "--direct", "--lake", lake, "--out", out, "--json")
    code, text, _ = said(capsys, *words)
    told = json.loads(text)
    assert code == 0 and told["summary"]["cycle_s"] == pytest.approx(CYCLE_S, rel=2e-3)
    assert told["cpu_s"] > 0.0
    names = {"report.html", "layout.mcap", "layout.parquet", "motion.parquet", "starts.parquet", "summary.json"}
    assert {path.name for path in out.iterdir()} == names | {"layout.png", "motion.png", "starts.png"}
    assert "It was not timed" not in (out / "report.html").read_text()
    assert told["run_id"] in (out / "report.html").read_text()
    assert pq.read_table(out / "layout.parquet")["design"].to_pylist() == ["blue.around", "red.around"]


def test_the_second_time_everything_comes_from_the_lake(tmp_path: Path, lake: str) -> None:
    file = load_layout_file(write_layout(tmp_path))
    layout.run(file, lake=lake, direct=True)
    again = layout.run(file, lake=lake, direct=True)
    assert all(record.cached for record in again.records)
    assert again.cpu_s is not None and again.cpu_s > 0.0


def test_settings_and_seed_are_laid_over_the_file(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_layout(tmp_path)
    code, text, _ = said(
        capsys, "layout", path, "--direct", "--lake", lake, "--json", "--seed", "3", "--set", "solver.starts=1"
    )
    assert code == 0 and json.loads(text)["summary"]["starts"] == 1


def test_links_and_bodies_get_certified_hulls(tmp_path: Path, lake: str) -> None:
    result = layout.run(write_layout(tmp_path, **LAYOUT), lake=lake, direct=True)
    assert {"robot", "hulls", "layout", "recording", "report"} == set(result.refs)
    hull: Any = Lake(lake).load(result.refs["robot"])
    assert hull.surface_covered.all()


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        (
            {"stations": [table("blue"), table("red", **FAR)]},
            3,
            ["none of 2 starts passed its gate", "red is out of reach (relax it by 3", "move or free what is named"],
        ),
        (
            {"walls": [{"name": "east", "normal": [-1, 0, 0], "offset": "-0.5 m"}],
             "stations": [table("blue"), table("red", harness=None, pose={"position": ["0.9 m", "0 m", "0 m"]})]},
            3,
            ["east and red overlap (relax it by 6"],
        ),
        (
            # the harness keeps both in front of the robot, the wall behind it
            {"walls": [{"name": "west", "normal": [-1, 0, 0], "offset": "0.4 m", "holds_robot": False}],
             "stations": [table(name, harness={"joints": [
                 {"turn": "z", "range": ["-20 deg", "20 deg"]}, {"offset": {"position": ["0.9 m", "0 m", "0 m"]}}]})
                 for name in ("blue", "red")]},
            3,
            ["west and ", "overlap (relax it by "],
        ),
        (
            {"solver": {"begin": "placed"}},
            2,
            ["overlaps where it is placed", "blue and red overlap by 0.4 m", "smallest change found that clears it: "],
        ),
        (
            {"stations": [table("blue", harness={"planar": {"x": ["1 m", "-1 m"]}}), table("red")]},
            2,
            ["stations.0.harness.planar.x", "is reversed, from 1 m to -1 m, its lower end 2000 mm above its upper end"],
        ),
        (
            {"robot": {**ROBOT, "upper": ["-200 deg", "0.8 m"]}},
            2,
            ["robot.upper", "joint 'joint_r' has lower limit", "move them apart by more than"],
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_is_named_with_its_measure(
    tmp_path: Path,
    lake: str,
    capsys: pytest.CaptureFixture[str],
    changes: dict[str, Any],
    code: int,
    words: list[str],
) -> None:
    found, _, error = said(capsys, "layout", write_layout(tmp_path, **changes), "--direct", "--lake", lake)
    assert found == code and "error: " in error
    for word in words:
        assert word in error, error
    assert "Traceback" not in error


def test_a_relaxation_that_nobody_looked_for_is_not_spoken_of(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_layout(tmp_path, stations=[table("blue"), table("red", **FAR)], solver={"starts": 1, "extras": False})
    out = tmp_path / "out"
    code, _, error = said(capsys, "layout", path, "--direct", "--lake", lake, "--out", str(out))
    assert code == 3 and "can be served" not in error and not out.exists()
    assert "red is not met by 0.3" in error and "set solver.extras to true" in error


def test_fingers_that_no_layout_moves_do_not_block_it(tmp_path: Path, lake: str) -> None:
    (tmp_path / "arm.urdf").write_text(gripper_urdf())
    result = layout.run(write_layout(tmp_path, **gripping()), lake=lake, direct=True)
    assert result.summary["converged"] and result.summary["cycle_s"] < 1.0


def test_a_robot_without_its_meshes_is_left_out_of_the_recording_and_said_so(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm.urdf").write_text(gripper_urdf(mesh="gone.stl"))
    path = write_layout(tmp_path, **gripping(hull={"model": "point"}))
    code, text, error = said(capsys, "layout", path, "--direct", "--lake", lake, "--json")
    assert code == 0, error
    told = json.loads(text)
    assert any("without the robot" in note and "gone.stl" in note for note in told["notes"])
    code, _, error = said(capsys, "layout", write_layout(tmp_path, **gripping()), "--direct", "--lake", lake)
    assert code == 2 and "'gone.stl' was not found" in error and "model: point" in error


@pytest.mark.parametrize("model", ["point", "links"])
def test_a_malformed_mesh_of_the_robot_is_an_error(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str], model: str
) -> None:
    (tmp_path / "arm.urdf").write_text(gripper_urdf(mesh="upper.stl"))
    (tmp_path / "upper.stl").write_text("solid this is none")
    path = write_layout(tmp_path, **gripping(hull={"model": model}))
    code, _, error = said(capsys, "layout", path, "--direct", "--lake", lake)
    assert code == 2 and "link 'upper'" in error and "upper.stl" in error and "Traceback" not in error


def test_each_question_names_the_other(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, error = said(capsys, "inspect", "four_stations", "--direct")
    assert code == 2 and "describes a cell layout, not an inspection: run cellwright layout" in error
    code, _, error = said(capsys, "inspect", "drilling_panel", "--direct")
    assert code == 2 and "lists tasks at poses, not an inspection: run cellwright sequence" in error
    code, _, error = said(capsys, "layout", "grooved_cylinder", "--direct")
    assert code == 2 and "describes an inspection, not a layout: run cellwright inspect" in error


def test_an_attempt_hands_back_what_missed_its_gate(tmp_path: Path, lake: str) -> None:
    path = write_layout(tmp_path, stations=[table("blue"), table("red", **FAR)], solver={"starts": 1})
    result = layout.run(path, lake=lake, direct=True, attempt=True, watcher=Unwatched())
    assert not result.summary["converged"] and result.report is None
    assert result.summary["tracking_m"] > 0.05


def test_a_study_of_layouts_has_a_row_for_every_start(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_layout(tmp_path)
    study = {
        "cellwright-study": 1,
        "name": "Small",
        "flow": "layout",
        "cell": "layout.yaml",
        "set": {"solver.starts": 1, "solver.extras": False},
        "axes": {"place": {"near": {}, "far": {"stations.1": table("red", **FAR)}}},
        "seeds": 2,
        "figures": [
            {"title": "Cloud", "kind": "cloud", "x": "cpu_s", "y": "cycle_s", "lines": "place"},
            {"title": "Best", "kind": "best_of_n", "x": "seed", "y": "cycle_s", "lines": "place"},
            {"title": "Miss", "x": "place", "y": "tracking_m"},
        ],
        "published": [{"place": "near", "cpu_s": 1.0, "cycle_s": 0.7}],
    }
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(study, sort_keys=False))
    out = tmp_path / "out"
    code, text, _ = said(capsys, "sweep", tmp_path / "study.yaml", "--direct", "--lake", lake, "--out", out)
    assert code == 0 and "2/2" in text and "0/2" in text and "published" in text
    rows = pq.read_table(out / "table.parquet").to_pylist()
    assert [(row["place"], row["seed"]) for row in rows] == [("near", "0"), ("near", "1"), ("far", "0"), ("far", "1")]
    assert all(row["cycle_s"] == pytest.approx(CYCLE_S, rel=2e-3) and not row["error"] for row in rows[:2])
    assert all(row["cycle_s"] is None and row["error"] and row["tracking_m"] > 0.05 for row in rows[2:])
    assert (out / "summary.md").read_text().count("|") > 20
    assert len(list(out.glob("figure_*.png"))) == 3
