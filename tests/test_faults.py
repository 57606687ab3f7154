"""What bad input and broken surroundings come to: one error that says what to mend, the right code, nothing torn."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import httpx
import pytest

from cellwright.cell.parametric_parts import plate_with_pocket, stl_bytes
from cellwright.cell.scene import Scene
from cellwright.errors import InvalidInputError
from flows import command_line, server
from flows.requests import request_of
from schemas.cell_objects import build_cell
from schemas.scanner import ScannerParams
from schemas.sources import SourceFile
from storage.lake import Lake
from tasks.assemble_cell import assemble_cell
from tasks.preprocess_mesh import MeshParams, preprocess_mesh
from tasks.read_source import SourceParams, read_source
from tasks.simulate_scan import _check_number_of_rays
from tests.small_inspection import CELL, write_cell

PLATE = stl_bytes(plate_with_pocket())
MALFORMED, NO_ANSWER, LAKE = 2, 3, 5
PARTS = Path(__file__).parents[2] / "shared" / "data" / "parts"


POST_AROUND_THE_BASE = (
    "obstacles=[{name: post, cylinder: {radius: 100 mm, length: 500 mm}, pose: {position: [0 m, 0 m, 0.2 m]}}]"
)


@dataclass(frozen=True)
class Bench:
    """A folder with a small cell file, and a lake that the tests of this module share."""

    folder: Path
    lake: str
    capsys: pytest.CaptureFixture[str]

    def refused(self, code: int, *arguments: str, cell: Path | None = None, lake: str | None = None) -> str:
        """Run `inspect`, check that it ends in this code with one message, and return the message."""
        cell = cell or write_cell(self.folder)
        found = command_line.main(["inspect", str(cell), "--direct", "--lake", lake or self.lake, "--json", *arguments])
        printed = self.capsys.readouterr()
        assert found == code, printed.err
        assert printed.out == ""
        assert printed.err.startswith("error: ")
        assert "Traceback" not in printed.err
        assert Lake(self.lake).verify() == []
        return printed.err.removeprefix("error: ").rstrip("\n")

    def refused_setting(self, code: int, *settings: str) -> str:
        """Run `inspect` with settings, see `refused`."""
        return self.refused(code, *(word for setting in settings for word in ("--set", setting)))


@pytest.fixture(scope="module")
def shared_lake(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("faults") / "lake")


@pytest.fixture
def bench(tmp_path: Path, shared_lake: str, capsys: pytest.CaptureFixture[str]) -> Bench:
    return Bench(tmp_path, shared_lake, capsys)


def ascii_stl(*triangles: tuple[tuple[float, float, float], ...]) -> bytes:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in triangles
    )
    return f"solid part\n{facets}endsolid part\n".encode()


def with_value(value: bytes) -> bytes:
    return PLATE[:96] + value + PLATE[100:]


PLY = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("part.stl", b"", r"part\.stl is empty \(0 bytes\): export it again"),
        ("part.stl", bytes(range(256)) * 20, r"part\.stl is no STL, or is cut off"),
        ("part.stl", PLATE[:700], r"it says 28 faces but holds 12: export"),
        ("part.stl", PLATE[:80] + bytes(4), r"holds no triangles: export"),
        ("part.stl", PLATE[:80] + b"\xff\xff\xff\xff" + PLATE[84:], r"says 4294967295 faces but holds 28"),
        ("part.stl", with_value(b"\x00\x00\xc0\x7f"), r"1 of 84 vertices that are not finite.*: export"),
        ("part.stl", with_value(b"\x00\x00\x80\x7f"), r"1 of 84 vertices that are not finite.*: export"),
        ("part.stl", ascii_stl(((0, 0, 0), (9, 0, 0), (20, 0, 0))), r"no face has an area"),
        ("part.stl", ascii_stl(((5, 5, 5), (5, 5, 5), (5, 5, 5))), r"0 mm long as read in mm"),
        ("part.ply", b"rubbish", r"part\.ply is malformed"),
        ("part.ply", PLY + b"end_header\n0 0 0\n9 0 0\n0 9 0\n", r"no triangles \(a point cloud"),
        (
            "part.ply",
            PLY + b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n9 0 0\n0 9 0\n3 0 1 7\n",
            r"a face with vertex 7 but 3 vertices",
        ),
        ("part.obj", b"v 0 0 nan\nv 9 0 0\nv 0 9 0\nf 1 2 3\n", r"1 of 3 vertices that are not finite"),
        ("part.obj", b"v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 9\n", r"part\.obj is malformed"),
        ("part.3mf", b"rubbish", r"part\.3mf is no 3MF file"),
        ("part.step", b"rubbish", r"part\.step is no STEP file"),
        ("part.txt", b"rubbish", r"type '\.txt': use one of \.stl"),
    ],
)
def test_a_malformed_part_is_refused(name: str, content: bytes, says: str, bench: Bench) -> None:
    (bench.folder / name).write_bytes(content)
    assert re.search(says, bench.refused_setting(MALFORMED, f"part.file={name}"))


def test_a_missing_part_is_told_with_file_line_and_key(bench: Bench) -> None:
    cell = write_cell(bench.folder)
    (bench.folder / "plate.stl").unlink()
    said = bench.refused(MALFORMED, cell=cell)
    assert said.startswith(f"{cell}, line 4, part.file: '{bench.folder / 'plate.stl'}' does not exist")


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("part.unit=m", "120 m long as read in m, but a part must be at most 5 m: is the unit mm?"),
        ("part.unit=um", "0.12 mm long as read in um, but a part must be at least 1 mm: is the unit mm?"),
        ("part.scale=500", "60 m long as read in mm, but a part must be at most 5 m"),
        ("part.scale=0.0005", "0.06 mm long as read in mm, but a part must be at least 1 mm"),
        ("part.scale=-1", "must be above 0"),
        ("part.unit=parsec", "is not one of um, mm, cm, m, in, ft"),
    ],
)
def test_a_part_in_the_wrong_unit_is_refused(setting: str, says: str, bench: Bench) -> None:
    assert says in bench.refused_setting(MALFORMED, setting)


@pytest.mark.skipif(not PARTS.is_dir(), reason="../shared/data/parts is not there")
def test_a_busted_mesh_is_read_with_its_findings() -> None:
    source = read_source(params=SourceParams.of(PARTS / "busted.STL"))
    assert preprocess_mesh(source, params=MeshParams()).finding


def test_defects_that_planning_can_live_with_are_findings() -> None:
    o, x, y, z, w = (0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (0.0, 9.0, 0.0), (0.0, 0.0, 9.0), (9.0, 9.0, 9.0)
    tetrahedron = [(o, y, x), (o, x, z), (o, z, y), (x, y, z)]
    fin, needle = (x, y, w), (o, x, (18.0, 0.0, 0.0))
    source = SourceFile(name="part.stl", content=ascii_stl(*tetrahedron, tetrahedron[0], fin, needle))
    mesh = preprocess_mesh(source, params=MeshParams())
    assert not mesh.watertight
    for defect in ("faces that repeat", "non-manifold", "without area"):
        assert defect in " ".join(mesh.finding)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty: write a cell file"),
        ("- a\n- b\n", "a cell file is a list of `key: value` lines"),
        (CELL.replace("  box", "\tbox"), "line 8: not readable as YAML"),
        (CELL.replace("tilt: [0 deg]", "tilt: [0 deg"), "not readable as YAML"),
        (CELL + "name: again\n", "name is given twice, first in line 2"),
        (CELL.replace("small", "!!python/object/apply:os.system [id]"), "is not plain YAML: remove it"),
        ("a0: &a0 [x]\n" + "".join(f"a{n + 1}: &a{n + 1} [{f'*a{n}, ' * 9}]\n" for n in range(9)), "an anchor (&name)"),
        ("[" * 5000, "is nested too deeply"),
        (CELL.replace("table:", "tabel:"), "line 7, tabel: unknown key 'tabel': did you mean table?"),
        (CELL.replace("300 mm, 300 mm", "300, 300 mm"), "line 8, table.box.size.0: 300 has no unit"),
        (CELL.replace("300 mm, 300 mm", "300 deg, 300 mm"), "'300 deg' is not a length"),
        (CELL.replace("300 mm, 300 mm", ".nan, 300 mm"), "nan is not finite"),
        (CELL.replace("300 mm, 300 mm", "0 mm, 300 mm"), "must be above 0"),
        (CELL.replace("300 mm, 300 mm", "1e30 mm, 300 mm"), "must be at most 1e+06 mm"),
        (CELL.replace("cellwright: 1", "cellwright: 2"), "this release reads cellwright: 1"),
        (CELL.replace("name: small", 'name: "a\\0b"'), "characters that cannot be printed"),
    ],
)
def test_a_malformed_cell_file_is_refused(text: str, says: str, bench: Bench) -> None:
    said = bench.refused(MALFORMED, cell=write_cell(bench.folder, text))
    assert says in said
    assert str(bench.folder / "cell.yaml") in said


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_a_cell_file_that_is_not_utf_8_is_refused(encoding: str, bench: Bench) -> None:
    cell = write_cell(bench.folder)
    cell.write_bytes(CELL.replace("small", "grün").encode(encoding))
    assert "is not a text file" in bench.refused(MALFORMED, cell=cell)


def test_windows_line_ends_a_byte_order_mark_and_odd_names_are_taken(bench: Bench) -> None:
    cell = write_cell(bench.folder / "mit Leerzeichen 检查")
    cell.write_bytes(b"\xef\xbb\xbf" + CELL.replace("small", "Prüfling 检查").replace("\n", "\r\n").encode())
    assert command_line.main(["validate", str(cell)]) == 0


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("planner.seed=-1", "must be at least 0"),
        ("planner.seed=true", "true is not a whole number"),
        ("planner.seed=99999999999999999999", "must be at most 9223372036854775807"),
        ("planner.selection.min_coverage=0", "must be above 0"),
        ("planner.selection.min_coverage=98", "must be at most 100 %: write 98 %"),
        ("planner.selection.min_coverage=101 %", "'101 %' must be at most 100 %: write a smaller value"),
        ("planner.viewpoints.theta_tilt=[]", "has 0 entries but needs at least 1"),
        ("planner.viewpoints.standoffs=[500 mm]", "outside the scanner's 127 to 227 mm"),
        ("planner.reachability.scan_speed=1e-9 m/s", "must be at least 1 mm/s"),
        ("planner.reachability.step=1e-9 mm", "must be at least 0.1 mm"),
        ("planner.stitching.tool_acceleration=1e-9 m/s^2", "must be at least 0.001 m/s^2"),
        ("robot.max_velocity=1e-9 deg/s", "must be at least 0.1 deg/s"),
        ("robot.max_acceleration=1e-9 deg/s^2", "must be at least 0.1 deg/s^2"),
        ("scanner.profile_rate=1e9 Hz", "must be at most"),
        ("scanner.max_incidence=0 deg", "must be above 0"),
        ("planner.sampling.density=0 /mm^2", "must be above 0"),
        ("planner.sampling.density=1000 /mm^2", "samples but at most 300000 can be handled: lower planner.sampling"),
        ("obstacles=[{name: table, sphere: {radius: 1 mm}}]", "'table' names another body too"),
        (
            "obstacles=[{name: forearm_link, sphere: {radius: 1 mm}, pose: {position: [2 m, 0 m, 0 m]}}]",
            "several bodies",
        ),
        ("robot.model=ur10", "did you mean ur10e?"),
        ("robot.base_link=foot", "has no link 'foot': it has base_link"),
        ("robot.start=[0 deg]", "has 1 entries but ur10e has 6 joints"),
        (
            "robot.start=[999 deg, 0 deg, 0 deg, 0 deg, 0 deg, 0 deg]",
            "shoulder_pan_joint 17.44 outside -6.283",
        ),
        ("part.rests_on=tabel", "'tabel' is no body of the cell: did you mean table?"),
        ("nonsense", "write path.to.field=value"),
        ("a.b=5", "unknown key 'a'"),
    ],
)
def test_a_setting_that_makes_no_sense_is_refused(setting: str, says: str, bench: Bench) -> None:
    assert says in bench.refused_setting(MALFORMED, setting)


def test_more_candidates_than_can_be_handled_are_refused(bench: Bench) -> None:
    said = bench.refused_setting(
        MALFORMED,
        "planner.sampling={density: 7 /mm^2, method: random}",
        "planner.verification_cloud.density_factor=0.001",
    )
    assert "candidate sweeps and up to" in said
    assert "lower planner.sampling.density or leave out tilts" in said


def test_more_scan_points_than_can_be_handled_are_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"lower scanner\.points_per_profile or scanner\.profile_rate"):
        _check_number_of_rays(replace(ScannerParams().scanner(), profile_rate=1e6), 10.0)


def arm(n_joints: int, kind: str = "revolute", limit: str = 'lower="-3" upper="3" velocity="2" effort="1"') -> str:
    links = "".join(f'<link name="l{n}"/>' for n in range(n_joints + 1))
    joints = "".join(
        f'<joint name="j{n}" type="{kind if n == 2 else "revolute"}"><parent link="l{n}"/><child link="l{n + 1}"/>'
        f'<origin xyz="0 0.05 0.25"/><axis xyz="{"0 0 1" if n in (0, 4) else "0 1 0"}"/><limit {limit}/></joint>'
        for n in range(n_joints)
    )
    return f'<robot name="arm">{links}{joints}</robot>'


@pytest.mark.parametrize(
    ("urdf", "says"),
    [
        (arm(5), "the arm has 5 joints"),
        (arm(7), "the arm has 7 joints"),
        (arm(6, "prismatic"), "joint 'j2' is prismatic: only arms of revolute joints"),
        (arm(6, limit=""), "joint 'j0' has no velocity limit in the URDF: add"),
        (arm(6, limit='lower="nan" upper="3" velocity="2" effort="1"'), "lower='nan'"),
        (arm(6, limit='lower="3" upper="-3" velocity="2" effort="1"'), "lower must be less than upper"),
        (arm(6)[:300], "is not valid XML"),
        ("rubbish", "is not valid XML"),
        ("<html/>", "outermost element is <html>, not <robot>"),
        ('<robot name="x"><link name="a"/></robot>', "no moving joint hangs on link 'a'"),
        (
            arm(6).replace(
                '<link name="l1"/>',
                '<link name="l1"><collision><geometry><mesh filename="gone.stl"/></geometry></collision></link>',
            ),
            "mesh 'gone.stl' was not found: tried",
        ),
    ],
)
def test_a_malformed_robot_is_refused(urdf: str, says: str, bench: Bench) -> None:
    (bench.folder / "arm.urdf").write_text(urdf)
    angles = ", ".join(["10 deg"] * urdf.count("<joint"))
    said = bench.refused_setting(
        MALFORMED, "robot.model=arm.urdf", f"robot.start=[{angles}]", "robot.max_acceleration=100 deg/s^2"
    )
    assert says in said


@pytest.mark.parametrize(
    ("code", "settings", "says"),
    [
        (MALFORMED, ["robot.start=[0 deg, 0 deg, 0 deg, 0 deg, 0 deg, 0 deg]"], "the start configuration collides: "),
        (MALFORMED, ["obstacles=[{name: hall, box: {size: [9 m, 9 m, 9 m]}}]"], "with 'hall'"),
        (
            MALFORMED,
            [POST_AROUND_THE_BASE],
            "collides: .* with 'post'",
        ),
        (NO_ANSWER, ["part.pose.position=[5 m, 0 m]", "table.pose.position=[5 m, 0 m, 0.1 m]"], "out of reach"),
        (
            NO_ANSWER,
            ["planner.reachability.clearance=1 m"],
            "closer than 1000 mm.*lower planner.reachability.clearance",
        ),
        (NO_ANSWER, ["planner.measurability.max_uncertainty=1e-9 um"], r"uncertainty\): add tilts"),
        (NO_ANSWER, ["planner.reachability.shortest=100 m"], r"too short"),
    ],
)
def test_a_cell_in_which_nothing_can_move_is_refused(code: int, settings: list[str], says: str, bench: Bench) -> None:
    assert re.search(says, bench.refused_setting(code, *settings))


@pytest.mark.parametrize(
    ("position", "says"),
    [("[0 m, 0 m, 0.05 m]", "both stand still"), ("AT_THE_SCANNER", "the start configuration brings")],
)
def test_a_part_in_the_robot_is_refused(position: str, says: str, bench: Bench) -> None:
    if position == "AT_THE_SCANNER":
        position = "[{:.4f} m, {:.4f} m, {:.4f} m]".format(*_scanner_housing_at_start(bench.folder))
    text = re.sub(r"  rests_on: table\n  pose: .*\n", f"  pose: {{position: {position}}}\n", CELL, count=1)
    text = text.replace("position: [700 mm, 0 mm, 100 mm]", "position: [900 mm, 900 mm, -100 mm]")
    code = NO_ANSWER if "still" in says else MALFORMED
    assert says in bench.refused(code, cell=write_cell(bench.folder, text))


def _scanner_housing_at_start(folder: Path) -> list[float]:
    params = request_of(write_cell(folder)).cell
    cell = build_cell(assemble_cell((), params=params))
    row = [body.name for body in cell.bodies].index("scanner body")
    position: list[float] = Scene(cell).body_poses(cell.start)[row, :3, 3].tolist()
    return position


@pytest.mark.parametrize(
    ("lake", "code", "says"),
    [
        ("plate.stl", MALFORMED, "plate.stl is a file; choose another path"),
        ("plate.stl/lake", MALFORMED, "plate.stl is a file; choose another path"),
        ("x" * 300, LAKE, "File name too long"),
    ],
)
def test_a_place_that_cannot_be_a_lake_is_refused(lake: str, code: int, says: str, bench: Bench) -> None:
    assert says in bench.refused(code, lake=str(bench.folder / lake))


@pytest.fixture
def closed_folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in which this process cannot write."""
    folder = tmp_path / "closed"
    folder.mkdir()
    folder.chmod(0o555)
    for each in tmp_path.parents:  # pytest keeps its folders to their owner, who is somebody else below
        if "pytest-of-" in str(each):
            each.chmod(0o755)
    tmp_path.chmod(0o755)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)  # root writes everywhere
    try:
        yield folder
    finally:
        if root:
            os.seteuid(0)
        folder.chmod(0o755)


def test_a_lake_that_cannot_be_written_is_told(
    tmp_path: Path, closed_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell, acting = tmp_path / "cell.yaml", os.geteuid()
    os.seteuid(os.getuid())
    write_cell(tmp_path)
    os.seteuid(acting)
    assert (
        command_line.main(["inspect", str(cell), "--direct", "--json", "--lake", str(closed_folder / "lake")]) == LAKE
    )
    said = capsys.readouterr().err
    assert "Permission denied: make the folder writable for this user or choose another lake with --lake" in said
    assert list(closed_folder.iterdir()) == []


def test_a_full_disk_is_told_and_leaves_only_whole_artefacts(bench: Bench) -> None:
    disk = bench.folder / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=60k", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small disk is not permitted here")
    try:
        said = bench.refused(LAKE, lake=str(disk / "lake"))
        assert "No space left on device" in said
        assert "free some space" in said
        assert Lake(str(disk / "lake")).verify() == []
        assert len(list(Lake(str(disk / "lake")).manifests())) >= 1
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_result_folder_that_cannot_be_written_is_refused_before_planning(bench: Bench) -> None:
    write_cell(bench.folder)
    said = bench.refused(MALFORMED, "--out", str(bench.folder / "plate.stl" / "out"), lake=str(bench.folder / "new"))
    assert "plate.stl" in said
    assert "--out" in said
    assert not (bench.folder / "new").exists()


def test_an_unknown_stage_to_refresh_is_refused(bench: Bench) -> None:
    assert "did you mean 'select_views'?" in bench.refused(MALFORMED, "--refresh", "select_view")


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["show", "coverage"], MALFORMED, "no artefact 'coverage'"),
        (["show", "abc"], MALFORMED, "abc"),
        (["lineage", "nope"], MALFORMED, "no artefact 'nope'"),
        (["sql", "selec 1"], MALFORMED, "syntax error"),
        (["sql", "select * from nope"], MALFORMED, "nope"),
    ],
)
def test_a_lake_command_about_nothing_is_refused(arguments: list[str], code: int, says: str, bench: Bench) -> None:
    assert command_line.main(["lake", *arguments, "--lake", str(bench.folder / "none")]) == code
    said = bench.capsys.readouterr().err
    assert says in said
    assert "Traceback" not in said


def test_a_server_that_goes_away_during_a_run_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    gone = server.ServerStatus("running", "http://127.0.0.1:9/api", 1, tmp_path)
    monkeypatch.setenv("CELLWRIGHT_HOME", str(tmp_path))
    monkeypatch.setattr(server, "start", lambda say: gone)
    monkeypatch.setattr(server, "_require_answer", lambda url: None)
    with pytest.raises(server.ServerError, match=r"stopped answering .* run again"), server.connected(print):
        raise httpx.ConnectError("[Errno 111] Connection refused")
