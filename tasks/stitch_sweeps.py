"""Order the selected sweeps and connect them into one timed, collision-free plan (Kaiser 2021, section 4.4).

Connections come from one lazy probabilistic roadmap; the order is the paper's greedy one and, up to
``exact_up_to`` sweeps, the one proven shortest by dynamic programming on the same connection costs. Both are
stored with their durations, and with a lower bound. Everything is timed as fast as joints and scan speed allow.
A view that cannot be executed or connected is left out with its reason, so that others can be selected instead.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from schemas.motion import Trajectory
from schemas.params import Params
from schemas.part import PartMesh
from schemas.poses import Pose
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage
from schemas.views import Reachability, Viewpoints, ViewSelection

if TYPE_CHECKING:
    from cellwright.solvers.stitched_plan import StitchSettings


class StitchParams(Params):
    """Settings of the stitching stage; limits of the search for the best order take their defaults for `greedy`.

    That method searches only where going to the nearest next ends nowhere.
    """

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    method: Literal["best", "greedy", "exact"] = Field(
        default="best", description="The better of both orders, nearest next as in the paper, or dynamic programming."
    )
    exact_up_to: int = Field(default=15, ge=1, le=18, description="Most sweeps for dynamic programming.")
    max_alternatives: int = Field(default=8, ge=1, le=64, description="Branches and windings tried of each sweep.")
    max_connections: int = Field(default=1000, ge=1, description="Connections that the best order may evaluate.")
    roadmap_nodes: int = Field(
        default=1000, ge=0, le=100_000, description="Configurations that the roadmap starts with."
    )
    neighbours: int = Field(default=12, ge=1, le=200, description="Roadmap neighbours of a configuration.")
    step_rad: float = Field(
        default=math.radians(2.0), gt=0, le=0.2, description="Largest joint turn between checks while searching."
    )
    clearance_m: float = Field(
        default=0.005,
        ge=0,
        description="Distance kept between bodies on connections. Sweeps keep it at the poses at which they were "
        "followed, and it or 1 mm, the smaller, between those.",
    )
    scan_speed_m_s: float = Field(default=0.1, gt=0, description="Speed of the scanner on a sweep.")
    tool_acceleration_m_s2: float = Field(default=1.0, gt=0, description="Acceleration of the scanner on a sweep.")
    sample_s: float = Field(default=0.008, gt=0, le=0.1, description="Time between states.")
    return_to_start: bool = Field(default=False, description="Whether the plan ends in the start configuration.")
    min_sweeps: int = Field(default=1, ge=0, description="Fewest sweeps of a plan; a shorter one is an error.")
    seed: int = Field(default=0, ge=0, description="Seed of roadmap and shortening.")

    @model_validator(mode="after")
    def _only_what_applies(self) -> Self:
        for name in ("exact_up_to", "max_connections") if self.method == "greedy" else ():
            object.__setattr__(self, name, type(self).model_fields[name].default)  # frozen for everybody else
        return self

    def settings(self) -> StitchSettings:
        """Return the settings as the library takes them."""
        from cellwright.solvers.roadmap import RoadmapSize
        from cellwright.solvers.stitched_plan import StitchSettings

        return StitchSettings(
            scan_speed=self.scan_speed_m_s,
            tool_acceleration=self.tool_acceleration_m_s2,
            sample=self.sample_s,
            step=self.step_rad,
            sweep_clearance=min(self.clearance_m, StitchSettings.confirm_step),
            max_alternatives=self.max_alternatives,
            roadmap=RoadmapSize(
                n_nodes=self.roadmap_nodes,
                n_batch=max(100, self.roadmap_nodes // 2),
                n_most=4 * self.roadmap_nodes,
                n_neighbours=self.neighbours,
            ),
            exact_up_to=self.exact_up_to,
            n_evaluations=self.max_connections,
            returns=self.return_to_start,
        )


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
