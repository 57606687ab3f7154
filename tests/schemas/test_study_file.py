"""A study file: its grid is every combination, and a mistake in it shows before anything runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from cellwright.errors import InvalidInputError
from schemas.cell_file import load_cell_file
from schemas.hull_trial import hull_trial
from schemas.layout_file import load_layout_file
from schemas.sequence_file import load_sequence_file
from schemas.study_file import grid, load_study_file

PROJECT = Path(__file__).parents[2]
STUDIES = sorted((PROJECT / "studies").glob("*.yaml"))

PLAIN: dict[str, Any] = {
    "cellwright-study": 1,
    "name": "Small",
    "cell": "grooved_cylinder",
    "set": {"planner.refinement.rounds": 0, "planner.seed": 5},
    "axes": {
        "tilting": {"off": {"planner.viewpoints.theta_tilt": ["0 deg"]}, "on": None},
        "seed": {0: {"planner.seed": 0}, 1: {"planner.seed": 1}, 2: {}},
    },
    "figures": [{"title": "Sweeps", "x": "seed", "y": "sweeps", "lines": "tilting"}],
    "published": [{"tilting": "off", "seed": 0, "sweeps": 7}],
}


def write(tmp_path: Path, **changes: Any) -> Path:
    path = tmp_path / "study.yaml"
    path.write_text(yaml.safe_dump({**PLAIN, **changes}, sort_keys=False))
    return path


def test_the_grid_is_every_combination_the_last_axis_fastest(tmp_path: Path) -> None:
    points = grid(load_study_file(write(tmp_path)))
    assert [tuple(point.point.values()) for point in points] == [
        ("off", "0"), ("off", "1"), ("off", "2"), ("on", "0"), ("on", "1"), ("on", "2"),
    ]  # fmt: skip


def test_a_point_lays_its_settings_over_those_of_the_study(tmp_path: Path) -> None:
    points = grid(load_study_file(write(tmp_path)))
    assert points[0].overrides == (
        "planner.refinement.rounds=0", "planner.seed=0", "planner.viewpoints.theta_tilt=[0 deg]",
    )  # fmt: skip
    assert points[-1].overrides == ("planner.refinement.rounds=0", "planner.seed=5")


@pytest.mark.parametrize(
    "value",
    [
        "2 mm",
        "yes",
        "1e3",
        "on",
        "a: b",
        "[x",
        "é",
        "a # b",
        {"box": {"size": ["1 m", "2 m", "3 m"]}},
        None,
        1.5,
        ["a", 3],
    ],
)
def test_a_value_means_in_a_setting_what_it_means_in_the_file(tmp_path: Path, value: Any) -> None:
    study = load_study_file(write(tmp_path, set={"part.thing": value}))
    text = grid(study)[0].overrides[0].removeprefix("part.thing=")
    assert "\n" not in text
    assert yaml.safe_load(text) == value


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cellwright-study": 2}, "cellwright-study"),
        ({"axis": {}}, "axis.*did you mean axes"),
        ({"axes": {}}, "axes"),
        ({"axes": {"seed": {}}}, "axes.seed has no points: add one"),
        ({"axes": {"seed": ["0", "1"]}}, "axes.seed"),
        ({"axes": {"sweeps": {"a": {}}}, "figures": [], "published": []}, "axes.sweeps is named like a column"),
        (
            {"figures": [{"title": "T", "x": "sed", "y": "sweeps"}]},
            "'T' has x: sed, which is no axis: use one of tilting, seed",
        ),
        ({"figures": [{"title": "T", "x": "seed", "y": "sweep"}]}, "y: sweep, which is no column: did you mean sweeps"),
        ({"figures": [{"title": "T", "x": "seed", "y": "sweeps", "scale": "ln"}]}, r"figures\[?\.?0.*scale"),
        ({"published": [{"seed": 7, "sweeps": 3}]}, "seed: 7 is no point of that axis: use one of 0, 1, 2"),
        ({"published": [{"seed": 0, "sweep": 3}]}, "sweep is neither an axis nor a column: did you mean sweeps"),
        ({"published": [{"seed": 0, "sweeps": "many"}]}, "sweeps: 'many' is no number"),
        ({"name": ""}, "name"),
        (
            {"axes": {axis: {str(n): {} for n in range(300)} for axis in "abc"}, "figures": [], "published": []},
            "axes make 27000000 runs, but a study has at most 10000: remove points",
        ),
    ],
)
def test_a_mistake_is_named_with_its_place_and_mend(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message) as caught:
        load_study_file(write(tmp_path, **changes))
    assert "study.yaml" in str(caught.value)
    assert "cell file" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "a: [", "\x00"])
def test_a_file_that_is_no_study_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(text)
    with pytest.raises(InvalidInputError, match=r"study\.yaml") as caught:
        load_study_file(path)
    assert "cell file" not in str(caught.value)
    with pytest.raises(InvalidInputError, match=r"study file .*nowhere"):
        load_study_file(tmp_path / "nowhere.yaml")


def test_seconds_of_a_stage_are_a_column(tmp_path: Path) -> None:
    figures = [{"title": "T", "x": "seed", "y": "follow_sweeps [s]"}]
    assert load_study_file(write(tmp_path, figures=figures)).figures[0].y == "follow_sweeps [s]"


LOADERS = {"inspect": load_cell_file, "layout": load_layout_file, "sequence": load_sequence_file}


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_every_point_of_a_shipped_study_is_a_valid_cell_file(path: Path) -> None:
    study = load_study_file(path)
    points = grid(study)
    assert len({point.overrides for point in points}) == len(points)
    for point in points:
        if study.flow == "spherize":
            hull_trial(path, point.overrides)
        else:
            LOADERS[study.flow](PROJECT / "examples" / f"{study.cell}.yaml", point.overrides)


def test_the_paper_study_spans_the_paper() -> None:
    points = grid(load_study_file(PROJECT / "studies" / "coverage_vs_density.yaml"))
    axes = {axis: {point.point[axis] for point in points} for axis in points[0].point}
    assert axes["density"] >= {"0.001 /mm²", "0.005 /mm²", "0.01 /mm²"}
    assert axes["tilting"] == {"off", "on"}
    assert axes["method"] == {"random", "blue noise"}
    assert len(axes["seed"]) >= 3
    # the verification cloud is the same density everywhere, or coverages could not be compared
    cell = PROJECT / "examples" / "grooved_cylinder.yaml"
    densities = {
        round(planner.sampling.density_per_m2 * planner.verification_cloud.density_factor)
        for planner in (load_cell_file(cell, point.overrides).planner for point in points)
    }
    assert densities == {100_000}


def test_seeds_are_a_last_axis(tmp_path: Path) -> None:
    axes = {"tilting": PLAIN["axes"]["tilting"]}
    study = load_study_file(write(tmp_path, axes=axes, seeds=3))
    assert list(study.axes) == ["tilting", "seed"]
    found = [next(text for text in point.overrides if "seed" in text) for point in grid(study)]
    assert found == ["planner.seed=0", "planner.seed=1", "planner.seed=2"] * 2
    with pytest.raises(InvalidInputError, match=r"axes\.seed and seeds are both given: keep one"):
        load_study_file(write(tmp_path, seeds=2))


def test_columns_are_those_of_the_flow(tmp_path: Path) -> None:
    figures = [{"title": "Cycles", "kind": "cloud", "x": "cpu_s", "y": "cycle_s", "lines": "tilting"}]
    assert load_study_file(write(tmp_path, flow="layout", figures=figures, published=[])).flow == "layout"
    with pytest.raises(InvalidInputError, match="has y: cycle_s, which is no column"):
        load_study_file(write(tmp_path, figures=[{**figures[0], "x": "sweeps"}], published=[]))
