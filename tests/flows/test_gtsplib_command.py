"""`cellwright sequence FILE.gtsp`: cost, bound, gap and tour of a GTSPLIB file."""

from __future__ import annotations

import io
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellwright.solvers.gtsp.gtsplib import format_gtsplib
from cellwright.solvers.gtsp.problem import SequencingProblem
from flows import command_line
from flows.gtsplib_command import telling

PUBLIC = Path(__file__).parents[3] / "shared" / "data" / "gtsp" / "39rat195.gtsp"


def write_problem(folder: Path) -> tuple[Path, SequencingProblem]:
    cost = np.random.default_rng(4).integers(1, 100, (12, 12)).astype(float)
    problem = SequencingProblem(cost, tuple(np.arange(3 * k, 3 * k + 3) for k in range(4)))
    path = folder / "small.gtsp"
    path.write_text(format_gtsplib(problem))
    return path, problem


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict[str, Any]]:
    code = command_line.main(["sequence", *arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_the_tour_costs_what_is_printed_and_is_written_as_tsplib(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, problem = write_problem(tmp_path)
    code, told = run(capsys, str(path), "--out", str(tmp_path / "small.tour"))
    nodes = [node - 1 for node in told["tour"]]
    assert code == 0 and told["proven"] and problem.violation(nodes) is None
    assert problem.cost_of(nodes) == told["cost"] == told["lower_bound"]
    lines = (tmp_path / "small.tour").read_text().splitlines()
    begin = lines.index("TOUR_SECTION") + 1
    assert [int(word) for word in lines[begin:-2]] == told["tour"] and lines[-2:] == ["-1", "EOF"]


def test_people_read_cost_bound_and_tour(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, _ = write_problem(tmp_path)
    assert command_line.main(["sequence", str(path)]) == 0
    out = capsys.readouterr().out
    assert "proven cheapest" in out and "tour: " in out


def test_a_time_limit_returns_the_best_tour_with_its_gap(capsys: pytest.CaptureFixture[str]) -> None:
    if not PUBLIC.is_file():
        pytest.skip("the public GTSPLIB files are not beside the project")
    code, told = run(capsys, str(PUBLIC), "--time-limit", "0.5")
    assert code == 0 and 854 <= told["cost"] <= 1000 and told["lower_bound"] <= 854
    assert len(told["tour"]) == 39 == len(set(told["sets"]))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("missing.gtsp",), "there is no GTSPLIB file missing.gtsp"),
        (("small.gtsp", "--time-limit", "0"), "give seconds above 0"),
        (("small.gtsp", "--time-limit", "nan"), "give seconds above 0"),
        (("small.gtsp", "--seed", "-1"), "at least 0"),
        (("small.gtsp", "--set", "planner.seed=1"), "leave it out"),
        (("small.gtsp", "--out", "."), "is a folder"),
    ],
)
def test_a_wrong_option_is_named(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_problem(tmp_path)
    code, told = run(capsys, *arguments)
    assert code == 2 and words in told["error"]


def test_a_damaged_file_is_named_with_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, _ = write_problem(tmp_path)
    path.write_text(path.read_text().replace("TYPE : AGTSP", "TYPE : GTSP"))
    code, told = run(capsys, str(path))
    assert code == 2 and "TYPE is GTSP, but" in told["error"] and "line 2" in told["error"]


def test_a_place_that_cannot_be_written_is_named_before_the_search(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cellwright.solvers.sequencing.solve_sequence", None)  # nothing may be searched
    path, _ = write_problem(tmp_path)
    assert command_line.main(["sequence", str(path), "--out", str(path / "tour.txt")]) == 2
    assert f"cannot write into {path}" in capsys.readouterr().err


def test_the_problem_itself_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, _ = write_problem(tmp_path)
    before = path.read_bytes()
    code, told = run(capsys, str(path), "--out", str(path))
    assert code == 2 and "is the GTSPLIB file itself" in told["error"] and path.read_bytes() == before


def test_a_search_that_takes_long_says_now_and_then_that_it_lives() -> None:
    said = io.StringIO()
    with telling("a.gtsp", 60.0, said, first_word_s=0.01, next_word_s=0.02):
        waited = time.monotonic()
        while said.getvalue().count("\n") < 2 and time.monotonic() - waited < 10.0:
            time.sleep(0.005)
    told = said.getvalue().splitlines()
    assert len(told) >= 2 and all(line == "a.gtsp: searching for 0 s of 60 s at most" for line in told)
    quick = io.StringIO()
    with telling("a.gtsp", None, quick):
        pass
    assert quick.getvalue() == ""


def test_the_bound_of_a_problem_of_whole_numbers_is_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cost = np.random.default_rng(4).integers(1, 100, (120, 120)).astype(float)
    problem = SequencingProblem(cost, tuple(np.arange(4 * k, 4 * k + 4) for k in range(30)))
    path = tmp_path / "larger.gtsp"
    path.write_text(format_gtsplib(problem))
    code, told = run(capsys, str(path), "--time-limit", "0.6")
    assert code == 0 and not told["proven"] and told["lower_bound"] > 0
    assert told["lower_bound"] == int(told["lower_bound"]) <= told["cost"]
