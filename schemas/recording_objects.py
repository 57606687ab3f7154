"""What recordings share: moving frames over time, and all bodies of a cell as coloured triangles."""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any

import numpy as np

from cellwright.arrays import FloatArray, Int32Array, IntArray
from cellwright.cell.bodies import BASE, WORLD, Mesh
from cellwright.cell.cell import PART, Cell
from cellwright.cell.transforms import quaternion_from_rotation

_COLOURS = {
    "part": (0.72, 0.76, 0.80, 1.0),
    "robot": (0.55, 0.63, 0.71, 1.0),
    "tool": (0.88, 0.48, 0.12, 1.0),
    "world": (0.80, 0.78, 0.74, 0.85),
}


def link_names(n_joints: int) -> list[str]:
    """Return the names of the frames of the moving links."""
    return [f"link_{joint}" for joint in range(1, n_joints + 1)]


def carriers(n_joints: int) -> dict[int, str]:
    """Return the frame that carries bodies, by their parent."""
    return {WORLD: "world", BASE: "base", **{row + 1: link for row, link in enumerate(link_names(n_joints))}}


def pose_columns(
    cell: Cell,
    time_s: FloatArray,
    position_rad: FloatArray,
    fixed: Sequence[tuple[int, FloatArray]],
    first_link: int,
    rate_hz: float,
) -> dict[str, Any]:
    """Return the columns of poses: fixed frames (row, pose) and the links in the base, all of them at every tick.

    The fixed ones too, because a viewer that jumps into the plan reads the last message before that moment only.
    ``first_link`` is the row of the first link's frame; times (states,) in s, positions (states, joints) in rad.
    """
    n_joints, end = cell.robot.n_joints, float(time_s[-1])
    # the last state is always there, and never a rounding error after a tick
    ticks = np.append(np.arange(np.ceil(end * rate_hz - 1e-6)) / rate_hz, end)
    q = np.stack([np.interp(ticks, time_s, position_rad[:, joint]) for joint in range(n_joints)], axis=1)
    T_base_link = np.stack([cell.robot.link_poses(row)[1:] for row in q])  # (ticks, joints, 4, 4)
    T_fixed = np.broadcast_to(np.stack([T for _, T in fixed]), (len(ticks), len(fixed), 4, 4))
    poses = np.concatenate([T_fixed, T_base_link], axis=1).reshape(-1, 4, 4)
    rows = [*(row for row, _ in fixed), *range(first_link, first_link + n_joints)]
    return {
        "pose_time_ns": np.repeat(nanoseconds(ticks), len(rows)),
        "pose_frame": np.tile(np.array(rows, np.int32), len(ticks)),
        "pose_position_m": poses[:, :3, 3],
        "pose_quaternion": quaternion_from_rotation(poses[:, :3, :3]),
    }


def nanoseconds(time_s: FloatArray) -> IntArray:
    """Return times in whole nanoseconds."""
    return np.round(time_s * 1e9).astype(np.int64)


def entity_columns(cell: Cell) -> dict[str, Any]:
    """Return the columns of all bodies as triangles in the frame that carries them; the part stays in its own."""
    colours, first, count, triangles = _entities(cell)
    of_parent = carriers(cell.robot.n_joints)
    return {
        "entity": tuple(body.name for body in cell.bodies),
        "entity_frame": tuple(PART if body.name == PART else of_parent[body.parent] for body in cell.bodies),
        "entity_colour": colours,
        "entity_first_face": first,
        "entity_n_faces": count,
        "triangle_m": triangles,
    }


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
