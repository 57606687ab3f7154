"""How sweeps are stitched, and what comes out: segments in order, and the sweeps that had to be left out."""

from __future__ import annotations

from dataclasses import dataclass, field

from cellwright.solvers.path_timing import TimedMotion
from cellwright.solvers.roadmap import RoadmapSize


@dataclass(frozen=True)
class StitchSettings:
    """How sweeps are stitched; SI units.

    Attributes:
        scan_speed, tool_acceleration: Limits of the travel on sweeps.
        sample: Time between states.
        trace_step: Travel between traced poses.
        step: Largest joint turn between checked states while searching.
        confirm_step, confirm_angle: Furthest motion of any point, largest joint turn while confirming.
        sweep_clearance: Distance that the scene keeps by which sweeps are confirmed, to tell what was asked for.
        max_alternatives: Branches and windings tried of each sweep.
        roadmap: Size of the roadmap.
        exact_up_to: Most sweeps for the exact order.
        n_evaluations: Connections that the best order may evaluate.
        returns: Whether the plan ends where it starts.
    """

    scan_speed: float = 0.1
    tool_acceleration: float = 1.0
    sample: float = 0.008
    trace_step: float = 0.002
    step: float = 0.02
    confirm_step: float = 1e-3
    confirm_angle: float = 0.01
    sweep_clearance: float = 0.0
    max_alternatives: int = 8
    roadmap: RoadmapSize = field(default_factory=RoadmapSize)
    exact_up_to: int = 15
    n_evaluations: int = 1000
    returns: bool = False


@dataclass(frozen=True, eq=False)
class StitchedSegment:
    """A sweep (``sweep`` its number) or a connection (``sweep`` -1); a sweep's motion has the travel as last column."""

    motion: TimedMotion
    sweep: int
    branch: int
    direction: int
    via: str


@dataclass(frozen=True)
class LeftOut:
    """The number of a sweep that is not executed, and why."""

    sweep: int
    reason: str


@dataclass(frozen=True, eq=False)
class StitchedPlan:
    """A plan through those sweeps that can be executed and connected.

    Attributes:
        segments: In order; none if no sweep is executed.
        durations: Duration in s of the plan in every order that was compared.
        chosen: Name of the order that is the plan; empty if there is none.
        lower_bound: No order of the executed sweeps over such connections is shorter, s.
        proven: Whether the chosen order is shortest.
        left_out: Sweeps that are not executed.
        n_joints: Number of joints.
    """

    segments: tuple[StitchedSegment, ...]
    durations: dict[str, float]
    chosen: str
    lower_bound: float
    proven: bool
    left_out: tuple[LeftOut, ...]
    n_joints: int
