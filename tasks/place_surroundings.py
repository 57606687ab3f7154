"""Place what stands around the part into the part's frame: what may block the scanner's sight, whatever the arm does.

Bodies that stand in the world and those fixed to the robot's base are taken; the moving arm is left to the collision
checks. Round bodies are inscribed polyhedra, less than 1 % of their radius too thin.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from schemas.params import Params
from schemas.part import Surroundings
from schemas.poses import Pose
from schemas.sources import CellModel
from schemas.stage import stage


class SurroundingsParams(Params):
    """Where the part stands."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")


@stage(version=1)
def place_surroundings(cell: CellModel, *, params: SurroundingsParams) -> Surroundings:
    """Return all bodies of the cell that stand still, as triangles in the frame `part`."""
    from cellwright.cell.bodies import BASE, WORLD
    from cellwright.cell.tessellation import triangles_of
    from cellwright.cell.transforms import apply, inverse
    from schemas.cell_objects import build_cell

    built = build_cell(cell)
    T_part_world = inverse(params.T_world_part.matrix())
    carriers = {WORLD: T_part_world, BASE: T_part_world @ built.T_world_base}
    vertices, faces, n_vertices = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
    for body in built.bodies:
        if body.parent in carriers:
            points, triangles = triangles_of(body.shape)
            vertices.append(apply(carriers[body.parent] @ body.T_parent_body, points))
            faces.append(triangles + n_vertices)
            n_vertices += len(points)
    return Surroundings(vertices_m=np.concatenate(vertices), faces=np.concatenate(faces).astype(np.int32))
