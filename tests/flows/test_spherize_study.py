"""Studies of sphere hulls: a row of metrics for each hull, and the meshes drawn under them."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import trimesh
import yaml
from PIL import Image

from flows import command_line

STUDY: dict[str, Any] = {
    "cellwright-study": 1,
    "flow": "spherize",
    "name": "Boxes",
    "set": {"mesh": "box.stl", "starts": 1},
    "axes": {
        "method": {"certified": {}, "k-means": {"method": "k-means", "inflate": False}},
        "k": {"1": {"spheres": 1}, "4": {"spheres": 4}},
    },
    "figures": [
        {"title": "Hulls", "kind": "hulls", "x": "k", "y": "volume_ratio"},
        {"title": "Volume", "x": "k", "y": "volume_ratio", "lines": "method"},
    ],
}


def swept(folder: Path, **changes: Any) -> int:
    trimesh.creation.box(extents=(120, 80, 60)).export(folder / "box.stl")
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump({**STUDY, **changes}, sort_keys=False))
    return command_line.main(
        ["sweep", str(path), "--direct", "--json", "--lake", str(folder / "lake"), "--out", str(folder / "out")]
    )


def test_a_study_measures_hulls_and_draws_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert swept(tmp_path) == 0
    told = json.loads(capsys.readouterr().out)
    table = pq.read_table(io.BytesIO((tmp_path / "out" / "table.parquet").read_bytes())).to_pylist()
    assert [(row["method"], row["k"], row["n_spheres"]) for row in table] == [
        ("certified", "1", 1), ("certified", "4", 4), ("k-means", "1", 1), ("k-means", "4", 4)
    ]  # fmt: skip
    ours, plain = table[:2], table[2:]
    assert all(row["surface_covered"] and row["interior"] == "covered" and row["gap_max_m"] == 0.0 for row in ours)
    assert not plain[1]["surface_covered"] and ours[1]["volume_ratio"] < ours[0]["volume_ratio"]
    lengths = {f"{what}_{how}_m" for what in ("protrusion", "gap") for how in ("mean", "p95", "max")}
    assert lengths | {"coverage", "overshoot_m", "fit_s", "volume_kind"} <= table[0].keys()
    assert "certified | 4 | 4 | yes | 100.00%" in (tmp_path / "out" / "summary.md").read_text()
    with Image.open(told["files"]["Hulls"]) as picture:
        # a row for each method: the body and two hulls
        assert picture.width > picture.height


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"set": {"mesh": "bix.stl"}}, "bix.stl' does not exist"),
        ({"set": {"mesh": "box.stl", "sphere": 2}}, "unknown key 'sphere': did you mean spheres?"),
        ({"set": {"mesh": "box.stl", "seed": -1}}, "seed"),
        ({"set": {}}, "mesh: is missing"),
        ({"cell": "two_tables"}, "is read by no run of flow: spherize"),
        ({"flow": "layout"}, "cell is missing: name the cell file"),
        ({"flow": "layout", "cell": "two_tables", "axes": {"k": {"1": {}}}}, "kind: hulls, which draws sphere hulls"),
    ],
)
def test_a_malformed_study_stops_before_anything_runs(
    changes: dict[str, Any], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert swept(tmp_path, **changes) == 2
    assert message in capsys.readouterr().err and not (tmp_path / "lake").exists()
