"""The planner's settings in a cell file: one section a question.

Defaults are those of Kaiser 2021, Table 2, where it has one.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from cellwright import quantities
from schemas.cell_file_fields import (
    Acceleration,
    AcuteAngle,
    Angle,
    Density,
    DensityFactor,
    Duration,
    NonNegativeLength,
    PositiveLength,
    PositiveUncertainty,
    Quantity,
    Section,
    Share,
    SmallAngle,
    Speed,
    Text,
    Tilt,
    WholeNumber,
    Work,
    fault,
)
from schemas.scanner import ScannerParams

_STANDOFF_WORDS = ("min", "best", "max")
_STANDOFF = Quantity(quantities.LENGTH, above=0.0)


def _standoff(value: object) -> object:
    if isinstance(value, str) and value in _STANDOFF_WORDS:
        return value
    if isinstance(value, str) and value.isalpha():
        raise fault(f"{value!r} is not a standoff: write min, best, max or a length like 182 mm")
    return _STANDOFF.read(value)


Standoff = Annotated[float | Literal["min", "best", "max"], BeforeValidator(_standoff)]


class SamplingSection(Section):
    """Where is the surface sampled?"""

    density_per_m2: Density = Field(
        default=0.005e6, alias="density", description="Samples on an area, at least 50 in all."
    )
    method: Literal["blue-noise", "random"] = Field(
        default="blue-noise", description="Evenly spaced samples, or independent ones as in the paper."
    )
    critical_angle_rad: AcuteAngle = Field(
        default=math.radians(20.0),
        alias="critical_angle",
        description="Faces turned to the table within this angle are not measured (paper: Θ = 20 deg).",
    )


class RefinementSection(Section):
    """How are gaps between the samples found and closed while planning?"""

    density_factor: DensityFactor = Field(
        default=10.0, description="Density of the refinement cloud over that of the samples."
    )
    rounds: WholeNumber = Field(
        default=3, ge=0, le=20, description="Most rounds of adding missed points; 0 turns it off."
    )


class VerificationCloudSection(Section):
    """On which points is the coverage measured in the end?"""

    density_factor: DensityFactor = Field(
        default=10.0, description="Density of the verification cloud, which no planning step sees."
    )


class ViewpointsSection(Section):
    """From which directions may each sample be looked at? All combinations are candidates."""

    delta_rot_rad: tuple[Angle, ...] = Field(
        default=(0.0, math.radians(120.0), math.radians(240.0)),
        alias="delta_rot",
        min_length=1,
        max_length=360,
        description="Rotations about the viewing axis.",
    )
    theta_tilt_rad: tuple[Tilt, ...] = Field(
        default=(math.radians(-45.0), 0.0, math.radians(45.0)),
        alias="theta_tilt",
        min_length=1,
        max_length=180,
        description="Tilts about the scanner's x axis, in the plane of the laser fan.",
    )
    psi_tilt_rad: tuple[Tilt, ...] = Field(
        default=(math.radians(-45.0), 0.0, math.radians(45.0)),
        alias="psi_tilt",
        min_length=1,
        max_length=180,
        description="Tilts about the scanner's y axis, across the laser fan.",
    )
    standoffs: tuple[Standoff, ...] = Field(
        default=("best",), min_length=1, max_length=20, description="Distances: `min`, `best`, `max` or lengths."
    )

    def standoffs_m(self, scanner: ScannerParams) -> tuple[float, ...]:
        """Return the standoffs in m, with the words replaced by the scanner's own."""
        words = {"min": scanner.min_standoff_m, "best": scanner.best_standoff_m, "max": scanner.max_standoff_m}
        return tuple(words[item] if isinstance(item, str) else item for item in self.standoffs)


class MeasurabilitySection(Section):
    """When does a sample count as measured?"""

    max_uncertainty_m: PositiveUncertainty = Field(
        default=100e-6, alias="max_uncertainty", description="Largest permitted uncertainty (paper: 100 um)."
    )


class ReachabilitySection(Section):
    """Which parts of the candidate sweeps can the robot execute?"""

    step_m: Annotated[float, Quantity(quantities.LENGTH, least=1e-4, most=0.05)] = Field(
        default=0.005, alias="step", description="Largest distance of the checked poses on a sweep."
    )
    margin_m: Annotated[float, Quantity(quantities.LENGTH, least=0.0, most=5.0)] = Field(
        default=0.030, alias="margin", description="Run-in and run-out beyond the outermost measured samples."
    )
    shortest_m: PositiveLength = Field(
        default=0.050, alias="shortest", description="Shortest piece worth executing (paper: 50 mm)."
    )
    scan_speed_m_s: Speed = Field(default=0.1, alias="scan_speed", description="Speed of the scanner on a sweep.")
    clearance_m: NonNegativeLength = Field(
        default=0.005,
        alias="clearance",
        description="Distance kept between bodies at the checked poses of a sweep and on connections; between those "
        "poses at least 1 mm, or the clearance if that is less.",
    )


class SelectionSection(Section):
    """Which few sweeps are executed?"""

    min_coverage: Share = Field(default=1.0, description="Share of the coverable samples to measure.")
    method: Literal["best", "greedy", "exact"] = Field(
        default="best",
        description="Own search with branch and bound, the paper's greedy, or the integer program by HiGHS.",
    )
    max_work: Work = Field(default=6e9, description="Work of `best`: matrix entries visited, about a nanosecond each.")
    node_limit: WholeNumber | None = Field(
        default=None,
        ge=1,
        le=10**9,
        description="Most nodes of branch and bound; if left out `exact` takes 1000, or its time limit.",
    )
    time_limit_s: Duration | None = Field(
        default=None,
        alias="time_limit",
        description="Time limit of `exact` alone; where it strikes, the result is the machine's.",
    )

    @model_validator(mode="after")
    def _a_clock_for_exact_alone(self) -> Self:
        if self.time_limit_s is not None and self.method != "exact":
            raise fault(
                f"time_limit is {self.time_limit_s:g} s but method {self.method} reads no clock: remove it, or write "
                "method: exact"
            )
        return self


class StitchingSection(Section):
    """In which order, and how, are the sweeps connected?"""

    method: Literal["best", "greedy", "exact"] = Field(
        default="best",
        description="Order: the best found, nearest next as in the paper, or proven shortest else an error.",
    )
    exact_up_to: WholeNumber = Field(default=15, ge=1, le=18, description="Most sweeps for the exact order.")
    max_connections: WholeNumber = Field(
        default=1000, ge=1, le=1_000_000, description="Connections that the search for the best order may evaluate."
    )
    roadmap_nodes: WholeNumber = Field(default=1000, ge=0, le=100_000, description="Configurations in the roadmap.")
    neighbours: WholeNumber = Field(default=12, ge=1, le=200, description="Roadmap neighbours of a configuration.")
    max_alternatives: WholeNumber = Field(
        default=8, ge=1, le=64, description="Branches and windings tried of each sweep."
    )
    step_rad: SmallAngle = Field(
        default=math.radians(2.0), alias="step", description="Largest joint step between collision checks."
    )
    tool_acceleration_m_s2: Acceleration = Field(
        default=1.0, alias="tool_acceleration", description="Acceleration of the scanner on a sweep."
    )
    return_to_start: bool = Field(default=False, description="Whether the plan ends in the start configuration.")


class HullsSection(Section):
    """With how many spheres are bodies covered where a layout is optimised? Nothing else uses them."""

    part_spheres: WholeNumber = Field(default=20, ge=1, le=200, description="Spheres of the part.")
    body_spheres: WholeNumber = Field(
        default=6, ge=1, le=200, description="Spheres of each link, of the scanner's housing and of each other body."
    )


class ScanSection(Section):
    """How is the scan simulated and its coverage counted?"""

    noise: bool = Field(default=False, description="Whether points scatter by their predicted uncertainty.")
    coverage_radius_m: PositiveLength = Field(
        default=0.002, alias="coverage_radius", description="A point is covered with a scan point this close."
    )


class ReportSection(Section):
    """What does the report say on its cover?"""

    title: Text | None = Field(default=None, description="Title; the cell's name if left out.")
    notes: Text | None = Field(default=None, description="A remark shown below the title.")


class PlannerSection(Section):
    """All settings of the planner."""

    seed: WholeNumber = Field(
        default=0, ge=0, le=2**63 - 1, description="Seed of samples and clouds, selection, roadmap and noise."
    )
    sampling: SamplingSection = Field(default=SamplingSection(), description="Where the surface is sampled.")
    refinement: RefinementSection = Field(default=RefinementSection(), description="How gaps are closed.")
    verification_cloud: VerificationCloudSection = Field(
        default=VerificationCloudSection(), description="Where coverage is measured."
    )
    viewpoints: ViewpointsSection = Field(default=ViewpointsSection(), description="Candidate views of a sample.")
    measurability: MeasurabilitySection = Field(default=MeasurabilitySection(), description="What counts as measured.")
    reachability: ReachabilitySection = Field(default=ReachabilitySection(), description="What the robot can execute.")
    selection: SelectionSection = Field(default=SelectionSection(), description="Which sweeps are executed.")
    stitching: StitchingSection = Field(default=StitchingSection(), description="How sweeps are connected.")
    hulls: HullsSection = Field(default=HullsSection(), description="Hulls of spheres, where there is a layout.")
    scan: ScanSection = Field(default=ScanSection(), description="How the scan is simulated.")
    report: ReportSection = Field(default=ReportSection(), description="What the report says.")

    @model_validator(mode="after")
    def _margin_leaves_step(self) -> Self:
        if self.reachability.step_m > self.reachability.shortest_m:
            raise fault("reachability.step is longer than reachability.shortest: write a smaller step")
        return self
