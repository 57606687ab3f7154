"""Order the selected sweeps and connect them into one timed, collision-free plan (Kaiser 2021, section 4.4).

Connections come from one lazy probabilistic roadmap; the order is the paper's greedy one and, up to
``exact_up_to`` sweeps, the one proven shortest by dynamic programming on the same connection costs. Both are
stored with their durations, and with a lower bound. Everything is timed as fast as joints and scan speed allow.
A view that cannot be executed or connected is left out with its reason, so that others can be selected instead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas.motion import Trajectory
from schemas.part import PartMesh
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage
from schemas.sweep_params import StitchParams
from schemas.views import Reachability, Viewpoints, ViewSelection

if TYPE_CHECKING:
    pass


@stage(version=4)
def stitch_sweeps(
    cell: CellModel,
    mesh: PartMesh,
    viewpoints: Viewpoints,
    reachability: Reachability,
    selection: ViewSelection,
    earlier: Trajectory | None = None,
    *,
    params: StitchParams,
    progress: Progress = no_progress,
) -> Trajectory:
    """Plan the whole motion from the start configuration through the selected sweeps that can be executed.

    What ``earlier`` has left out or replaced counts as replaced, unless it is selected again.

    Raises:
        InvalidInputError: If nothing is selected, the start configuration collides or is beyond a joint limit, or
            ``method`` is ``exact`` and there are more sweeps than ``exact_up_to``.
        InfeasibleError: If fewer than ``min_sweeps`` can be executed and connected; it names views and reasons.
        SolverError: If ``method`` is ``exact`` and the order could not be proven shortest.
    """
    import numpy as np

    from cellwright.cell.motion_filter import FilteredScene
    from cellwright.cell.scene import Scene
    from cellwright.cell.start_check import check_start
    from cellwright.errors import InfeasibleError, InvalidInputError, listed
    from cellwright.solvers.stitching import stitch
    from schemas.cell_objects import build_cell
    from schemas.plan_objects import planned_sweeps, trajectory_of

    n_sweeps = len(selection.view)
    if n_sweeps == 0:
        raise InvalidInputError("no view is selected: there is nothing to stitch; look at the coverage's causes first")
    if params.method == "exact" and n_sweeps > params.exact_up_to:
        raise InvalidInputError(
            f"the exact order takes at most {params.exact_up_to} sweeps but {n_sweeps} are selected: use `method` "
            "best, or raise exact_up_to"
        )
    T_world_part = params.T_world_part.matrix()
    built = build_cell(cell, mesh, T_world_part)
    scene = Scene(built, params.clearance_m)
    beyond = np.maximum(cell.lower_rad - built.start, built.start - cell.upper_rad)
    if beyond.max() > 0.0:
        joint = int(np.argmax(beyond))
        raise InvalidInputError(
            f"the start configuration has joint {cell.joint[joint]} at {built.start[joint]:.4g} rad, outside its "
            f"limits {cell.lower_rad[joint]:.4g} to {cell.upper_rad[joint]:.4g} rad: choose another start_rad"
        )
    check_start(scene, params.clearance_m)
    settings = params.settings()
    plan = stitch(
        built,
        FilteredScene(scene),
        planned_sweeps(viewpoints, reachability, selection, T_world_part),
        settings=settings,
        method=params.method,
        rng=np.random.default_rng(params.seed),
        sweep_checker=FilteredScene(scene.with_clearance(settings.sweep_clearance)),
        progress=progress,
    )
    n_executed = n_sweeps - len(plan.left_out)
    if n_executed < params.min_sweeps:
        reasons = listed(f"view {selection.view[sweep.sweep]}: {sweep.reason}" for sweep in plan.left_out)
        raise InfeasibleError(
            f"{n_executed} of {n_sweeps} selected sweeps can be executed and connected, fewer than {params.min_sweeps} "
            f"({reasons}): raise roadmap_nodes or max_alternatives, lower clearance_m, choose another start_rad, or "
            "give the arm more room around the part"
        )
    return trajectory_of(plan, selection, earlier)
