from __future__ import annotations

import numpy as np
import pytest

from cellwright.errors import InvalidInputError
from schemas.poses import Pose
from schemas.sources import SourceFile
from tasks.list_tasks import TaskListParams, TaskParams, list_tasks
from tests.tasks.goldens import check_golden, rounded

CSV = b"name,x,y,z,dx,dy,dz,dwell_s,after\nbolt,1,2,3,0,0,-2,0.5,\nnut,4,5,6,1,0,0,,bolt\n"


def table(content: bytes = CSV, name: str = "tasks.csv") -> SourceFile:
    return SourceFile(name, content)


def test_written_tasks_come_before_those_of_the_table():
    first = TaskParams(name="first", position_m=(0.1, 0.0, 0.0), direction=(0.0, 0.0, 1.0))
    found = list_tasks(table(), params=TaskListParams(tasks=(first,), dwell_s=0.25, n_rotations=5))
    assert found.name == ("first", "bolt", "nut")
    assert found.dwell_s.tolist() == [0.25, 0.5, 0.25] and found.n_rotations.tolist() == [5, 5, 5]
    assert found.before.tolist() == [[1, 2]]


def test_the_table_is_read_in_its_unit_and_placed_in_its_frame():
    placed = Pose(position_m=(1.0, 0.0, 0.0), quaternion=(0.5**0.5, 0.0, 0.0, 0.5**0.5))  # a quarter turn about z
    found = list_tasks(table(), params=TaskListParams(metres_per_unit=0.01, T_world_tasks=placed))
    T = found.T_world_tool.reshape(-1, 4, 4)
    assert np.allclose(T[0, :3, 3], [1.0 - 0.02, 0.01, 0.03])
    assert np.allclose(T[0, :3, 2], [0.0, 0.0, -1.0]) and np.allclose(T[1, :3, 2], [0.0, 1.0, 0.0])
    assert np.allclose(np.linalg.det(T[:, :3, :3]), 1.0)


def test_a_task_with_a_whole_orientation_keeps_it():
    turned = (0.5, 0.5, 0.5, 0.5)
    task = TaskParams(name="t", position_m=(0.0, 0.0, 0.0), quaternion=turned)
    found = list_tasks(None, params=TaskListParams(tasks=(task,), n_rotations=12))
    assert found.n_rotations.tolist() == [1]
    assert np.allclose(found.T_world_tool.reshape(4, 4)[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"x,y,z\n1,2,3\n", "lacks dx, dy, dz"),
        (b"x,y,z,dx,dy,dz,speed\n", "has the column 'speed'"),
        (b"x,y,z,dx,dy,dz\n1,2,3,0,0\n", "line 2: has 5 entries"),
        (b"x,y,z,dx,dy,dz\n1,2,nan,0,0,1\n", "line 2, z: 'nan' is not finite"),
        (b"x,y,z,dx,dy,dz\n1,2,three,0,0,1\n", "line 2, z: 'three' is not a number"),
        (b"x,y,z,dx,dy,dz\n1,2,3,0,0,0\n", "no length"),
        (b"x,y,z,dx,dy,dz\n", "holds no task"),
        (b"name,x,y,z,dx,dy,dz\na,1,2,3,0,0,1\n\na,1,2,3,0,0,1\n", "line 4, name: 'a' names task 1 too"),
        (b"name,x,y,z,dx,dy,dz,after\na,1,2,3,0,0,1,b\nb,1,2,3,0,0,1,a\n", "contradicts itself: 'a' after 'b' after"),
        (b"name,x,y,z,dx,dy,dz,after\nhole,1,2,3,0,0,1,hol\n", "line 2, after: 'hol' is no task: did you mean hole"),
        (b"x,y,z,dx,dy,dz\n1,-1e300,3,0,0,1\n", "line 2: task '1' is 1e+297 m away: correct it, or the unit"),
        (b"x,y,z,dx,dy,dz\n" + 2001 * b"1,2,3,0,0,1\n", "are 2001 tasks, but at most 2000"),
        (b"\xff\xfe", "not text in UTF-8"),
    ],
)
def test_a_malformed_table_is_named_with_its_line(content, words):
    with pytest.raises(InvalidInputError) as caught:
        list_tasks(table(content), params=TaskListParams())
    assert words in str(caught.value)


def test_a_direction_may_be_of_any_length():
    found = [
        list_tasks(table(b"x,y,z,dx,dy,dz\n1,2,3,0,%s,%s\n" % (one, one)), params=TaskListParams())
        for one in (b"1", b"1e300")
    ]
    assert np.allclose(found[0].T_world_tool, found[1].T_world_tool)


def test_a_station_without_tasks_is_refused():
    with pytest.raises(InvalidInputError, match="no tasks"):
        list_tasks(None, params=TaskListParams())


def test_the_result_is_the_one_of_this_version():
    check_golden(list_tasks, rounded(list_tasks(table(), params=TaskListParams())))
