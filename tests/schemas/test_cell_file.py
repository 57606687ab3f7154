import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Box
from cellwright.cell.transforms import inverse, rotation_from_rpy
from cellwright.errors import InvalidInputError
from schemas.cell_file import CellFile, ScannerSection, load_cell_file
from schemas.scanner import ScannerParams

ROOT = Path(__file__).parents[2]
PARTS = ROOT.parent / "shared" / "data" / "parts"
CELLS = [path for path in sorted((ROOT / "tests" / "cells").glob("*.yaml")) if "\ntasks:" not in path.read_text()]

CELL = """\
cellwright: 1
name: bracket
robot:
  model: ur10e
  start: [0 deg, -90 deg, 90 deg, 0 deg, 0 deg, 0 deg]
part:
  file: part.stl
  rests_on: table
  pose: {position: [680 mm, 0 mm], rotation: [90 deg, 0 deg, 0 deg]}
table:
  box: {size: [300 mm, 300 mm, 200 mm]}
  pose: {position: [680 mm, 0 mm, 100 mm]}
obstacles:
  - name: post
    cylinder: {radius: 25 mm, length: 800 mm}
    pose: {position: [450 mm, 550 mm, 400 mm]}
planner:
  sampling: {density: 0.01 /mm^2}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "part.stl").write_bytes(b"x")
    (tmp_path / "part.step").write_bytes(b"x")
    (tmp_path / "part.doc").write_bytes(b"x")
    (tmp_path / "meshes").mkdir()
    (tmp_path / "cell.yaml").write_text(CELL)
    return tmp_path


def load(folder: Path, text: str = CELL, *overrides: str) -> CellFile:
    (folder / "cell.yaml").write_text(text)
    return load_cell_file(folder / "cell.yaml", overrides)


def message(folder: Path, text: str = CELL, *overrides: str) -> str:
    with pytest.raises(InvalidInputError) as caught:
        load(folder, text, *overrides)
    return str(caught.value)


def test_quantities_arrive_in_si(folder: Path) -> None:
    cell = load(folder)
    assert cell.name == "bracket" and cell.path == folder / "cell.yaml"
    assert cell.robot.start_rad == pytest.approx([0, -math.pi / 2, math.pi / 2, 0, 0, 0])
    assert cell.planner.sampling.density_per_m2 == 1e4
    assert cell.part.file == folder / "part.stl"
    assert cell.body("table").shape() == Box((0.3, 0.3, 0.2))
    assert [body.name for body in cell.bodies()] == ["table", "post"]
    assert np.allclose(cell.part.pose.matrix()[:3, :3], rotation_from_rpy(math.pi / 2, 0, 0))
    assert cell.part.up_part() == pytest.approx((0.0, 1.0, 0.0))


def test_two_keys_are_enough_and_defaults_are_the_papers(folder: Path) -> None:
    cell = load(folder, "cellwright: 1\npart: {file: part.stl}\n")
    assert cell.name == "cell"
    assert cell.scanner.params() == ScannerParams()
    planner = cell.planner
    assert planner.sampling.critical_angle_rad == pytest.approx(math.radians(20))
    assert planner.measurability.max_uncertainty_m == pytest.approx(100e-6)
    assert planner.reachability.shortest_m == 0.05
    assert planner.viewpoints.standoffs_m(cell.scanner.params()) == (0.182,)
    n_tilts = len(planner.viewpoints.delta_rot_rad) * len(planner.viewpoints.theta_tilt_rad)
    assert n_tilts * len(planner.viewpoints.psi_tilt_rad) == 27
    assert max(planner.viewpoints.theta_tilt_rad) == pytest.approx(math.radians(45))


def test_defaults_do_not_depend_on_how_they_came(folder: Path) -> None:
    written = load(folder, CELL + "scanner: {standoff: {best: 182 mm}, uncertainty: {at_best_standoff: 40 um}}\n")
    assert written.scanner.params() == ScannerParams()


def test_settings_win_over_the_file_and_reach_lists_by_name_and_number(folder: Path) -> None:
    cell = load(
        folder,
        CELL,
        "planner.sampling.density=0.005 /mm^2",
        "planner.viewpoints.theta_tilt=[0 deg]",
        "obstacles.post.cylinder.radius=40 mm",
        "obstacles.0.cylinder.length=1 m",
        "planner.scan.noise=true",
        "name=other = name",
    )
    assert cell.planner.sampling.density_per_m2 == 5e3
    assert cell.planner.viewpoints.theta_tilt_rad == (0.0,)
    assert cell.obstacles[0].cylinder is not None
    assert (cell.obstacles[0].cylinder.radius_m, cell.obstacles[0].cylinder.length_m) == (0.04, 1.0)
    assert cell.planner.scan.noise
    assert cell.name == "other = name"


def test_a_setting_changes_one_place_of_a_shared_anchor(folder: Path) -> None:
    text = CELL.replace("box: {size", "box: &b {size") + "fixture:\n  - {name: clamp, box: *b}\n"
    cell = load(folder, text, "fixture.clamp.box.size=[1 mm, 2 mm, 3 mm]")
    assert cell.fixture[0].shape() == Box((0.001, 0.002, 0.003))
    assert cell.body("table").shape() == Box((0.3, 0.3, 0.2))


def edited(old: str, new: str) -> str:
    assert old in CELL
    return CELL.replace(old, new)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (CELL + "scanner: {standoff: {best: 182}}\n",
         "line 19, scanner.standoff.best: 182 has no unit but a length needs one: write 182 mm"),
        (edited("model: ur10e", "model: ur10"), "line 4, robot.model: 'ur10' is not a built-in robot: did you mean ur"),
        (edited("model: ur10e", "model: robots/a.urdf"), "a.urdf' does not exist (nor does the folder"),
        (edited("model: ur10e", "model: part.stl"), "has type '.stl': use one of .urdf"),
        (edited("start:", "strat:"), "line 5, robot.strat: unknown key 'strat': did you mean start?"),
        (edited("-90 deg, 90 deg", "-90 deg, 90"), "line 5, robot.start.2: 90 has no unit but an angle needs one: wri"),
        (edited(", 0 deg, 0 deg, 0 deg]", "]"), "line 5, robot.start: has 3 entries but ur10e has 6 joints"),
        (edited("0 deg, 0 deg]\npart", ".nan deg, 0 deg]\npart"), "robot.start.4: '.nan deg' is not an angle"),
        (edited("part.stl", "prat.stl"), "line 7, part.file:"),
        (edited("part.stl", "part.doc"), "has type '.doc': use one of .stl, .ply, .obj, .3mf, .step, .stp"),
        (edited("part.stl", "meshes"), "has no file type"),
        (edited("part.stl", "part.step\n  unit: mm"), "line 8, part.unit: part.step carries its own unit: remove `uni"),
        (edited("part.stl", "part.stl\n  unit: milimetre"), "part.unit: 'milimetre' is not one of um, mm, cm, m, in"),
        (edited("part.stl", "part.stl\n  scale: -1"), "part.scale: -1 must be above 0"),
        (edited("  file: part.stl\n", ""), "part.file: is missing: add it, like `file: part.stl`"),
        (edited("rests_on: table", "rests_on: tabel"), "line 8, part.rests_on: 'tabel' is no body of the cell: did yo"),
        (edited("  rests_on: table\n", ""), "part.pose.position: has 2 entries but needs 3: write [x, y, z] or add"),
        (edited("[680 mm, 0 mm],", "[680 mm, 0 mm, 5 mm],"), "part.pose.position: has a height but `rests_on` finds i"),
        (edited("[680 mm, 0 mm],", "[680 mm],"), "part.pose: position has 1 entries but needs 3"),
        (edited("[680 mm, 0 mm],", "[680 mm, 160 mm],"), "part.pose.position: the part would stand beside 'table'"),
        (edited("[90 deg, 0 deg, 0 deg]", "90 deg"), "part.pose.rotation: '90 deg' is not a list: write [90 deg, ...]"),
        (edited("rotation: [90 deg, 0 deg, 0 deg]", "quaternion: [1, 1, 0, 0]"), "quaternion has length 1.41421: scal"),
        (edited("}\ntable", ", quaternion: [1, 0, 0, 0]}\ntable"), "rotation and quaternion are both given: keep one"),
        (edited("300 mm, 200 mm", "300 mm, -200 mm"), "line 11, table.box.size.2: '-200 mm' must be above 0"),
        (edited("300 mm, 200 mm", "300 mm"), "table.box.size"),
        (edited("  box: {size: [300 mm, 300 mm, 200 mm]}\n", ""), "table: body 'table' has no shape: give it one of b"),
        (edited("    cylinder", "    sphere: {radius: 1 mm}\n    cylinder"), "body 'post' has cylinder and sphere: gi"),
        (edited("  - name: post\n    cyl", "  - cyl"), "line 14, obstacles.0.name: is missing"),
        (edited("name: post", "name: part"), "obstacles.0.name: 'part' is the workpiece's own name: choose another"),
        (edited("name: post", "name: table"), "obstacles.0.name: 'table' names another body too (line 10)"),
        (edited("obstacles:\n  - name", "obstacles:\n    name"), "obstacles: {'name': 'post'"),
        (edited("planner:", "planer:"), "line 17, planer: unknown key 'planer': did you mean planner?"),
        (edited("planner:\n  sampling: {density: 0.01 /mm^2}", "planner:"), "planner: an empty value is not a section"),
        (edited("0.01 /mm^2", "0.01 mm"), "planner.sampling.density: '0.01 mm' is not a density on a surface: write i"),
        (edited("{density: 0.01 /mm^2}", "{method: blue_noise}"), "'blue_noise' is not one of blue-noise, random: did"),
        (edited("cellwright: 1", "cellwright: 2"), "line 1, cellwright: 2 is another version: this release reads cell"),
        (edited("cellwright: 1\n", ""), "cellwright: is missing: add it, like `cellwright: 1`"),
        (CELL + "  seed: -1\n", "planner.seed: -1 must be at least 0"),
        (CELL + "  seed: 1.5\n", "planner.seed: 1.5 is not a whole number"),
        (CELL + "  scan: {noise: maybe}\n", "planner.scan.noise: 'maybe' is neither true nor false"),
        (CELL + "  selection: {min_coverage: 95}\n", "planner.selection.min_coverage: 95 must be at most 100 %: write"),
        (CELL + "  viewpoints: {theta_tilt: []}\n", "planner.viewpoints.theta_tilt: has 0 entries but needs at least"),
        (CELL + "  viewpoints: {theta_tilt: [90 deg]}\n", "'90 deg' must be at most 89 deg"),
        (CELL + "  viewpoints: {standoffs: [far]}\n", "'far' is not a standoff: write min, best, max or a length"),
        (CELL + "  viewpoints: {standoffs: [1 m]}\n", "1000 mm is outside the scanner's 127 to 227 mm"),
        (CELL + "  reachability: {step: 30 mm, shortest: 20 mm}\n", "step is longer than reachability.shortest"),
        (CELL + "scanner: {standoff: {min: 200 mm}}\n", "standoffs must rise: min 200 mm, best 182 mm, max 227 mm"),
        (CELL + "scanner: {uncertainty: {constant: 50 um}}\n", "at_best_standoff (40 um) must exceed constant (50 um)"),
        (CELL + "scanner: {model: custom}\n", "a custom scanner has no default for aperture, standoff"),
        (CELL + "scanner: {mount: {position: [1 mm, 2 mm]}}\n", "scanner.mount.position: has 2 entries but needs 3"),
        (CELL + "robot: {}\n", "line 19: robot is given twice, first in line 3: remove one"),
        (edited("name: post", "name: post\n    name: pole"), "obstacles.0.name is given twice, first in line 14"),
        (CELL + "? [a]\n: 1\n", "a key must be text"),
        (CELL + "x: [1\n", "not readable as YAML"),
        (CELL + "x: !!python/object/apply:os.system [ls]\n", "is not plain YAML: remove it"),
        (CELL + "x: 2020-99-99\n", "line 19: '2020-99-99' is not readable"),
        ("a: &a [*a]\n", "is an anchor (&name) used inside itself?"),
        ("[" * 3000, "nested too deeply"),
        ("- 1\n", "line 1: a cell file is a list of `key: value` lines, not [1]"),
        ("", "is empty: write a cell file, starting with `cellwright: 1`"),
        ("\x00\x01", "not readable as YAML"),
    ],
)  # fmt: skip
def test_a_fault_is_named_with_its_line_key_value_and_mend(folder: Path, text: str, words: str) -> None:
    said = message(folder, text)
    assert str(folder / "cell.yaml") in said
    assert words in said


def test_several_faults_are_shown_at_once_up_to_five_in_the_order_of_the_file(folder: Path) -> None:
    faulty = CELL.replace(" mm", " furlong")
    said = message(folder, faulty).splitlines()
    assert said[0].endswith(" errors:") and len(said) == 7
    assert said[6].strip().startswith("and ") and said[6].endswith(" more")
    lines = [int(row.split(",")[0].split()[1]) for row in said[1:6]]
    assert lines == sorted(lines) and len(lines) == 5


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("planner.sampling.density=0.01", "--set planner.sampling.density=0.01, planner.sampling.density: 0.01 has no"),
        ("planner.sampling.densty=1 /mm^2", "unknown key 'densty': did you mean density?"),
        ("obstacles.3.name=x", "obstacles has 1 entries (post) and no '3': count from 0 or name one"),
        ("fixture.0.name=x", "fixture has no entries, so there is no '0': set the whole list, fixture=[...]"),
        ("part.file=~nobody_of_that_name/x.stl", "names the home folder of somebody unknown here"),
        ("part.file=" + "x" * 5000 + ".stl", "part.file: '"),
        ("part.file=" + "x" * 5000 + ".stl", "cannot be opened (File name too long)"),
        ("part.file=pipe.stl", "pipe.stl' is not a regular file"),
        ("part.file=meshes.stl", "meshes.stl' does not exist"),
        ("robot.packages={a: " + "x" * 5000 + "}", "cannot be opened (File name too long)"),
        ("planner.stitching.step=1e-12 deg", "planner.stitching.step: '1e-12 deg' must be at least 0.05 deg"),
        ("planner.sampling.density=1e30 /mm^2", "must be at most 10000 /mm^2"),
        ("planner.reachability.margin=900 m", "planner.reachability.margin: '900 m' must be at most 5"),
        ("planner.measurability.max_uncertainty=0 um", "max_uncertainty: '0 um' must be above 0"),
        ("part.scale=1e300", "part.scale: '1e300' must be at most 1e+09"),
        ("name.first=x", "name is 'bracket', not a section: it has no 'first'"),
        ("planner.seed", "not a setting: write path.to.field=value"),
        ("planner..seed=1", "not a setting: write path.to.field=value"),
        ("name=[1", "the value is not readable as YAML: quote it"),
        ("part.file=", "part.file: None is not a path"),
    ],
)  # fmt: skip
def test_a_faulty_setting_is_named(folder: Path, setting: str, words: str) -> None:
    os.mkfifo(folder / "pipe.stl")
    assert words in message(folder, CELL, setting)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nothing.yaml", "does not exist"),
        ("meshes", "is a folder"),
        ("part.stl", "`key: value`"),
        ("junk", "not a text"),
    ],
)
def test_what_is_no_cell_file_is_refused(folder: Path, name: str, words: str) -> None:
    (folder / "junk").write_bytes(b"\xff\xfe\x00binary")
    with pytest.raises(InvalidInputError, match=words):
        load_cell_file(folder / name)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.sampled_from(["5 mm", "5 deg"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)
KEYS = sorted({field.alias or name for name, field in CellFile.model_fields.items()})


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=4))
def test_whatever_stands_in_it_gives_a_cell_or_the_error(folder: Path, wrong: dict[str, object]) -> None:
    data = {**yaml.safe_load(CELL), **wrong}
    try:
        load(folder, yaml.safe_dump(data))
    except InvalidInputError as error:
        assert "cell.yaml" in str(error)


def rays(params: ScannerParams) -> FloatArray:
    """Points on the laser fan at all working distances, in the laser-emitter frame."""
    standoff = np.linspace(params.min_standoff_m, params.max_standoff_m, 9)
    across = np.linspace(-1, 1, 11) * math.tan(params.aperture_rad / 2)
    return np.array([[0.0, d * share, d] for d in standoff for share in across])


def test_emitter_and_detector_sit_in_the_housing_and_look_out_of_its_lower_face() -> None:
    scanner = ScannerSection()
    params = scanner.params()
    T_flange_scanner = scanner.mount.matrix()
    handle, body = scanner.housing
    T_scanner_body = inverse(T_flange_scanner) @ body.pose.matrix()
    half = np.array(body.box.size_m if body.box else ()) / 2
    emitter, detector = np.zeros(3), np.array([-params.emitter_detector_distance_m, 0.0, 0.0])
    lower_face = (T_scanner_body[:3, 3] + half)[2]
    for origin in (emitter, detector):
        assert (np.abs(origin - T_scanner_body[:3, 3]) < half - 0.025).all()  # with room for a lens around it
        for target in rays(params):
            leaves = origin + (target - origin) * lower_face / target[2]
            assert (np.abs(leaves - T_scanner_body[:3, 3])[:2] < half[:2]).all()  # not through a side wall
            assert target[2] > lower_face
    # nothing of the handle is below that face
    T_scanner_handle = inverse(T_flange_scanner) @ handle.pose.matrix()
    assert T_scanner_handle[2, 3] + 0.058 / 2 < lower_face
    # turned the other way round, the detector would stand within 5 mm of the housing's wall
    assert np.abs(-detector - T_scanner_body[:3, 3])[0] > half[0] - 0.006


@pytest.mark.parametrize("path", CELLS, ids=lambda path: path.stem)
@pytest.mark.skipif(not PARTS.is_dir(), reason="public part files are not there")
def test_the_cells_of_the_public_parts_are_valid(path: Path) -> None:
    # the manufacturer's URDF of this robot, which names its flange otherwise, is written by another test
    cell = load_cell_file(path, ["robot.flange_link=tool0"] if path.stem == "crx10ia_l" else [])
    assert cell.part.rests_on == "pedestal"
    assert cell.part.file.is_file()


def test_the_shipped_example_is_valid() -> None:
    cell = load_cell_file(ROOT / "examples" / "grooved_cylinder.yaml")
    assert cell.part.file.name == "grooved_cylinder.stl"


def test_importing_the_cell_file_imports_nothing_heavy() -> None:
    code = (
        "import sys, schemas.cell_file; "
        "print([name for name in ('pint', 'scipy', 'trimesh', 'numba', 'pinocchio') if name in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
