from __future__ import annotations

import io
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from cellwright.errors import InvalidInputError
from flows import inspection, sequenced_plan
from flows.inspection_result import InspectionResult
from flows.requests import InspectionRequest, request_of
from schemas.artefact import digest
from schemas.payload import PayloadParams
from storage.lake import Lake
from tests.flows.test_sequence import efforts
from tests.small_inspection import CELL, write_cell

SEQUENCING = "sequencing: {cost: optimal_control, steps: 8, max_motions: 6, payload: {mass: 1.5 kg}}\n"

# one worker for all of them, or each would plan the cell anew
pytestmark = pytest.mark.xdist_group("sequencing")


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_cell(tmp_path_factory.mktemp("sequencing"), CELL + SEQUENCING)


@pytest.fixture(scope="module")
def lake_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("lake") / "lake")


@pytest.fixture(scope="module")
def sequenced(cell: Path, lake_url: str) -> InspectionResult:
    return inspection.run(cell, lake=lake_url, direct=True)


@pytest.fixture(scope="module")
def stitched(cell: Path, lake_url: str) -> InspectionResult:
    return inspection.run(cell, overrides=["sequencing=null"], lake=lake_url, direct=True)


def test_the_sequenced_plan_is_cheaper_verified_scanned_and_reported(
    sequenced: InspectionResult, stitched: InspectionResult
) -> None:
    told = sequenced.summary["sequencing"]
    assert told["taken"] and told["name"] == "optimal control"
    assert told["plans"][told["name"]]["cost"] < told["plans"][told["stitched"]]["cost"]
    assert sequenced.summary["duration_s"] < stitched.summary["duration_s"]
    assert told["plans"][told["stitched"]]["duration_s"] == pytest.approx(stitched.summary["duration_s"])
    assert sequenced.summary["coverage"] >= stitched.summary["coverage"] - 0.01
    assert sequenced.summary["verified_states"] > 100
    assert b"The sequence, by what it costs" in sequenced.report.page
    assert b"The sequence, by what it costs" not in stitched.report.page
    assert "sequencing" not in stitched.summary
    assert dict(sequenced.rows())["sequence"].startswith("by optimal control, cost ")
    assert "sequence" not in dict(stitched.rows())


def test_all_that_belongs_to_the_plan_is_of_the_sequence(sequenced: InspectionResult, lake_url: str) -> None:
    made = {record.name: record.ref for record in sequenced.records}
    assert sequenced.refs["trajectory"] == made["take_sequence"]
    assert sequenced.refs["scan"] == made["simulate_scan sequenced"]
    assert sequenced.refs["coverage"] == made["measure_coverage sequenced"]
    found: Any = Lake(lake_url).load(sequenced.refs["sequence"])
    assert found.duration_s[-1] == pytest.approx(sequenced.summary["duration_s"])


def test_the_verification_of_the_sequence_looks_at_torques_with_the_payload(
    sequenced: InspectionResult, stitched: InspectionResult, lake_url: str
) -> None:
    shares: list[float] = []
    for result, expected in ((sequenced, 1), (stitched, 0)):
        found: Any = Lake(lake_url).load(result.refs["verification"])
        own = [share for name, share in zip(found.check, found.found, strict=True) if name == "joint torque"]
        assert len(own) == expected
        shares += own
    told: Any = Lake(lake_url).load(sequenced.refs["sequence"])
    assert shares == pytest.approx([told.torque_share[-1]], rel=0.02)  # looked at at other moments


def test_torques_stand_in_table_recording_and_figure_where_dynamics_count(
    cell: Path, sequenced: InspectionResult, stitched: InspectionResult, lake_url: str, tmp_path: Path
) -> None:
    inspection.run(cell, lake=lake_url, direct=True, out=tmp_path / "weighed")
    inspection.run(cell, overrides=["sequencing=null"], lake=lake_url, direct=True, out=tmp_path / "plain")
    states = pq.read_table(tmp_path / "weighed" / "trajectory.parquet")
    torque = np.array(states["torque_nm"].to_pylist())
    told: Any = Lake(lake_url).load(sequenced.refs["sequence"])
    assert torque.shape == (states.num_rows, 6) and np.array_equal(torque, told.torque_nm)
    n_told, effort = efforts(tmp_path / "weighed" / "plan.mcap")
    assert n_told == torque.size and np.array_equal(effort, torque)
    assert "torque_nm" not in pq.read_schema(tmp_path / "plain" / "trajectory.parquet").names
    assert efforts(tmp_path / "plain" / "plan.mcap")[0] == 0
    heights = [Image.open(io.BytesIO(each.report.plan_png)).height for each in (sequenced, stitched)]
    assert 2 * heights[0] == 3 * heights[1]


def test_a_sequence_that_fails_its_torques_leaves_the_stitched_plan_with_a_note(
    cell: Path, stitched: InspectionResult, lake_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    heavier = PayloadParams(mass_kg=60.0, centre_m=(0.0, 0.0, 0.2))

    def with_more(request: InspectionRequest, _: object) -> InspectionRequest:
        verification = request.verification.model_copy(update={"by_torque": True, "payload": heavier})
        return request.model_copy(update={"verification": verification})

    monkeypatch.setattr(sequenced_plan, "_with_torques", with_more)
    kept = inspection.run(cell, lake=lake_url, direct=True)
    told: Any = Lake(lake_url).load(kept.refs["trajectory"])
    assert told.torque_nm.shape == told.position_rad.shape
    assert digest(replace(told, torque_nm=None)) == stitched.refs["trajectory"].digest
    assert kept.refs["scan"] == stitched.refs["scan"] and kept.refs["coverage"] == stitched.refs["coverage"]
    assert kept.refs["verification"].digest == stitched.refs["verification"].digest
    assert any("the stitched plan stays" in note and "joint torque is" in note for note in kept.notes)


def test_a_second_run_computes_nothing(cell: Path, sequenced: InspectionResult, lake_url: str) -> None:
    again = inspection.run(cell, lake=lake_url, direct=True)
    assert not [record.name for record in again.records if not record.cached]
    assert again.refs == sequenced.refs


def test_where_nothing_is_cheaper_the_stitched_plan_stays_and_the_report_says_so(
    cell: Path, stitched: InspectionResult, lake_url: str
) -> None:
    best = "planner.stitching.method=best"
    kept = inspection.run(cell, overrides=["sequencing.cost=time", best], lake=lake_url, direct=True)
    without = inspection.run(cell, overrides=["sequencing=null", best], lake=lake_url, direct=True)
    assert not kept.summary["sequencing"]["taken"]
    assert kept.refs["trajectory"] == without.refs["trajectory"]
    assert dict(kept.rows())["sequence"] == "as stitched: time found none that costs less"
    assert b"The stitched plan stays: the best sequence found costs" in kept.report.page


def test_the_request_takes_weights_payload_and_the_middle_of_the_housing(cell: Path) -> None:
    params = request_of(cell, ["sequencing.weights.speed=0.5 s/rad^2"]).sequencing
    assert params is not None and params.weight_speed_s_per_rad2 == 0.5 and params.payload_kg == 1.5
    assert params.payload_centre_m == pytest.approx((0.0775, 0.0, 0.0865))
    there = request_of(cell, ["sequencing.payload.centre=[1 mm, 2 mm, 3 mm]"]).sequencing
    assert there is not None and there.payload_centre_m == (0.001, 0.002, 0.003)


def test_a_payload_that_nothing_can_weigh_is_told(cell: Path) -> None:
    def notes(work_j: float, *overrides: str) -> list[str]:
        found: Any = SimpleNamespace(work_j=np.array([math.nan, work_j]))  # with the greedy plan, which may be missing
        return sequenced_plan._payload_notes(request_of(cell, overrides), found)

    (note,) = notes(math.nan, "sequencing.cost=time")
    assert note.startswith(f"{cell}, sequencing.payload: 1.5 kg change nothing") and "<inertial>" in note
    assert not notes(3.0, "sequencing.cost=time")
    assert not notes(math.nan, "sequencing.cost=optimal_control")
    assert not notes(math.nan, "sequencing={cost: time}")


def test_a_payload_that_the_arm_cannot_hold_is_named_with_its_key(cell: Path, lake_url: str) -> None:
    with pytest.raises(Exception, match=r"needs [\d.]+ N m to hold the arm at the start, but its limit is") as caught:
        inspection.run(cell, overrides=["sequencing.payload.mass=300 kg"], lake=lake_url, direct=True)
    assert "carry less" in str(caught.value)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("sequencing.cost=energy", "'energy'"),
        ("sequencing.weights.time=1", "needs one: write 1 /s"),
        ("sequencing.weights.torque=1 s", "is not a weight of squared torque"),
        ("sequencing.payload.mass=-1 kg", "must be at least 0"),
        ("sequencing.wieghts={}", "did you mean"),
    ],
)
def test_faults_in_the_cell_file_are_named(cell: Path, override: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        request_of(cell, [override])
