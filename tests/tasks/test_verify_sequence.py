from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwright.errors import InfeasibleError, InvalidInputError
from schemas.payload import PayloadParams
from tasks.verify_sequence import verify_sequence
from tests import small_sequence as small
from tests.tasks.goldens import check_golden


def run(sequence=None, tasks=None, cell=None, **changes):
    params = small.request().verification.model_copy(update=changes)
    return verify_sequence(
        cell or small.cell(), tasks or small.task_list(), small.alternatives(), sequence or small.sequence(),
        params=params,
    )  # fmt: skip


def test_a_planned_sequence_passes_and_keeps_its_distance():
    found = small.verification()
    assert found.engine.startswith("python-fcl") or "fcl" in found.engine
    assert found.proven_distance_m > 0.0 and found.n_states > 1000
    assert np.all(np.where(found.at_least, found.found >= found.permitted, found.found <= found.permitted))


def fails(words, **changes):
    with pytest.raises(InfeasibleError, match=words):
        run(**changes)


def test_a_task_that_is_left_out_fails():
    plan = small.sequence()
    fails("tasks not performed", sequence=replace(plan, task=np.array([plan.task[1], *plan.task[1:]], np.int32)))


def test_an_order_that_is_not_permitted_fails():
    listed = small.task_list()
    wrong = replace(listed, before=listed.before[:, ::-1].copy())
    fails("tasks in an order that is not permitted is 1", tasks=wrong)


def test_a_tool_beside_its_task_fails():
    T = small.task_list().T_world_tool.copy()
    T[1, 7] += 0.001
    fails("tool off its task is 0.001", tasks=replace(small.task_list(), T_world_tool=T))


def test_a_dwell_that_is_too_short_fails():
    fails("time missing at a task is 0.1", tasks=replace(small.task_list(), dwell_s=small.task_list().dwell_s + 0.1))


def test_a_tool_that_leaves_its_task_between_the_moments_of_a_dwell_fails():
    plan = small.sequence()
    when = plan.arrive_s[0] + 0.3 * (plan.leave_s[0] - plan.arrive_s[0])
    row = int(np.searchsorted(plan.time_s, when))
    away = plan.position_rad[row] + np.array([0.0, 0.0, 0.0, 0.0, 0.01, 0.0])
    states = {
        "time_s": when, "position_rad": away, "velocity_rad_s": 0.0, "acceleration_rad_s2": 0.0,
        "segment": plan.segment[row],
    }  # fmt: skip
    fails(
        "tool off its task is 0.003",
        sequence=replace(
            plan, **{name: np.insert(getattr(plan, name), row, value, axis=0) for name, value in states.items()}
        ),
    )


def test_moving_at_a_task_without_strokes_fails():
    # what is called work may touch: nothing but strokes and dwell may be called so
    fails("motion at a task outside its strokes", tasks=replace(small.task_list(), approach_m=np.zeros(4)))


@pytest.mark.parametrize("stop", [-1, 0, 99])
def test_a_motion_that_is_called_work_fails(stop):
    plan = small.sequence()
    moving = plan.kind.index("motion", 1)
    kind, stops = list(plan.kind), plan.stop.copy()
    kind[moving], stops[moving] = "work", stop
    fails("segments called work of no stop of their own", sequence=replace(plan, kind=tuple(kind), stop=stops))


def test_work_that_is_called_a_motion_is_no_stroke():
    plan = small.sequence()
    fails("stroke cut short", sequence=replace(plan, kind=("motion",) * len(plan.kind)))


def test_a_stop_whose_times_are_out_of_order_fails():
    plan = small.sequence()
    fails("stop whose times are out of order", sequence=replace(plan, arrive_s=plan.arrive_s - 2.0))


def test_a_stroke_that_is_too_short_fails():
    fails("stroke cut short is 0.01", tasks=replace(small.task_list(), approach_m=small.task_list().approach_m + 0.01))


def test_contact_at_work_is_a_collision_unless_it_is_permitted():
    fails("colliding states is 1 .*bit touches wall", touches=())


def test_contact_on_the_way_is_a_collision_although_it_is_permitted_at_work():
    cell = small.cell()
    wall = cell.body.index("wall")
    T = cell.T_parent_body.copy()
    T[wall, 3] -= 0.034  # between two strokes of 30 mm the bit now grazes the wall
    fails("colliding states is 1 .*bit touches wall", cell=replace(cell, T_parent_body=T))


def test_joints_that_are_too_fast_fail():
    cell = small.cell()
    fails("joint speed of the curve", cell=replace(cell, max_velocity_rad_s=0.5 * cell.max_velocity_rad_s))


def test_an_end_elsewhere_than_asked_for_fails():
    fails("end off the given configuration", returns=False, end_rad=(0.0,) * 6)


def test_artefacts_of_another_sequence_are_refused():
    plan = small.sequence()
    with pytest.raises(InvalidInputError, match="do not belong together"):
        run(replace(plan, alternative=plan.alternative + 1000))


def test_the_result_is_the_one_of_this_version():
    found = small.verification()
    told = f"{found.check} {found.unit} {np.round(found.permitted, 6).tolist()} {found.nearest_bodies}"
    check_golden(verify_sequence, f"{told} {found.least_distance_m:.4f}")


def test_torques_are_checked_in_place_of_accelerations_where_torques_are_what_limits():
    found = run(by_torque=True)
    shares = dict(zip(found.check, found.found, strict=True))
    assert 0.0 < shares["joint torque"] < 1.0 and not any("acceleration" in name for name in shares)


def test_a_payload_that_asks_for_too_much_torque_fails():
    fails("joint torque is .* in joint", by_torque=True, payload=PayloadParams(mass_kg=60.0, centre_m=(0.0, 0.0, 0.2)))
