from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.ignored_pairs import Reason
from cellwright.cell.inverse_kinematics import inverse_kinematics_for
from cellwright.cell.transforms import inverse, pose
from cellwright.errors import InfeasibleError, InvalidInputError
from schemas.artefact import digest
from schemas.cell_objects import packed_bodies
from schemas.payload import PayloadParams
from schemas.views import Reachability
from tasks.verify_plan import VerifyParams, verify_plan
from tests.cellwright.solvers import scanning_cell
from tests.tasks.goldens import check_golden, rounded
from tests.tasks.scanning_artefacts import PART_POSE, cell_model, part_mesh, reachability, viewpoints
from tests.tasks.test_simulate_scan import swing

BRANCH = 1
"""An inverse kinematics branch that keeps clear of everything on the first sweep."""
PARAMS = VerifyParams(T_world_part=PART_POSE, scan_speed_m_s=0.2)


def run(trajectory=None, cell=None, params=PARAMS, selection=None, progress=lambda share: None):
    return verify_plan(
        cell or cell_model(),
        part_mesh(),
        viewpoints(),
        reachability(),
        selection or scanning_cell.selection(),
        trajectory or scanning_cell.trajectory(),
        params=params,
        progress=progress,
    )


@cache
def verification():
    return run()


def test_a_sound_plan_is_verified_with_what_was_found_and_permitted():
    proof = verification()
    assert np.all(np.where(proof.at_least, proof.found >= proof.permitted, proof.found <= proof.permitted))
    assert 0.0 < proof.proven_distance_m <= proof.least_distance_m < np.inf
    assert proof.proven_distance_m >= 0.99 * proof.least_distance_m - 1e-6
    assert set(proof.nearest_bodies) < {*cell_model().body, "part"}
    assert len(set(proof.check)) == len(proof.check)
    assert {"colliding states", "scanner off its planned line", "sweeps not executed"} <= set(proof.check)
    assert "fcl" in proof.engine.lower()
    assert proof.n_states > len(scanning_cell.trajectory().time_s)


def test_steps_between_checked_states_are_at_most_a_millimetre_and_a_tenth_of_a_degree():
    found = dict(zip(verification().check, verification().found, strict=True))
    assert found["motion between checked states"] <= 1e-3
    assert found["joint turn between checked states"] <= np.deg2rad(0.1)


def test_the_proof_is_the_same_whenever_it_is_made():
    assert digest(run()) == digest(verification())


def one_sweep():
    """A cell and what a plan in it is verified with: the first sweep alone, from its own start, without a planner."""
    built = scanning_cell.cell()
    time = np.linspace(0.0, 2.0, 101)
    share = time / 2.0

    def joints(shift):
        at = 0.12 * (10 * share**3 - 15 * share**4 + 6 * share**5) - 0.06 + shift
        along = np.tile(np.eye(4), (len(at), 1, 1))
        along[:, 0, 3] = at
        T = scanning_cell.sweep_pose(*scanning_cell.ANGLES[0]) @ along
        flange = inverse(built.T_world_base) @ T @ inverse(built.T_flange_scanner)
        return at, inverse_kinematics_for(built.robot.chain).solve(flange)[:, BRANCH]

    step = 1e-5
    travel, q = joints(0.0)
    along = (joints(step)[1] - joints(-step)[1]) / (2 * step)  # joint angles change by so much a metre
    speed = 0.06 * (30 * share**2 - 60 * share**3 + 30 * share**4)
    velocity = along * speed[:, None]
    trajectory = replace(
        swing("sweep"),
        time_s=time,
        position_rad=q,
        velocity_rad_s=velocity,
        acceleration_rad_s2=np.gradient(velocity, time, axis=0),
        segment=np.zeros(len(time), np.int32),
        travel_m=travel,
        end_s=time[-1:],
        branch=np.array([BRANCH], np.int8),
    )
    reached = Reachability(
        view=np.zeros(1, np.int32),
        branch=np.array([BRANCH], np.int8),
        start_m=np.array([-0.06]),
        end_m=np.array([0.06]),
        q_start_rad=q[:1],
        outcome=np.zeros(5, np.int8),
        blocked_by=np.full(5, -1, np.int32),
        body=tuple(body.name for body in built.bodies),
    )
    cell = replace(cell_model(), start_rad=q[0])
    return cell, part_mesh(), viewpoints(), reached, scanning_cell.selection(1), trajectory


def test_the_result_is_the_one_of_this_version():
    proof = verify_plan(*one_sweep(), params=PARAMS)
    # the engine's name holds its version
    facts = {"nearest_s": round(proof.nearest_s, 3), "engine": ""}
    for name in ("least_distance_m", "proven_distance_m"):
        facts[name] = round(getattr(proof, name), 5)
    check_golden(verify_plan, rounded(proof, 4, **facts))


def test_torques_are_checked_with_the_payload_where_they_are_asked_for():
    *given, trajectory = one_sweep()
    checked = PARAMS.model_copy(update={"by_torque": True})
    found = verify_plan(*given, trajectory, params=checked)
    shares = dict(zip(found.check, found.found, strict=True))
    assert 0.0 < shares["joint torque"] < 1.0
    payload = PayloadParams(mass_kg=60.0, centre_m=(0.0, 0.0, 0.2))
    with pytest.raises(InfeasibleError, match=r"joint torque is [\d.]+ of its limit .* in joint \d: carry less"):
        verify_plan(*given, trajectory, params=checked.model_copy(update={"payload": payload}))


def test_a_plan_through_an_obstacle_that_the_planner_did_not_know_is_an_error():
    trajectory = scanning_cell.trajectory()
    row = int(np.argmax(np.isnan(trajectory.travel_m) & (trajectory.segment == 2)))
    at = scanning_cell.cell().robot.flange_pose(trajectory.position_rad[row + 20])
    post = Body("post", Box((0.05, 0.05, 0.05)), WORLD, at @ pose(np.array([0.0, 0.0, 0.05]), np.eye(3)))
    blocked = replace(cell_model(), **packed_bodies((*scanning_cell.cell_without_part().bodies, post)))
    with pytest.raises(InfeasibleError, match=r"colliding states is 1 .* at \d+\.\d+ s: .*post"):
        run(cell=blocked)


def test_a_pair_that_was_only_sampled_as_never_touching_is_checked():
    trajectory = scanning_cell.trajectory()
    row = int(np.argmax(np.isnan(trajectory.travel_m) & (trajectory.segment == 2)))
    at = scanning_cell.cell().robot.flange_pose(trajectory.position_rad[row + 20])
    post = Body("post", Box((0.05, 0.05, 0.05)), WORLD, at @ pose(np.array([0.0, 0.0, 0.05]), np.eye(3)))
    model = cell_model()
    blocked = replace(model, **packed_bodies((*scanning_cell.cell_without_part().bodies, post)))
    pairs = np.array([[body, len(model.body)] for body in range(len(model.body))], np.int32)

    def ignoring(reason):
        return replace(
            blocked,
            ignored_pair=np.concatenate([model.ignored_pair, pairs]),
            ignored_reason=np.concatenate([model.ignored_reason, np.full(len(pairs), reason, np.int8)]),
        )

    with pytest.raises(InfeasibleError, match=r"colliding states is 1 .*post"):
        run(cell=ignoring(Reason.NEVER_TOUCHING))
    assert run(cell=ignoring(Reason.DECLARED)).n_states == verification().n_states


def test_a_tampered_trajectory_is_an_error():
    trajectory = scanning_cell.trajectory()
    position = trajectory.position_rad.copy()
    position[200:, 0] += 0.1
    with pytest.raises(InfeasibleError, match="joint speed"):
        run(trajectory=replace(trajectory, position_rad=position))


def test_a_plan_for_another_selection_is_invalid():
    selection = scanning_cell.selection()
    fewer = replace(
        selection, view=selection.view[:4], n_samples=selection.n_samples[:4], n_only=selection.n_only[:4],
        max_uncertainty_m=selection.max_uncertainty_m[:4],
    )  # fmt: skip
    with pytest.raises(InvalidInputError, match="executes view 4, which is not selected"):
        run(selection=fewer)


def test_a_slower_permitted_scan_is_an_error():
    with pytest.raises(InfeasibleError, match=r"scanner speed on a sweep is 0\.2"):
        run(params=PARAMS.model_copy(update={"scan_speed_m_s": 0.1}))


def test_a_slower_permitted_acceleration_is_an_error():
    with pytest.raises(InfeasibleError, match=r"scanner acceleration on a sweep is 1\.0"):
        run(params=PARAMS.model_copy(update={"tool_acceleration_m_s2": 0.5}))


def test_a_plan_that_should_return_but_does_not_is_an_error():
    with pytest.raises(InfeasibleError, match="end off the start configuration"):
        run(params=PARAMS.model_copy(update={"return_to_start": True}))


def test_progress_rises_to_one():
    shares = []
    run(progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0


def rows_of(artefact, rows, *names, **others):
    """Return a copy whose columns ``names`` hold these rows, with other fields replaced."""
    return replace(artefact, **{name: getattr(artefact, name)[rows] for name in names}, **others)


def test_a_sweep_that_the_plan_leaves_out_is_not_missed_and_any_other_is():
    last = [*range(5), 4]  # view 4 once more, as view 5
    counts = "n_samples", "n_only", "max_uncertainty_m"
    wider = rows_of(scanning_cell.selection(), last, *counts, view=np.arange(6, dtype=np.int32))
    poses = "sample", "position_m", "quaternion", "delta_rot_rad", "theta_tilt_rad", "psi_tilt_rad", "standoff_m"
    views = rows_of(viewpoints(), last, *poses)
    own = np.flatnonzero(reachability().view == 4)
    pieces = [*range(len(reachability().view)), *own]
    view = np.concatenate([reachability().view, np.full(len(own), 5, np.int32)])
    reached = rows_of(reachability(), pieces, "branch", "start_m", "end_m", "q_start_rad", view=view)
    reached = rows_of(reached, last, "outcome", "blocked_by")
    trajectory = scanning_cell.trajectory()
    told = replace(trajectory, left_out_view=np.array([5], np.int32), left_out_reason=("it is walled in",))
    inputs = cell_model(), part_mesh(), views, reached, wider
    assert verify_plan(*inputs, told, params=PARAMS).n_states == verification().n_states
    with pytest.raises(InfeasibleError, match=r"sweeps not executed is 1 .*view 5"):
        verify_plan(*inputs, trajectory, params=PARAMS)
