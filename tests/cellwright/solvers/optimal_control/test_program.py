from __future__ import annotations

import numpy as np
import pytest

from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.optimal_control.cost_bounds import least_cost
from cellwright.solvers.optimal_control.program import CostWeights, DiscreteMotion, MotionProgram
from cellwright.solvers.optimal_control.settled_motion import free_motion
from cellwright.solvers.optimal_control.starts import neighbouring_start, straight_start
from tests.cellwright.solvers.optimal_control.planar_arm import dynamics_of, held_configurations, pendulum, program_of

SMOOTH = CostWeights(time=1.0, effort=0.05, velocity=2.0)
"""Torque is dear: no limit is met, so the solution is smooth and its order can be seen."""


def euler_lagrange_residual(program: MotionProgram, found: DiscreteMotion, v_a: np.ndarray, v_b: np.ndarray) -> float:
    """The equations of section 2.3 once more, from numbers: largest residual in N m s."""
    mechanics, h = program.mechanics, found.step
    begin, end = (np.asarray(part).T for part in mechanics.ends_function(found.q[:-1].T, found.q[1:].T, h))
    push = 0.5 * h * found.torque
    inner = end[:-1] + push[:-1] - begin[1:] + push[1:]
    first = mechanics.momentum(found.q[0], v_a) - begin[0] + push[0]
    last = -mechanics.momentum(found.q[-1], v_b) + end[-1] + push[-1]
    return float(max(np.abs(part).max() for part in (inner, first, last)))


@pytest.mark.parametrize("bound_nodes", [True, False])
def test_a_solution_satisfies_the_discrete_equations_and_all_limits(bound_nodes: bool) -> None:
    dynamics = dynamics_of("ur10e")
    program = MotionProgram(dynamics, bound_nodes=bound_nodes)
    q_a, q_b = held_configurations("ur10e", 2, 1)
    v_a, v_b = np.array([0.3, -0.2, 0.1, 0.5, 0.0, -0.4]), np.array([-0.1, 0.2, 0.3, 0.0, 0.1, 0.2])
    for begin, end in ((np.zeros(6), np.zeros(6)), (v_a, v_b)):
        found = program.solve(straight_start(program, q_a, q_b), v_a=begin, v_b=end)
        assert found.converged
        assert euler_lagrange_residual(program, found, begin, end) < 1e-5
        np.testing.assert_array_equal(found.q[[0, -1]], [q_a, q_b])
        np.testing.assert_allclose(np.diff(found.q, axis=0) / found.step, found.velocity, atol=1e-5)
        np.testing.assert_allclose(found.node_velocity[[0, -1]], [begin, end], atol=1e-12)
        assert (np.abs(found.velocity) <= dynamics.max_velocity * (1 + 1e-9)).all()
        assert (np.abs(found.torque) <= dynamics.max_effort * (1 + 1e-9)).all()
        assert ((found.q >= dynamics.lower) & (found.q <= dynamics.upper)).all()


def test_the_papers_program_has_the_papers_cost() -> None:
    program = MotionProgram(dynamics_of("ur10e"), bound_nodes=False)
    found = program.solve(straight_start(program, *held_configurations("ur10e", 2, 2)))
    rate = 1.0 + 1e-6 * np.sum(found.torque**2, axis=1) + np.sum(found.velocity**2, axis=1)
    assert found.cost == pytest.approx(found.step * rate.sum(), rel=1e-9)


def test_random_motions_are_solved_within_limits_and_above_their_bound() -> None:
    for name in ("ur10e", "irb6640"):
        program, dynamics = program_of(name), dynamics_of(name)
        ends = held_configurations(name, 14, 3).reshape(-1, 2, 6)
        solved = [free_motion(program, q_a, q_b) for q_a, q_b in ends]
        assert sum(each.converged for each in solved) == len(solved), [each.fault for each in solved]
        for each, (q_a, q_b) in zip(solved, ends):
            curve = each.curve
            assert np.abs(curve.torque / dynamics.max_effort).max() <= 1.0 + 1e-6
            assert np.abs(curve.motion.velocity / dynamics.max_velocity).max() <= 1.0 + 1e-6
            assert curve.cost >= float(least_cost(dynamics, program.weights, q_a, q_b))
            assert curve.cost == pytest.approx(each.discrete.cost, rel=0.2)


def test_torques_agree_with_inverse_dynamics_to_second_order_of_the_step() -> None:
    dynamics = dynamics_of("ur10e")
    q_a, q_b = np.array([0.3, -1.2, 0.8, 0.2, 0.4, 0.1]), np.array([1.0, -0.6, 0.3, -0.4, 0.9, 0.5])
    error = []
    for n_steps in (10, 20, 40):
        program = MotionProgram(dynamics, SMOOTH, n_steps=n_steps)
        found = program.solve(straight_start(program, q_a, q_b))
        assert found.converged and np.abs(found.torque / dynamics.max_effort).max() < 0.95
        # accelerations at the middles of the steps from the node velocities, two steps off the ends
        acceleration = np.diff(found.node_velocity, axis=0) / found.step
        middle = 0.5 * (found.q[1:] + found.q[:-1])
        tau = dynamics.torques(middle, found.velocity, acceleration)
        error.append(np.abs(tau - found.torque).max())
    np.testing.assert_allclose(np.divide(error[:-1], error[1:]), 4.0, rtol=0.5)
    assert error[-1] < 0.01 * dynamics.max_effort.max()


def test_a_rod_without_gravity_is_turned_as_the_maximum_principle_says() -> None:
    # turning inertia I by d in time T costs at least int u^2 = 12 (I d)^2 / T^3, so T + c_e int u^2 is least at
    # T^4 = 36 c_e (I d)^2 and is 4 T / 3 there; gravity points along the axis and does nothing
    dynamics = pendulum(pose(np.zeros(3), rotation_from_rpy(np.pi / 2.0, 0.0, 0.0)))
    inertia, d, effort = float(dynamics.mass_matrix(np.zeros(1))[0, 0]), 1.5, 0.5
    T = (36.0 * effort * (inertia * d) ** 2) ** 0.25
    error = []
    for n_steps in (10, 20, 40):
        program = MotionProgram(dynamics, CostWeights(1.0, effort, 0.0), n_steps=n_steps)
        found = free_motion(program, np.array([-0.5]), np.array([-0.5 + d]))
        assert found.converged
        assert found.discrete.duration == pytest.approx(T, rel=5.0 / n_steps**2)
        error.append(abs(found.curve.cost - 4.0 * T / 3.0))
    assert error[-1] < 1e-3 * T
    assert error[0] > 10.0 * error[-1]


def test_boxes_hold_the_nodes() -> None:
    program = program_of("ur10e")
    start = straight_start(program, *held_configurations("ur10e", 2, 5))
    boxes = start.q - 0.05, start.q + 0.05
    found = program.solve(start, boxes=boxes)
    assert found.converged
    assert (found.q >= boxes[0] - 1e-9).all() and (found.q <= boxes[1] + 1e-9).all()
    assert found.cost >= program.solve(start).cost


def test_a_neighbours_solution_warms_the_start() -> None:
    program = program_of("ur10e")
    cold = warm = 0
    for q_a, q_b in held_configurations("ur10e", 8, 6).reshape(-1, 2, 6):
        first = program.solve(straight_start(program, q_a, q_b))
        near_a, near_b = 0.97 * q_a, 0.97 * q_b
        again = program.solve(neighbouring_start(first, near_a, near_b), warm=True)
        straight = program.solve(straight_start(program, near_a, near_b))
        assert again.converged and again.cost <= straight.cost * 1.01
        cold, warm = cold + straight.iterations, warm + again.iterations
    assert warm < 0.7 * cold


def test_the_same_question_has_the_same_answer() -> None:
    q_a, q_b = held_configurations("ur10e", 2, 7)
    answers = [
        MotionProgram(dynamics_of("ur10e")).solve(straight_start(program_of("ur10e"), q_a, q_b)) for _ in range(2)
    ]
    np.testing.assert_array_equal(answers[0].q, answers[1].q)
    assert answers[0].cost == answers[1].cost


def test_bad_questions_are_refused() -> None:
    program, dynamics = program_of("ur10e"), dynamics_of("ur10e")
    q = np.zeros(6)
    with pytest.raises(InvalidInputError, match=r"joint 'elbow_joint' is at 4 rad at the goal"):
        free_motion(program, q, np.array([0, 0, 4.0, 0, 0, 0]))
    with pytest.raises(InvalidInputError, match="6 finite joint positions"):
        free_motion(program, q, np.full(6, np.nan))
    with pytest.raises(InfeasibleError, match=r"'shoulder_lift_joint' needs .* to hold the arm at the start"):
        free_motion(MotionProgram(dynamics, max_effort=np.full(6, 60.0)), q, q + 0.5)
    with pytest.raises(InfeasibleError, match=r"has 9 /s at the goal"):
        free_motion(program, q, q + 0.5, v_b=np.full(6, 9.0))
    with pytest.raises(InvalidInputError, match="n_steps is 2"):
        MotionProgram(dynamics, n_steps=2)
    with pytest.raises(InvalidInputError, match=r"'wrist_3_joint' has torque limit 0"):
        MotionProgram(dynamics, max_effort=np.array([300, 300, 150, 50, 50, 0.0]))
    with pytest.raises(InvalidInputError, match="weight time is 0"):
        CostWeights(time=0.0)
    with pytest.raises(InvalidInputError, match="weight effort is -1"):
        CostWeights(effort=-1.0)


def test_a_program_with_other_steps_keeps_all_else() -> None:
    limits = np.full(6, 4.0)
    own = MotionProgram(
        dynamics_of("ur10e"), CostWeights(2.0, 1e-5, 0.1), n_steps=6, max_effort=limits * 50.0, max_acceleration=limits,
        reserve=(0.1, 0.2), most_iterations=123,
    )  # fmt: skip
    twice = own.with_steps(12)
    assert twice.n_steps == 12 and own.n_steps == 6
    for name in ("max_effort", "max_acceleration"):
        assert np.array_equal(getattr(twice, name), getattr(own, name))
    for name in ("weights", "reserve", "bound_nodes", "_most_iterations", "dynamics"):
        assert getattr(twice, name) == getattr(own, name)
