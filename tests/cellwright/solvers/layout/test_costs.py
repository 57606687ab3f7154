from __future__ import annotations

import casadi
import numpy as np
import pytest

from cellwright.cell.built_in_robots import built_in_robot
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
