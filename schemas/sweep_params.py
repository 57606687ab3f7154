"""Settings by which sweeps are followed and connected: of the stages that do so, and of those that try it elsewhere."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from schemas.params import Params
from schemas.poses import Pose

if TYPE_CHECKING:
    from cellwright.solvers.stitched_plan import StitchSettings
    from cellwright.solvers.sweeps.poses import FollowSettings


class SweepParams(Params):
    """Settings of the reachability stage."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    step_m: float = Field(default=0.005, gt=0, le=0.05, description="Largest distance of the checked poses on a sweep.")
    margin_m: float = Field(default=0.030, ge=0, description="Run-in and run-out beyond the outermost samples.")
    shortest_m: float = Field(default=0.050, gt=0, description="Shortest piece worth executing (paper: 50 mm).")
    scan_speed_m_s: float = Field(default=0.1, gt=0, description="Speed of the scanner on a sweep.")
    clearance_m: float = Field(default=0.005, ge=0, description="Distance kept between bodies.")
    max_exact_checks: int = Field(
        default=20_000,
        ge=0,
        description="Most states on which the exact collision engine is asked where the fast filter does not decide.",
    )

    def settings(self) -> FollowSettings:
        """Return the settings as the library takes them."""
        from cellwright.solvers.sweeps.poses import FollowSettings

        return FollowSettings(
            margin=self.margin_m,
            step=self.step_m,
            scan_speed=self.scan_speed_m_s,
            shortest=self.shortest_m,
            clearance=self.clearance_m,
            max_exact_checks=self.max_exact_checks,
        )


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
