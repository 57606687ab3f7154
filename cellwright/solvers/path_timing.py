"""Give a joint path its fastest timing under joint velocity and acceleration limits, at rest or at speed at its ends.

A straight joint motion has a closed form, the trapezoid of its path parameter. A curved path is timed by TOPP-RA
(Pham and Pham 2018, `cellwright.solvers.parameter_rates`) on a grid; limits on the travel of a tool are joint limits
of one more coordinate. The result is sampled so that the cubic Hermite curve through its states keeps all limits: the
instants at which the path acceleration switches become states of their own where that is needed, and what then still
exceeds a limit by more than `LIMIT_TOLERANCE` is removed by slowing the whole motion by that share.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.errors import InfeasibleError, SolverError
from cellwright.solvers.hermite import shares_of_limits
from cellwright.solvers.parameter_rates import fastest_rates

LIMIT_TOLERANCE = 0.005
"""Share by which the curve between states may exceed a limit; no controller tracks better than this."""
SHORTEST_INTERVAL = 1e-4
"""Seconds; closer states would lose digits of the acceleration between them."""
SHORTEST_MOTION = 1e-12
"""Rad or m; a coordinate that changes by less stands still."""
MOST_STATES = 2_000_000
"""States of one motion: days of motion that nobody waits for, and the memory of the planner."""
SPAN_PER_GRID_STEP = 1.0 / 100.0
"""Longest step of the timing grid as a share of the path; 1/100 is within 1 % of the trapezoid's time."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Largest absolute velocity and acceleration of each coordinate, both (coordinates,), SI units."""

    velocity: FloatArray
    acceleration: FloatArray

    def with_travel(self, speed: float, acceleration: float) -> Limits:
        """Return the limits with those of a travel (m/s, m/s^2) as the last coordinate."""
        return Limits(np.append(self.velocity, speed), np.append(self.acceleration, acceleration))


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """A motion, mostly from rest to rest, as states; between them it follows the cubic Hermite curve.

    Attributes:
        time: Rises strictly from 0, (states,) in s.
        position, velocity, acceleration: (states, coordinates). Where the acceleration switches it is the one
            on either side of the switch.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    @property
    def duration(self) -> float:
        """How long it takes in s."""
        return float(self.time[-1])

    def reversed(self) -> TimedMotion:
        """Return the motion run backwards: as fast, and within the same limits."""
        backwards = slice(None, None, -1)
        return TimedMotion(
            self.duration - self.time[backwards],
            self.position[backwards],
            -self.velocity[backwards],
            self.acceleration[backwards],
        )

    def slowed(self, factor: float) -> TimedMotion:
        """Return the motion taking ``factor`` times as long along the same curve."""
        return TimedMotion(self.time * factor, self.position, self.velocity / factor, self.acceleration / factor**2)

    def of_first(self, count: int) -> TimedMotion:
        """Return the motion of the first ``count`` coordinates alone."""
        return TimedMotion(self.time, self.position[:, :count], self.velocity[:, :count], self.acceleration[:, :count])

    def then(self, following: TimedMotion) -> TimedMotion:
        """Return this motion with another appended, which begins where this one ends."""
        return TimedMotion(
            np.concatenate([self.time, following.time[1:] + self.duration]),
            np.concatenate([self.position, following.position[1:]]),
            np.concatenate([self.velocity, following.velocity[1:]]),
            np.concatenate([self.acceleration, following.acceleration[1:]]),
        )


class Path(Protocol):
    """A twice differentiable path over its parameter, as `scipy.interpolate.CubicSpline` is one."""

    def __call__(self, s: FloatArray, nu: int = 0) -> FloatArray:
        """Return the ``nu``-th derivative (0, 1, 2) at parameters ``s`` (values,): (values, coordinates)."""
        ...


def trapezoid_time(distance: FloatArray, velocity: FloatArray | float, acceleration: FloatArray | float) -> FloatArray:
    """Return the least time from rest to rest over a distance, elementwise, under both limits.

    >>> float(trapezoid_time(np.array(1.0), 1.0, 1.0))
    2.0
    """
    d = np.abs(distance)
    reaches_speed = d * acceleration >= np.square(velocity)
    return np.asarray(np.where(reaches_speed, d / velocity + velocity / acceleration, 2.0 * np.sqrt(d / acceleration)))


def least_time(q_a: FloatArray, q_b: FloatArray, limits: Limits) -> FloatArray:
    """Return a time that no motion from rest at ``q_a`` to rest at ``q_b`` undercuts, (...) of (..., joints).

    Every joint alone needs its trapezoid, whatever the others do; the slowest joint counts.
    """
    return np.asarray(np.max(trapezoid_time(q_b - q_a, limits.velocity, limits.acceleration), axis=-1))


def time_straight(q_a: FloatArray, q_b: FloatArray, limits: Limits, sample: float) -> TimedMotion:
    """Time the straight joint motion by its trapezoid; states every ``sample`` s and where it switches.

    A motion without length is two samples of rest, so that time always rises.
    """
    delta = q_b - q_a
    speed, acceleration = (float(value) for value in _parameter_limits(delta, limits))
    if not np.isfinite(speed):
        rest = np.zeros((3, len(q_a)))
        return TimedMotion(np.array([0.0, sample, 2.0 * sample]), np.stack([q_a, q_a, q_b]), rest, rest)
    ramp = min(speed / acceleration, acceleration**-0.5)
    duration = float(trapezoid_time(np.array(1.0), speed, acceleration))
    switches = [0.0, ramp, duration - ramp, duration]
    time = _merged(np.arange(0.0, duration, sample), np.array(switches))
    rising = time < ramp
    falling = time >= duration - ramp
    to_end = duration - time
    rate = acceleration * np.where(rising, time, np.where(falling, to_end, ramp))
    covered = np.where(
        rising,
        0.5 * acceleration * time**2,
        np.where(
            falling,
            1.0 - 0.5 * acceleration * to_end**2,
            0.5 * acceleration * ramp**2 + acceleration * ramp * (time - ramp),
        ),
    )
    change = np.where(rising, acceleration, np.where(falling, -acceleration, 0.0))
    position = q_a + covered[:, None] * delta
    position[-1] = q_b
    return TimedMotion(time, position, rate[:, None] * delta, change[:, None] * delta)


def time_path(
    path: Path, knots: FloatArray, limits: Limits, sample: float, moving: tuple[bool, bool] = (False, False)
) -> TimedMotion:
    """Time a smooth path, from rest to rest unless it says otherwise, as fast as the limits allow.

    Args:
        path: The path; its second derivative may jump at knots only.
        knots: Parameters from the path's first to its last, rising, that the timing grid must contain.
        limits: Limits of all its coordinates.
        sample: Time between states in s; the end and the switches that matter are states as well.
        moving: Whether the first and the last point are passed at speed instead of at rest.

    Raises:
        SolverError: If TOPP-RA finds no timing.
        InfeasibleError: If the motion takes so long that its states cannot be kept.
    """
    grid = _grid(knots)
    rate = _fastest_rates(path, grid, limits, moving)
    step_time = 2.0 * np.diff(grid) / (rate[:-1] + rate[1:])
    grid_time = np.concatenate([[0.0], np.cumsum(step_time)])
    if grid_time[-1] > MOST_STATES * sample:
        raise InfeasibleError(
            f"a motion takes {grid_time[-1]:.3g} s, but at most {MOST_STATES * sample:.3g} s can be planned: "
            "raise max_velocity_rad_s, max_acceleration_rad_s2 or scan_speed_m_s"
        )
    motion = _sampled(path, grid, grid_time, rate, np.arange(0.0, grid_time[-1], sample))
    for _ in range(2):
        # a switch inside an interval bends the Hermite curve: make the switches of such intervals states
        velocity_share, acceleration_share = shares_of_limits(
            motion.time, motion.position, motion.velocity, limits.velocity, limits.acceleration
        )
        bad = np.flatnonzero(np.maximum(velocity_share, acceleration_share) > 1.0 + LIMIT_TOLERANCE)
        if len(bad) == 0:
            return motion
        inside = np.searchsorted(motion.time, grid_time, side="right") - 1
        motion = _sampled(path, grid, grid_time, rate, motion.time, grid_time[np.isin(inside, bad)])
    return _slowed(motion, limits)


def _parameter_limits(delta: FloatArray, limits: Limits) -> tuple[FloatArray, FloatArray]:
    """Limits of a parameter that runs from 0 to 1 along ``delta`` (..., joints); infinite where nothing moves."""
    length = np.abs(delta)
    moves = length > SHORTEST_MOTION
    safe = np.where(moves, length, 1.0)
    speed = np.min(np.where(moves, limits.velocity / safe, np.inf), axis=-1)
    acceleration = np.min(np.where(moves, limits.acceleration / safe, np.inf), axis=-1)
    return speed, np.where(np.isfinite(speed), acceleration, 1.0)


def _grid(knots: FloatArray) -> FloatArray:
    longest = (knots[-1] - knots[0]) * SPAN_PER_GRID_STEP
    pieces = [
        np.linspace(a, b, max(1, int(np.ceil((b - a) / longest - 1e-9))), endpoint=False)
        for a, b in itertools.pairwise(knots)
    ]
    return np.append(np.concatenate(pieces), knots[-1])


def _fastest_rates(path: Path, grid: FloatArray, limits: Limits, moving: tuple[bool, bool]) -> FloatArray:
    """Return the largest parameter rates on the grid, zero at the ends that are at rest."""
    first, second = path(grid, 1), path(grid, 2)
    finite = bool(np.isfinite(first).all() and np.isfinite(second).all())
    at_rest = not moving[0], not moving[1]
    rate = (
        fastest_rates(first, second, grid, limits.velocity, limits.acceleration, *at_rest)
        if finite
        else np.zeros(len(grid))
    )
    if not np.all(np.isfinite(rate)) or np.any(rate[1:-1] <= 0.0):
        raise SolverError(
            f"no timing from rest to rest was found on a path of {len(grid)} grid points and length "
            f"{grid[-1] - grid[0]:.4g}: check its limits and its smoothness"
        )
    return rate


def _sampled(
    path: Path,
    grid: FloatArray,
    grid_time: FloatArray,
    rate: FloatArray,
    time: FloatArray,
    extra: FloatArray | None = None,
) -> TimedMotion:
    """Evaluate the timed path: between grid points the parameter's acceleration is constant."""
    fixed = grid_time[[0, -1]] if extra is None else np.concatenate([grid_time[[0, -1]], extra])
    time = _merged(time, fixed)
    row = np.clip(np.searchsorted(grid_time, time, side="right") - 1, 0, len(grid) - 2)
    change = (rate[row + 1] ** 2 - rate[row] ** 2) / (2.0 * (grid[row + 1] - grid[row]))
    since = time - grid_time[row]
    s = np.clip(grid[row] + since * (rate[row] + 0.5 * change * since), grid[0], grid[-1])
    s[-1] = grid[-1]
    speed = rate[row] + change * since
    speed[[0, -1]] = rate[[0, -1]]
    first, second = path(s, 1), path(s, 2)
    return TimedMotion(time, path(s), first * speed[:, None], second * (speed**2)[:, None] + first * change[:, None])


def _merged(time: FloatArray, fixed: FloatArray) -> FloatArray:
    """Return both sets of times as one rising set with gaps above `SHORTEST_INTERVAL`; the fixed ones go first."""
    fixed = np.unique(fixed)
    kept = [fixed[0]]
    for moment in fixed[1:-1]:
        if moment - kept[-1] > SHORTEST_INTERVAL and fixed[-1] - moment > SHORTEST_INTERVAL:
            kept.append(moment)
    kept.append(fixed[-1])
    rising = np.array(kept)
    after = np.minimum(np.searchsorted(rising, time), len(rising) - 1)
    gap = np.minimum(np.abs(time - rising[after]), np.abs(time - rising[np.maximum(after - 1, 0)]))
    return np.sort(np.concatenate([rising, time[gap > SHORTEST_INTERVAL]]))


def _slowed(motion: TimedMotion, limits: Limits) -> TimedMotion:
    shares = shares_of_limits(motion.time, motion.position, motion.velocity, limits.velocity, limits.acceleration)
    return motion.slowed(max(float(shares[0].max()), float(shares[1].max()) ** 0.5, 1.0))
