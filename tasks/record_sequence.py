"""Record a sequence for viewers: joint states, moving frames with that of the tool, the scene as triangles.

The recording is what Foxglove and Rerun open; nothing is computed from it. Frames form a tree under ``world``.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from schemas.motion import Recording
from schemas.params import Params
from schemas.sources import CellModel
from schemas.stage import stage
from schemas.tasks import TaskSequence


class SequenceRecordingParams(Params):
    """Settings of the recording of a sequence."""

    frame_rate_hz: float = Field(default=50.0, gt=0, le=1000, description="Poses of the frames a second.")


@stage(version=1)
def record_sequence(cell: CellModel, sequence: TaskSequence, *, params: SequenceRecordingParams) -> Recording:
    """Lay the sequence out in time: what a viewer shows from the first state to the last."""
    from schemas.cell_objects import build_cell
    from schemas.recording_objects import entity_columns, link_names, nanoseconds, pose_columns

    built = build_cell(cell)
    n_joints = built.robot.n_joints
    links = link_names(n_joints)
    fixed = [
        (0, built.T_world_base),
        (1 + n_joints, built.robot.chain.T_last_flange),
        (2 + n_joints, built.T_flange_scanner),
    ]
    return Recording(
        joint=cell.joint,
        state_time_ns=nanoseconds(sequence.time_s),
        position_rad=sequence.position_rad,
        velocity_rad_s=sequence.velocity_rad_s,
        torque_nm=sequence.torque_nm,
        frame=("base", *links, "flange", "tool"),
        frame_parent=("world", *(["base"] * n_joints), links[-1], "flange"),
        **pose_columns(built, sequence.time_s, sequence.position_rad, fixed, 1, params.frame_rate_hz),
        **entity_columns(built),
        cloud_time_ns=np.zeros(0, np.int64),
        cloud_point_m=np.zeros((0, 3), np.float32),
        cloud_uncertainty_m=np.zeros(0, np.float32),
    )
