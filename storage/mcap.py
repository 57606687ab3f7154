"""Recordings as MCAP, with the protobuf messages that Foxglove and Rerun open by themselves.

``/joint_states`` holds `foxglove.JointStates` (torques are `effort`, which is not set where there are none), ``/tf``
`FrameTransforms` (one message for the poses of one time), ``/scene`` one `SceneUpdate` with a triangle list a body,
``/scan`` one `PointCloud` for the points of one time. Times are the plan's and start at zero; nothing of the clock
enters, compression runs on one thread, so the same recording gives the same bytes.

The way back is exact. What the messages cannot carry stands beside them: names and parents of joints and frames in
a metadata record, and the places of negative zeros, which protobuf writes as nothing at all, in attachments.
"""

from __future__ import annotations

import heapq
import io
import itertools
import json
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap_protobuf.decoder import DecoderFactory
from zstandard import ZstdError

from cellwright.arrays import AnyArray, IntArray
from cellwright.errors import InvalidInputError, LakeError
from schemas.artefact import Artefact
from schemas.motion import Recording

FILE = "recording.mcap"
"""Name of a recording's only file."""
JOINT_STATES, FRAMES, SCENE, SCAN = "/joint_states", "/tf", "/scene", "/scan"
SCAN_FRAME = "part"

_MESSAGES = {
    JOINT_STATES: "foxglove.JointStates",
    FRAMES: "foxglove.FrameTransforms",
    SCENE: "foxglove.SceneUpdate",
    SCAN: "foxglove.PointCloud",
}

_METADATA = "cellwright"
_ZEROS = "negative-zeros/"
_SIGNED = ("pose_position_m", "pose_quaternion", "entity_colour", "triangle_m")
_CLOUD = np.dtype([("point", "<f4", 3), ("uncertainty", "<f4")])
_SECOND_NS = 1_000_000_000

_DAMAGE = (
    *(McapError, DecodeError, ZstdError, zlib.error, struct.error, InvalidInputError, ValueError, LookupError),
    TypeError,  # what protobuf raises for a damaged descriptor
    MemoryError,  # what zstandard raises for a damaged length
)

_Message = tuple[int, int, Callable[[], None]]
"""Time in ns, rank among equal times, and the call that logs it."""


def encode(artefact: Artefact) -> dict[str, bytes]:
    """Return the recording's MCAP file.

    Raises:
        InvalidInputError: If names repeat, rows point nowhere, times are negative, or bodies do not follow one
            another in the triangles.
    """
    recording = _recording(artefact)
    _check(recording)
    import foxglove
    from foxglove import channels
    from foxglove.mcap import MCAPWriteOptions

    sink = io.BytesIO()
    context = foxglove.Context()  # the global one would send every channel to every open file
    options = MCAPWriteOptions(compression_threads=0)  # more threads give other bytes
    with foxglove.open_mcap(sink, context=context, writer_options=options) as writer:
        writer.write_metadata(_METADATA, _names(recording))
        for field in _SIGNED:
            zeros = _negative_zeros(getattr(recording, field))
            if len(zeros):
                data = zlib.compress(zeros.astype("<i8").tobytes(), 6)
                name = _ZEROS + field
                writer.attach(log_time=0, create_time=0, name=name, media_type="application/octet-stream", data=data)
        joints = channels.JointStatesChannel(JOINT_STATES, context=context)
        frames = channels.FrameTransformsChannel(FRAMES, context=context)
        scene = channels.SceneUpdateChannel(SCENE, context=context)
        scan = channels.PointCloudChannel(SCAN, context=context)
        topics = (
            _scene(recording, scene),
            _frames(recording, frames),
            _joints(recording, joints),
            _scan(recording, scan),
        )
        # in the order of time for players, and within a topic in the order of the rows
        for _, _, log in heapq.merge(*topics, key=lambda message: message[:2]):
            log()
        for channel in (joints, frames, scene, scan):
            channel.close()
    return {FILE: sink.getvalue()}


def decode(kind: type[Artefact], files: Mapping[str, bytes]) -> Artefact:
    """Return the recording that the MCAP file holds, checking its CRCs.

    Raises:
        LakeError: If the file is damaged or not one that `encode` wrote.
    """
    if FILE not in files:
        raise LakeError(f"{FILE} is missing among the files {sorted(files)}")
    try:
        reader = SeekingReader(io.BytesIO(files[FILE]), validate_crcs=True, decoder_factories=[DecoderFactory()])
        names = _read_names(reader)
        messages: dict[str, list[Any]] = {topic: [] for topic in _MESSAGES}
        # in the order of the file, which within a topic is that of the rows
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            if schema is None or schema.name != _MESSAGES[channel.topic]:
                raise ValueError(f"topic {channel.topic} does not hold {_MESSAGES[channel.topic]}")
            messages[channel.topic].append((message.log_time, decoded))
        columns = _joint_columns(messages[JOINT_STATES], len(names["joint"])) | _pose_columns(
            messages[FRAMES], {name: row for row, name in enumerate(names["frame"])}
        )
        columns |= _scene_columns(messages[SCENE]) | _cloud_columns(messages[SCAN])
        for attachment in reader.iter_attachments():
            _restore_zeros(columns[attachment.name.removeprefix(_ZEROS)], attachment.data)
        return kind(**names, **columns)
    except _DAMAGE as error:
        raise LakeError(f"{FILE} is damaged or not a recording of ours: {type(error).__name__}: {error}") from error


def _recording(artefact: Artefact) -> Recording:
    if not isinstance(artefact, Recording):
        raise InvalidInputError(f"{type(artefact).__name__} is not a recording: MCAP holds recordings only")
    return artefact


def _check(recording: Recording) -> None:
    n_joints = len(recording.joint)
    for name in ("position_rad", "velocity_rad_s", "torque_nm"):
        width = getattr(recording, name).shape[1]
        if width != n_joints and (name != "torque_nm" or width):
            raise InvalidInputError(f"recording.{name} has {width} columns for {n_joints} joints")
    for name in ("frame", "entity"):
        names = getattr(recording, name)
        if len(set(names)) < len(names):
            raise InvalidInputError(f"recording.{name} holds a name twice: {len(names)} rows, {len(set(names))} names")
    for name in ("state_time_ns", "pose_time_ns", "cloud_time_ns"):
        times = getattr(recording, name)
        # the seconds of a message are 32 bits wide
        if len(times) and not (times.min() >= 0 and times.max() < 2**32 * _SECOND_NS):
            raise InvalidInputError(f"recording.{name} runs from {times.min()} to {times.max()}: start at 0 ns")
    rows = recording.pose_frame
    if len(rows) and not (rows.min() >= 0 and rows.max() < len(recording.frame)):
        raise InvalidInputError(f"recording.pose_frame runs from {rows.min()} to {rows.max()}: rows of the frames")
    n_faces = recording.entity_n_faces.astype(np.int64)
    first = np.concatenate([[0], np.cumsum(n_faces)])
    n_triangles = len(recording.triangle_m)
    if (n_faces < 0).any() or (recording.entity_first_face != first[:-1]).any() or first[-1] != n_triangles:
        raise InvalidInputError(
            f"recording.entity_first_face and entity_n_faces must cut the {n_triangles} triangles body after body"
        )


def _names(recording: Recording) -> dict[str, str]:
    return {
        "kind": recording.KIND,
        "joint": json.dumps(recording.joint),
        "frame": json.dumps(recording.frame),
        "frame_parent": json.dumps(recording.frame_parent),
    }


def _read_names(reader: Any) -> dict[str, tuple[str, ...]]:
    for record in reader.iter_metadata():
        if record.name == _METADATA:
            return {name: tuple(json.loads(record.metadata[name])) for name in ("joint", "frame", "frame_parent")}
    raise ValueError(f"it has no metadata record {_METADATA!r}")


def _stamp(time_ns: int) -> Any:
    from foxglove.messages import Timestamp

    return Timestamp(time_ns // _SECOND_NS, time_ns % _SECOND_NS)


def _runs(times: IntArray) -> Iterator[tuple[int, slice]]:
    """Yield ``(time, rows)`` for each run of equal times."""
    if not len(times):
        return
    starts = np.concatenate([[0], np.flatnonzero(np.diff(times)) + 1, [len(times)]]).tolist()
    for start, end in itertools.pairwise(starts):
        yield int(times[start]), slice(start, end)


def _joints(recording: Recording, channel: Any) -> Iterator[_Message]:
    from foxglove.messages import JointState, JointStates

    unknown = [None] * len(recording.joint)
    for i, time_ns in enumerate(recording.state_time_ns.tolist()):
        q, v = recording.position_rad[i].tolist(), recording.velocity_rad_s[i].tolist()
        values = zip(recording.joint, q, v, recording.torque_nm[i].tolist() or unknown)
        states = [JointState(name=name, position=q, velocity=v, effort=u) for name, q, v, u in values]
        message = JointStates(timestamp=_stamp(time_ns), joints=states)
        yield time_ns, 2, lambda message=message, t=time_ns: channel.log(message, log_time=t)  # type: ignore[misc]


def _frames(recording: Recording, channel: Any) -> Iterator[_Message]:
    from foxglove.messages import FrameTransform, FrameTransforms, Quaternion, Vector3

    names, parents = recording.frame, recording.frame_parent
    for time_ns, rows in _runs(recording.pose_time_ns):
        stamp = _stamp(time_ns)
        poses = zip(
            recording.pose_frame[rows].tolist(),
            recording.pose_position_m[rows].tolist(),
            recording.pose_quaternion[rows].tolist(),
        )
        transforms = [
            FrameTransform(
                timestamp=stamp,
                parent_frame_id=parents[frame],
                child_frame_id=names[frame],
                translation=Vector3(x=x, y=y, z=z),
                rotation=Quaternion(w=qw, x=qx, y=qy, z=qz),
            )
            for frame, (x, y, z), (qw, qx, qy, qz) in poses
        ]
        message = FrameTransforms(transforms=transforms)
        yield time_ns, 1, lambda message=message, t=time_ns: channel.log(message, log_time=t)  # type: ignore[misc]


def _scene(recording: Recording, channel: Any) -> Iterator[_Message]:
    from foxglove.messages import (
        Color,
        Point3,
        Pose,
        Quaternion,
        SceneEntity,
        SceneUpdate,
        TriangleListPrimitive,
        Vector3,
    )

    if not recording.entity:
        return
    entities = []
    bodies = zip(
        recording.entity,
        recording.entity_frame,
        recording.entity_colour.tolist(),
        recording.entity_first_face.tolist(),
        recording.entity_n_faces.tolist(),
    )
    for name, frame, (r, g, b, a), first, n_faces in bodies:
        corners = recording.triangle_m[first : first + n_faces].reshape(-1, 3).tolist()
        points = [Point3(x=x, y=y, z=z) for x, y, z in corners]
        # viewers need not take a missing pose for none
        pose = Pose(position=Vector3(x=0.0, y=0.0, z=0.0), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
        triangles = TriangleListPrimitive(pose=pose, points=points, color=Color(r=r, g=g, b=b, a=a))
        entities.append(
            SceneEntity(timestamp=_stamp(0), frame_id=frame, id=name, frame_locked=True, triangles=[triangles])
        )
    message = SceneUpdate(entities=entities)
    yield 0, 0, lambda: channel.log(message, log_time=0)


def _scan(recording: Recording, channel: Any) -> Iterator[_Message]:
    from foxglove.messages import (
        PackedElementField,
        PackedElementFieldNumericType,
        PointCloud,
        Pose,
        Quaternion,
        Vector3,
    )

    float32 = PackedElementFieldNumericType.Float32
    fields = [
        PackedElementField(name=name, offset=4 * i, type=float32)
        for i, name in enumerate(("x", "y", "z", "uncertainty"))
    ]
    pose = Pose(position=Vector3(x=0.0, y=0.0, z=0.0), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
    points = np.zeros(len(recording.cloud_time_ns), _CLOUD)
    points["point"], points["uncertainty"] = recording.cloud_point_m, recording.cloud_uncertainty_m
    for time_ns, rows in _runs(recording.cloud_time_ns):
        message = PointCloud(
            timestamp=_stamp(time_ns),
            frame_id=SCAN_FRAME,
            pose=pose,
            point_stride=_CLOUD.itemsize,
            fields=fields,
            data=points[rows].tobytes(),
        )
        yield time_ns, 3, lambda message=message, t=time_ns: channel.log(message, log_time=t)  # type: ignore[misc]


def _joint_columns(messages: list[Any], n_joints: int) -> dict[str, AnyArray]:
    times = np.array([time_ns for time_ns, _ in messages], np.int64)
    fields = {"position_rad": "position", "velocity_rad_s": "velocity"}
    told = {state.HasField("effort") for _, states in messages for state in states.joints}
    if len(told) > 1:
        raise ValueError("some joint states tell the effort, others do not")
    if told == {True}:
        fields["torque_nm"] = "effort"
    values = np.array(
        [[[getattr(s, field) for field in fields.values()] for s in states.joints] for _, states in messages]
    )
    values = values.astype(np.float64).reshape(len(messages), n_joints, len(fields))
    return {"state_time_ns": times, **{name: values[..., row] for row, name in enumerate(fields)}}


def _pose_columns(messages: list[Any], row_of: Mapping[str, int]) -> dict[str, AnyArray]:
    times = [time_ns for time_ns, poses in messages for _ in poses.transforms]
    transforms = [pose for _, poses in messages for pose in poses.transforms]
    places = [(p.translation.x, p.translation.y, p.translation.z) for p in transforms]
    turns = [(p.rotation.w, p.rotation.x, p.rotation.y, p.rotation.z) for p in transforms]
    return {
        "pose_time_ns": np.array(times, np.int64),
        "pose_frame": np.array([row_of[p.child_frame_id] for p in transforms], np.int32),
        "pose_position_m": np.array(places, np.float64).reshape(-1, 3),
        "pose_quaternion": np.array(turns, np.float64).reshape(-1, 4),
    }


def _scene_columns(messages: list[Any]) -> dict[str, Any]:
    entities = [entity for _, update in messages for entity in update.entities]
    colours = [(t.color.r, t.color.g, t.color.b, t.color.a) for entity in entities for t in entity.triangles]
    corners = [(p.x, p.y, p.z) for entity in entities for t in entity.triangles for p in t.points]
    n_faces = np.array([sum(len(t.points) for t in entity.triangles) // 3 for entity in entities], np.int32)
    return {
        "entity": tuple(entity.id for entity in entities),
        "entity_frame": tuple(entity.frame_id for entity in entities),
        "entity_colour": np.array(colours, np.float64).reshape(-1, 4),
        "entity_first_face": np.cumsum(n_faces, dtype=np.int32) - n_faces,
        "entity_n_faces": n_faces,
        "triangle_m": np.array(corners, np.float64).reshape(-1, 9),
    }


def _cloud_columns(messages: list[Any]) -> dict[str, AnyArray]:
    points = np.frombuffer(b"".join(cloud.data for _, cloud in messages), _CLOUD)
    n_points = [len(cloud.data) // _CLOUD.itemsize for _, cloud in messages]
    return {
        "cloud_time_ns": np.repeat(np.array([time_ns for time_ns, _ in messages], np.int64), n_points),
        "cloud_point_m": points["point"],
        "cloud_uncertainty_m": points["uncertainty"],
    }


def _negative_zeros(values: AnyArray) -> IntArray:
    flat = values.reshape(-1)
    return np.flatnonzero((flat == 0.0) & np.signbit(flat))


def _restore_zeros(values: AnyArray, data: bytes) -> None:
    values.reshape(-1)[np.frombuffer(zlib.decompress(data), "<i8")] = -0.0
