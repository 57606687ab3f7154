"""A cell as pictures of it need it: every body's triangles in the world, its role, and what sets the frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.cell.bodies import BASE, WORLD
from cellwright.cell.cell import PART, Cell
from cellwright.cell.scanner import Scanner
from cellwright.cell.tessellation import triangles_of
from cellwright.cell.transforms import apply
from cellwright.cell.urdf_tree import parse_urdf

ROBOT, SCANNER, PART_ROLE, STANDING = "robot", "scanner", "part", "standing body"
COLOURS = {ROBOT: "#8fa3b8", SCANNER: "#d98a4b", PART_ROLE: "#3f8f74", STANDING: "#b9a88c"}
"""One colour a role."""
_LARGE = 1.0
"""Bodies longer than this many diagonals of robot and part set no frame."""
_FAR = 1.5
"""Bodies whose middle is farther from robot and part than this many diagonals set no frame."""


@dataclass(frozen=True, eq=False)
class Solids:
    """Bodies as triangles in the world: vertices (n, 3) in m, faces (m, 3), and the row of each face's body (m,)."""

    vertices: FloatArray
    faces: IntArray
    body: IntArray


@dataclass(frozen=True, eq=False)
class Layout:
    """A cell ready to be drawn: each body's role and corners in the world, which are large, and the frame (2, 3).

    ``framed`` (n, 3) are the points that pictures must hold: those of the bodies that set the frame, and the grid's.
    """

    names: tuple[str, ...]
    roles: tuple[str, ...]
    corners: tuple[FloatArray, ...]
    triangles: tuple[IntArray, ...]
    large: tuple[bool, ...]
    frame: FloatArray
    framed: FloatArray
    T_world_scanner: FloatArray
    parents: tuple[int, ...]
    n_joints: int

    def solids(self, large: bool) -> Solids:
        """Return the large bodies, or all others."""
        vertices, faces, rows, count = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)], 0
        for row, (corners, triangles) in enumerate(zip(self.corners, self.triangles)):
            if self.large[row] == large:
                vertices.append(corners)
                faces.append(triangles + count)
                rows.append(np.full(len(triangles), row))
                count += len(corners)
        return Solids(np.concatenate(vertices), np.concatenate(faces), np.concatenate(rows))


def laid_out(cell: Cell) -> Layout:
    T_base_link = cell.robot.link_poses(cell.start)
    links = parse_urdf(cell.robot.urdf).links.keys()
    roles, corners, triangles = [], [], []
    for body in cell.bodies:
        T_world_parent = np.eye(4) if body.parent == WORLD else cell.T_world_base @ T_base_link[body.parent]
        vertices, faces = triangles_of(body.shape)
        corners.append(apply(T_world_parent @ body.T_parent_body, vertices))
        triangles.append(faces)
        of_robot = body.parent >= BASE and (body.name in links or body.name.rpartition(".")[0] in links)
        standing = PART_ROLE if body.name == PART else STANDING
        roles.append(standing if body.parent == WORLD else ROBOT if of_robot else SCANNER)
    T_world_scanner = cell.T_world_base @ T_base_link[-1] @ cell.robot.chain.T_last_flange @ cell.T_flange_scanner
    names = tuple(body.name for body in cell.bodies)
    large, frame, framed = _framing(roles, corners, np.stack([cell.T_world_base[:3, 3], T_world_scanner[:3, 3]]))
    parents = tuple(body.parent for body in cell.bodies)
    return Layout(
        names, tuple(roles), tuple(corners), tuple(triangles), large, frame, framed, T_world_scanner, parents,
        cell.robot.n_joints,
    )  # fmt: skip


def _framing(
    roles: Sequence[str], corners: Sequence[FloatArray], always: FloatArray
) -> tuple[tuple[bool, ...], FloatArray, FloatArray]:
    """Return which bodies are large, the box (2, 3) around all others that are not far away, and the points in it."""
    own = np.concatenate([always, *(points for role, points in zip(roles, corners) if role != STANDING)])
    low, high = own.min(axis=0), own.max(axis=0)
    diagonal = max(float(np.linalg.norm(high - low)), 1e-6)
    large, framed = [], [own]
    for role, points in zip(roles, corners):
        box = np.stack([points.min(axis=0), points.max(axis=0)])
        too_large = role == STANDING and float((box[1] - box[0]).max()) > _LARGE * diagonal
        away = float(np.linalg.norm(np.maximum(0.0, np.maximum(low - box.mean(axis=0), box.mean(axis=0) - high))))
        large.append(too_large)
        if not too_large and away <= _FAR * diagonal:
            framed.append(points)
    together = np.concatenate(framed)
    frame = np.stack([together.min(axis=0), together.max(axis=0)])
    x, y = zip(*grid_box(frame))
    grid = np.array([(one, other, 0.0) for one in x for other in y])
    return tuple(large), frame, np.concatenate([together, grid])


def laser_fan(scanner: Scanner) -> FloatArray:
    """Return emitter, the ends of the nearest laser line, those of the farthest, and the detector, (6, 3)."""
    slope = math.tan(scanner.aperture / 2)
    near, far = scanner.min_standoff, scanner.max_standoff
    ends = [(0.0, side * slope * z, z) for z, side in ((near, -1), (near, 1), (far, -1), (far, 1))]
    return np.array([(0.0, 0.0, 0.0), *ends, (-scanner.emitter_detector_distance, 0.0, 0.0)])


def grid_step(frame: FloatArray) -> float:
    """Return the width of the grid in m: some eight lines, at round lengths."""
    wanted = float((frame[1] - frame[0])[:2].max()) / 6.0
    power = 10.0 ** math.floor(math.log10(max(wanted, 1e-6)))
    return float(next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= 0.999 * wanted))


def grid_box(frame: FloatArray) -> tuple[FloatArray, FloatArray]:
    step = grid_step(frame)
    return np.floor(frame[0, :2] / step) * step, np.ceil(frame[1, :2] / step) * step
