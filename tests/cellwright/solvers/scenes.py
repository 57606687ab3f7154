"""Small scenes with known visibility, and the sensor model once more in plain numpy as an oracle."""

from __future__ import annotations

import numpy as np
import trimesh

from cellwright.arrays import BoolArray, FloatArray
from cellwright.causes import Cause
from cellwright.cell.bodies import Mesh
from cellwright.cell.occlusion import Occluder
from cellwright.cell.scanner import Scanner
from cellwright.solvers.measurability import Sweeps

SCANNER = Scanner(
    aperture=np.radians(31.0),
    min_standoff=0.127,
    best_standoff=0.182,
    max_standoff=0.227,
    emitter_detector_distance=0.076,
    uncertainty_constant=0.0,
    uncertainty_quadratic=40e-6 / 0.182**2,
    max_incidence=np.radians(75.0),
    profile_rate=100.0,
    points_per_profile=200,
)
DOWN = np.diag([1.0, -1.0, -1.0])
"""A scanner that looks down: x stays, y and z turn round."""


def mesh_of(*solids: trimesh.Trimesh) -> Mesh:
    solid = trimesh.util.concatenate(list(solids))
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int32))


def box(extents: tuple[float, float, float], centre: tuple[float, float, float]) -> trimesh.Trimesh:
    solid = trimesh.creation.box(extents=extents)
    solid.apply_translation(centre)
    return solid


def looking_down(*position: tuple[float, float, float]) -> Sweeps:
    return Sweeps.untrimmed(np.array(position), np.tile(DOWN, (len(position), 1, 1)))


def random_sweeps(n: int, size: float, rng: np.random.Generator) -> Sweeps:
    """Sweeps that look at a ball of radius ``size`` from all sides."""
    rotation = np.array([trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3] for _ in range(n)])
    aim = rng.normal(scale=size / 2, size=(n, 3))
    return Sweeps.untrimmed(aim - rng.uniform(0.13, 0.25, (n, 1)) * rotation[:, :, 2], rotation)


def crosses(start: FloatArray, end: FloatArray, triangles: FloatArray) -> bool:
    """Tell by brute force whether one segment, without its first billionth, meets one of the triangles."""
    along = end - start
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    p = np.cross(along, c - a)
    det = ((b - a) * p).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = ((start - a) * p).sum(-1) / det
        q = np.cross(start - a, b - a)
        v, t = (along * q).sum(-1) / det, ((c - a) * q).sum(-1) / det
        return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-8) & (t < 1)).any())


def judge(
    scanner: Scanner, u_max: float, mesh: Mesh, p: FloatArray, n: FloatArray, sweeps: Sweeps, view: int
) -> tuple[Cause, float, float]:
    """Return the test that stops one pair, its uncertainty and its travel: the definition, written down once more."""
    triangles = np.asarray(mesh.vertices)[mesh.faces]
    x, y, z = sweeps.rotation[view].T
    travel = float((p - sweeps.position[view]) @ x)
    emitter = sweeps.position[view] + travel * x
    detector = emitter - scanner.emitter_detector_distance * x
    across, standoff = (p - emitter) @ y, (p - emitter) @ z
    if not scanner.min_standoff <= standoff <= scanner.max_standoff:
        return Cause.FIELD_OF_VIEW, np.nan, travel
    if abs(np.arctan2(across, standoff)) > scanner.aperture / 2 or not (
        sweeps.start[view] <= travel <= sweeps.end[view]
    ):
        return Cause.FIELD_OF_VIEW, np.nan, travel
    incidence = [np.arccos(np.clip(n @ (eye - p) / np.linalg.norm(eye - p), -1, 1)) for eye in (emitter, detector)]
    if max(incidence) > scanner.max_incidence:
        return Cause.INCIDENCE, np.nan, travel
    uncertainty = (scanner.uncertainty_constant + scanner.uncertainty_quadratic * standoff**2) / np.cos(incidence[0])
    if uncertainty > u_max:
        return Cause.UNCERTAINTY, uncertainty, travel
    if crosses(p, emitter, triangles):
        return Cause.EMITTER_OCCLUDED, uncertainty, travel
    if crosses(p, detector, triangles):
        return Cause.DETECTOR_OCCLUDED, uncertainty, travel
    return Cause.NONE, uncertainty, travel


def samples_on(solid: trimesh.Trimesh, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    face = rng.choice(len(solid.faces), size=n, p=solid.area_faces / solid.area)
    points = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(3), size=n), solid.triangles[face])
    return points, np.asarray(solid.face_normals[face])


def occluder_of(*solids: trimesh.Trimesh) -> Occluder:
    return Occluder(mesh_of(*solids))


def seen(found_cause: FloatArray) -> BoolArray:
    return np.asarray(found_cause == Cause.NONE)
