from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwright.cell.scene import Scene
from cellwright.cell.transforms import inverse
from cellwright.errors import InfeasibleError, InvalidInputError
from schemas.cell_objects import build_cell
from schemas.task_objects import at_work, pose_tasks
from tasks.generate_alternatives import generate_alternatives
from tests import small_sequence as small
from tests.tasks.goldens import check_golden


def moved(row: int, position: list[float], **changes):
    """Return the tasks with one of them elsewhere."""
    T = small.task_list().T_world_tool.copy()
    T[row, [3, 7, 11]] = position
    return replace(small.task_list(), T_world_tool=T, **changes)


def run(tasks, **changes):
    params = small.request().alternatives.model_copy(update=changes)
    return generate_alternatives(small.cell(), tasks, params=params)


def test_every_alternative_holds_the_tool_at_its_task():
    built, found, listed = build_cell(small.cell()), small.alternatives(), pose_tasks(small.task_list())
    for k, row in enumerate(found.task.tolist()):
        for q, back in ((found.position_rad[k], 0.0), (found.entry_rad[k], listed[row].approach)):
            T = built.T_world_base @ built.robot.flange_pose(q) @ built.T_flange_scanner
            seen = inverse(listed[row].T_world_tool) @ T
            assert np.allclose(seen[:3, 3], [0.0, 0.0, -back], atol=1e-7)
            c, s = np.cos(found.rotation_rad[k]), np.sin(found.rotation_rad[k])
            assert np.allclose(seen[:3, :3], [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-6)


def test_every_alternative_is_free_and_within_the_limits():
    built, found = build_cell(small.cell()), small.alternatives()
    on_the_way = Scene(built, 0.005)
    working = Scene(at_work(built, small.request().alternatives.touches), 0.005)
    chain = built.robot.chain
    assert not on_the_way.collide_all(found.entry_rad).any()
    assert not working.collide_all(found.position_rad).any()
    assert on_the_way.collide_all(found.position_rad).all()  # the bit touches the wall, and only then it may
    assert (found.position_rad >= chain.lower).all() and (found.position_rad <= chain.upper).all()


def test_alternatives_of_a_task_differ():
    found = small.alternatives()
    for row in range(4):
        q = found.position_rad[found.task == row]
        apart = np.abs(q[:, None] - q[None]).max(axis=-1) + 9.0 * np.eye(len(q))
        assert 1 <= len(q) <= 6 and apart.min() > small.request().alternatives.same_rad


def test_a_task_out_of_reach_is_named():
    with pytest.raises(InfeasibleError) as caught:
        run(moved(1, [3.0, 0.0, 0.5]))
    assert str(caught.value).startswith("cannot do task 'b': out of reach in 4 turns")
    assert "(3000, 0, 500) mm" in str(caught.value)


def test_a_task_inside_a_body_names_what_collides():
    with pytest.raises(InfeasibleError) as caught:
        run(moved(2, [0.74, 0.0, 0.45]))
    assert "cannot do task 'c'" in str(caught.value) and "'post'" not in str(caught.value)
    assert "post on" in str(caught.value)


def test_a_task_outside_the_joint_limits_says_so():
    tight = replace(small.cell(), lower_rad=small.cell().start_rad - 0.05, upper_rad=small.cell().start_rad + 0.05)
    with pytest.raises(InfeasibleError, match="outside the joint limits"):
        generate_alternatives(tight, small.task_list(), params=small.request().alternatives)


def test_the_first_five_of_many_hopeless_tasks_are_listed():
    T = np.tile(small.task_list().T_world_tool[:1], (7, 1))
    T[:, 3] = 9.0
    many = replace(
        small.task_list(), name=tuple("abcdefg"), T_world_tool=T, n_rotations=np.ones(7, np.int32),
        dwell_s=np.zeros(7), approach_m=np.zeros(7), before=np.zeros((0, 2), np.int32),
    )  # fmt: skip
    with pytest.raises(InfeasibleError) as caught:
        run(many)
    lines = str(caught.value).splitlines()
    assert lines[0] == "7 of 7 tasks cannot be performed:" and lines[-1] == "  and 2 more" and len(lines) == 7


def test_bodies_that_touch_at_work_must_exist():
    with pytest.raises(InvalidInputError, match="touches names bitt"):
        run(small.task_list(), touches=(("bitt", "wall"),))


def test_without_contact_at_work_no_task_can_be_done():
    with pytest.raises(InfeasibleError, match=r"4 of 4 tasks cannot be performed(.|\n)*tool.touches"):
        run(small.task_list(), touches=())


def test_the_result_is_the_one_of_this_version():
    found = small.alternatives()
    told = f"{found.task.tolist()} {found.branch.tolist()} {np.round(found.rotation_rad, 6).tolist()} "
    told += f"{(np.round(found.entry_rad, 6) + 0.0).tolist()} {found.n_solutions.tolist()} {found.n_left_out.tolist()}"
    check_golden(generate_alternatives, told)
