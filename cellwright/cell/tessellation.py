"""Any body as triangles: for pictures, recordings and engines that take meshes only.

Round shapes are inscribed polyhedra; they are for looking at, never for collision checks.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.bodies import Box, Capsule, Cylinder, Mesh, Shape, Sphere


def triangles_of(shape: Shape, sections: int = 24) -> tuple[FloatArray, IntArray]:
    """Return vertices (n, 3) in m in the body's frame and faces (m, 3) of a shape.

    ``sections`` is the number of sides of round shapes.
    """
    import trimesh

    if isinstance(shape, Mesh):
        return np.asarray(shape.vertices, float), np.asarray(shape.faces, np.int64)
    match shape:
        case Box(size):
            solid = trimesh.creation.box(extents=size)
        case Cylinder(radius, length):
            solid = trimesh.creation.cylinder(radius=radius, height=length, sections=sections)
        case Sphere(radius):
            solid = trimesh.creation.uv_sphere(radius=radius, count=[sections // 2, sections])
        case Capsule(radius, length):
            solid = trimesh.creation.capsule(height=length, radius=radius, count=[sections // 2, sections])
            solid.apply_translation([0.0, 0.0, -float(solid.bounds.mean(axis=0)[2])])
    return np.asarray(solid.vertices, float), np.asarray(solid.faces, np.int64)
