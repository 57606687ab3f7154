"""What stands in the way of a line of sight: segments and rays against triangle meshes, in double precision.

Touching counts as blocked; see `cellwright.cell.bounding_volumes` for why no ray slips between two faces. A line of
sight that begins on a surface must not be blocked by that surface: the first and last `CONTACT` of the scene's
diagonal are left open. A sample lies off its own face by rounding only, at most about 16 ulp of its coordinates, so
seen at 75 degrees from the normal or less the face is met within 1.4e-14 extents; `CONTACT` keeps a margin of more
than 1e4 over that for parts that stand within 100 of their own sizes from the origin, and is a nanometre on a part of
one metre: no real obstacle is as thin, or as near, unseen.
"""

from __future__ import annotations

from functools import partial

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.cell.bodies import Mesh
from cellwright.cell.bounding_volumes import MISS, TriangleTree, build_tree, trace_rays
from cellwright.errors import InvalidInputError
from cellwright.threads import map_slices

CONTACT = 1e-9
"""Share of the scene's diagonal next to both ends of a line of sight that cannot block it."""
_RAYS_AT_ONCE = 8192


class Occluder:
    """Triangle meshes, in one frame, that block lines of sight.

    Attributes:
        tree: The hierarchy over all triangles.
        n_faces: Triangles of all meshes together.
        contact: Length next to both ends of a segment that cannot block it, in m.
    """

    def __init__(self, *meshes: Mesh) -> None:
        """Build the hierarchy; faces are numbered through the meshes in the order given.

        Raises:
            InvalidInputError: If a vertex is not finite or a face names a vertex that is not there.
        """
        offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        for mesh in meshes:
            _check(mesh)
        vertices = np.concatenate([np.empty((0, 3)), *(np.asarray(mesh.vertices, float) for mesh in meshes)])
        faces = np.concatenate(
            [
                np.empty((0, 3), np.int64),
                *(np.asarray(mesh.faces, np.int64) + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)),
            ]
        )
        self.n_faces = len(faces)
        used = vertices[np.unique(faces)]
        diagonal = float(np.linalg.norm(np.ptp(used, axis=0))) if len(used) else 0.0
        self.contact = CONTACT * diagonal
        self.tree: TriangleTree = build_tree(vertices, faces)

    def blocked(self, origins: FloatArray, targets: FloatArray, *, n_threads: int | None = None) -> BoolArray:
        """Tell which segments meet a face between their ends.

        Args:
            origins, targets: Ends of the segments, (segments, 3) in m; they may lie on faces.
            n_threads: Threads; ``None`` takes the cores that the process may use.

        Returns:
            (segments,), False where both ends coincide.
        """
        starts, ends = np.broadcast_arrays(np.asarray(origins, float), np.asarray(targets, float))
        work = partial(_blocked_slice, self.tree, self.contact, starts, ends)
        found = list(map_slices(work, len(starts), _RAYS_AT_ONCE, n_threads=n_threads))
        return np.concatenate([np.empty(0, bool), *found])

    def first_hit(
        self, origins: FloatArray, directions: FloatArray, *, n_threads: int | None = None
    ) -> tuple[FloatArray, Int32Array]:
        """Find the first face on each ray.

        Args:
            origins: (rays, 3) in m.
            directions: (rays, 3), of any length but zero.
            n_threads: Threads; ``None`` takes the cores that the process may use.

        Returns:
            Distance in m, infinite on a miss, (rays,); face, -1 on a miss, (rays,).

        Raises:
            InvalidInputError: If a direction is zero or not finite.
        """
        starts, along = np.broadcast_arrays(np.asarray(origins, float), np.asarray(directions, float))
        lengths = np.linalg.norm(along, axis=-1, keepdims=True)
        if not (np.isfinite(lengths).all() and (lengths > 0).all()):
            raise InvalidInputError("a ray has no direction: its direction is zero or not a number")
        work = partial(_first_hit_slice, self.tree, starts, along / lengths)
        found = list(map_slices(work, len(starts), _RAYS_AT_ONCE, n_threads=n_threads))
        distance = np.concatenate([np.empty(0), *(pair[0] for pair in found)])
        face = np.concatenate([np.empty(0, np.int32), *(pair[1] for pair in found)])
        return distance, face


def _check(mesh: Mesh) -> None:
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if not np.isfinite(vertices).all():
        raise InvalidInputError(f"{(~np.isfinite(vertices)).any(axis=1).sum()} vertices are not finite: mend the mesh")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise InvalidInputError(
            f"a face names vertex {faces.max() if faces.min() >= 0 else faces.min()} of {len(vertices)}: mend the mesh"
        )


def _blocked_slice(
    tree: TriangleTree, contact: float, origins: FloatArray, targets: FloatArray, rows: slice
) -> BoolArray:
    starts = np.ascontiguousarray(origins[rows])
    along = targets[rows] - starts
    near, far, hit = np.empty(len(starts)), np.empty(len(starts)), np.empty(len(starts), np.int32)
    trace_segments(tree, contact, len(starts), starts, along, near, far, hit)
    return np.asarray(hit != MISS)


def _first_hit_slice(
    tree: TriangleTree, origins: FloatArray, directions: FloatArray, rows: slice
) -> tuple[FloatArray, Int32Array]:
    n_rays = rows.stop - rows.start
    near, far, hit = np.zeros(n_rays), np.full(n_rays, np.inf), np.empty(n_rays, np.int32)
    starts, along = np.ascontiguousarray(origins[rows]), np.ascontiguousarray(directions[rows])
    trace_rays(tree, n_rays, starts, along, near, far, False, hit)
    face = np.full(n_rays, MISS, np.int32)
    met = hit != MISS
    face[met] = tree.face[hit[met]]
    return far, face


@numba.njit(cache=True, nogil=True, error_model="numpy")
def trace_segments(tree, contact, n_segments, starts, along, near, far, hit):  # type: ignore[no-untyped-def]
    """Find out which of the first ``n_segments`` segments meet a face between their ends.

    Args:
        tree: `TriangleTree`.
        contact: Length next to both ends that cannot block, m.
        n_segments: Segments to follow.
        starts, along: One end, and the way to the other, (segments, 3) in m.
        near, far: Scratch, (segments,).
        hit: Overwritten by `MISS` for a free segment, (segments,).
    """
    for i in range(n_segments):
        length = np.sqrt(along[i, 0] * along[i, 0] + along[i, 1] * along[i, 1] + along[i, 2] * along[i, 2])
        # a segment shorter than both contacts is free: the open interval is empty
        near[i] = min(contact / length, 0.5) if length > 0 else 0.5
        far[i] = 1.0 - near[i]
    trace_rays(tree, n_segments, starts, along, near, far, True, hit)
