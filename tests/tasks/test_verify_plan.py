from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.ignored_pairs import Reason
from cellwright.cell.transforms import pose
from cellwright.errors import InfeasibleError, InvalidInputError
from schemas.artefact import digest
from schemas.cell_objects import packed_bodies
from tasks.verify_plan import VerifyParams, verify_plan
from tests.cellwright.solvers import scanning_cell
from tests.tasks.scanning_artefacts import PART_POSE, cell_model, part_mesh, reachability, viewpoints

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
    assert np.all(proof.found <= proof.permitted)
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
