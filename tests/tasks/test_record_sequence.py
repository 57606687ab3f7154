from __future__ import annotations

from dataclasses import replace

import numpy as np

from storage.formats import format_of
from tasks.record_sequence import SequenceRecordingParams, record_sequence
from tests import small_sequence as small
from tests.tasks.goldens import check_golden


def recording():
    return record_sequence(small.cell(), small.sequence(), params=SequenceRecordingParams(frame_rate_hz=10))


def test_the_recording_lasts_as_long_as_the_sequence():
    found = recording()
    end = round(1e9 * small.sequence().time_s[-1])
    assert found.state_time_ns[-1] == end and found.pose_time_ns.max() == end


def test_frames_form_a_tree_with_the_tool_at_its_tip():
    found = recording()
    assert found.frame == ("base", *(f"link_{k}" for k in range(1, 7)), "flange", "tool")
    assert found.frame_parent[-2:] == ("link_6", "flange") and found.frame_parent[0] == "world"
    assert {"spindle", "bit", "wall", "post"} <= set(found.entity)


def test_it_survives_the_file_format():
    found = recording()
    files = format_of(type(found)).encode(found)
    back = format_of(type(found)).decode(type(found), files)
    assert np.array_equal(back.state_time_ns, found.state_time_ns) and back.frame == found.frame


def test_joint_states_carry_the_torques_of_a_sequence_that_has_them():
    torque = np.random.default_rng(0).normal(size=small.sequence().position_rad.shape)
    told = replace(small.sequence(), torque_nm=torque)
    found = record_sequence(small.cell(), told, params=SequenceRecordingParams(frame_rate_hz=10))
    assert np.array_equal(found.torque_nm, torque)
    assert recording().torque_nm.shape == (len(torque), 0)


def test_the_result_is_the_one_of_this_version():
    found = recording()
    told = f"{found.frame} {found.entity} {found.entity_frame} {found.entity_n_faces.tolist()} {len(found.pose_frame)}"
    check_golden(record_sequence, told)
