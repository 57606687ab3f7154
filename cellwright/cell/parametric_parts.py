"""Parts made by code, for examples and tests: watertight meshes with a known shape, and their STL files."""

from __future__ import annotations

import numpy as np

from cellwright.arrays import AnyArray, FloatArray
from cellwright.cell.bodies import Mesh
from cellwright.errors import InvalidInputError


def grooved_cylinder(
    radius: float = 0.060,
    height: float = 0.2094,
    groove_depth: float = 0.020,
    groove_bottom: float = 0.075,
    lower_flank: float = 0.010,
    groove_floor: float = 0.020,
    upper_flank: float = 0.030,
    n_segments: int = 180,
) -> Mesh:
    """Build a standing cylinder with one dominant groove around it, its flanks differently inclined.

    It resembles the test part of Kaiser 2021, figure 5: about 0.1 m^2 of surface, of which 0.091 m^2 are measured
    when it stands on a table. The origin is the middle of the bottom, z is the axis.

    Args:
        radius: Radius, m.
        height: Height, m.
        groove_depth: Depth of the groove, m.
        groove_bottom: Height at which the groove begins, m.
        lower_flank: Height over which the lower flank goes in, m: the smaller, the more it looks up.
        groove_floor: Height of the floor between the flanks, m.
        upper_flank: Height over which the upper flank comes out, m.
        n_segments: Corners of the polygon that stands for the circle.

    Raises:
        InvalidInputError: If the groove does not fit into the cylinder.
    """
    top = groove_bottom + lower_flank + groove_floor + upper_flank
    if not (0 < groove_depth < radius and groove_bottom > 0 and top < height):
        raise InvalidInputError(
            f"a groove from {groove_bottom:g} to {top:g} m, {groove_depth:g} m deep, does not fit into a cylinder of "
            f"height {height:g} m and radius {radius:g} m: make it smaller"
        )
    inner = radius - groove_depth
    profile = [
        (radius, 0.0),
        (radius, groove_bottom),
        (inner, groove_bottom + lower_flank),
        (inner, groove_bottom + lower_flank + groove_floor),
        (radius, top),
        (radius, height),
    ]
    return revolve(np.array(profile), n_segments)


def revolve(profile: FloatArray, n_segments: int) -> Mesh:
    """Turn a profile (points, 2) of (radius, z), rising, about the z axis, and close it at both ends.

    Raises:
        InvalidInputError: If a radius is not positive or there are fewer than three segments.
    """
    if n_segments < 3 or len(profile) < 2 or (profile[:, 0] <= 0).any():
        raise InvalidInputError(f"cannot turn {len(profile)} points with {n_segments} segments: give positive radii")
    angle = 2 * np.pi * np.arange(n_segments) / n_segments
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)  # (segments, 2)
    rings = np.concatenate(
        [np.column_stack([radius * circle, np.full(n_segments, z)]) for radius, z in profile]
    )  # (points * segments, 3)
    bottom, top = len(rings), len(rings) + 1
    vertices = np.concatenate([rings, [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]])
    here = np.arange(n_segments)
    beside = (here + 1) % n_segments
    last = (len(profile) - 1) * n_segments
    faces = [np.stack([np.full(n_segments, bottom), beside, here], axis=1)]
    for level in range(len(profile) - 1):
        low, high = level * n_segments, (level + 1) * n_segments
        faces.append(np.stack([low + here, low + beside, high + beside], axis=1))
        faces.append(np.stack([low + here, high + beside, high + here], axis=1))
    faces.append(np.stack([np.full(n_segments, top), last + here, last + beside], axis=1))
    return Mesh(vertices, np.concatenate(faces).astype(np.int32))


def box(size: tuple[float, float, float]) -> Mesh:
    """Build a box with edge lengths ``size`` in m, its bottom on z = 0, centred in x and y."""
    return prism(_rectangle(size[0], size[1]), size[2])


def prism(outline: FloatArray, height: float) -> Mesh:
    """Build a prism over a convex outline (corners, 2), counter-clockwise, in m, from z = 0 to ``height``."""
    n = len(outline)
    vertices = np.concatenate([np.column_stack([outline, np.zeros(n)]), np.column_stack([outline, np.full(n, height)])])
    return Mesh(vertices, _faces([*_fan(range(n))[:, ::-1].tolist(), *_fan(range(n, 2 * n)).tolist(), *_wall(0, n, n)]))


def plate_with_pocket(
    size: tuple[float, float, float] = (0.12, 0.08, 0.02),
    pocket: tuple[float, float, float] = (0.06, 0.04, 0.012),
) -> Mesh:
    """Build a plate with a rectangular pocket in the middle of its top; sizes in m, the bottom on z = 0.

    Raises:
        InvalidInputError: If the pocket does not fit into the plate.
    """
    if not all(0 < inner < outer for inner, outer in zip(pocket, size)):
        raise InvalidInputError(f"a pocket of {pocket} m does not fit into a plate of {size} m: make it smaller")
    outer, inner = _rectangle(size[0], size[1]), _rectangle(pocket[0], pocket[1])
    heights = (0.0, size[2], size[2], size[2] - pocket[2])
    vertices = np.concatenate(
        [np.column_stack([ring, np.full(4, z)]) for ring, z in zip((outer, outer, inner, inner), heights)]
    )
    # walls run from ring to ring: outside up, over the rim, and down into the pocket
    walls = [*_wall(0, 4, 4), *_wall(4, 8, 4), *_wall(8, 12, 4)]
    return Mesh(vertices, _faces([*_fan(range(4))[:, ::-1].tolist(), *walls, *_fan(range(12, 16)).tolist()]))


def panel_height(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the height of the upper side of `floor_panel` above its floor at ``x``, ``y`` in m."""
    tunnel = 0.20 * np.exp(-((y / 0.17) ** 4))
    sills = 0.18 * _step((np.abs(y) - 0.86) / 0.12)
    fire_wall = 0.34 * _step((x - 1.10) / 0.22)
    return np.asarray(np.maximum(np.maximum(tunnel, sills), fire_wall))


def floor_panel(n_along: int = 21, n_across: int = 31, thickness: float = 0.012) -> Mesh:
    """Build a piece of floor as in a car body: a tunnel in the middle, sills at the sides, a wall rising at the end.

    It lies on the xy plane, x from 0 to 1.4 m along the tunnel, y from -1.05 to 1.05 m; see `panel_height`.

    Args:
        n_along, n_across: Grid lines along x and y.
        thickness: Thickness, measured upright, m.

    Raises:
        InvalidInputError: If there are fewer than two grid lines or the sheet has no thickness.
    """
    if min(n_along, n_across) < 2 or thickness <= 0.0:
        raise InvalidInputError(
            f"a grid of {n_along} x {n_across} lines and a thickness of {thickness:g} m make no panel: give at least "
            "two lines each way and a positive thickness"
        )
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(0.0, 1.4, n_along), np.linspace(-1.05, 1.05, n_across)))
    z = panel_height(x, y)
    vertices = np.concatenate([np.column_stack([x, y, z]), np.column_stack([x, y, z - thickness])])
    grid = np.arange(n_along * n_across).reshape(n_across, n_along)
    a, b, c, d = (each.ravel() for each in (grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]))
    top = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    below = grid.size
    rim = np.concatenate([grid[0, :-1], grid[:-1, -1], grid[-1, :0:-1], grid[:0:-1, 0]])  # counter-clockwise from above
    beside = np.roll(rim, -1)
    wall = [np.stack([below + rim, below + beside, beside], axis=1), np.stack([below + rim, beside, rim], axis=1)]
    return Mesh(vertices, np.concatenate([top, below + top[:, ::-1], *wall]).astype(np.int32))


def _step(u: FloatArray) -> FloatArray:
    """Return the smooth step from 0 at ``u`` = 0 to 1 at 1."""
    u = np.clip(u, 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def stl_bytes(mesh: Mesh, metres_per_unit: float = 1e-3) -> bytes:
    """Write a mesh as binary STL, by default in mm."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = mesh.vertices[mesh.faces] / metres_per_unit
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    rows = np.zeros(len(triangles), record)
    rows["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    rows["corners"] = triangles
    return b"cellwright".ljust(80) + len(rows).to_bytes(4, "little") + rows.tobytes()


def _rectangle(x: float, y: float) -> FloatArray:
    return np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2


def _fan(ring: range) -> AnyArray:
    return np.array([[ring[0], ring[k], ring[k + 1]] for k in range(1, len(ring) - 1)])


def _wall(low: int, high: int, n: int) -> list[list[int]]:
    quads = [(low + k, low + (k + 1) % n, high + (k + 1) % n, high + k) for k in range(n)]
    return [triangle for a, b, c, d in quads for triangle in ([a, b, c], [a, c, d])]


def _faces(rows: list[list[int]]) -> AnyArray:
    return np.array(rows, dtype=np.int32)
