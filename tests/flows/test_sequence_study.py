"""Studies of sequences: rows, and the table beside published figures."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader

from flows import command_line, sequence_study
from schemas.study_file import load_study_file
from tests.small_sequence import CELL, write_cell

PUBLISHED = {"order": "by slowest joint", "weighted_cost": 12.5}


def study_file(folder: Path) -> Path:
    few = [line for line in CELL.splitlines() if "name: c," not in line and "name: d," not in line]
    write_cell(folder, "\n".join(few) + "\n")
    data = {
        "cellwright-study": 1,
        "flow": "sequence",
        "name": "Orders",
        "cell": "station.yaml",
        "set": {
            "planner.weights": {"torque": "1e-4 /N^2/m^2/s"},
            "planner.max_motions": 4,
            "planner.roadmap_nodes": 60,
            "planner.max_alternatives": 2,
        },
        "axes": {
            "order": {
                "by slowest joint": {"planner.cost": "velocity"},
                "nowhere": {"planner.clearance": "450 mm"},
            }
        },
        "figures": [{"title": "Cost", "x": "order", "y": "weighted_cost"}],
        "published": [PUBLISHED],
    }
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def test_a_study_prices_sequences_and_keeps_failures_as_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["sweep", str(study_file(tmp_path)), "--direct", "--json"]
    code = command_line.main([*words, "--lake", str(tmp_path / "lake"), "--out", str(tmp_path / "out")])
    told = json.loads(capsys.readouterr().out)
    assert code == 0 and len(told["rows"]) == 2
    row, failed = told["rows"]
    parts = [row[f"weighted_{name}"] for name in ("travel", "strokes", "holding")]
    assert sum(parts) == pytest.approx(row["weighted_cost"])
    whole = [row[f"weighted_{name}"] for name in ("time", "torque", "speed")]
    assert sum(whole) == pytest.approx(row["weighted_cost"]) and row["weighted_time"] == pytest.approx(
        row["duration_s"]
    )
    assert failed["error"]
    page = (tmp_path / "out" / "summary.md").read_text()
    assert "| published |" in page and "12.5" in page
    assert (tmp_path / "out" / "figure_1_weighted_cost.png").stat().st_size > 5_000
    assert [path.name for path in (tmp_path / "out").glob("*.mcap")] == ["run_1_by_slowest_joint.mcap"]
    with (tmp_path / "out" / "run_1_by_slowest_joint.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.statistics is not None
    seconds = 1e-9 * (summary.statistics.message_end_time - summary.statistics.message_start_time)
    assert seconds == pytest.approx(row["duration_s"], abs=0.01)


def test_the_table_shows_what_rows_have(tmp_path: Path) -> None:
    study = load_study_file(study_file(tmp_path))
    rows = [
        {"order": "by slowest joint", "error": "", "duration_s": 3.0, "cost": 2.5, "weighted_cost": 14.0},
        {"order": "nowhere", "error": "no way"},
    ]
    page = sequence_study.summary_page(study, rows)
    lines = page.splitlines()
    assert lines[2] == "| order | total | cycle, s | cost |"
    assert lines[4:] == [
        "| by slowest joint | 14.0 | 3.00 | 2.50 |",
        "| published | 12.5 | – | – |",
        "| nowhere | – | – | – |",
    ]
