"""A malformed cell file, or a setting that makes no sense, is refused before anything runs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cellwright.errors import InvalidInputError
from flows import command_line
from schemas.scanner import ScannerParams
from tasks.simulate_scan import _check_number_of_rays
from tests.faults.bench import MALFORMED, Bench
from tests.small_inspection import CELL, write_cell


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
        ("planner.reachability.scan_speed=1e9 m/s", "must be at most 100000 mm/s"),
        ("planner.stitching.tool_acceleration=1e300 m/s^2", "must be at most 10000 m/s^2"),
        ("planner.stitching.max_connections=99999999999999999999", "must be at most 1000000"),
        ("planner.selection.max_work=1e300", "must be at most 1e+15"),
        ("planner.selection.node_limit=99999999999999999999", "must be at most 1000000000"),
        ("robot.max_velocity=1e300 deg/s", "must be at most 100000 deg/s"),
        ("robot.max_acceleration=1e300 deg/s^2", "must be at most 1e+07 deg/s^2"),
        ("scanner.max_incidence=0 deg", "must be above 0"),
        ("planner.sampling.density=0 /mm^2", "must be above 0"),
        ("planner.sampling.density=1000 /mm^2", "samples but at most 300000 can be handled: lower planner.sampling"),
        ("obstacles=[{name: table, sphere: {radius: 1 mm}}]", "'table' names another body too"),
        (
            "obstacles=[{name: forearm_link, sphere: {radius: 1 mm}, pose: {position: [2 m, 0 m, 0 m]}}]",
            "obstacles.0.name: 'forearm_link' names a link of the robot too: choose another",
        ),
        ("robot.model=ur10", "did you mean ur10e?"),
        ("robot.base_link=foot", "'foot' is no link of ur10e: known are base_link"),
        ("robot.start=[0 deg]", "has 1 entries but ur10e has 6 joints"),
        (
            "robot.start=[999 deg, 0 deg, 0 deg, 0 deg, 0 deg, 0 deg]",
            "shoulder_pan_joint 999 deg is outside -360 to 360 deg: move it inside",
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
    with pytest.raises(InvalidInputError, match="lower points_per_profile or profile_rate_hz, or raise"):
        _check_number_of_rays(replace(ScannerParams().scanner(), profile_rate=1e6), 10.0)
