from __future__ import annotations

import io
import re
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from cellwright.errors import InfeasibleError, InvalidInputError
from schemas.artefact import digest
from schemas.motion import Trajectory
from schemas.sequencing import SweepSequence, sequencing_figures
from schemas.sweep_params import StitchParams
from tasks.sequence_sweeps import SweepSequenceParams, sequence_sweeps
from tasks.stitch_sweeps import stitch_sweeps
from tasks.take_sequence import TakenSequenceParams, take_sequence
from tasks.verify_plan import VerifyParams, verify_plan
from tests.cellwright.solvers import scanning_cell
from tests.tasks.goldens import check_golden
from tests.tasks.scanning_artefacts import PART_POSE, cell_model, part_mesh, reachability, viewpoints

STITCHING = StitchParams(T_world_part=PART_POSE, scan_speed_m_s=0.2, max_alternatives=2, roadmap_nodes=100)
PARAMS = SweepSequenceParams(T_world_part=PART_POSE, stitching=STITCHING, n_steps=10, max_motions=30, target_gap=0.01)
BY_TIME = PARAMS.model_copy(update={"cost": "time"})

# one worker for all of them, or each would sequence anew
pytestmark = pytest.mark.xdist_group("sequence_sweeps")


def inputs(cell: Any = None) -> tuple[Any, ...]:
    return cell or cell_model(), part_mesh(), viewpoints(), reachability(), scanning_cell.selection()


@cache
def stitched(method: str = "best") -> Trajectory:
    found: Trajectory = stitch_sweeps(*inputs(), params=STITCHING.model_copy(update={"method": method}))
    return found


def run(params: SweepSequenceParams = PARAMS, cell: Any = None, trajectory: Trajectory | None = None) -> SweepSequence:
    found: SweepSequence = sequence_sweeps(*inputs(cell), trajectory or stitched(), params=params)
    return found


@cache
def controlled() -> SweepSequence:
    return run()


@cache
def by_time() -> SweepSequence:
    return run(BY_TIME, trajectory=stitched("greedy"))


def taken(sequence: SweepSequence, trajectory: Trajectory) -> Trajectory:
    found: Trajectory = take_sequence(sequence, trajectory, params=TakenSequenceParams())
    return found


def test_optimal_control_costs_less_and_takes_less_time_than_the_stitched_and_the_greedy_plan() -> None:
    found = controlled()
    assert found.plan == ("greedy", "exact", "optimal control") and found.is_taken
    assert found.taken.tolist() == [False, False, True]
    assert found.cost[2] < found.cost[1] <= found.cost[0] + 1e-9
    assert found.duration_s[2] < found.duration_s[1] == pytest.approx(stitched().time_s[-1])
    assert found.lower_bound <= found.cost[2] * (1 + 1e-6)
    assert 0 < found.n_evaluated < 0.2 * found.n_motions
    assert found.n_joined + found.n_stopped == 5 and found.n_joined >= 4


def test_the_plan_passes_the_verification_of_all_plans() -> None:
    plan = taken(controlled(), stitched())
    verified = verify_plan(
        *inputs(), plan, params=VerifyParams(T_world_part=PART_POSE, scan_speed_m_s=STITCHING.scan_speed_m_s)
    )
    assert verified.n_states > 100 and verified.least_distance_m > 0.0
    assert plan.order_method[-1] == "optimal control" and plan.order_chosen.tolist() == [False, False, True]
    assert plan.order_duration_s[-1] == plan.time_s[-1]
    assert "optimal control" in plan.via


def test_sweeps_between_joining_motions_run_at_scanning_speed_from_end_to_end() -> None:
    plan = taken(controlled(), stitched())
    number = next(k for k in range(1, len(plan.kind) - 1, 2) if plan.via[k - 1] == plan.via[k + 1] == "optimal control")
    time, travel = (column[plan.segment == number] for column in (plan.time_s, plan.travel_m))
    assert np.abs(np.diff(travel) / np.diff(time)) == pytest.approx(STITCHING.scan_speed_m_s, rel=1e-6)
    assert np.abs(plan.velocity_rad_s[plan.segment == number][0]).max() > 0.01


def test_the_torques_of_joining_motions_keep_their_limits() -> None:
    assert controlled().torque_share[2] <= 1.0 + 1e-6
    assert (controlled().effort_n2m2s > 0).all() and (controlled().work_j > 0).all()


def peer_torques(plan: Any, carried_kg: float) -> Any:
    """Return what pinocchio's inverse dynamics of the URDF with a point mass on the flange asks for, state by state."""
    import pinocchio

    model = pinocchio.buildModelFromXML(cell_model().urdf)
    flange = model.frames[model.getFrameId(cell_model().flange_link)]
    carried = pinocchio.Inertia(carried_kg, np.zeros(3), np.zeros((3, 3)))
    model.appendBodyToJoint(flange.parentJoint, carried, flange.placement)
    data = model.createData()
    rows = zip(plan.position_rad, plan.velocity_rad_s, plan.acceleration_rad_s2)
    return np.array([pinocchio.rnea(model, data, *row) for row in rows])


def test_the_plan_has_the_torques_of_inverse_dynamics_with_the_payload() -> None:
    plan = taken(controlled(), stitched())
    assert plan.torque_nm.shape == plan.position_rad.shape
    np.testing.assert_allclose(plan.torque_nm, peer_torques(plan, PARAMS.payload_kg), atol=1e-8)
    assert not np.allclose(plan.torque_nm, peer_torques(plan, 0.0), atol=0.5)


def test_the_stitched_plan_gets_its_torques_too_if_it_stays_though_dynamics_count() -> None:
    kept = take_sequence(controlled(), stitched(), params=TakenSequenceParams(keep_stitched=True))
    np.testing.assert_allclose(kept.torque_nm, peer_torques(stitched(), PARAMS.payload_kg), atol=1e-8)
    assert digest(replace(kept, torque_nm=None)) == digest(stitched())


def test_by_time_alone_no_torques_are_told() -> None:
    plan = taken(by_time(), stitched("greedy"))
    assert plan.torque_nm.shape == (len(plan.time_s), 0) and len(by_time().stitched_torque_nm) == 0


def test_the_picture_shows_both_plans() -> None:
    from PIL import Image

    width, height = Image.open(io.BytesIO(controlled().picture)).size
    assert width > 600 and height > 300


def test_by_time_the_sequence_finds_what_dynamic_programming_finds() -> None:
    found = by_time()
    assert found.is_taken and found.plan == ("greedy", "sequence")
    exact = dict(zip(stitched().order_method, stitched().order_duration_s.tolist()))["exact"]
    assert found.duration_s[1] == pytest.approx(exact, abs=1e-6)
    assert found.duration_s[1] < found.duration_s[0] and found.proven
    assert found.picture[:4] == b"\x89PNG"


def test_a_plan_that_is_already_shortest_stays_and_it_says_why() -> None:
    found = run(BY_TIME)
    assert not found.is_taken and len(found.time_s) == 0 and found.kind == ()
    assert re.fullmatch(r"the best sequence found costs [\d.]+, not less than the stitched plan's [\d.]+", found.reason)
    assert digest(taken(found, stitched())) == digest(stitched())


def test_the_figures_are_plain_values() -> None:
    figures = sequencing_figures(controlled())
    assert figures["stitched"] == "exact" and figures["name"] == "optimal control" and figures["taken"]
    assert figures["plans"]["exact"]["work_j"] > 0 and figures["greedy_before_s"] is None


def test_the_greedy_plan_of_another_placement_is_kept_for_comparison() -> None:
    found = sequence_sweeps(*inputs(), stitched(), stitched(), params=BY_TIME)
    assert found.greedy_before_s == stitched().order_duration_s[0]


def test_the_sequence_is_the_same_whenever_it_is_found() -> None:
    assert digest(run(BY_TIME, trajectory=stitched("greedy"))) == digest(by_time())


def test_the_result_is_the_one_of_this_version() -> None:
    found = by_time()
    decisions = [*zip(found.view.tolist(), found.branch.tolist(), found.direction.tolist(), found.via, strict=True)]
    # decisions and hundredths of seconds: the last digits of joint angles differ from machine to machine
    columns = [each.name for each in fields(found)]  # a lake's artefact of this version must have them
    controlled = np.round(run(PARAMS).end_s, 1).tolist()  # motions by optimal control, too
    told = decisions, np.round(found.end_s, 2).tolist(), np.round(found.work_j).tolist(), columns, controlled
    check_golden(sequence_sweeps, repr(told))


def weaker(share: float) -> Any:
    model = cell_model()
    weak = re.sub(r'effort="([\d.]+)"', lambda found: f'effort="{share * float(found[1]):.6g}"', model.urdf)
    assert weak != model.urdf
    return replace(model, urdf=weak)


def test_torque_limits_too_small_to_hold_the_arm_are_named() -> None:
    with pytest.raises(InfeasibleError, match=r"joint '\w+' needs [\d.]+ N m to hold the arm at the start"):
        run(cell=weaker(0.02))


def test_a_robot_without_masses_is_refused_with_the_mend_but_sequenced_by_time() -> None:
    model = cell_model()
    massless = replace(model, urdf=re.sub(r"<inertial>.*?</inertial>", "", model.urdf, flags=re.DOTALL))
    with pytest.raises(InvalidInputError, match=r"moves no mass: add <inertial>.*or sequence by time alone: .* `cost`"):
        run(cell=massless)
    found = run(BY_TIME, cell=massless, trajectory=stitched("greedy"))
    assert found.is_taken and np.isnan(found.work_j).all() and found.picture == b""


def test_a_robot_without_torque_limits_is_refused_with_the_mend() -> None:
    model = cell_model()
    unlimited = replace(model, urdf=re.sub(r'effort="[\d.]+"', "", model.urdf))
    with pytest.raises(InvalidInputError, match=r"joint '\w+' has torque limit nan.*write time for `cost`"):
        run(cell=unlimited)
