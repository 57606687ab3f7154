"""A plate with a block on it, as artefacts: sweeps that look down on it and what could be executed of them."""

from __future__ import annotations

import numpy as np
import trimesh

from cellwright.arrays import FloatArray
from cellwright.cell.transforms import quaternion_from_rotation
from schemas.motion import ScanCloud
from schemas.part import PartMesh, SurfaceSamples, Surroundings
from schemas.views import Reachability, Viewpoints, ViewSelection

DOWN = np.diag([1.0, -1.0, -1.0])


def plate(*, two_sided: bool = False) -> PartMesh:
    solid = trimesh.creation.box(extents=(0.4, 0.4, 0.02))
    solid.apply_translation([0.0, 0.0, -0.01])
    return PartMesh(
        vertices_m=np.asarray(solid.vertices, float),
        faces=np.asarray(solid.faces, np.int32),
        normals=np.asarray(solid.face_normals, float),
        areas_m2=np.asarray(solid.area_faces, float),
        to_measure=np.ones(len(solid.faces), bool),
        watertight=True,
        two_sided=two_sided,
        finding=(),
    )


def nothing_around() -> Surroundings:
    return Surroundings(np.empty((0, 3)), np.empty((0, 3), np.int32))


def screen_above(height: float) -> Surroundings:
    """A square 0.2 m wide sheet above the middle of the plate."""
    corners = [[-0.1, -0.1, height], [0.1, -0.1, height], [0.1, 0.1, height], [-0.1, 0.1, height]]
    return Surroundings(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def points_on_top(*xy: tuple[float, float]) -> SurfaceSamples:
    mesh = plate()
    points = np.array([(x, y, 0.0) for x, y in xy]).reshape(-1, 3)
    top = int(np.argmax(mesh.normals[:, 2]))
    return SurfaceSamples(
        points_m=points,
        normals=np.tile([0.0, 0.0, 1.0], (len(points), 1)),
        face=np.full(len(points), top, np.int32),
        method="random",
        density_per_m2=1.0,
        area_m2=0.16,
    )


def views_down(*xy: tuple[float, float]) -> Viewpoints:
    """Sweeps along x at the best standoff; each lights a stripe of about 0.1 m in y."""
    n = len(xy)
    return Viewpoints(
        sample=np.zeros(n, np.int32),
        position_m=np.array([(x, y, 0.182) for x, y in xy]),
        quaternion=np.tile(quaternion_from_rotation(DOWN), (n, 1)),
        delta_rot_rad=np.zeros(n),
        theta_tilt_rad=np.zeros(n),
        psi_tilt_rad=np.zeros(n),
        standoff_m=np.full(n, 0.182),
    )


def reached(
    n_views: int, *pieces: tuple[int, float, float], outcome: tuple[int, ...] = (), blocked_by: tuple[int, ...] = ()
) -> Reachability:
    rows = np.array(pieces, float).reshape(-1, 3)
    return Reachability(
        view=rows[:, 0].astype(np.int32),
        branch=np.zeros(len(rows), np.int8),
        start_m=rows[:, 1],
        end_m=rows[:, 2],
        q_start_rad=np.zeros((len(rows), 6)),
        outcome=np.array(outcome or [0] * n_views, np.int8),
        blocked_by=np.array(blocked_by or [-1] * n_views, np.int32),
        body=("table", "part"),
    )


def selected(*views: int, n_samples: int = 1) -> ViewSelection:
    n = len(views)
    return ViewSelection(
        view=np.array(views, np.int32),
        n_samples=np.ones(n, np.int32),
        n_only=np.zeros(n, np.int32),
        max_uncertainty_m=np.full(n, 4e-5),
        cause=np.zeros(n_samples, np.int8),
        greedy_view=np.array(views, np.int32),
        method="greedy",
        lower_bound=1.0,
        gap=0.0,
        proven=True,
        stopped_by="optimality",
    )


def scanned(points: FloatArray, uncertainty: float = 4e-5) -> ScanCloud:
    """A scan of these points (n, 3) of the top, from above."""
    top = points_on_top((0.0, 0.0)).face[0]
    return ScanCloud(
        points_m=points.astype(np.float32),
        uncertainty_m=np.full(len(points), uncertainty, np.float32),
        face=np.full(len(points), top, np.int32),
        profile=np.zeros(len(points), np.int32),
        time_s=np.zeros(1),
        position_m=np.array([[0.0, 0.0, 0.182]]),
        quaternion=quaternion_from_rotation(DOWN)[None],
        segment=np.zeros(1, np.int32),
    )
