from __future__ import annotations

import re

import pytest

from cellwright.cell.scene import Scene
from cellwright.cell.symbolic_dynamics import Payload
from cellwright.errors import InfeasibleError
from cellwright.solvers.motion_cost import VelocityCost
from cellwright.solvers.optimal_control.program import CostWeights
from cellwright.solvers.pose_tasks.dynamic_costs import (
    DynamicSettings,
    dynamics_of,
    optimal_control_cost,
    worked_ways,
)
from schemas.cell_objects import build_cell
from schemas.task_objects import alternatives_of, pose_tasks
from tests import small_sequence as small


def worked(payload_kg: float):
    cell = build_cell(small.cell())
    dynamics = dynamics_of(cell, Payload.point(payload_kg, (0.0, 0.0, 0.1)))
    straight = VelocityCost(cell.robot.chain.max_velocity)
    cost = optimal_control_cost(cell, Scene(cell, 0.0), straight, dynamics, DynamicSettings(CostWeights(), n_steps=4))
    ways = alternatives_of(small.alternatives())
    return worked_ways(cell, pose_tasks(small.task_list()), ways, cost, dynamics.max_effort, 0.008)


def test_a_light_tool_leaves_all_alternatives_with_strokes_that_torques_allow():
    found = worked(1.0)
    assert [each.row for each in found] == list(range(len(small.alternatives().task)))
    assert all(each.stroke is not None and not each.stroke.fault for each in found)


def test_a_tool_too_heavy_is_told_with_joint_torque_and_limit():
    with pytest.raises(InfeasibleError) as caught:
        worked(60.0)
    told = re.search(r"'a': joint '\w+' needs at least ([\d.]+) to hold .* limit is ([\d.]+)", str(caught.value))
    assert told is not None
    needs, limit = told.groups()
    assert float(needs) > float(limit) and "carry less" in str(caught.value)
