"""Follow every candidate sweep with the arm and keep the pieces that it can execute (Kaiser 2021, section 4.2).

Each view's useful interval plus a margin is cut into poses; all inverse kinematics branches are tested for joint
limits, collisions and continuity at the scanning speed. Views without an executable piece say why: the furthest test
that any branch reached, and for collisions the body that was in the way of most poses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.part import PartMesh
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage
from schemas.sweep_params import SweepParams
from schemas.views import Measurability, Reachability, Viewpoints

if TYPE_CHECKING:
    pass


@stage(version=2)
def follow_sweeps(
    cell: CellModel,
    mesh: PartMesh,
    viewpoints: Viewpoints,
    measurability: Measurability,
    *,
    params: SweepParams,
    progress: Progress = no_progress,
) -> Reachability:
    """Find the executable pieces of all views that measure a sample.

    Raises:
        InvalidInputError: If the inputs do not belong together, the arm has no inverse kinematics, or the start
            configuration collides.
    """
    from cellwright.cell.scene import Scene
    from cellwright.cell.start_check import check_start
    from cellwright.solvers.sweeps.following import follow_sweeps as follow
    from schemas.cell_objects import build_cell
    from schemas.reach_objects import reachability_of, sweeps_to_follow

    T_world_part = params.T_world_part.matrix()
    built = build_cell(cell, mesh, T_world_part)
    sweeps = sweeps_to_follow(viewpoints, measurability, T_world_part)
    scene = Scene(built, params.clearance_m)
    check_start(scene, params.clearance_m)  # said before the long search instead of after it
    followed = follow(
        built,
        sweeps,
        settings=params.settings(),
        exact=scene.collides,
        progress=progress,
    )
    return reachability_of(followed, tuple(body.name for body in built.bodies))
