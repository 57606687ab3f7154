"""Which pairs of sphere hulls need no collision check: joined links, hulls that always touch, hulls that never meet.

Hulls are larger than their bodies, so pairs that the bodies keep clear of may always touch as hulls: a planner would
find every configuration in collision. The rules are those of `cellwright.cell.ignored_pairs`, asked of the spheres in
random configurations. Configurations prove nothing, so "never" keeps a margin.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import FloatArray, Int8Array, Int32Array
from cellwright.cell.ignored_pairs import NEVER_MARGIN, Reason

N_SAMPLES = 2000
"""Random configurations that pairs of hulls are sorted by."""


@dataclass(frozen=True, eq=False)
class HullPairs:
    """Pairs of hulls and what was found.

    Attributes:
        ignored: Pairs of rows that need no check, lower row first, sorted, (pairs, 2).
        reason: Why, a `Reason` each, (pairs,).
        checked: The other pairs, (others, 2).
        touching: Share of the sampled configurations in which a checked pair touches, (others,).
    """

    ignored: Int32Array
    reason: Int8Array
    checked: Int32Array
    touching: FloatArray


def hull_pairs(
    centres: list[FloatArray],
    radii: list[FloatArray],
    group: list[int],
    poses: list[FloatArray],
    neighbours: Collection[tuple[int, int]],
    *,
    known: dict[tuple[int, int], Reason] | None = None,
) -> HullPairs:
    """Sort all pairs of hulls.

    Args:
        centres: Of each hull's spheres, (k, 3) in m in the hull's own frame.
        radii: In m, (k,) each.
        group: What moves each hull; hulls of one group never move against each other.
        poses: Of each hull in one common frame in all sampled configurations, (samples, 4, 4) each.
        neighbours: Pairs of groups that a joint connects, in either order.
        known: Pairs of rows, lower first, that are ignored for another reason already.
    """
    joined = {tuple(sorted(pair)) for pair in neighbours}
    found: dict[tuple[int, int], Reason] = dict(known or {})
    open_pairs = []
    for a in range(len(group)):
        for b in range(a + 1, len(group)):
            if group[a] == group[b]:
                found[a, b] = Reason.SAME_PARENT
            elif tuple(sorted((group[a], group[b]))) in joined:
                found[a, b] = Reason.NEIGHBOURS
            elif (a, b) not in found and len(radii[a]) and len(radii[b]):
                open_pairs.append((a, b))
    n_samples = len(poses[0]) if poses else 0
    checked, touching = [], []
    for a, b in open_pairs:
        gaps = _gaps_over(centres[a], radii[a], poses[a], centres[b], radii[b], poses[b])
        n_touching = int(np.count_nonzero(gaps < 0.0))
        if n_touching == n_samples:
            found[a, b] = Reason.ALWAYS_TOUCHING
        elif gaps.min() > NEVER_MARGIN:
            found[a, b] = Reason.NEVER_TOUCHING
        else:
            checked.append((a, b))
            touching.append(n_touching / n_samples)
    ignored = sorted(found)
    return HullPairs(
        np.array(ignored, np.int32).reshape(-1, 2),
        np.array([found[pair] for pair in ignored], np.int8),
        np.array(checked, np.int32).reshape(-1, 2),
        np.array(touching, float),
    )


def _gaps_over(
    one: FloatArray,
    one_radii: FloatArray,
    T_one: FloatArray,
    other: FloatArray,
    other_radii: FloatArray,
    T_other: FloatArray,
) -> FloatArray:
    """Return the gap between two hulls in each configuration, (samples,)."""
    gaps: FloatArray = _least_gaps(
        np.ascontiguousarray(one),
        one_radii,
        np.ascontiguousarray(T_one),
        np.ascontiguousarray(other),
        other_radii,
        np.ascontiguousarray(T_other),
    )
    return gaps


@numba.njit(cache=True, nogil=True)
def _least_gaps(one, one_radii, T_one, other, other_radii, T_other):  # type: ignore[no-untyped-def]
    out = np.empty(len(T_one))
    p = np.empty(3)
    q = np.empty((len(other), 3))
    for s in range(len(T_one)):
        for j in range(len(other)):
            for k in range(3):
                q[j, k] = T_other[s, k, 3]
                for m in range(3):
                    q[j, k] += T_other[s, k, m] * other[j, m]
        least = np.inf
        for i in range(len(one)):
            for k in range(3):
                p[k] = T_one[s, k, 3]
                for m in range(3):
                    p[k] += T_one[s, k, m] * one[i, m]
            for j in range(len(other)):
                way = (p[0] - q[j, 0]) ** 2 + (p[1] - q[j, 1]) ** 2 + (p[2] - q[j, 2]) ** 2
                reach = least + one_radii[i] + other_radii[j]
                if reach > 0.0 and way < reach * reach:
                    least = np.sqrt(way) - one_radii[i] - other_radii[j]
        out[s] = least
    return out
