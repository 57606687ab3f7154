"""Record a layout for viewers: first the stations move to their places, then the robot runs its cycle once.

The recording is what Foxglove and Rerun open; nothing is computed from it. Approaches whose time does not count are
shown at 0.25 m/s, so it may last longer than the cycle. Bodies are solid, hulls translucent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from cellwright.arrays import FloatArray, Int32Array, IntArray
from schemas.body_params import BodyParams
from schemas.layout import Layout, RobotHull
from schemas.layout_objects import build_problem, drawn
from schemas.layout_params import LayoutProblemParams
from schemas.motion import Recording
from schemas.params import Params
from schemas.sources import SourceFile
from schemas.sphere_hull import SphereHull
from schemas.stage import stage

if TYPE_CHECKING:
    from cellwright.solvers.layout.problem import LayoutProblem

_SHOWN_SPEED_M_S = 0.25
"""At which approaches are shown whose time does not count."""
_SHORTEST_S = 0.02
_ROBOT, _STATION, _HULL, _LINK_HULL = (
    (0.55, 0.63, 0.71, 1.0),
    (0.80, 0.78, 0.74, 1.0),
    (0.25, 0.65, 0.84, 0.25),
    (0.88, 0.48, 0.12, 0.2),
)

Entity = tuple[str, str, tuple[float, float, float, float], FloatArray]
"""Name, frame, colour, and triangles as rows of three points, (n, 9)."""


class ShownBody(Params):
    """A body that is shown; its pose is on what carries it."""

    station: str | None = Field(default=None, min_length=1, description="Station that carries it; none: the flange.")
    body: BodyParams


class LayoutRecordingParams(Params):
    """What is recorded, and how."""

    problem: LayoutProblemParams = Field(description="The problem that the layout solves.")
    bodies: tuple[ShownBody, ...] = Field(default=(), description="Bodies of stations and obstacles.")
    frame_rate_hz: float = Field(default=50.0, gt=0, le=1000, description="Poses of the frames a second.")
    show_robot: bool = Field(default=True, description="Whether the robot's meshes are at hand.")
    moving_s: float = Field(default=2.0, gt=0, le=60, description="Time in which the stations move to their places.")


@stage(version=2)
def record_layout(
    urdf: SourceFile | None,
    files: tuple[SourceFile, ...],
    robot: RobotHull | None,
    hulls: SphereHull | None,
    layout: Layout,
    *,
    params: LayoutRecordingParams,
) -> Recording:
    """Lay a layout out in time; meshes of robot and stations are found among the files by their names.

    Raises:
        InvalidInputError: If a mesh is malformed, or missing although the robot is to be shown.
    """
    problem = build_problem(params.problem, urdf, robot, hulls)
    time, q = _cycle(problem, layout, params.moving_s)
    frames, parents = _frames(problem)
    pose_time, pose_frame, position, quaternion = _poses(problem, layout, time, q, params)
    contents = {file.name: file.content for file in files}
    entities = [
        *(_robot_bodies(problem, contents, urdf is None, params) if params.show_robot else ()),
        *_hulls(problem),
        *_station_bodies(contents, params),
    ]
    count = np.array([len(triangles) for *_, triangles in entities], np.int32)
    velocity = np.gradient(q, time, axis=0)
    return Recording(
        joint=layout.joint,
        state_time_ns=_nanoseconds(time),
        position_rad=q,
        velocity_rad_s=velocity,
        frame=frames,
        frame_parent=parents,
        pose_time_ns=pose_time,
        pose_frame=pose_frame,
        pose_position_m=position,
        pose_quaternion=quaternion,
        entity=tuple(name for name, *_ in entities),
        entity_frame=tuple(frame for _, frame, *_ in entities),
        entity_colour=np.array([colour for _, _, colour, _ in entities]).reshape(-1, 4),
        entity_first_face=(np.cumsum(count) - count).astype(np.int32),
        entity_n_faces=count,
        triangle_m=np.concatenate([np.empty((0, 9)), *(triangles for *_, triangles in entities)]),
        cloud_time_ns=np.empty(0, np.int64),
        cloud_point_m=np.empty((0, 3), np.float32),
        cloud_uncertainty_m=np.empty(0, np.float32),
    )


def _nanoseconds(time_s: FloatArray) -> IntArray:
    return np.round(time_s * 1e9).astype(np.int64)


def _cycle(problem: LayoutProblem, layout: Layout, begins_s: float) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) in s, rising, and joint positions (n, joints): waiting, then the whole cycle."""
    approaches = [layout.approach_position[layout.approach_visit == row] for row in range(len(problem.visits))]
    times, positions = [np.zeros(1)], [approaches[0][:1]]
    now = begins_s

    def add(at: FloatArray, q: FloatArray) -> None:
        nonlocal now
        times.append(now + at)
        positions.append(q)
        now += float(at[-1])

    for visit, motion in enumerate(drawn(layout).transitions):
        add(_approach_times(problem, visit, len(approaches[visit])), approaches[visit])
        add(motion.times_s, motion.q)
    if len(layout.duration_s) < len(problem.visits):
        add(_approach_times(problem, len(problem.visits) - 1, len(approaches[-1])), approaches[-1])
    time, q = np.concatenate(times), np.concatenate(positions)
    # the end of one piece is the beginning of the next
    kept = np.concatenate([[True], np.diff(time) > 1e-6])
    return time[kept], q[kept]


def _approach_times(problem: LayoutProblem, visit: int, n_poses: int) -> FloatArray:
    """Return times from 0 at an approach's poses in s, (poses,)."""
    approach = problem.approach_of(visit)
    if approach is None or n_poses < 2:
        return np.zeros(n_poses)
    steps = approach.durations_s
    if steps is None:
        lengths = np.linalg.norm(np.diff(approach.T_station_tool[:, :3, 3], axis=0), axis=1)
        steps = np.maximum(lengths / _SHOWN_SPEED_M_S, _SHORTEST_S)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _station_frame(name: str) -> str:
    return f"station/{name}"


def _frames(problem: LayoutProblem) -> tuple[tuple[str, ...], tuple[str, ...]]:
    links = [f"link_{joint}" for joint in range(1, problem.arm.n_joints + 1)]
    stations = [_station_frame(station.name) for station in problem.stations]
    frames = ("base", *stations, *links, "flange", "tool")
    return frames, ("world", *(["world"] * len(stations)), *(["base"] * len(links)), links[-1], "flange")


def _poses(
    problem: LayoutProblem, layout: Layout, time: FloatArray, q: FloatArray, params: LayoutRecordingParams
) -> tuple[IntArray, Int32Array, FloatArray, FloatArray]:
    """Poses of flange and tool once, of base and stations while they move, of the links at every tick."""
    from cellwright.cell.transforms import quaternion_from_rotation

    n_bodies, n_joints = 1 + len(problem.stations), problem.arm.n_joints
    end = float(time[-1])
    ticks = np.append(np.arange(np.ceil(end * params.frame_rate_hz - 1e-6)) / params.frame_rate_hz, end)
    moving = np.append(ticks[ticks < params.moving_s], params.moving_s)
    share = 0.5 - 0.5 * np.cos(np.pi * moving / params.moving_s)[:, None]  # gently from and to rest
    designs = layout.before + share * (layout.value - layout.before)
    bodies = np.concatenate([problem.base_pose(designs)[:, None], problem.station_poses(designs)], axis=1)
    at_ticks = np.stack([np.interp(ticks, time, q[:, joint]) for joint in range(n_joints)], axis=1)
    links = problem.arm.link_poses(at_ticks)[:, 1:]
    fixed = np.stack([problem.arm.T_last_flange, problem.T_flange_tool])
    poses = np.concatenate([fixed, bodies.reshape(-1, 4, 4), links.reshape(-1, 4, 4)])
    times = np.concatenate([np.zeros(2), np.repeat(moving, n_bodies), np.repeat(ticks, n_joints)])
    frame = np.concatenate(
        [
            n_bodies + n_joints + np.arange(2),
            np.tile(np.arange(n_bodies), len(moving)),
            np.tile(n_bodies + np.arange(n_joints), len(ticks)),
        ]
    )
    order = np.argsort(times, kind="stable")
    poses = poses[order]
    return (
        _nanoseconds(times[order]),
        frame[order].astype(np.int32),
        poses[:, :3, 3],
        quaternion_from_rotation(poses[:, :3, :3]),
    )


def _robot_bodies(
    problem: LayoutProblem, contents: Mapping[str, bytes], built_in: bool, params: LayoutRecordingParams
) -> list[Entity]:
    """Return the robot's collision shapes.

    Raises:
        InvalidInputError: If geometry is malformed or a mesh is missing; the link is named.
    """
    from cellwright.cell.built_in_robots import built_in_meshes
    from cellwright.cell.robot import moving_joints
    from cellwright.cell.spherized_urdf import link_shapes, merged_mesh
    from cellwright.cell.urdf_geometry import meshes_among

    arm = problem.arm
    read = built_in_meshes(params.problem.arm.robot) if built_in else meshes_among(contents)
    shapes = link_shapes(arm.tree, read)
    path = [joint for joint in arm.tree.path(arm.base_link, arm.flange_link) if joint.name in arm.joint_names]
    attached = arm.tree.attachments(arm.base_link, moving_joints(path, arm.base_link, arm.flange_link))
    found: list[Entity] = []
    for link, each in shapes.items():
        number, T = attached[link]
        mesh = merged_mesh(each)
        frame = f"link_{number}" if number else "base"
        found.append((f"robot {link}", frame, _ROBOT, _triangles(mesh.vertices, mesh.faces, T)))
    return found


def _triangles(vertices: FloatArray, faces: Int32Array | IntArray, T: FloatArray) -> FloatArray:
    from cellwright.cell.transforms import apply

    return np.asarray(apply(T, vertices)[faces].reshape(-1, 9))


def _hulls(problem: LayoutProblem) -> list[Entity]:
    spheres = problem.robot_spheres
    found: list[Entity] = []
    for link in np.unique(spheres.link).tolist():
        rows = (spheres.link == link) & (spheres.radii > 0.0)
        if rows.any():
            frame = f"link_{link}" if link else "base"
            found.append((f"robot hull {link}", frame, _LINK_HULL, _balls(spheres.centres[rows], spheres.radii[rows])))
    for station in problem.stations:
        if len(station.hull):
            triangles = _balls(station.hull.centres, station.hull.radii)
            found.append((f"hull of {station.name}", _station_frame(station.name), _HULL, triangles))
    return found


def _balls(centres: FloatArray, radii: FloatArray) -> FloatArray:
    from cellwright.cell.bodies import Sphere
    from cellwright.cell.tessellation import triangles_of

    vertices, faces = triangles_of(Sphere(1.0), 16)
    corners = vertices[faces].reshape(-1, 3)
    return np.concatenate([(radius * corners + centre).reshape(-1, 9) for centre, radius in zip(centres, radii)])


def _station_bodies(contents: Mapping[str, bytes], params: LayoutRecordingParams) -> Sequence[Entity]:
    from cellwright.cell.tessellation import triangles_of
    from schemas.body_shapes import shape_of

    found: list[Entity] = []
    for shown in params.bodies:
        vertices, faces = triangles_of(shape_of(shown.body, contents))
        triangles = _triangles(vertices, faces, shown.body.pose.matrix())
        frame = "flange" if shown.station is None else _station_frame(shown.station)
        found.append((shown.body.name, frame, _STATION, triangles))
    return found
