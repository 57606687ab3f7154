from __future__ import annotations

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.built_in_robots import built_in_arm, built_in_robot
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_model import symbolic_model
from cellwright.solvers.layout.costs import cost_expression, extra_costs, manipulability, repeatability
from cellwright.solvers.layout.problem import LayoutCost
from tests.cellwright.solvers.small_layouts import polar_arm

UR = SerialArm.from_robot(built_in_robot("ur10e"))
SIGMA = (1e-4, 2e-4, 1e-4, 3e-4, 1e-4, 1e-4)
Q = np.random.default_rng(0).uniform(-2, 2, (4, 6))


@pytest.mark.parametrize("worst_case", [False, True])
def test_expressions_and_numbers_agree(worst_case: bool) -> None:
    cost = LayoutCost(0.7, 30.0, SIGMA, worst_case)
    model = symbolic_model(UR)
    x = casadi.SX.sym("x", 6)
    function = casadi.Function("cost", [x], [cost_expression(model.jacobian(x), cost)])
    symbolic = [float(function(q)) for q in Q]
    np.testing.assert_allclose(extra_costs(UR, Q, cost), symbolic, atol=1e-5)


def test_manipulability_vanishes_where_the_arm_is_stretched_and_lowers_the_cost() -> None:
    stretched = np.array([[0.0, -1.0, 0.0, -1.0, 1.0, 0.0]])
    bent = np.array([[0.0, -1.0, 1.5, -1.0, 1.5, 0.0]])
    assert manipulability(UR, stretched)[0] < 1e-6 < 0.05 < manipulability(UR, bent)[0]
    cost = LayoutCost(manipulability=1.0)
    assert extra_costs(UR, bent, cost)[0] < extra_costs(UR, stretched, cost)[0]


def test_repeatability_is_the_spread_of_the_tool_that_sampling_shows() -> None:
    rng = np.random.default_rng(1)
    q = Q[0]
    noisy = UR.flange_pose(q + rng.normal(0, SIGMA, (40_000, 6)))[:, :3, 3]
    sampled = np.sqrt(((noisy - UR.flange_pose(q)[:3, 3]) ** 2).sum(axis=1).mean())
    assert repeatability(UR, q[None], np.array(SIGMA))[0] == pytest.approx(sampled, rel=0.02)
    signs = np.array(np.meshgrid(*[[-3.0, 3.0]] * 6)).reshape(6, -1).T
    corners = UR.flange_pose(q + signs * SIGMA)[:, :3, 3]
    farthest = np.linalg.norm(corners - UR.flange_pose(q)[:3, 3], axis=1).max()
    assert repeatability(UR, q[None], np.array(SIGMA), worst_case=True)[0] >= farthest * 0.999


def test_arms_with_few_joints_have_manipulability_too() -> None:
    # a polar arm's is the reach times the unit slide, with the turn's own rotation
    assert manipulability(polar_arm(), np.array([[0.3, 1.0]]))[0] == pytest.approx(np.sqrt(2.0))


@given(st.integers(0, 1_000), st.sampled_from(["ur10e", "kr180_r2500_extra", "scara", "pr_robot"]), st.booleans())
@settings(max_examples=25, deadline=None)
def test_slopes_of_the_extra_costs_are_those_of_differences(seed: int, robot: str, worst_case: bool) -> None:
    arm = built_in_arm(robot)
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.maximum(arm.lower, -2.0), np.minimum(arm.upper, 2.0))
    deviation = tuple(rng.uniform(1e-4, 3e-4, arm.n_joints).tolist())
    x = casadi.SX.sym("x", arm.n_joints)
    J = symbolic_model(arm).jacobian(x)
    step = 1e-5 * np.eye(arm.n_joints)
    for cost in (LayoutCost(manipulability=2.0), LayoutCost(0.0, 30.0, deviation, worst_case)):
        if cost.manipulability and manipulability(arm, q[None])[0] < 1e-3:
            continue
        slope = casadi.Function("slope", [x], [casadi.gradient(cost_expression(J, cost), x)])
        away = extra_costs(arm, q + step, cost) - extra_costs(arm, q - step, cost)
        np.testing.assert_allclose(np.asarray(slope(q))[:, 0], away / 2e-5, rtol=1e-3, atol=1e-5)
