"""The scanning cell of the solvers' tests as the artefacts that stages take."""

from __future__ import annotations

from functools import cache

import numpy as np

from cellwright.cell.transforms import inverse, pose, quaternion_from_rotation
from schemas.cell_objects import packed_bodies
from schemas.part import PartMesh
from schemas.poses import Pose
from schemas.sources import CellModel
from schemas.views import Reachability, Viewpoints
from tests.cellwright.solvers import scanning_cell

T_WORLD_PART = pose(scanning_cell.PART_AT, np.eye(3))
PART_POSE = Pose.of(T_WORLD_PART)


@cache
def cell_model() -> CellModel:
    cell = scanning_cell.cell_without_part()
    chain = cell.robot.chain
    return CellModel(
        urdf=cell.robot.urdf,
        base_link=cell.robot.base_link,
        flange_link=cell.robot.flange_link,
        T_world_base=cell.T_world_base,
        T_flange_scanner=cell.T_flange_scanner,
        joint=cell.robot.joint_names,
        lower_rad=chain.lower,
        upper_rad=chain.upper,
        max_velocity_rad_s=chain.max_velocity,
        max_acceleration_rad_s2=chain.max_acceleration,
        start_rad=cell.start,
        ignored_pair=cell.ignored_pairs,
        ignored_reason=np.zeros(len(cell.ignored_pairs), np.int8),
        **packed_bodies(cell.bodies),
    )


@cache
def part_mesh() -> PartMesh:
    mesh = scanning_cell.part()
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(cross, axis=1)
    return PartMesh(
        vertices_m=mesh.vertices,
        faces=mesh.faces,
        normals=cross / doubled[:, None],
        areas_m2=doubled / 2,
        to_measure=np.ones(len(mesh.faces), bool),
        watertight=True,
        two_sided=False,
        finding=(),
    )


@cache
def viewpoints() -> Viewpoints:
    T = np.stack([inverse(T_WORLD_PART) @ sweep.T_world_scanner for sweep in scanning_cell.sweeps()])
    n = len(T)
    return Viewpoints(
        sample=np.arange(n, dtype=np.int32),
        position_m=T[:, :3, 3],
        quaternion=quaternion_from_rotation(T[:, :3, :3]),
        delta_rot_rad=np.zeros(n),
        theta_tilt_rad=np.zeros(n),
        psi_tilt_rad=np.zeros(n),
        standoff_m=np.full(n, scanning_cell.STANDOFF),
    )


@cache
def reachability() -> Reachability:
    rows = [(view, piece) for view, sweep in enumerate(scanning_cell.sweeps()) for piece in sweep.pieces]
    n = len(scanning_cell.sweeps())
    return Reachability(
        view=np.array([view for view, _ in rows], np.int32),
        branch=np.array([piece.branch for _, piece in rows], np.int8),
        start_m=np.array([piece.start for _, piece in rows]),
        end_m=np.array([piece.end for _, piece in rows]),
        q_start_rad=np.stack([piece.q_start for _, piece in rows]),
        outcome=np.zeros(n, np.int8),
        blocked_by=np.full(n, -1, np.int32),
        body=tuple(body.name for body in scanning_cell.cell().bodies),
    )
