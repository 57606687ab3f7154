"""`cellwright spherize`: spheres that hold a robot or a mesh, with their metrics, from the lake the second time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cellwright.cell.urdf_tree import parse_urdf
from flows import command_line

METRICS = {"coverage", "interior", "volume_ratio", "overshoot_m"} | {
    f"{what}_{how}_m" for what in ("protrusion", "gap") for how in ("mean", "p95", "max")
}


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("spherize") / "lake")


def said(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, str, str]:
    """Run a command; return its exit code and what it wrote."""
    code = command_line.main(list(map(str, words)))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_a_robot_comes_out_as_a_urdf_of_spheres(tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "arm.urdf"
    words = ("spherize", "pr_robot", "--spheres", "2", "--lake", lake, "--out", out, "--json")
    code, text, _ = said(capsys, *words)
    told = json.loads(text)
    assert code == 0 and all(row["surface_covered"] for row in told["bodies"])
    assert METRICS <= told["bodies"][0].keys() == json.loads((tmp_path / "arm.json").read_text())["links"][0].keys()
    tree = parse_urdf(out.read_text())
    spheres = [shape for link in tree.links.values() for shape in link.iterfind("collision/geometry/sphere")]
    assert len(spheres) == sum(row["n_spheres"] for row in told["bodies"])
    assert {path.name for path in tmp_path.iterdir()} == {"arm.urdf", "arm.srdf", "arm.json", "arm.png"}
    code, text, _ = said(capsys, *words[:-1])
    assert code == 0 and "From the lake." in text


def test_a_mesh_comes_out_as_spheres_that_hold_it(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import trimesh

    box = trimesh.creation.box(extents=(120, 80, 60))
    box.export(tmp_path / "box.stl")
    out = tmp_path / "box.json"
    code, _, _ = said(capsys, "spherize", tmp_path / "box.stl", "--spheres", "3", "--lake", lake, "--out", out)
    plain = json.loads(out.read_text())
    spheres = plain["spheres"]
    assert plain.keys() >= METRICS and plain["gap_max_m"] == 0.0 < plain["protrusion_p95_m"] < plain["protrusion_max_m"]
    centres, radii = np.array([s["centre_m"] for s in spheres]), np.array([s["radius_m"] for s in spheres])
    points = 1e-3 * box.sample(500, seed=0)
    assert code == 0 and len(spheres) == 3
    assert (np.linalg.norm(points[:, None] - centres, axis=2) <= radii).any(axis=1).all()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["scarra"], "'scarra' is no file and no built-in robot: did you mean scara?"),
        (["part.doc"], "part.doc is of no known kind"),
        (["missing.stl"], "missing.stl does not exist"),
        (["missing.urdf"], "missing.urdf cannot be read"),
        (["scara", "--spheres", "0"], "give 1 to 200 spheres"),
        (["scara", "--out", "a.json"], "--out a.json is of another kind: name a .urdf or .xml file"),
        (["part.step", "--unit", "mm"], "part.step"),
        (["scara", "--package", "x"], "--package x: write NAME=FOLDER"),
        (["scara", "--spheres", "100000"], "give 1 to 200 spheres"),
        (["scara", "--curve", "2"], "--curve measures one mesh, and scara is a robot"),
        (["box.stl", "--curve", "2", "--out", "a.urdf"], "--out a.urdf is of another kind: name a .json file"),
    ],
)
def test_what_cannot_be_covered_is_named(
    words: list[str],
    message: str,
    tmp_path: Path,
    lake: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, error = said(capsys, "spherize", *words, "--lake", lake)
    assert code == 2 and message in error and "Traceback" not in error


def test_paths_may_begin_with_the_home_folder(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import trimesh

    monkeypatch.setenv("HOME", str(tmp_path))
    trimesh.creation.box(extents=(120, 80, 60)).export(tmp_path / "box.stl")
    code, _, error = said(capsys, "spherize", "~/box.stl", "--spheres", "1", "--lake", lake, "--out", "~/out.json")
    assert code == 0 and not error.count("error:") and (tmp_path / "out.json").is_file()
    code, _, error = said(capsys, "spherize", "~nobody-knows/box.stl", "--lake", lake)
    assert code == 2 and "the home folder of somebody unknown here" in error


def test_a_robot_whose_mesh_is_missing_hears_of_packages(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = "<mesh filename='package://arm/meshes/a.stl'/>"
    urdf = f"<robot name='r'><link name='a'><collision><geometry>{mesh}</geometry></collision></link></robot>"
    (tmp_path / "r.urdf").write_text(urdf)
    code, _, error = said(capsys, "spherize", tmp_path / "r.urdf", "--lake", lake)
    assert code == 2 and "a.stl' was not found" in error and "--package NAME=FOLDER" in error


BARE = "<robot name='bare'><link name='a'/><link name='b'/><joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint></robot>"  # noqa: E501


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("garbage.stl", b"\x00\xff" * 80, "garbage.stl"),
        ("empty.stl", b"", "empty.stl"),
        ("garbage.obj", b"v 1 2\nf 1 2 9\n", "garbage.obj"),
        ("bare.urdf", BARE.encode(), "has no collision geometry to cover: add <collision> to its links"),
        ("garbage.urdf", b"<robot", "garbage.urdf"),
        ("binary.urdf", b"\xff\xfe\x00", "binary.urdf is not a URDF"),
    ],
)
def test_a_malformed_file_is_one_clear_error(
    name: str, content: bytes, message: str, tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(content)
    code, _, error = said(capsys, "spherize", tmp_path / name, "--lake", lake)
    told = [line for line in error.splitlines() if line.startswith("error:")]
    assert code == 2 and len(told) == 1 and message in told[0] and "Traceback" not in error


@pytest.mark.parametrize("numbers", ["5,0", "a", "3,,4", "201"])
def test_a_curve_over_no_numbers_is_a_wrong_call(numbers: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        said(capsys, "spherize", "box.stl", "--curve", numbers)
    assert ended.value.code == 2 and "numbers from 1 to 200" in capsys.readouterr().err


def test_a_mesh_with_an_edge_of_three_faces_is_covered_too(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    fan = "v 0 0 0\nv 100 0 0\nv 0 80 0\nv 0 -80 0\nv 0 0 60\nf 1 2 3\nf 1 2 4\nf 1 2 5\n"
    (tmp_path / "fan.obj").write_text(fan)
    code, text, _ = said(capsys, "spherize", tmp_path / "fan.obj", "--spheres", "3", "--lake", lake, "--json")
    (row,) = json.loads(text)["bodies"]
    assert code == 0 and row["surface_covered"] and row["interior"] == "none"


def test_a_curve_holds_the_mesh_with_every_number_and_draws_it(
    tmp_path: Path, lake: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import trimesh

    trimesh.creation.box(extents=(120, 80, 60)).export(tmp_path / "box.stl")
    out = tmp_path / "curve.json"
    words = ("spherize", tmp_path / "box.stl", "--curve", "4,1,4", "--lake", lake, "--out", out)
    code, _, _ = said(capsys, *words)
    rows = json.loads(out.read_text())["hulls"]
    assert code == 0 and [row["n_spheres"] for row in rows] == [1, 4]
    assert all(row["surface_covered"] and row["coverage"] == 1.0 and row["gap_max_m"] == 0.0 for row in rows)
    # one sphere about a box is its circumscribed ball
    ball = 4.0 / 3.0 * np.pi * (0.5 * np.linalg.norm([120.0, 80.0, 60.0])) ** 3 / (120.0 * 80.0 * 60.0)
    assert rows[0]["volume_ratio"] == pytest.approx(ball, rel=0.01) and rows[1]["volume_ratio"] < ball
    assert {path.name for path in tmp_path.iterdir()} >= {"curve.json", "curve.png", "curve_metrics.png"}
