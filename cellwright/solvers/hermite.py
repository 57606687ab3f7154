"""Read a sampled motion as the cubic Hermite curve through its positions and velocities, and bound it exactly.

Between two states the joints follow the cubic with the states' positions and velocities. Its velocity is a
quadratic and its acceleration a line, so the extremes of all three are closed forms: what is found here is the
worst value anywhere on the curve, not the worst sample. Everything is vectorised over intervals and joints.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray, IntArray


def states_at(
    time: FloatArray, position: FloatArray, velocity: FloatArray, at: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (times, joints) at the times ``at`` (times,) in s.

    ``time`` (states,) rises strictly; ``position`` and ``velocity`` are (states, joints). Times outside the
    motion are clipped to its ends.
    """
    row = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    u = np.clip((at - time[row]) / (time[row + 1] - time[row]), 0.0, 1.0)[:, None]
    v0, b, c, durations = _quadratic(time, position, velocity)
    v0, b, c, h = v0[row], b[row], c[row], durations[row][:, None]
    return (
        np.asarray(position[row] + h * u * (v0 + u * (b / 2.0 + u * c / 3.0))),
        np.asarray(v0 + u * (b + u * c)),
    )


def interval_states(
    time: FloatArray, position: FloatArray, velocity: FloatArray, shares: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions, velocities and accelerations (intervals, shares, joints) at ``shares`` of every interval.

    ``shares`` (shares,) lie in 0..1. Accelerations may jump where intervals meet: each interval has its own.
    """
    v0, b, c, durations = (each[:, None] for each in _quadratic(time, position, velocity))
    h, u = durations[..., None], np.asarray(shares, float)[:, None]
    return (
        np.asarray(position[:-1, None] + h * u * (v0 + u * (b / 2.0 + u * c / 3.0))),
        np.asarray(v0 + u * (b + u * c)),
        np.asarray((b + 2.0 * u * c) / h),
    )


def position_extremes(time: FloatArray, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the greatest position on each interval, both (intervals, joints)."""
    v0, b, c, h = _quadratic(time, position, velocity)
    low = np.minimum(position[:-1], position[1:])
    high = np.maximum(position[:-1], position[1:])
    root = np.sqrt(np.maximum(b * b - 4.0 * c * v0, 0.0))
    # the stable pair of quadratic roots: one sum of equal signs, the other root through their product
    q = -0.5 * (b + np.where(b < 0.0, -root, root))
    for numerator, denominator in ((q, c), (v0, q)):
        usable = np.abs(denominator) > 1e-300
        u = np.clip(np.where(usable, numerator / np.where(usable, denominator, 1.0), 0.0), 0.0, 1.0)
        p = position[:-1] + h[:, None] * u * (v0 + u * (b / 2.0 + u * c / 3.0))
        low, high = np.minimum(low, p), np.maximum(high, p)
    return low, high


def peak_velocity(time: FloatArray, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the greatest absolute velocity on each interval, (intervals, joints)."""
    v0, b, c, _ = _quadratic(time, position, velocity)
    peak = np.maximum(np.abs(velocity[:-1]), np.abs(velocity[1:]))
    turning = np.abs(c) > 1e-300
    u = np.clip(np.where(turning, -b / np.where(turning, 2.0 * c, 1.0), 0.0), 0.0, 1.0)
    return np.asarray(np.maximum(peak, np.abs(v0 + u * (b + u * c))))


def peak_acceleration(time: FloatArray, position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the greatest absolute acceleration on each interval, (intervals, joints): at one of its ends."""
    _, b, c, h = _quadratic(time, position, velocity)
    return np.asarray(np.maximum(np.abs(b), np.abs(b + 2.0 * c)) / h[:, None])


def shares_of_limits(
    time: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    max_velocity: FloatArray,
    max_acceleration: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return each interval's worst share of the velocity and of the acceleration limits, both (intervals,)."""
    return (
        np.asarray(np.max(peak_velocity(time, position, velocity) / max_velocity, axis=1)),
        np.asarray(np.max(peak_acceleration(time, position, velocity) / max_acceleration, axis=1)),
    )


def subdivide(time: FloatArray, parts: IntArray) -> FloatArray:
    """Return all times of ``time`` plus those that cut interval ``i`` into ``parts[i]`` equal parts.

    ``parts`` (intervals,) holds whole numbers of at least 1; the given times come back bit for bit.
    """
    first = np.repeat(np.cumsum(parts) - parts, parts)
    interval = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(int(parts.sum())) - first) / parts[interval]
    return np.append(time[interval] + share * np.diff(time)[interval], time[-1])


def _quadratic(
    time: FloatArray, position: FloatArray, velocity: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return v0, b, c (intervals, joints) of the velocity ``v0 + b u + c u^2``, u in 0..1, and the durations."""
    h = np.diff(time)
    slope = np.diff(position, axis=0) / h[:, None]
    v0, v1 = velocity[:-1], velocity[1:]
    return v0, 6.0 * slope - 4.0 * v0 - 2.0 * v1, 3.0 * (v0 + v1) - 6.0 * slope, h
