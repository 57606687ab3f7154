"""The artefacts of a layout: a robot's spheres, the optimised layout with all its starts, and its report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from cellwright.arrays import BoolArray, FloatArray, Int8Array, Int32Array
from schemas.artefact import Artefact
from schemas.columns import ANY_WIDTH, blob, column, fact


@dataclass(frozen=True, eq=False, repr=False)
class RobotHull(Artefact):
    """A robot of spheres: each link's hull with its proofs and metrics, and the pairs that need no check."""

    KIND: ClassVar[str] = "robot-hull"

    name: str = fact("Name of the robot", dtype="str")
    urdf: bytes = blob("The URDF with spheres as collision geometry", suffix=".urdf")
    srdf: bytes = blob("The pairs of links that need no check", suffix=".srdf")
    link: tuple[str, ...] = column("URDF links that have a hull", dtype="str", table="links")
    first_sphere: Int32Array = column("First sphere of the link", dtype="int32", table="links")
    n_spheres: Int32Array = column("Spheres of the link", dtype="int32", table="links")
    fitted: BoolArray = column("Whether the hull was fitted; else the URDF had it", dtype="bool", table="links")
    surface_covered: BoolArray = column(
        "Whether every point of the link's surface is proven to lie in a sphere", dtype="bool", table="links"
    )
    interior: tuple[str, ...] = column(
        "covered: no hole inside, proven; none: the link encloses nothing", dtype="str", table="links"
    )
    coverage: FloatArray = column("Share of surface samples in a sphere", table="links")
    volume_ratio: FloatArray = column("Volume of the union over that of the link", table="links")
    volume_kind: tuple[str, ...] = column(
        "What it compares with: enclosed (within the outer surface) or convex (hull of an open mesh)",
        dtype="str",
        table="links",
    )
    protrusion_mean_m: FloatArray = column(
        "Mean distance of the hull's skin outside the link from it", unit="m", table="links"
    )
    protrusion_p95_m: FloatArray = column("95th percentile of it, by area", unit="m", table="links")
    protrusion_max_m: FloatArray = column("Largest sampled protrusion", unit="m", table="links")
    gap_mean_m: FloatArray = column("Mean distance of surface samples from the hull, 0 in it", unit="m", table="links")
    gap_p95_m: FloatArray = column("95th percentile of it", unit="m", table="links")
    gap_max_m: FloatArray = column("Largest sampled gap", unit="m", table="links")
    overshoot_m: FloatArray = column("No point of the hull is further from the link: proven", unit="m", table="links")
    centre_m: FloatArray = column("Sphere centres", width=3, unit="m", frame="link", table="spheres")
    radius_m: FloatArray = column("Sphere radii", unit="m", table="spheres")
    ignored_pair: Int32Array = column(
        "Pairs of rows of links that need no check, lower first", dtype="int32", width=2, table="pairs"
    )
    ignored_reason: Int8Array = column(
        "0 same parent, 1 neighbours, 2 hulls always touch, 3 hulls never meet in sampling, 4 declared",
        dtype="int8",
        table="pairs",
    )
    checked_pair: Int32Array = column("The other pairs", dtype="int32", width=2, table="checked")
    touching_share: FloatArray = column("Share of sampled configurations in which the two hulls touch", table="checked")


@dataclass(frozen=True, eq=False, repr=False)
class Layout(Artefact):
    """The best layout of several starts with the robot's whole cycle, gated; or, not converged, what blocks it.

    A layout that has not converged is the record of an attempt and not a result: flows refuse it. Processor times are
    no content: they stand in the lake's provenance.
    """

    KIND: ClassVar[str] = "layout"

    method: str = fact("The solver", dtype="str")
    converged: bool = fact("Whether the best start passed its gate", dtype="bool")
    blocking: str = fact("The requirement that blocks it; empty if it converged", dtype="str")
    cycle_s: float = fact("Cycle time", unit="s")
    transition_s: float = fact("Of which transitions", unit="s")
    approach_s: float = fact("Of which timed approaches", unit="s")
    extra_cost_s: float = fact("Extra cost L", unit="s")
    before_cycle_s: float = fact("Cycle time where the first start began; NaN if there is none", unit="s")
    before_blocking: str = fact("Why there is none", dtype="str")
    best_start: int = fact("The start that it came from", dtype="int64")

    design: tuple[str, ...] = column("Design joint: owner.joint", dtype="str", table="design")
    revolute: BoolArray = column("Whether it turns (rad) or slides (m)", dtype="bool", table="design")
    lower: FloatArray = column("Lower end of its range", unit="rad or m", table="design")
    upper: FloatArray = column("Upper end of its range", unit="rad or m", table="design")
    before: FloatArray = column("Where the first start began", unit="rad or m", table="design")
    value: FloatArray = column("Where it is now", unit="rad or m", table="design")

    body: tuple[str, ...] = column("The robot's base, then stations and obstacles", dtype="str", table="bodies")
    T_world_body: FloatArray = column("Pose, a 4x4 matrix row by row", width=16, frame="world", table="bodies")
    T_world_body_before: FloatArray = column("Pose where it began", width=16, frame="world", table="bodies")

    joint: tuple[str, ...] = column("Joint names, base to flange", dtype="str", table="joints")
    joint_revolute: BoolArray = column("Whether it turns (rad) or slides (m)", dtype="bool", table="joints")
    joint_lower: FloatArray = column("Lower joint limit", unit="rad or m", table="joints")
    joint_upper: FloatArray = column("Upper joint limit", unit="rad or m", table="joints")
    joint_speed: FloatArray = column("Speed limit", unit="rad/s or m/s", table="joints")

    start_visit: tuple[str, ...] = column("Where a transition begins", dtype="str", table="transitions")
    end_visit: tuple[str, ...] = column("Where it ends", dtype="str", table="transitions")
    start_row: Int32Array = column("Row of the visit where it begins", dtype="int32", table="transitions")
    end_row: Int32Array = column("Row of the visit where it ends", dtype="int32", table="transitions")
    duration_s: FloatArray = column("Its time", unit="s", table="transitions")

    transition: Int32Array = column("Transition of a state", dtype="int32", table="states")
    time_s: FloatArray = column("Time since the transition began", unit="s", table="states")
    position: FloatArray = column("Joint positions", width=ANY_WIDTH, unit="rad or m", table="states")
    velocity: FloatArray = column(
        "Joint velocities; NaN: constant between the states", width=ANY_WIDTH, unit="rad/s or m/s", table="states"
    )

    approach_visit: Int32Array = column("Visit of an approach's pose", dtype="int32", table="approaches")
    approach_position: FloatArray = column(
        "Joint positions at it", width=ANY_WIDTH, unit="rad or m", table="approaches"
    )

    before_transition: Int32Array = column("Transition of a state before", dtype="int32", table="before_states")
    before_time_s: FloatArray = column("Time since the transition began", unit="s", table="before_states")
    before_position: FloatArray = column("Joint positions", width=ANY_WIDTH, unit="rad or m", table="before_states")
    before_velocity: FloatArray = column(
        "Joint velocities; NaN: constant between the states",
        width=ANY_WIDTH,
        unit="rad/s or m/s",
        table="before_states",
    )

    check: tuple[str, ...] = column("What the gate measured", dtype="str", table="gate")
    found: FloatArray = column("Worst value found", table="gate")
    permitted: FloatArray = column("Permitted value", table="gate")
    unit: tuple[str, ...] = column("Unit of both", dtype="str", table="gate")

    requirement: tuple[str, ...] = column("What would have to give for a layout", dtype="str", table="relaxation")
    excess: FloatArray = column("By how much", table="relaxation")
    excess_unit: tuple[str, ...] = column("Unit of it", dtype="str", table="relaxation")

    trial_converged: BoolArray = column("Whether a start passed its gate", dtype="bool", table="starts")
    trial_cycle_s: FloatArray = column("Its cycle time", unit="s", table="starts")
    trial_extra_cost_s: FloatArray = column("Its extra cost", unit="s", table="starts")
    trial_endpoint_m: FloatArray = column("Its largest miss of a target", unit="m", table="starts")
    trial_penetration_m: FloatArray = column("Its deepest penetration", unit="m", table="starts")
    trial_iterations: Int32Array = column("Iterations of its programs", dtype="int32", table="starts")
    trial_blocking: tuple[str, ...] = column("What blocks it; empty if it passed", dtype="str", table="starts")


@dataclass(frozen=True, eq=False, repr=False)
class LayoutReport(Artefact):
    """The report of one layout: self-contained HTML, the same figures as PNG, the summary as JSON."""

    KIND: ClassVar[str] = "layout-report"

    page: bytes = blob("The report, one self-contained page", suffix=".html")
    layout_png: bytes = blob("The cell from above, before and after", suffix=".png")
    motion_png: bytes = blob("Joint positions over the cycle with their limits", suffix=".png")
    starts_png: bytes = blob("Cycle times of all starts", suffix=".png")
    summary: str = fact("Figures of the layout as JSON", dtype="str")
