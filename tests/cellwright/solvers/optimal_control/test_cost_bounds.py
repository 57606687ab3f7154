from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_dynamics import symbolic_dynamics
from cellwright.solvers.optimal_control.cost_bounds import estimate, holding_cost, least_cost
from cellwright.solvers.optimal_control.program import CostWeights, MotionProgram
from cellwright.solvers.optimal_control.settled_motion import free_motion
from tests.cellwright.solvers.optimal_control.planar_arm import (
    dynamics_of,
    held_configurations,
    planar_urdf,
    program_of,
)

UPRIGHT = symbolic_dynamics(SerialArm.from_urdf(planar_urdf("0 1 0", (120.0, 40.0))))
"""The planar arm in a vertical plane, strong enough to hold itself everywhere."""

weight = st.sampled_from([0.0, 1e-4, 1e-2, 1.0, 10.0])
angle = st.floats(-2.5, 2.5)


@given(st.sampled_from([0.1, 1.0]), weight, weight, st.tuples(angle, angle), st.tuples(angle, angle))
@settings(max_examples=25, deadline=None)
def test_no_solved_motion_undercuts_the_bound(
    time: float, effort: float, velocity: float, q_a: tuple[float, float], q_b: tuple[float, float]
) -> None:
    a, b = np.array(q_a), np.array(q_b)
    if np.abs(a - b).max() < 0.01:
        return
    weights = CostWeights(time, effort, velocity)
    found = free_motion(MotionProgram(UPRIGHT, weights, n_steps=12), a, b)
    if found.converged:
        assert float(least_cost(UPRIGHT, weights, a, b)) <= found.curve.cost * (1.0 + 1e-6)


@given(weight, weight, st.tuples(angle, angle), st.tuples(angle, angle))
@settings(max_examples=60, deadline=None)
def test_the_closed_form_is_the_minimum_that_its_proof_speaks_of(
    effort: float, velocity: float, q_a: tuple[float, float], q_b: tuple[float, float]
) -> None:
    a, b = np.array(q_a), np.array(q_b)
    D, lift = float(np.sum((a - b) ** 2)), np.zeros(2)
    if D < 1e-6:
        return
    W = float(UPRIGHT.energies_function(b, lift)[1] - UPRIGHT.energies_function(a, lift)[1])
    least, most = (
        float(np.max(np.abs(a - b) / UPRIGHT.max_velocity)),
        float(UPRIGHT.max_velocity @ UPRIGHT.max_velocity),
    )

    def inner(T: float) -> float:
        if velocity == 0.0:
            return T + effort * W**2 / (T * most)
        Q = np.concatenate([[D / T], D / T + np.geomspace(1e-9, 1e6, 4000)])
        return T + float(np.min(velocity * Q + effort * W**2 / Q))

    found = minimize_scalar(inner, bounds=(least, least + 200.0), method="bounded", options={"xatol": 1e-7})
    brute = min(float(found.fun), inner(least))
    bound = float(least_cost(UPRIGHT, CostWeights(1.0, effort, velocity), a, b))
    assert bound == pytest.approx(brute, rel=1e-2)
    assert bound <= brute * (1.0 + 1e-9)


def test_the_bound_is_tight_where_speed_is_what_costs() -> None:
    program, dynamics = program_of("ur10e"), dynamics_of("ur10e")
    for q_a, q_b in held_configurations("ur10e", 8, 9).reshape(-1, 2, 6):
        found = free_motion(program, q_a, q_b)
        assert found.converged
        assert found.curve.cost < 1.15 * float(least_cost(dynamics, program.weights, q_a, q_b))


def test_bounds_of_many_pairs_equal_those_of_each_and_both_ways() -> None:
    dynamics, weights = dynamics_of("irb6640"), CostWeights()
    q = held_configurations("irb6640", 5, 4)
    all_pairs = least_cost(dynamics, weights, q[:, None], q[None])
    assert all_pairs.shape == (5, 5)
    np.testing.assert_allclose(all_pairs, all_pairs.T)
    np.testing.assert_array_equal(np.diag(all_pairs), 0.0)
    assert all_pairs[1, 3] == pytest.approx(float(least_cost(dynamics, weights, q[1], q[3])))
    assert (estimate(dynamics, weights, q[:, None], q[None]) >= all_pairs).all()


def test_holding_costs_what_the_torques_that_hold_cost() -> None:
    dynamics, weights = dynamics_of("irb6640"), CostWeights()
    q = held_configurations("irb6640", 3, 4)
    torque = dynamics.torques(q, np.zeros((3, 6)), np.zeros((3, 6)))
    np.testing.assert_allclose(holding_cost(dynamics, weights, q, 2.0), 2e-6 * np.sum(torque**2, axis=1), rtol=1e-9)
