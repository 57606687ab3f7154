"""A request carries everything that a cell file says to the stage that needs it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from cellwright.errors import InvalidInputError
from flows.requests import InspectionRequest, request_of
from schemas.cell_file import ScannerSection
from schemas.cell_file_planner import PlannerSection

CELL = Path(__file__).parents[2] / "examples" / "grooved_cylinder.yaml"

OTHER_WORDS = {
    "planner.sampling.method": "random",
    "planner.selection.method": "greedy",
    "planner.selection.min_coverage": "0.9",
    "planner.selection.node_limit": "17",
    "planner.stitching.method": "greedy",
    "planner.stitching.exact_up_to": "9",
    "planner.selection.time_limit": "9 s",
    "planner.viewpoints.standoffs": "[170 mm]",
    "planner.scan.noise": "true",
    "planner.stitching.return_to_start": "true",
    "planner.report.title": "another",
    "planner.report.notes": "a remark",
}
"""Another valid value of each setting that is no plain number."""

METHODS_THAT_READ = {"planner.selection.time_limit": ["planner.selection.method=exact"]}
"""What else must be set for a setting to count."""

OTHER_SCANNER_WORDS = {
    "scanner.standoff.min": "130 mm",
    "scanner.standoff.max": "220 mm",
    "scanner.mount": "{position: [150 mm, 0 mm, 150 mm]}",
    "scanner.housing": "[]",
    "scanner.uncertainty.constant": "1 um",
}


def leaves(model: type[BaseModel], path: str) -> Iterator[tuple[str, Any]]:
    """Yield every setting below a section: its path as written in the file, and its default in SI."""
    for name, field in model.model_fields.items():
        where = f"{path}.{field.alias or name}"
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel) and where != "scanner.mount":
            yield from leaves(field.annotation, where)
        else:
            yield where, field.default


def another(path: str, default: Any) -> str:
    if path in (known := OTHER_WORDS | OTHER_SCANNER_WORDS):
        return known[path]
    if isinstance(default, tuple):
        return "[0 deg, 10 deg]"
    name = path.rpartition(".")[2]
    if isinstance(default, int):
        return str(default + 1)
    units = {
        "density": "/m^2", "critical_angle": "rad", "max_uncertainty": "m", "step": "m", "margin": "m",
        "shortest": "m", "scan_speed": "m/s", "clearance": "m", "time_limit": "s", "tool_acceleration": "m/s^2",
        "coverage_radius": "m", "aperture": "rad", "best": "m", "emitter_detector_distance": "m",
        "at_best_standoff": "m", "max_incidence": "rad", "profile_rate": "Hz",
    }  # fmt: skip
    unit_of = "rad" if path == "planner.stitching.step" else units.get(name, "")
    return f"{0.9 * default!r} {unit_of}".strip()


SETTINGS = [*leaves(PlannerSection, "planner")]
SCANNER_SETTINGS = [(path, default) for path, default in leaves(ScannerSection, "scanner") if path != "scanner.model"]


def as_json(request: InspectionRequest) -> str:
    return request.model_dump_json(exclude={"name"})


@pytest.fixture(scope="module")
def plain() -> InspectionRequest:
    return request_of(CELL)


@pytest.mark.parametrize(("path", "default"), SETTINGS + SCANNER_SETTINGS, ids=lambda value: str(value)[:40])
def test_every_setting_of_the_cell_file_reaches_a_stage(plain: InspectionRequest, path: str, default: Any) -> None:
    base = METHODS_THAT_READ.get(path, [])
    changed = request_of(CELL, [*base, f"{path}={another(path, default)}"])
    assert as_json(changed) != as_json(request_of(CELL, base) if base else plain)


def test_every_planner_setting_is_asked_for_above() -> None:
    paths = {path for path, _ in SETTINGS}
    assert len(paths) > 30
    assert paths >= OTHER_WORDS.keys()


@pytest.mark.parametrize(
    "override",
    [
        "robot.base={position: [10 mm, 0 mm, 0 mm]}",
        "robot.start=[1 deg, -110 deg, 80 deg, -60 deg, -90 deg, 0 deg]",
        "robot.max_velocity=100 deg/s",
        "robot.max_acceleration=100 deg/s^2",
        "robot.flange_link=flange",
        "part.unit=in",
        "part.scale=0.5",
        "part.rests_on=floor",
        "part.pose.position=[600 mm, 0 mm]",
        "part.pose.rotation=[0 deg, 0 deg, 90 deg]",
        "table.box.size=[300 mm, 300 mm, 201 mm]",
        "obstacles=[]",
        "fixture=[{name: clamp, sphere: {radius: 1 mm}, pose: {position: [0 mm, 0 mm, 2 m]}}]",
    ],
)
def test_every_section_of_the_cell_reaches_a_stage(plain: InspectionRequest, override: str) -> None:
    assert as_json(request_of(CELL, [override])) != as_json(plain)


def test_a_time_limit_for_a_method_without_a_clock_is_refused() -> None:
    assert request_of(CELL, ["planner.selection.method=exact", "planner.selection.time_limit=9 s"]).cover.time_limit_s
    for method in ("best", "greedy"):
        with pytest.raises(InvalidInputError, match=rf"time_limit is 9 s but method {method} reads no clock: remove"):
            request_of(CELL, [f"planner.selection.method={method}", "planner.selection.time_limit=9 s"])


def test_the_clouds_never_share_their_random_numbers() -> None:
    seeds: set[int] = set()
    for seed in range(5):
        request = request_of(CELL, [f"planner.seed={seed}"])
        seeds |= {request.samples.seed, request.refinement_cloud.seed, request.verification_cloud.seed}
    assert len(seeds) == 15


def test_settings_that_belong_together_stay_together(plain: InspectionRequest) -> None:
    request = request_of(
        CELL, ["planner.measurability.max_uncertainty=77 um", "planner.reachability.scan_speed=0.07 m/s"]
    )
    for params in (request.sensing, request.gaps, request.extension, request.scan, request.coverage):
        assert params.max_uncertainty_m == pytest.approx(77e-6)
        assert params.scanner == plain.sensing.scanner
    assert request.report.max_uncertainty_m == pytest.approx(77e-6)
    speeds = {request.sweeps.scan_speed_m_s, request.stitching.scan_speed_m_s, request.verification.scan_speed_m_s}
    assert speeds == {0.07}


def test_a_request_travels_as_json(plain: InspectionRequest) -> None:
    assert InspectionRequest.model_validate_json(plain.model_dump_json()) == plain
    assert len(plain.model_dump_json()) < 20_000


def test_the_name_of_the_cell_is_the_title_unless_there_is_one(plain: InspectionRequest) -> None:
    assert plain.report.title == "grooved cylinder"
    assert request_of(CELL, ["planner.report.title=Cover"]).report.title == "Cover"


def test_files_of_the_cell_are_named_once_each(tmp_path: Path) -> None:
    import trimesh

    trimesh.creation.box(extents=(1, 1, 1)).export(tmp_path / "box.stl")
    (tmp_path / "other").mkdir()
    trimesh.creation.box(extents=(1, 1, 2)).export(tmp_path / "other" / "box.stl")
    cell = tmp_path / "cell.yaml"
    cell.write_text(
        "cellwright: 1\npart: {file: box.stl, pose: {position: [1 m, 0 m, 0 m]}}\nobstacles:\n"
        "  - {name: one, mesh: {file: box.stl}}\n  - {name: two, mesh: {file: other/box.stl, scale: 2}}\n"
    )
    request = request_of(cell)
    assert [file.name for file in request.cell_files] == ["one: box.stl", "two: box.stl"]
    assert request.cell_files[0].sha256 == request.part.sha256 != request.cell_files[1].sha256
    assert [body.scale for body in request.cell.bodies] == [(0.001,) * 3, (0.002,) * 3]  # type: ignore[union-attr]


def test_a_robot_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_bytes(b"\xff\xfe\x00binary")
    (tmp_path / "cell.yaml").write_text(
        f"cellwright: 1\nrobot: {{model: arm.urdf}}\npart: {{file: {CELL.with_suffix('.stl')}}}\n"
    )
    with pytest.raises(InvalidInputError, match=r"arm\.urdf is not a URDF: it is not text"):
        request_of(tmp_path / "cell.yaml")
