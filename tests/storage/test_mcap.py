from __future__ import annotations

import hashlib
import importlib.util
import io
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from cellwright.errors import InvalidInputError, LakeError
from schemas.artefact import digest
from schemas.motion import Recording
from storage.mcap import FILE, decode, encode
from tests.storage.specimens import same

ROOT = Path(__file__).parents[2]

_NAMES = st.lists(st.text(st.characters(exclude_categories=("Cs",)), max_size=6), max_size=3, unique=True)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    joint, frame, entity = draw(_NAMES), draw(_NAMES), draw(_NAMES)
    n_states, n_points = draw(st.integers(0, 4)), draw(st.integers(0, 6))
    n_poses = draw(st.integers(0, 6)) if frame else 0
    n_faces = np.array([draw(st.integers(0, 3)) for _ in entity], np.int32)
    # few distinct times, in any order: several rows share a message, or return to an earlier time
    times = st.sampled_from([0, 1, 40_000_000, 1_000_000_001])

    def floats(*shape: int, dtype: Any = np.float64) -> Any:
        return draw(hnp.arrays(dtype, shape))

    return Recording(
        joint=joint,
        state_time_ns=draw(hnp.arrays(np.int64, n_states, elements=times)),
        position_rad=floats(n_states, len(joint)),
        velocity_rad_s=floats(n_states, len(joint)),
        torque_nm=draw(st.sampled_from([None, floats(n_states, len(joint))])),
        frame=frame,
        frame_parent=["world"] * len(frame),
        pose_time_ns=draw(hnp.arrays(np.int64, n_poses, elements=times)),
        pose_frame=draw(hnp.arrays(np.int32, n_poses, elements=st.integers(0, max(len(frame) - 1, 0)))),
        pose_position_m=floats(n_poses, 3),
        pose_quaternion=floats(n_poses, 4),
        entity=entity,
        entity_frame=["base"] * len(entity),
        entity_colour=floats(len(entity), 4),
        entity_first_face=np.cumsum(n_faces, dtype=np.int32) - n_faces,
        entity_n_faces=n_faces,
        triangle_m=floats(int(n_faces.sum()), 9),
        cloud_time_ns=draw(hnp.arrays(np.int64, n_points, elements=times)),
        cloud_point_m=floats(n_points, 3, dtype=np.float32),
        cloud_uncertainty_m=floats(n_points, dtype=np.float32),
    )


def plan(n_states: int = 25) -> Recording:
    """A small plan: two joints, two frames, two bodies, a scan of three profiles."""
    times = np.arange(n_states) * 4_000_000
    return Recording(
        joint=("shoulder", "elbow"),
        state_time_ns=times,
        position_rad=np.stack([np.sin(times * 1e-9), -np.zeros(n_states)], axis=1),
        velocity_rad_s=np.zeros((n_states, 2)),
        frame=("base", "link"),
        frame_parent=("world", "base"),
        pose_time_ns=np.concatenate([[0], times]),
        pose_frame=np.concatenate([[0], np.ones(n_states, np.int32)]).astype(np.int32),
        pose_position_m=np.linspace(-1, 1, 3 * (n_states + 1)).reshape(-1, 3),
        pose_quaternion=np.tile([1.0, 0.0, -0.0, 0.0], (n_states + 1, 1)),
        entity=("table", "part"),
        entity_frame=("world", "part"),
        entity_colour=np.array([[0.5, 0.5, 0.5, 1.0], [1.0, 0.0, 0.0, 1.0]]),
        entity_first_face=np.array([0, 2], np.int32),
        entity_n_faces=np.array([2, 1], np.int32),
        triangle_m=np.arange(27.0).reshape(3, 9),
        cloud_time_ns=np.repeat([0, 10_000_000, 20_000_000], 4),
        cloud_point_m=np.arange(36, dtype=np.float32).reshape(12, 3),
        cloud_uncertainty_m=np.full(12, 4e-5, np.float32),
    )


@given(recordings())
@settings(deadline=None)
def test_every_recording_comes_back_bit_for_bit(recording: Recording) -> None:
    back = decode(Recording, encode(recording))
    assert same(back, recording)
    assert digest(back) == digest(recording)


def test_the_same_recording_gives_the_same_bytes_in_every_process() -> None:
    code = (
        "import hashlib\nfrom storage.mcap import encode\nfrom tests.storage.test_mcap import plan\n"
        "print(hashlib.sha256(encode(plan(4000))['recording.mcap']).hexdigest())"
    )
    there = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=ROOT).stdout
    assert there.strip() == hashlib.sha256(encode(plan(4000))[FILE]).hexdigest()


def test_recordings_written_at_the_same_time_do_not_leak_into_each_other() -> None:
    recordings = [plan(n_states) for n_states in (500, 1500)] * 2
    alone = [encode(recording) for recording in recordings]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(encode, recordings)) == alone


def test_the_mcap_library_reads_the_messages_under_the_names_that_viewers_know() -> None:
    messages: dict[str, list[Any]] = {}
    reader = make_reader(io.BytesIO(encode(plan())[FILE]), validate_crcs=True, decoder_factories=[DecoderFactory()])
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        assert schema is not None
        messages.setdefault(f"{channel.topic} {schema.name}", []).append((message.log_time, decoded))
    assert {name: len(found) for name, found in messages.items()} == {
        "/joint_states foxglove.JointStates": 25,
        "/tf foxglove.FrameTransforms": 25,
        "/scene foxglove.SceneUpdate": 1,
        "/scan foxglove.PointCloud": 3,
    }
    time_ns, states = messages["/joint_states foxglove.JointStates"][2]
    assert time_ns == 8_000_000
    assert states.timestamp.ToNanoseconds() == 8_000_000
    assert [state.name for state in states.joints] == ["shoulder", "elbow"]
    assert states.joints[0].position == np.sin(0.008)
    assert not any(state.HasField("effort") for state in states.joints)
    (_, update) = messages["/scene foxglove.SceneUpdate"][0]
    assert [(entity.id, entity.frame_id) for entity in update.entities] == [("table", "world"), ("part", "part")]
    assert len(update.entities[0].triangles[0].points) == 6
    (_, cloud) = messages["/scan foxglove.PointCloud"][1]
    assert (cloud.frame_id, cloud.point_stride) == ("part", 16)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "uncertainty"]
    assert np.frombuffer(cloud.data, np.float32).reshape(4, 4)[0].tolist() == [12, 13, 14, np.float32(4e-5)]
    (_, first) = messages["/tf foxglove.FrameTransforms"][0]
    assert [(t.parent_frame_id, t.child_frame_id) for t in first.transforms] == [("world", "base"), ("base", "link")]


def test_torques_are_the_effort_of_joint_states() -> None:
    torque = np.array([[1.5, -0.0], [2.5, np.nan], [-300.25, 1e-9]])
    recording = replace(plan(3), torque_nm=torque)
    reader = make_reader(io.BytesIO(encode(recording)[FILE]), decoder_factories=[DecoderFactory()])
    states = [decoded for *_, decoded in reader.iter_decoded_messages(topics=["/joint_states"])]
    found = np.array([[joint.effort for joint in each.joints] for each in states])
    np.testing.assert_array_equal(found, torque)
    assert same(decode(Recording, encode(recording)), recording)


def test_torques_of_other_joints_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="torque_nm has 1 columns for 2 joints"):
        encode(replace(plan(3), torque_nm=np.ones((3, 1))))


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed")
def test_rerun_reads_the_file(tmp_path: Path) -> None:
    (tmp_path / "plan.mcap").write_bytes(encode(plan())[FILE])
    rerun = str(Path(sys.executable).parent / "rerun")
    environment = os.environ | {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    convert = [rerun, "mcap", "convert", "plan.mcap", "-o", "plan.rrd"]
    subprocess.run(convert, check=True, capture_output=True, cwd=tmp_path, env=environment, timeout=60)
    printed = subprocess.run(
        [rerun, "rrd", "print", "plan.rrd"], check=True, capture_output=True, text=True, cwd=tmp_path, env=environment
    ).stdout
    lines = printed.splitlines()
    for topic, component, n_rows in (
        ("/tf", "Transform3D:translation", 26),
        ("/scan", "Points3D:positions", 3),
        ("/joint_states", "foxglove.JointStates:message", 25),
        ("/scene", "foxglove.SceneUpdate:message", 1),
    ):
        assert any(f"{n_rows} rows" in line and f"- {topic} -" in line and component in line for line in lines), printed


@pytest.mark.parametrize(
    ("change", "fact"),
    [
        ({"state_time_ns": np.arange(25) - 1}, "start at 0 ns"),
        ({"joint": ("a", "b", "c")}, "2 columns for 3 joints"),
        ({"frame": ("base", "base")}, "holds a name twice"),
        ({"pose_frame": np.full(26, 2, np.int32)}, "rows of the frames"),
        ({"entity_first_face": np.array([0, 1], np.int32)}, "body after body"),
        ({"entity_n_faces": np.array([2, 2], np.int32)}, "body after body"),
    ],
)
def test_a_recording_that_messages_cannot_carry_is_refused(change: dict[str, Any], fact: str) -> None:
    with pytest.raises(InvalidInputError, match=fact):
        encode(replace(plan(), **change))


@given(st.data())
@settings(deadline=None)
def test_damaged_files_end_in_lake_errors_or_another_digest(data: st.DataObject) -> None:
    content = bytearray(_FILE)
    at = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        content[at] ^= 1 << data.draw(st.integers(0, 7))
    else:
        del content[at:]
    try:
        back = decode(Recording, {FILE: bytes(content)})
    except LakeError:
        return
    assert digest(back) != digest(plan()) or same(back, plan())


def test_a_flipped_byte_in_the_messages_is_found_by_its_crc() -> None:
    content = bytearray(_FILE)
    content[len(content) // 4] ^= 0x10
    with pytest.raises(LakeError, match=r"recording\.mcap is damaged"):
        decode(Recording, {FILE: bytes(content)})


_FILE = encode(plan())[FILE]
