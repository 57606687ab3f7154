"""Artefacts of motion: the timed plan, what the scanner sees along it, its verification, its recording.

Between two states of a trajectory the joints follow the cubic Hermite curve through positions and velocities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellwright.arrays import BoolArray, Float32Array, FloatArray, Int8Array, Int32Array, IntArray
from schemas.artefact import Artefact
from schemas.columns import ANY_WIDTH, column, fact, torque_column


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Artefact):
    """The timed joint motion from the start configuration through all sweeps.

    Times rise strictly; the state at which a connection and a sweep meet is stored once, as one of the sweep.
    Sweeps that are left out are findings: no segment executes them.
    """

    KIND: ClassVar[str] = "trajectory"

    time_s: FloatArray = column("Time since the start", unit="s", table="states")
    position_rad: FloatArray = column("Joint positions", width=ANY_WIDTH, unit="rad", table="states")
    velocity_rad_s: FloatArray = column("Joint velocities", width=ANY_WIDTH, unit="rad/s", table="states")
    acceleration_rad_s2: FloatArray = column("Joint accelerations", width=ANY_WIDTH, unit="rad/s^2", table="states")
    torque_nm: FloatArray = torque_column("dynamics do not count")
    segment: Int32Array = column("Segment that the state belongs to", dtype="int32", table="states")
    travel_m: FloatArray = column("Travel along the sweep; NaN on a connection", unit="m", table="states")
    kind: tuple[str, ...] = column("sweep or connection", dtype="str", table="segments")
    view: Int32Array = column("View of a sweep; -1 on a connection", dtype="int32", table="segments")
    branch: Int8Array = column("Branch of a sweep; -1 on a connection", dtype="int8", table="segments")
    direction: Int8Array = column(
        "1 along x of the laser-emitter frame, -1 against it, 0 on a connection",
        dtype="int8",
        table="segments",
    )
    start_s: FloatArray = column("Time at which the segment begins", unit="s", table="segments")
    end_s: FloatArray = column("Time at which it ends", unit="s", table="segments")
    via: tuple[str, ...] = column(
        "How a connection was found: direct or roadmap; empty on a sweep", dtype="str", table="segments"
    )
    order_method: tuple[str, ...] = column("greedy, exact, ...: orders that were compared", dtype="str", table="orders")
    order_duration_s: FloatArray = column("Duration of the whole plan in that order", unit="s", table="orders")
    order_chosen: BoolArray = column("Whether this order is the plan", dtype="bool", table="orders")
    left_out_view: Int32Array = column(
        "View that is selected and not executed: it cannot be executed or connected", dtype="int32", table="left_out"
    )
    left_out_reason: tuple[str, ...] = column("Why, with the amounts", dtype="str", table="left_out")
    replaced_view: Int32Array = column(
        "View that an earlier selection left out and this one does without", dtype="int32", table="replaced"
    )
    replaced_reason: tuple[str, ...] = column("Why it was left out", dtype="str", table="replaced")
    order_lower_bound_s: float = fact("No order of the executed sweeps over the connections found is shorter", unit="s")
    order_proven: bool = fact("Whether the plan's order is proven shortest", dtype="bool")


@dataclass(frozen=True, eq=False, repr=False)
class ScanCloud(Artefact):
    """The points that the scanner measures along the trajectory."""

    KIND: ClassVar[str] = "scan-cloud"

    points_m: Float32Array = column("Measured points", dtype="float32", width=3, unit="m", frame="part", table="points")
    uncertainty_m: Float32Array = column(
        "Predicted uncertainty of the point", dtype="float32", unit="m", table="points"
    )
    face: Int32Array = column("Face of the part that was hit", dtype="int32", table="points")
    profile: Int32Array = column("Profile that measured the point", dtype="int32", table="points")
    time_s: FloatArray = column("Time of the profile", unit="s", table="profiles")
    position_m: FloatArray = column(
        "Origin of the laser-emitter frame", width=3, unit="m", frame="part", table="profiles"
    )
    quaternion: FloatArray = column(
        "Orientation of the laser-emitter frame (w, x, y, z)", width=4, frame="part", table="profiles"
    )
    segment: Int32Array = column("Segment of the trajectory", dtype="int32", table="profiles")


@dataclass(frozen=True, eq=False, repr=False)
class Verification(Artefact):
    """The proof that the plan can run: every check with what was found and what is permitted."""

    KIND: ClassVar[str] = "verification"

    check: tuple[str, ...] = column("What was checked", dtype="str", table="checks")
    found: FloatArray = column("Worst value found", table="checks")
    permitted: FloatArray = column("Permitted value", table="checks")
    unit: tuple[str, ...] = column("Unit of both values", dtype="str", table="checks")
    at_least: BoolArray = column(
        "Whether the permitted value is the least, else the most", dtype="bool", table="checks"
    )
    least_distance_m: float = fact("Smallest distance of bodies found; infinite if no bodies are checked", unit="m")
    proven_distance_m: float = fact("Bodies come nowhere nearer on the motion, between states neither", unit="m")
    nearest_bodies: tuple[str, ...] = column("The two bodies that come nearest", dtype="str", table="nearest")
    nearest_s: float = fact("Time at which they do", unit="s")
    n_distances: int = fact("Distances measured for the proof", dtype="int64")
    n_states: int = fact("States checked by the second collision engine", dtype="int64")
    engine: str = fact("Collision engine that verified", dtype="str")


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Artefact):
    """The plan as viewers play it: joint states, frames, scene and point cloud. Stored as MCAP."""

    KIND: ClassVar[str] = "recording"

    joint: tuple[str, ...] = column("Joint names", dtype="str", table="joints")
    state_time_ns: IntArray = column("Time of a joint state", dtype="int64", unit="ns", table="states")
    position_rad: FloatArray = column("Joint positions", width=ANY_WIDTH, unit="rad", table="states")
    velocity_rad_s: FloatArray = column("Joint velocities", width=ANY_WIDTH, unit="rad/s", table="states")
    torque_nm: FloatArray = column(
        "Joint torques, N on slides; left out where dynamics do not count",
        width=ANY_WIDTH,
        unit="N m",
        table="states",
        optional=True,
    )
    frame: tuple[str, ...] = column("Moving and fixed frames", dtype="str", table="frames")
    frame_parent: tuple[str, ...] = column("Parent of the frame", dtype="str", table="frames")
    pose_time_ns: IntArray = column("Time of a frame's pose", dtype="int64", unit="ns", table="poses")
    pose_frame: Int32Array = column("Frame (row of the frames)", dtype="int32", table="poses")
    pose_position_m: FloatArray = column(
        "Position in the parent frame", width=3, unit="m", frame="parent", table="poses"
    )
    pose_quaternion: FloatArray = column(
        "Orientation in the parent frame (w, x, y, z)", width=4, frame="parent", table="poses"
    )
    entity: tuple[str, ...] = column("Scene bodies, all as triangles", dtype="str", table="entities")
    entity_frame: tuple[str, ...] = column("Frame that carries the body", dtype="str", table="entities")
    entity_colour: FloatArray = column("Red, green, blue, opacity, 0 to 1", width=4, table="entities")
    entity_first_face: Int32Array = column("First triangle of the body", dtype="int32", table="entities")
    entity_n_faces: Int32Array = column("Triangles of the body", dtype="int32", table="entities")
    triangle_m: FloatArray = column(
        "Corners of the triangles, three points in a row",
        width=9,
        unit="m",
        frame="entity_frame",
        table="triangles",
    )
    cloud_time_ns: IntArray = column("Time at which the point is shown", dtype="int64", unit="ns", table="cloud")
    cloud_point_m: Float32Array = column(
        "Measured points", dtype="float32", width=3, unit="m", frame="part", table="cloud"
    )
    cloud_uncertainty_m: Float32Array = column("Predicted uncertainty", dtype="float32", unit="m", table="cloud")
