"""Record a plan for viewers: joint states, moving frames, the scene as triangles, the growing point cloud.

The recording is what Foxglove and Rerun open; nothing is computed from it. Frames form a tree under ``world``; the
point cloud is shown in portions, each at the time of its last profile.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np
from pydantic import Field

from cellwright.arrays import FloatArray, Int32Array, IntArray
from cellwright.cell.bodies import BASE, WORLD, Mesh
from cellwright.cell.cell import PART, Cell
from cellwright.cell.transforms import quaternion_from_rotation
from schemas.motion import Recording, ScanCloud, Trajectory
from schemas.params import Params
from schemas.part import PartMesh
from schemas.poses import Pose
from schemas.sources import CellModel
from schemas.stage import stage

_COLOURS = {
    "part": (0.72, 0.76, 0.80, 1.0),
    "robot": (0.55, 0.63, 0.71, 1.0),
    "tool": (0.88, 0.48, 0.12, 1.0),
    "world": (0.80, 0.78, 0.74, 0.85),
}


class RecordingParams(Params):
    """Settings of the recording."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    frame_rate_hz: float = Field(default=50.0, gt=0, le=1000, description="Poses of the frames a second.")
    cloud_rate_hz: float = Field(default=5.0, gt=0, le=100, description="Portions of the point cloud a second.")


@stage(version=1)
def record_plan(
    cell: CellModel, mesh: PartMesh, trajectory: Trajectory, scan: ScanCloud, *, params: RecordingParams
) -> Recording:
    """Lay the plan out in time: what a viewer shows from the first state to the last."""
    from schemas.cell_objects import build_cell

    T_world_part = params.T_world_part.matrix()
    built = build_cell(cell, mesh, T_world_part)
    frames, parents, carriers = _frames(built.robot.n_joints)
    pose_time, pose_frame, position, quaternion = _poses(built, trajectory, T_world_part, params.frame_rate_hz)
    colours, first, count, triangles = _entities(built)
    end = float(trajectory.time_s[-1])
    cloud_time, order = _portions(scan, params.cloud_rate_hz, end)
    return Recording(
        joint=cell.joint,
        state_time_ns=_nanoseconds(trajectory.time_s),
        position_rad=trajectory.position_rad,
        velocity_rad_s=trajectory.velocity_rad_s,
        frame=frames,
        frame_parent=parents,
        pose_time_ns=pose_time,
        pose_frame=pose_frame,
        pose_position_m=position,
        pose_quaternion=quaternion,
        entity=tuple(body.name for body in built.bodies),
        entity_frame=tuple(PART if body.name == PART else carriers[body.parent] for body in built.bodies),
        entity_colour=colours,
        entity_first_face=first,
        entity_n_faces=count,
        triangle_m=triangles,
        cloud_time_ns=cloud_time,
        cloud_point_m=scan.points_m[order],
        cloud_uncertainty_m=scan.uncertainty_m[order],
    )


def _nanoseconds(time_s: FloatArray) -> IntArray:
    return np.round(time_s * 1e9).astype(np.int64)


def _frames(n_joints: int) -> tuple[tuple[str, ...], tuple[str, ...], dict[int, str]]:
    links = [f"link_{joint}" for joint in range(1, n_joints + 1)]
    frames = ("base", PART, *links, "flange", "scanner")
    parents = ("world", "world", *(["base"] * n_joints), links[-1], "flange")
    carriers = {WORLD: "world", BASE: "base", **{row + 1: link for row, link in enumerate(links)}}
    return frames, parents, carriers


def _poses(
    cell: Cell, trajectory: Trajectory, T_world_part: FloatArray, rate_hz: float
) -> tuple[IntArray, Int32Array, FloatArray, FloatArray]:
    """Poses of the fixed frames once at time 0, of the links in the base at every tick."""
    n_joints = cell.robot.n_joints
    fixed = [
        (0, cell.T_world_base),
        (1, T_world_part),
        (2 + n_joints, cell.robot.chain.T_last_flange),
        (3 + n_joints, cell.T_flange_scanner),
    ]
    end = float(trajectory.time_s[-1])
    # the last state is always there, and never a rounding error after a tick
    ticks = np.append(np.arange(np.ceil(end * rate_hz - 1e-6)) / rate_hz, end)
    q = np.stack(
        [np.interp(ticks, trajectory.time_s, trajectory.position_rad[:, joint]) for joint in range(n_joints)], axis=1
    )
    T_base_link = np.stack([cell.robot.link_poses(row)[1:] for row in q])  # (ticks, joints, 4, 4)
    poses = np.concatenate([np.stack([T for _, T in fixed]), T_base_link.reshape(-1, 4, 4)])
    time = np.concatenate([np.zeros(len(fixed), np.int64), np.repeat(_nanoseconds(ticks), n_joints)])
    frame = np.concatenate([[row for row, _ in fixed], np.tile(np.arange(2, 2 + n_joints), len(ticks))])
    return time, frame.astype(np.int32), poses[:, :3, 3], quaternion_from_rotation(poses[:, :3, :3])


def _entities(cell: Cell) -> tuple[FloatArray, Int32Array, Int32Array, FloatArray]:
    """All bodies as triangles in the frame that carries them; the part stays in its own frame."""
    from cellwright.cell.tessellation import triangles_of
    from cellwright.cell.transforms import apply
    from cellwright.cell.urdf_tree import parse_urdf

    triangles, counts, colours = [], [], []
    links = parse_urdf(cell.robot.urdf).links.keys()
    for body in cell.bodies:
        vertices, faces = triangles_of(body.shape)
        placed = vertices if body.name == PART and isinstance(body.shape, Mesh) else apply(body.T_parent_body, vertices)
        triangles.append(placed[faces].reshape(-1, 9))
        counts.append(len(faces))
        colours.append(_COLOURS[_role(body.name, body.parent, links)])
    count = np.array(counts, np.int32)
    first = (np.cumsum(count) - count).astype(np.int32)
    return np.array(colours), first, count, np.concatenate(triangles)


def _role(name: str, parent: int, links: Set[str]) -> str:
    if name == PART:
        return "part"
    if parent == WORLD:
        return "world"
    # what hangs on the robot without being a link of its URDF was put there by the cell file
    return "robot" if name in links or name.rpartition(".")[0] in links else "tool"


def _portions(scan: ScanCloud, rate_hz: float, end: float) -> tuple[IntArray, IntArray]:
    """Time at which each point is shown, in ascending order, and the order of the points."""
    time = scan.time_s[scan.profile]
    shown = np.minimum(np.ceil(time * rate_hz) / rate_hz, max(end, float(time.max(initial=0.0))))
    order = np.argsort(shown, kind="stable")
    return _nanoseconds(shown[order]), order
