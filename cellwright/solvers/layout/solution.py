"""What every layout solver returns: design, joint trajectories, and the residuals that the gate measured."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError

ITSELF = "itself"
"""What a robot touches whose own spheres overlap: perhaps only since they are few, and larger than what they hold."""


@dataclass(frozen=True, eq=False)
class Transition:
    """The robot's motion from the end of one approach to the start of the next.

    Attributes:
        start, end: Rows of the problem's visits.
        times_s: From 0 to the transition's duration, rising, (n,) with at least two.
        q: Joint positions in rad or m, (n, joints).
        velocity: Joint velocities, (n, joints); None: constant between the points (first order). With velocities the
            motion between two points has a constant acceleration.
    """

    start: int
    end: int
    times_s: FloatArray
    q: FloatArray
    velocity: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check.

        Raises:
            InvalidInputError: If the shapes do not fit, a value is not finite, or the times do not rise from 0.
        """
        times = np.asarray(self.times_s, float)
        name = f"the transition from visit {self.start} to visit {self.end}"
        if times.ndim != 1 or len(times) < 2 or self.q.ndim != 2 or len(self.q) != len(times):
            raise InvalidInputError(
                f"{name} has times of shape {times.shape} and joint positions of shape {self.q.shape}: "
                "give one row a time, and at least two"
            )
        if self.velocity is not None and self.velocity.shape != self.q.shape:
            raise InvalidInputError(
                f"{name} has velocities of shape {self.velocity.shape}, but positions of {self.q.shape}: "
                "give one velocity a position"
            )
        for what, values in (("times", times), ("positions", self.q), ("velocities", self.velocity)):
            if values is not None and not np.isfinite(values).all():
                raise InvalidInputError(f"{name} has {what} that are not finite: give numbers")
        if times[0] != 0.0:
            raise InvalidInputError(f"{name} begins at {times[0]:.6g} s: its times count from 0")
        if not (np.diff(times) > 0.0).all():
            row = int(np.argmin(np.diff(times)))
            raise InvalidInputError(
                f"the times of {name} do not rise: {times[row + 1]:.9g} s comes after {times[row]:.9g} s"
            )

    @property
    def duration_s(self) -> float:
        """The time of the transition."""
        return float(self.times_s[-1])

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return joint positions (m, joints) at times (m,) in s."""
        times = np.asarray(times_s, float)
        piece = np.clip(np.searchsorted(self.times_s, times, side="right") - 1, 0, len(self.times_s) - 2)
        begin, step = self.times_s[piece], np.diff(self.times_s)[piece]
        share = ((times - begin) / step)[:, None]
        if self.velocity is None:
            return np.asarray((1.0 - share) * self.q[piece] + share * self.q[piece + 1])
        before, after = self.velocity[piece], self.velocity[piece + 1]
        return np.asarray(self.q[piece] + step[:, None] * share * (before + 0.5 * share * (after - before)))


@dataclass(frozen=True)
class Finding:
    """One requirement that a layout misses.

    Attributes:
        requirement: What is missed, with the names of what is involved.
        excess: By how much.
        unit: Of the excess.
    """

    requirement: str
    excess: float
    unit: str

    def __str__(self) -> str:
        """The finding as a phrase."""
        return f"{self.requirement} by {self.excess:.4g} {self.unit}".rstrip()


@dataclass(frozen=True)
class GateReport:
    """What the check on a dense time grid measured; penetrations are 0 where everything keeps clear.

    Attributes:
        path_violation_m: Deepest penetration of the robot into a hull, a wall or itself, clearance included.
        path_pair: The names of what touches there.
        layout_violation_m: Deepest penetration among stations, robot base and walls.
        endpoint_m, endpoint_rad: Largest residual of a tool pose at the ends of a transition.
        approach_m, approach_rad: Largest residual of a tool pose along an approach.
        approach_jump: Largest step of a joint, rad or m, between neighbours along an approach. They lie 5 mm apart, and
            far less where the arm turns fast: what is left is a jump to another branch.
        position_excess: Largest excess over a joint position limit, rad or m.
        design_excess: Largest excess over a design joint's limit, rad or m.
        speed_ratio: Largest joint speed over its limit.
        acceleration_ratio: Largest joint acceleration over its limit; 0 for first-order motions.
        rest_ratio: Largest joint speed over its limit where a transition has to begin or end at rest; 0 for
            first-order motions.
        handover_s: Longest time that a joint needs, at its acceleration limit, to take up the difference between its
            speeds on a transition and on the timed approach beside it; 0 for first-order motions.
        n_samples: Configurations that were checked.
        findings: What is missed: first what touches, then poses, joints, ranges and rates.
    """

    path_violation_m: float
    path_pair: tuple[str, str]
    layout_violation_m: float
    endpoint_m: float
    endpoint_rad: float
    approach_m: float
    approach_rad: float
    approach_jump: float
    position_excess: float
    design_excess: float
    speed_ratio: float
    acceleration_ratio: float
    rest_ratio: float
    handover_s: float
    n_samples: int
    findings: tuple[Finding, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether nothing is missed."""
        return not self.findings

    @property
    def blocking(self) -> str:
        """The first requirement that is missed, in words; empty if none."""
        return str(self.findings[0]) if self.findings else ""


@dataclass(frozen=True)
class Phase:
    """One nonlinear program of a solver: its name, Ipopt's return status and iterations, and its size."""

    name: str
    status: str
    iterations: int
    n_variables: int
    n_constraints: int
    n_checks: int = 0


@dataclass(frozen=True, eq=False)
class LayoutSolution:
    """A layout with the robot's whole cycle, gated.

    Attributes:
        method: The solver.
        design: Design joints, (n_design,).
        approach_q: Joint positions at the poses of each visit's approach, (poses, joints) a visit.
        transitions: One motion a pair of `LayoutProblem.transitions`.
        approach_s: Time of all timed approaches together.
        extra_cost: L, in s.
        report: What the gate measured.
        phases: The nonlinear programs behind it, in order.
        relaxation_m: Sum of the elastic slack that was left: the smallest relaxation found that makes it feasible.
    """

    method: str
    design: FloatArray
    approach_q: tuple[FloatArray, ...]
    transitions: tuple[Transition, ...]
    approach_s: float
    extra_cost: float
    report: GateReport
    phases: tuple[Phase, ...] = ()
    relaxation_m: float = 0.0
    notes: tuple[str, ...] = field(default=())

    @property
    def converged(self) -> bool:
        """Whether the solution passed its gate."""
        return self.report.passed

    @property
    def transition_s(self) -> float:
        """The time of all transitions together."""
        return sum(transition.duration_s for transition in self.transitions)

    @property
    def cycle_time_s(self) -> float:
        """Transitions and timed approaches together."""
        return self.transition_s + self.approach_s

    @property
    def iterations(self) -> int:
        """Ipopt iterations of all phases."""
        return sum(phase.iterations for phase in self.phases)
