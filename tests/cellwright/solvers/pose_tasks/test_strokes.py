from __future__ import annotations

import numpy as np
import pytest

from cellwright.solvers.path_timing import Limits
from cellwright.solvers.pose_tasks.strokes import at_work, time_stroke, trace_stroke
from schemas.cell_objects import build_cell
from schemas.task_objects import pose_tasks
from tests import small_sequence as small

LIMITS = Limits(np.full(6, 1.0), np.full(6, 4.0))


def stroke():
    found, tasks = small.alternatives(), pose_tasks(small.task_list())
    task = tasks[found.task[0]]
    path = trace_stroke(build_cell(small.cell()), task, float(found.rotation_rad[0]), found.position_rad[0])
    return task, path


def test_a_stroke_ends_in_the_task_and_begins_where_the_alternative_says():
    _, path = stroke()
    assert np.array_equal(path[-1], small.alternatives().position_rad[0])
    assert np.allclose(path[0], small.alternatives().entry_rad[0])


def test_the_tool_goes_straight():
    task, path = stroke()
    built = build_cell(small.cell())
    places = np.array([(built.robot.flange_pose(q) @ built.T_flange_scanner)[:3, 3] for q in path])
    along = task.T_world_tool[:3, 2]
    aside = (places - places[-1]) - ((places - places[-1]) @ along)[:, None] * along
    assert np.linalg.norm(aside, axis=1).max() < 1e-7
    assert np.allclose((places[-1] - places[0]) @ along, task.approach)


def test_a_stroke_without_length_is_the_task_alone():
    found, tasks = small.alternatives(), pose_tasks(small.task_list())
    still = type(tasks[0])("still", tasks[0].T_world_tool)
    path = trace_stroke(build_cell(small.cell()), still, 0.0, found.position_rad[0])
    assert path.shape == (1, 6)


def test_a_stroke_out_of_reach_is_none():
    found, tasks = small.alternatives(), pose_tasks(small.task_list())
    far = type(tasks[0])("far", tasks[0].T_world_tool, 1, 0.0, 5.0)
    assert trace_stroke(build_cell(small.cell()), far, float(found.rotation_rad[0]), found.position_rad[0]) is None


def test_work_is_stroke_dwell_and_stroke_back_at_rest_between():
    task, path = stroke()
    motion = time_stroke(path, task.approach, LIMITS, 0.008)
    whole = at_work(motion, path[-1], 0.5)
    assert whole.duration == pytest.approx(2.0 * motion.duration + 0.5)
    assert np.allclose(whole.position[0], whole.position[-1]) and np.allclose(whole.velocity[[0, -1]], 0.0)
    inside = (whole.time >= motion.duration) & (whole.time <= motion.duration + 0.5)
    assert np.allclose(whole.position[inside], path[-1], atol=1e-9)
    assert np.all(np.diff(whole.time) > 0)


def test_without_stroke_and_dwell_there_is_no_work():
    assert at_work(None, np.zeros(6), 0.0) is None
    assert at_work(None, np.zeros(6), 2.0).duration == 2.0
