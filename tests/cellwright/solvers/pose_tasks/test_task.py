from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cellwright.cell.transforms import inverse
from cellwright.solvers.pose_tasks.task import PoseTask, facing, working_cell
from schemas.cell_objects import build_cell
from tests import small_sequence as small

COORDINATE = st.floats(-1.0, 1.0)
VECTOR = st.tuples(COORDINATE, COORDINATE, COORDINATE)


@given(VECTOR, VECTOR.filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_a_direction_becomes_the_z_axis_of_a_true_rotation(position, direction):
    T = facing(np.array(position), np.array(direction))
    assert np.allclose(T[:3, 2], np.array(direction) / np.linalg.norm(direction))
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3)) and np.isclose(np.linalg.det(T[:3, :3]), 1.0)
    assert np.array_equal(T[:3, 3], position)


@given(st.integers(1, 9), st.floats(0.0, 0.2))
def test_turns_keep_the_tool_on_its_axis_as_far_back_as_asked_for(n_rotations, back):
    cell = build_cell(small.cell())
    task = PoseTask("t", facing(np.array([0.7, 0.1, 0.4]), np.array([1.0, 0.2, -0.3])), n_rotations)
    rotations = task.rotations()
    assert len(rotations) == n_rotations and rotations[0] == 0.0
    for T_base_flange in task.T_base_flange(cell, rotations, back):
        seen = inverse(task.T_world_tool) @ cell.T_world_base @ T_base_flange @ cell.T_flange_scanner
        assert np.allclose(seen[:3, 3], [0.0, 0.0, -back], atol=1e-9) and np.isclose(seen[2, 2], 1.0)


def test_contacts_at_work_are_added_to_those_that_are_always_permitted():
    cell = build_cell(small.cell())
    working = working_cell(cell, np.array([[0, 3]], np.int32))
    assert len(working.ignored_pairs) == len(cell.ignored_pairs) + 1
    assert working_cell(cell, np.empty((0, 2), np.int32)) is cell
