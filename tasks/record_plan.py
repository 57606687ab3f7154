"""Record a plan for viewers: joint states, moving frames, the scene as triangles, the growing point cloud.

The recording is what Foxglove and Rerun open; nothing is computed from it. Frames form a tree under ``world``; the
point cloud is shown in portions, each at the time of its last profile.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from cellwright.arrays import IntArray
from cellwright.cell.cell import PART
from schemas.motion import Recording, ScanCloud, Trajectory
from schemas.params import Params
from schemas.part import PartMesh
from schemas.poses import Pose
from schemas.sources import CellModel
from schemas.stage import stage


class RecordingParams(Params):
    """Settings of the recording."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    frame_rate_hz: float = Field(default=50.0, gt=0, le=1000, description="Poses of the frames a second.")
    cloud_rate_hz: float = Field(default=5.0, gt=0, le=100, description="Portions of the point cloud a second.")


@stage(version=2)
def record_plan(
    cell: CellModel, mesh: PartMesh, trajectory: Trajectory, scan: ScanCloud, *, params: RecordingParams
) -> Recording:
    """Lay the plan out in time: what a viewer shows from the first state to the last."""
    from schemas.cell_objects import build_cell
    from schemas.recording_objects import entity_columns, link_names, nanoseconds, pose_columns

    T_world_part = params.T_world_part.matrix()
    built = build_cell(cell, mesh, T_world_part)
    n_joints = built.robot.n_joints
    links = link_names(n_joints)
    fixed = [
        (0, built.T_world_base),
        (1, T_world_part),
        (2 + n_joints, built.robot.chain.T_last_flange),
        (3 + n_joints, built.T_flange_scanner),
    ]
    cloud_time, order = _portions(scan, params.cloud_rate_hz, float(trajectory.time_s[-1]))
    return Recording(
        joint=cell.joint,
        state_time_ns=nanoseconds(trajectory.time_s),
        position_rad=trajectory.position_rad,
        velocity_rad_s=trajectory.velocity_rad_s,
        torque_nm=trajectory.torque_nm,
        frame=("base", PART, *links, "flange", "scanner"),
        frame_parent=("world", "world", *(["base"] * n_joints), links[-1], "flange"),
        **pose_columns(built, trajectory.time_s, trajectory.position_rad, fixed, 2, params.frame_rate_hz),
        **entity_columns(built),
        cloud_time_ns=cloud_time,
        cloud_point_m=scan.points_m[order],
        cloud_uncertainty_m=scan.uncertainty_m[order],
    )


def _portions(scan: ScanCloud, rate_hz: float, end: float) -> tuple[IntArray, IntArray]:
    """Time at which each point is shown, in ascending order, and the order of the points."""
    from schemas.recording_objects import nanoseconds

    time = scan.time_s[scan.profile]
    shown = np.minimum(np.ceil(time * rate_hz) / rate_hz, max(end, float(time.max(initial=0.0))))
    order = np.argsort(shown, kind="stable")
    return nanoseconds(shown[order]), order
