"""Triangle meshes that contain a simple shape: for fits that must hold the real body, not a polyhedron inscribed in it.

Boxes are exact. Round shapes become circumscribed polyhedra: every face touches the shape or stays clear of it, and the
corners stand out by about 1 % of the radius.
"""

from __future__ import annotations

import math

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.parametric_parts import box, prism

_SECTIONS = 32
_ROUNDING = 1.0 + 1e-12


def enclosing_mesh(shape: Shape) -> Mesh:
    """Return a closed mesh, vertices in m in the body's frame, that contains a shape; a mesh is returned as it is."""
    match shape:
        case Mesh():
            return shape
        case Box(size):
            solid = box(size)
            return _moved(solid, -0.5 * size[2])
        case Cylinder(radius, length):
            angle = 2.0 * math.pi * np.arange(_SECTIONS) / _SECTIONS
            outline = (
                radius / math.cos(math.pi / _SECTIONS) * _ROUNDING * np.column_stack([np.cos(angle), np.sin(angle)])
            )
            return _moved(prism(outline, length), -0.5 * length)
        case Sphere(radius):
            return _hull(radius * _ball())
        case Capsule(radius, length):
            up = np.array([0.0, 0.0, 0.5 * length])
            return _hull(np.concatenate([radius * _ball() - up, radius * _ball() + up]))


def _moved(mesh: Mesh, z: float) -> Mesh:
    return Mesh(mesh.vertices + np.array([0.0, 0.0, z]), mesh.faces)


def _ball() -> FloatArray:
    """Return the corners of a polyhedron that contains the unit ball, (n, 3)."""
    from scipy.spatial import ConvexHull

    rings = math.pi * (np.arange(_SECTIONS // 2) + 0.5) / (_SECTIONS // 2)
    angle = 2.0 * math.pi * np.arange(_SECTIONS) / _SECTIONS
    around = np.stack([np.outer(np.sin(rings), np.cos(angle)), np.outer(np.sin(rings), np.sin(angle))], axis=-1)
    points = np.concatenate(
        [around, np.broadcast_to(np.cos(rings)[:, None, None], (len(rings), _SECTIONS, 1))], axis=-1
    )
    corners = points.reshape(-1, 3)
    # how far the nearest face is from the middle
    return np.asarray(corners / (-ConvexHull(corners).equations[:, 3]).min() * _ROUNDING)


def _hull(points: FloatArray) -> Mesh:
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(points, np.ascontiguousarray(faces, np.int32))
