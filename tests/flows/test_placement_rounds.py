from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellwright.arrays import FloatArray
from cellwright.cell.verification_scene import VerificationScene
from cellwright.errors import UnsafePlanError
from flows import inspection
from flows.findings import Findings
from flows.inspection_result import InspectionResult
from flows.requests import InspectionRequest, request_of
from schemas.poses import Pose
from storage.lake import Lake
from tests.every_stage import PLACING
from tests.small_inspection import CELL, write_cell
from tests.tasks.test_compare_placements import placement

POST = """\
obstacles:
  - name: post
    box: {size: [50 mm, 50 mm, 600 mm]}
    pose: {position: [300 mm, 600 mm, 300 mm]}
"""

# one worker for all of them, or each would plan the cell anew
pytestmark = pytest.mark.xdist_group("placement")


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_cell(tmp_path_factory.mktemp("placement"), CELL + POST + PLACING)


@pytest.fixture(scope="module")
def lake_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("lake") / "lake")


@pytest.fixture(scope="module")
def moved(cell: Path, lake_url: str) -> InspectionResult:
    return inspection.run(cell, lake=lake_url, direct=True)


@pytest.fixture(scope="module")
def unmoved(cell: Path, lake_url: str) -> InspectionResult:
    return inspection.run(cell, overrides=["layout=null"], lake=lake_url, direct=True)


def test_the_plan_in_the_new_placement_is_shorter_verified_and_reported(
    moved: InspectionResult, unmoved: InspectionResult
) -> None:
    told = moved.summary["placement"]
    assert told["moved"] and told["words"].startswith("x ")
    assert told["cycle_before_s"] == unmoved.summary["duration_s"]
    assert told["cycle_after_s"] == moved.summary["duration_s"] < unmoved.summary["duration_s"]
    assert told["coverage_after"] == moved.summary["coverage"] >= unmoved.summary["coverage"]
    assert moved.summary["verified_states"] > 100
    assert b"The placement, before and after" in moved.report.page
    assert b"The placement, before and after" not in unmoved.report.page
    assert dict(moved.rows())["placement"].startswith("part moved, x ")
    assert "placement" not in unmoved.summary and "placement" not in dict(unmoved.rows())


def test_all_that_belongs_to_the_plan_is_of_the_new_placement(moved: InspectionResult, lake_url: str) -> None:
    lake = Lake(lake_url)
    made = {record.name: record.ref for record in moved.records}
    found: Any = lake.load(made["optimise_placement"])
    cell: Any = lake.load(moved.refs["cell"])
    first: Any = lake.load(made["assemble_cell"])
    for name, now, before in zip(cell.body, cell.T_parent_body, first.T_parent_body):
        is_carried = name == "table"
        expected = found.T_world_motion @ before.reshape(4, 4) if is_carried else before.reshape(4, 4)
        np.testing.assert_allclose(now.reshape(4, 4), expected, atol=1e-12)
    for stage in ("trajectory", "reachability", "scan", "coverage", "overlaps", "cell"):
        assert moved.refs[stage] == next(
            ref for name, ref in made.items() if _is_moved(name, moved.refs[stage].kind, ref)
        )
    recipe = lake.manifest(moved.refs["report"]).about.params
    np.testing.assert_allclose(Pose.model_validate(recipe["T_world_part"]).matrix(), found.T_world_part, atol=1e-12)


def _is_moved(name: str, kind: str, ref: Any) -> bool:
    return name.endswith("moved") and ref.kind == kind


def test_every_selected_sweep_is_executed_at_least_as_far(
    moved: InspectionResult, unmoved: InspectionResult, lake_url: str
) -> None:
    from schemas.placement_objects import executed_spans

    lake = Lake(lake_url)
    after: Any = lake.load(moved.refs["trajectory"])
    before: Any = lake.load(unmoved.refs["trajectory"])
    spans = executed_spans(after)
    for view, (first, last) in executed_spans(before).items():
        assert spans[view][0] <= first + 1e-6 and spans[view][1] >= last - 1e-6


def test_a_placement_that_finds_nothing_better_leaves_the_plan_as_it_is(
    cell: Path, unmoved: InspectionResult, lake_url: str
) -> None:
    own = "report", "placement", "part_hull", "cell_hull"
    kept = inspection.run(cell, overrides=["layout.evaluations=1"], lake=lake_url, direct=True)
    assert not kept.summary["placement"]["moved"]
    assert {name: ref for name, ref in kept.refs.items() if name not in own} == {
        name: ref for name, ref in unmoved.refs.items() if name != "report"
    }
    assert dict(kept.rows())["placement"] == "kept, no better one of 1 judged"
    assert b"stays where the cell file puts it" in kept.report.page


def test_where_the_moved_plan_fails_its_verification_nothing_moves_and_it_says_so(
    cell: Path, moved: InspectionResult, unmoved: InspectionResult, lake_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, failures = VerificationScene.collision, [("arm", "part")]

    def fails_once(scene: VerificationScene, q: FloatArray) -> tuple[str, str] | None:
        return failures.pop() if failures else whole(scene, q)

    monkeypatch.setattr(VerificationScene, "collision", fails_once)
    kept = inspection.run(cell, lake=lake_url, direct=True, refresh=["verify_plan"])
    assert moved.summary["placement"]["moved"] and not failures
    assert kept.refs["trajectory"] == unmoved.refs["trajectory"]
    told = kept.summary["placement"]
    assert not told["moved"] and told["cycle_after_s"] == told["cycle_before_s"] == unmoved.summary["duration_s"]
    assert told["refusal"].startswith("its plan fails its verification: ") and "arm" in told["refusal"]
    assert dict(kept.rows())["placement"] == f"kept: {told['reason']}"
    assert b"stays where the cell file puts it: x " in kept.report.page
    assert b"looked better, but its plan fails its verification" in kept.report.page
    outcome: Any = Lake(lake_url).load(kept.refs["placement"])
    assert not outcome.moved
    assert all(record.name != "verify_plan moved" for record in kept.records)


def test_a_plan_that_fails_is_shown_where_the_part_stands(
    cell: Path, lake_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[InspectionRequest] = []

    def draw(request: InspectionRequest, *_: object) -> bytes:
        drawn.append(request)
        return b"a picture"

    monkeypatch.setattr("flows.cell_picture.picture_of", draw)
    monkeypatch.setattr("cellwright.cell.verification_scene.VerificationScene.collision", lambda *_: ("arm", "part"))
    heard: list[Findings] = []
    with pytest.raises(UnsafePlanError):
        inspection.run(cell, lake=lake_url, direct=True, refresh=["verify_plan"], explain=heard.append)
    assert heard[0].failed_motion.startswith("The plan fails at 0.00 s") and heard[0].cell_picture == b"a picture"
    (request,) = drawn
    assert request.part_pose.position_m[:2] == request_of(cell).part_pose.position_m[:2]


def test_a_second_run_computes_nothing(cell: Path, moved: InspectionResult, lake_url: str) -> None:
    again = inspection.run(cell, lake=lake_url, direct=True)
    assert not [record.name for record in again.records if not record.cached]
    assert again.refs == moved.refs


def test_the_identity_poses_the_request_as_it_was(cell: Path) -> None:
    request = request_of(cell)
    at = Pose(position_m=(0.7, 0.0, 0.2))
    still = placement(T_world_motion=np.eye(4), T_world_part=at.matrix(), carried=("table",))
    there = {"part_pose": at, "rests_on": None}
    assert request.placed(at).moved(still) == request.placed(at).model_copy(update=there)


def test_moving_the_base_moves_the_base_alone(cell: Path) -> None:
    request = request_of(cell, ["layout.move=robot"])
    assert request.placement is not None and request.placement.carries == ()
    D = Pose(position_m=(0.1, -0.2, 0.0)).matrix()
    now = request.moved(placement(moves="robot", carried=(), T_world_motion=D, T_world_base=D))
    assert now.cell.T_world_base.position_m == (0.1, -0.2, 0.0)
    assert now.cell.bodies == request.cell.bodies
