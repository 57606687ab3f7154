from __future__ import annotations

import itertools
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from cellwright.errors import InfeasibleError, InvalidInputError
from schemas.artefact import digest
from schemas.payload import PayloadParams
from schemas.task_objects import runs_of, timed_plan
from tasks.sequence_tasks import DynamicsParams, sequence_tasks
from tasks.verify_sequence import SequenceVerifyParams, verify_sequence
from tests import small_sequence as small
from tests.tasks.goldens import check_golden


def run(**changes):
    params = small.request().sequence.model_copy(update=changes)
    return sequence_tasks(small.cell(), small.task_list(), small.alternatives(), params=params)


def test_time_rises_strictly_and_segments_follow_each_other():
    plan = small.sequence()
    assert plan.time_s[0] == 0.0 and np.all(np.diff(plan.time_s) > 0)
    assert np.array_equal(plan.start_s[1:], plan.end_s[:-1]) and plan.end_s[-1] == pytest.approx(plan.time_s[-1])
    assert plan.kind == ("motion", "work") * 4 + ("motion",)


def test_every_task_is_done_once_and_after_what_comes_before_it():
    order = small.sequence().task.tolist()
    assert sorted(order) == [0, 1, 2, 3]
    assert order.index(0) < order.index(3)


def test_the_cost_is_the_duration_and_no_less_than_the_bound():
    plan = small.sequence()
    assert plan.cost == pytest.approx(plan.time_s[-1], rel=1e-6)
    assert 0.0 < plan.lower_bound <= plan.cost
    assert dict(zip(plan.order, plan.order_cost, strict=True))["sequence"] == plan.cost
    assert plan.cost <= plan.order_cost.min()


def test_few_of_all_motions_are_planned():
    plan = small.sequence()
    assert plan.n_evaluated <= small.request().sequence.max_motions + 5
    assert plan.n_motions == 4 * 6 + 6 * 6 * 6


def test_dwells_are_kept_where_the_file_asks_for_them():
    plan = small.sequence()
    assert np.allclose(plan.leave_s - plan.arrive_s, small.task_list().dwell_s[plan.task], atol=1e-9)


def test_the_same_seed_gives_the_same_bytes():
    assert digest(run()) == digest(small.sequence())


def test_too_few_motions_still_give_a_sequence_with_its_gap():
    plan = run(max_motions=1, target_gap=0.0)
    assert sorted(plan.task.tolist()) == [0, 1, 2, 3]
    assert plan.lower_bound < plan.cost and not plan.proven


def test_a_sequence_may_end_anywhere_or_at_a_given_configuration():
    end = (-2.6, -2.5, 2.1, 0.5, -1.3, 0.4)
    open_ = run(returns=False)
    assert open_.kind[-1] == "work"
    given = run(returns=False, end_rad=end)
    assert np.allclose(given.position_rad[-1], end)
    assert open_.cost < small.sequence().cost


def test_a_sequence_that_starts_anywhere_begins_with_work():
    # nothing is before anything: a round trip without a first task has no order
    listed = replace(small.task_list(), before=np.zeros((0, 2), np.int32))
    params = small.request().sequence.model_copy(update={"from_start": False})
    plan = sequence_tasks(small.cell(), listed, small.alternatives(), params=params)
    assert plan.kind == ("work", "motion") * 4
    assert np.allclose(plan.position_rad[0], plan.position_rad[-1])


def test_velocity_costs_count_the_slowest_joint_at_full_speed():
    plan = run(cost="velocity")
    assert plan.cost_name == "velocity bound" and plan.cost < plan.time_s[-1]


def test_an_end_that_collides_or_leaves_the_limits_is_refused():
    with pytest.raises(InvalidInputError, match="end_rad"):
        run(returns=False, end_rad=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InvalidInputError, match=r"joint elbow_joint at 99 rad, outside its limits -3.142 to 3.142 rad"):
        run(returns=False, end_rad=(0.0, 0.0, 99.0, 0.0, 0.0, 0.0))


def test_an_order_of_tasks_on_a_round_trip_without_a_first_one_is_refused():
    with pytest.raises(InvalidInputError, match="has no first task, so none comes after another"):
        run(from_start=False)


def test_a_single_task_without_motion_is_refused():
    listed, ways = small.task_list(), small.alternatives()
    own = int((ways.task == 0).sum())
    alone = replace(
        listed, name=listed.name[:1], T_world_tool=listed.T_world_tool[:1], n_rotations=listed.n_rotations[:1],
        dwell_s=np.zeros(1), approach_m=np.zeros(1), before=np.zeros((0, 2), np.int32),
    )  # fmt: skip
    columns = ("task", "rotation_rad", "branch", "position_rad", "entry_rad")
    alternatives = replace(
        ways, **{name: getattr(ways, name)[:own] for name in columns}, stroke_s=np.zeros(own),
        n_reached=ways.n_reached[:1], n_solutions=ways.n_solutions[:1], n_within_limits=ways.n_within_limits[:1],
        n_blocked=ways.n_blocked[:1], n_left_out=ways.n_left_out[:1],
    )  # fmt: skip
    params = small.request().sequence.model_copy(update={"from_start": False, "returns": False})
    with pytest.raises(InvalidInputError, match="asks for no motion: add a task"):
        sequence_tasks(small.cell(), alone, alternatives, params=params)


def test_parts_of_the_plan_meet_in_one_state():
    plan = small.sequence()
    whole = timed_plan(plan)
    parts = [timed_plan(plan, run) for _, run in runs_of(plan.kind)]
    assert sum(len(part.time) for part in parts) == len(whole.time) + len(parts) - 1
    for one, other in itertools.pairwise(parts):
        assert one.time[-1] == other.time[0] and np.array_equal(one.position[-1], other.position[0])


def test_tasks_that_no_motion_leads_to_are_named():
    from cellwright.solvers.pose_tasks import route

    class NoWay:
        name, unit, symmetric = "none", "s", True

        def bound(self, q_a, q_b):
            return np.zeros(np.broadcast_shapes(q_a.shape, q_b.shape)[:-1])

        def holding(self, q, dwell):
            return np.zeros(q.shape[:-1])

        def motion(self, q_a, q_b):
            from cellwright.solvers.motion_cost import CostedMotion
            from cellwright.solvers.path_timing import TimedMotion

            if any(abs(q[0] - 9.0) < 0.5 for q in (q_a, q_b)):
                return None
            rest = np.zeros((2, len(q_a)))
            return CostedMotion(1.0, TimedMotion(np.array([0.0, 1.0]), np.stack([q_a, q_b]), rest, rest), None, "x")

    from cellwright.solvers.pose_tasks.alternatives import Alternative
    from cellwright.solvers.pose_tasks.task import PoseTask

    names = ("here", "walled in", "there")
    ways = [Alternative(k, 0.0, 0, np.full(2, x), np.full(2, x), 0.0) for k, x in enumerate((1.0, 9.0, 2.0))]
    with pytest.raises(InfeasibleError, match="'walled in'"):
        route.find_route(
            [PoseTask(name, np.eye(4)) for name in names], ways, np.zeros(2), NoWay(), route.RouteRules(),
            route.RouteWork(), np.random.default_rng(0),
        )  # fmt: skip


def test_the_result_is_the_one_of_this_version():
    plan = small.sequence()
    told = f"{plan.task.tolist()} {plan.kind} {plan.via} {plan.cost:.3f} {plan.lower_bound:.3f} {plan.time_s[-1]:.3f}"
    columns = [each.name for each in fields(plan)]  # a lake's artefact of this version must have them
    check_golden(sequence_tasks, f"{told} {columns}")


def dynamic(**changes):
    """Return the sequence with two alternatives a task, dynamics priced or obeyed."""
    ways = small.alternatives()
    kept = np.concatenate([np.flatnonzero(ways.task == row)[:2] for row in range(4)])
    few = replace(
        ways, task=ways.task[kept], rotation_rad=ways.rotation_rad[kept], branch=ways.branch[kept],
        position_rad=ways.position_rad[kept], entry_rad=ways.entry_rad[kept], stroke_s=ways.stroke_s[kept],
    )  # fmt: skip
    weights = DynamicsParams(effort=1e-4, velocity=0.1, n_steps=10, payload=PayloadParams(mass_kg=3.0))
    given = {"dynamics": weights, **changes}
    params = small.request().sequence.model_copy(update=given)
    return few, sequence_tasks(small.cell(), small.task_list(), few, params=params)


def weighted(plan) -> float:
    lengths = plan.end_s - plan.start_s
    effort, velocity = plan.torque_squared_n2m2s.sum(), plan.speed_squared_rad2_s.sum()
    return plan.weight_time * lengths.sum() + plan.weight_torque * effort + plan.weight_speed * velocity


@cache
def optimal():
    return dynamic(cost="optimal_control", max_motions=12)


def test_the_cost_of_optimal_control_is_the_integral_along_the_whole_plan():
    _, plan = optimal()
    assert plan.cost_name == "optimal control" and plan.unit == ""
    assert plan.cost == pytest.approx(weighted(plan), rel=1e-4)
    assert 0.0 < plan.lower_bound <= plan.cost <= plan.order_cost.min()
    assert 0.1 < plan.torque_share <= 1.0 + 1e-6
    assert plan.n_evaluated < plan.n_motions == 4 * 2 + 6 * 2 * 2


def test_holding_still_is_part_of_the_work_at_each_task():
    from cellwright.solvers.pose_tasks.dynamic_costs import dynamics_of
    from schemas.cell_objects import build_cell

    few, plan = optimal()
    dynamics = dynamics_of(build_cell(small.cell()), PayloadParams(mass_kg=3.0).payload())
    torque = dynamics.holding_torque(few.position_rad[plan.alternative])
    assert np.allclose(plan.holding_n2m2s, (plan.leave_s - plan.arrive_s) * (torque**2).sum(axis=1))
    work = np.array([kind == "work" for kind in plan.kind])
    assert np.all(plan.holding_n2m2s <= plan.torque_squared_n2m2s[work] + 1e-9)


def peer_torques(plan, carried_kg: float):
    """Return what pinocchio's inverse dynamics of the URDF with a point mass on the flange asks for, state by state."""
    import pinocchio

    model = pinocchio.buildModelFromXML(small.cell().urdf)
    flange = model.frames[model.getFrameId(small.cell().flange_link)]
    carried = pinocchio.Inertia(carried_kg, np.zeros(3), np.zeros((3, 3)))
    model.appendBodyToJoint(flange.parentJoint, carried, flange.placement)
    data = model.createData()
    acceleration = plan.acceleration_rad_s2.copy()
    for arrive, leave in zip(plan.arrive_s, plan.leave_s):  # at each task it only has to hold still
        acceleration[(plan.time_s >= arrive - 1e-9) & (plan.time_s <= leave + 1e-9)] = 0.0
    rows = zip(plan.position_rad, plan.velocity_rad_s, acceleration)
    return np.array([pinocchio.rnea(model, data, *row) for row in rows])


def test_torques_at_the_states_are_those_of_inverse_dynamics_with_the_payload():
    for plan in (optimal()[1], dynamic()[1]):
        assert plan.torque_nm.shape == plan.position_rad.shape
        assert np.allclose(plan.torque_nm, peer_torques(plan, 3.0), atol=1e-8)
        assert not np.allclose(plan.torque_nm, peer_torques(plan, 0.0), atol=1.0)
        share = np.abs(plan.torque_nm) / [330.0, 330.0, 150.0, 54.0, 54.0, 54.0]
        assert share.max() == pytest.approx(plan.torque_share, rel=0.02)  # looked at at other moments


def test_optimal_motions_along_a_sequence_in_time_cost_less_than_its_own():
    _, in_time = dynamic()
    _, plan = dynamic(motions="optimal_control")
    assert in_time.cost == plan.cost and np.array_equal(in_time.alternative, plan.alternative)
    assert set(in_time.via) <= {"direct", "roadmap", ""} and "optimal control" in plan.via
    assert weighted(plan) < weighted(in_time)
    assert weighted(optimal()[1]) <= weighted(plan) * (1 + 1e-6)


def test_a_payload_that_the_arm_cannot_hold_is_named():
    with pytest.raises(InfeasibleError, match="limit"):
        dynamic(cost="optimal_control", dynamics=DynamicsParams(payload=PayloadParams(mass_kg=500.0)))


def test_an_end_that_the_arm_cannot_hold_is_named():
    """The start stands nearly upright and is held; the arm stretched out with the same payload is not."""
    upright = (0.0, -1.5708, 0.0, -1.5708, 0.0, 0.0)
    cell = replace(small.cell(), start_rad=np.array(upright))
    params = small.request().sequence.model_copy(
        update={
            "dynamics": DynamicsParams(payload=PayloadParams(mass_kg=60.0)), "cost": "optimal_control",
            "returns": False, "end_rad": (1.5708, -0.3, 0.1, 0.5, -1.3, 0.0),
        }
    )  # fmt: skip
    with pytest.raises(InfeasibleError, match="the end"):
        sequence_tasks(cell, small.task_list(), small.alternatives(), params=params)


def test_a_cost_that_guesses_tells_what_is_likely():
    _, plan = optimal()
    assert plan.lower_bound <= plan.likely_bound <= plan.cost
    assert plan.least_ratio > 0.0 and 12 <= plan.n_guessed <= plan.n_motions
    timed = small.sequence()
    assert np.isnan(timed.likely_bound) and np.isnan(timed.least_ratio) and timed.n_guessed == 0


def test_the_tool_stays_as_long_as_it_has_to_however_densely_states_are_sampled():
    """Strokes are timed anew with the sequence's own samples, so arrival is told by these, not by the alternatives'."""
    plan = run(sample_s=0.02)
    dwell = small.task_list().dwell_s[plan.task]
    work = np.array([kind == "work" for kind in plan.kind])
    assert np.allclose(plan.leave_s - plan.arrive_s, dwell, atol=1e-12)
    assert np.allclose(plan.arrive_s - plan.start_s[work], plan.end_s[work] - plan.leave_s, atol=1e-9)
    for arrive, leave in zip(plan.arrive_s, plan.leave_s):
        still = plan.velocity_rad_s[(plan.time_s >= arrive - 1e-9) & (plan.time_s <= leave + 1e-9)]
        assert len(still) >= 3 and np.abs(still).max() < 1e-9


def test_sequences_in_time_are_not_priced_unless_dynamics_are_weighed():
    plan = small.sequence()
    assert plan.weight_time == 0.0 and plan.torque_share == 0.0 and plan.torque_nm.shape == (len(plan.time_s), 0)
    for column in (plan.torque_squared_n2m2s, plan.speed_squared_rad2_s, plan.holding_n2m2s):
        assert len(column) and np.isnan(column).all()


def test_the_greatest_acceleration_is_told_and_kept_if_asked_for():
    timed, (_, free) = small.sequence(), optimal()
    assert timed.keeps_accelerations and not timed.keeps_torques and 0.5 < timed.acceleration_share < 1.01
    assert free.keeps_torques and not free.keeps_accelerations and free.acceleration_share > 1.5
    few, kept = dynamic(cost="optimal_control", max_motions=12, keep_accelerations=True)
    assert kept.keeps_torques and kept.keeps_accelerations and kept.acceleration_share < 1.01
    assert "optimal control" in kept.via and kept.cost > free.cost
    params = SequenceVerifyParams(
        touches=small.request().verification.touches, by_torque=True, keep_accelerations=True,
        payload=PayloadParams(mass_kg=3.0),
    )  # fmt: skip
    checks = verify_sequence(small.cell(), small.task_list(), few, kept, params=params).check
    assert {"joint torque", "joint acceleration of the curve"} <= set(checks)
    with pytest.raises(InfeasibleError, match="acceleration"):
        verify_sequence(small.cell(), small.task_list(), few, free, params=params)


def test_a_start_within_the_clearance_is_refused_before_any_search():
    with pytest.raises(
        InvalidInputError, match=r"the start configuration brings .* closer than 3000 mm: choose another"
    ):
        near = small.request().sequence.model_copy(update={"clearance_m": 3.0})
        sequence_tasks(small.cell(), small.task_list(), small.alternatives(), params=near)
