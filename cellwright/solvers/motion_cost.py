"""What a motion between two configurations costs: one interface for every way to know it.

Sequencing needs three things of a cost: a lower bound that is cheap and never wrong, the true cost of one motion, and
the motion itself. `VelocityCost` is the time of the slowest joint at full speed, without planning; `PathCost` is the
duration of a collision-free path, timed; `cellwright.solvers.optimal_control.motion.OptimalControlCost` minimises time,
torque and speed together. `PlannedMotions` joins a cost to `cellwright.solvers.gtsp.lazy.solve_lazily` and keeps every
motion that was evaluated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InvalidInputError
from cellwright.solvers.connections import Connections
from cellwright.solvers.gtsp.lazy import velocity_bounds
from cellwright.solvers.path_timing import Limits, TimedMotion, least_time


@dataclass(frozen=True, eq=False)
class CostedMotion:
    """A motion and what it costs.

    Attributes:
        cost: In the unit of the cost that made it.
        motion: States from start to goal; between them the cubic Hermite curve.
        torque: Joint torques at the states, (states, joints) in N m or N; None where the cost knows no dynamics.
        via: How it was found: ``velocity``, ``direct``, ``roadmap``, ``optimal control``.
    """

    cost: float
    motion: TimedMotion
    torque: FloatArray | None
    via: str


class MotionCost(Protocol):
    """A cost of going from one configuration to another.

    Attributes:
        name: For reports.
        unit: Of its values: ``s``, or empty for a weighted sum.
        symmetric: Whether a motion costs the same backwards.
    """

    @property
    def name(self) -> str: ...

    @property
    def unit(self) -> str: ...

    @property
    def symmetric(self) -> bool: ...

    def bound(self, q_a: FloatArray, q_b: FloatArray, /) -> FloatArray:
        """Return what no motion from ``q_a`` to ``q_b``, both (..., joints), undercuts: (...)."""
        ...

    def holding(self, q: FloatArray, dwell: float, /) -> FloatArray:
        """Return the cost of standing still at ``q`` (..., joints) for ``dwell`` s: (...)."""
        ...

    def motion(self, q_a: FloatArray, q_b: FloatArray, /) -> CostedMotion | None:
        """Return the motion, rest to rest, from ``q_a`` to ``q_b`` (joints,); None if none was found."""
        ...


@runtime_checkable
class GuessedCost(MotionCost, Protocol):
    """A cost whose bounds may be far below it, and which therefore guesses as well."""

    def guess(self, q: FloatArray, /) -> FloatArray:
        """Return what motions between all configurations ``q`` (n, joints) may cost, (n, n); no bound."""
        ...


@dataclass(frozen=True, eq=False)
class VelocityCost:
    """The time that the slowest joint needs at full speed: no acceleration, its own bound.

    Attributes:
        speed: Highest joint speeds, (joints,), rad/s or m/s.
        planned: Plans the motions, only to know that there are any; without it nothing is in the way.
    """

    speed: FloatArray
    planned: MotionCost | None = None
    name: str = "velocity bound"
    unit: str = "s"
    symmetric: bool = True

    def bound(self, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
        """Return max_j abs(q_b - q_a) / speed_j in s."""
        return np.asarray(np.max(np.abs(q_b - q_a) / self.speed, axis=-1))

    def holding(self, q: FloatArray, dwell: float) -> FloatArray:
        """Return the dwell itself."""
        return np.full(np.shape(q)[:-1], float(dwell))

    def motion(self, q_a: FloatArray, q_b: FloatArray) -> CostedMotion | None:
        """Return the planned motion; without a planner the straight one at constant speed, which ends with a jerk."""
        duration = float(self.bound(q_a, q_b))
        if self.planned is not None:
            found = self.planned.motion(q_a, q_b)
            return None if found is None else replace(found, cost=duration)
        time = np.array([0.0, max(duration, 1e-9)])
        velocity = np.repeat([(q_b - q_a) / time[-1]], 2, axis=0)
        motion = TimedMotion(time, np.stack([q_a, q_b]), velocity, np.zeros_like(velocity))
        return CostedMotion(duration, motion, None, "velocity")


@dataclass(eq=False)
class PathCost:
    """The duration of a collision-free path, timed under velocity and acceleration limits.

    Attributes:
        connections: Finds, confirms and remembers the motions.
        limits: The joint limits that ``connections`` keeps.
    """

    connections: Connections
    limits: Limits
    name: str = "timed path"
    unit: str = "s"
    symmetric: bool = True

    def bound(self, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
        """Return the time of the slowest joint's trapezoid in s."""
        return least_time(q_a, q_b, self.limits)

    def holding(self, q: FloatArray, dwell: float) -> FloatArray:
        """Return the dwell itself."""
        return np.full(np.shape(q)[:-1], float(dwell))

    def motion(self, q_a: FloatArray, q_b: FloatArray) -> CostedMotion | None:
        """Return the confirmed connection, or None.

        Limits hold within `cellwright.solvers.path_timing.LIMIT_TOLERANCE`, so a motion may seem to take less than
        the bound by that share; then the bound stands.
        """
        self.connections.confirm(q_a, q_b)
        found = self.connections.between(q_a, q_b)
        if found is None:
            return None
        cost = max(found.motion.duration, float(self.bound(q_a, q_b)))
        return CostedMotion(cost, found.motion, None, found.via)


class PlannedMotions:
    """Motions between the alternatives of a sequencing problem, each found at most once.

    ``bounds`` and ``service`` fill a `SequencingProblem`; ``evaluate`` is what `solve_lazily` asks; afterwards
    ``found[a, b]`` holds the motions.

    Attributes:
        found: The motions evaluated so far; None where there is none.
    """

    def __init__(self, cost: MotionCost, q: FloatArray, dwell: float | FloatArray = 0.0) -> None:
        q = np.asarray(q, float)
        if q.ndim != 2 or not np.isfinite(q).all():
            raise InvalidInputError(f"q has shape {q.shape}: give one finite configuration (joints,) an alternative")
        self.cost, self.q = cost, q
        self.dwell = np.broadcast_to(np.asarray(dwell, float), len(q))
        self.found: dict[tuple[int, int], CostedMotion | None] = {}

    @property
    def bounds(self) -> FloatArray:
        """Lower bounds of all motions, (alternatives, alternatives), row to column."""
        if isinstance(self.cost, VelocityCost):
            return velocity_bounds(self.q, self.cost.speed)
        # row by row: no array of all pairs and joints at once
        return np.stack([self.cost.bound(q_a, self.q) for q_a in self.q])

    @property
    def service(self) -> FloatArray:
        """What each alternative costs by itself while the robot stands there for its dwell, (alternatives,)."""
        return np.array([float(self.cost.holding(q, float(d))) for q, d in zip(self.q, self.dwell)])

    def evaluate(self, a: int, b: int) -> float:
        """Return the true cost of the motion from alternative ``a`` to ``b``, infinite if there is none."""
        if (a, b) not in self.found:
            self.found[a, b] = self.cost.motion(self.q[a], self.q[b])
        found = self.found[a, b]
        return math.inf if found is None else found.cost
