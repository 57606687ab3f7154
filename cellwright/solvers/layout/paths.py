"""Where the path of one transition starts: the most promising of many bent ones, judged by numbers alone.

A straight motion in joint space that cuts through an obstacle is a poor start for a gradient method: it has to be
pushed out on the right side. Bowing the motion out into random directions of joint space and measuring a few hundred
such paths costs less than one nonlinear program, and mostly one of them is already clear.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.geometry import LayoutGeometry

_BOWS = (0.2, 0.5, 0.9, 1.4)
"""Sizes of a bow in rad; the largest bow of a prismatic joint is its whole range."""
_PATHS_A_SIZE = 20
_SHRINKS = (1.0, 0.6, 0.3, 0.2)
"""Rounds of bows, each about the best path so far."""
_LEAST_SAMPLES = 33
_MOST_SAMPLES = 257
_DETOUR = 4.0
"""How much faster than the mean of the straight motion a path may pass something thin without stepping over it."""
_PENETRATION_COST = 40.0
"""Seconds a metre of penetration costs while paths are compared."""


def promising_paths(
    geometry: LayoutGeometry, design: FloatArray, straight: FloatArray, rng: np.random.Generator, most: int
) -> list[FloatArray]:
    """Return up to ``most`` paths (segments + 1, joints) between the ends of a straight one, best first.

    The straight one alone if it is clear.
    """
    paths: FloatArray = straight[None]
    n_samples = _n_samples(geometry, design, straight)
    costs = _costs(geometry, design, paths, n_samples)
    if costs[0] <= _time(geometry, straight[None])[0]:
        return [straight]
    arm = geometry.problem.arm
    s = np.linspace(0.0, 1.0, len(straight))[:, None]
    span = np.where(arm.revolute, 1.0, (arm.upper - arm.lower) / _BOWS[-1])
    for shrink in _SHRINKS:
        about = paths[np.argsort(costs, kind="stable")[0]]
        sizes = shrink * np.repeat(_BOWS, _PATHS_A_SIZE)
        bows = np.zeros((len(sizes), *straight.shape))
        for mode in (1, 2):
            directions = rng.normal(0.0, 1.0, (len(sizes), arm.n_joints))
            directions /= np.abs(directions).max(axis=1, keepdims=True)
            directions *= (sizes / mode)[:, None] * span
            bows += np.sin(mode * np.pi * s) * directions[:, None, :]
        bowed = np.clip(about + bows, arm.lower, arm.upper)
        bowed[:, [0, -1]] = straight[[0, -1]]
        paths = np.concatenate([paths, bowed])
        costs = np.concatenate([costs, _costs(geometry, design, bowed, n_samples)])
    return list(paths[np.argsort(costs, kind="stable")[:most]])


def _time(geometry: LayoutGeometry, paths: FloatArray) -> FloatArray:
    """Return the first-order times (n,) of paths (n, points, joints)."""
    steps = np.abs(np.diff(paths, axis=1)) / geometry.problem.arm.max_velocity
    return np.asarray(steps.max(axis=2).sum(axis=1))


def _n_samples(geometry: LayoutGeometry, design: FloatArray, straight: FloatArray) -> int:
    """Return how many samples a path between the ends of a straight one needs to step over nothing."""
    spheres = geometry.robot_world(geometry.problem.base_pose(design), straight)[:, geometry.moving_spheres]
    travel = float(np.linalg.norm(np.diff(spheres, axis=0), axis=2).sum(axis=0).max(initial=0.0))
    wanted = _DETOUR * travel / max(geometry.smallest_radii_m, 1e-6)
    return int(min(max(wanted, _LEAST_SAMPLES), _MOST_SAMPLES))


def _costs(geometry: LayoutGeometry, design: FloatArray, paths: FloatArray, n_samples: int) -> FloatArray:
    """Return time plus the price of the deepest and the mean penetration, (n,)."""
    n, points = paths.shape[:2]
    place = np.linspace(0.0, points - 1.0, n_samples)
    before = np.minimum(place.astype(int), points - 2)
    share = (place - before)[:, None]
    q = (1.0 - share) * paths[:, before] + share * paths[:, before + 1]
    gaps = geometry.motion_gap(design, q.reshape(-1, q.shape[2])).reshape(n, -1)
    inside = np.maximum(-gaps, 0.0)
    return np.asarray(_time(geometry, paths) + _PENETRATION_COST * (inside.max(axis=1) + inside.mean(axis=1)))
