"""Sample points on triangles: independent (rejection sampling) or evenly spaced (blue noise).

Rejection sampling, as Kaiser 2021 section 4.1 asks for: a face is proposed in proportion to its area, a point
uniformly in the parallelogram that the face is half of, and the point is rejected if it falls into the other half.

Blue noise by weighted sample elimination (Yuksel 2015, "Sample Elimination for Generating Poisson Disk Sample Sets"):
five times as many candidates as wanted are spread over the surface, and the most crowded is removed until the wanted
number is left. Points crowd each other unless their normals are more than 120 degrees apart, so that the two faces of a
thin wall are sampled independently. The number of samples is exact. Cost: n log n; 25,000 points take about a second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array, IntArray

OPPOSED = -0.5
"""Cosine between the normals of points that do not crowd each other: 120 degrees."""

_CANDIDATES_PER_SAMPLE = 5
"""Yuksel finds little gain beyond five candidates a sample."""
_EXPONENT = 8
_BETA, _GAMMA = 0.65, 1.5
"""Exponent of the weights and the two constants of the smallest counted distance, as published."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points on faces.

    Attributes:
        points: Positions, (n, 3) in m.
        face: Row of the triangle that carries the point, (n,), ascending.
    """

    points: FloatArray
    face: IntArray


def sample_randomly(triangles: FloatArray, n_samples: int, rng: np.random.Generator) -> SurfacePoints:
    """Draw independent, uniformly distributed points.

    Args:
        triangles: Corners, (faces, 3, 3) in m.
        n_samples: How many points.
        rng: Source of randomness.
    """
    cumulated = np.cumsum(_areas(triangles))
    face = np.empty(0, np.int64)
    weights = np.empty((0, 2))
    while len(face) < n_samples:
        n_proposed = 2 * (n_samples - len(face)) + 16  # half of the proposals are rejected
        proposed = np.searchsorted(cumulated, rng.random(n_proposed) * cumulated[-1], side="right")
        in_parallelogram = rng.random((n_proposed, 2))
        accepted = in_parallelogram.sum(axis=1) <= 1.0
        face = np.concatenate([face, np.minimum(proposed[accepted], len(triangles) - 1)])
        weights = np.concatenate([weights, in_parallelogram[accepted]])
    face, weights = face[:n_samples], weights[:n_samples]
    order = np.argsort(face, kind="stable")
    return SurfacePoints(_points(triangles, face[order], weights[order]), face[order])


def sample_blue_noise(
    triangles: FloatArray, normals: FloatArray, n_samples: int, rng: np.random.Generator
) -> SurfacePoints:
    """Choose evenly spaced points, exactly ``n_samples`` of them.

    Args:
        triangles: Corners, (faces, 3, 3) in m.
        normals: Unit normals of the faces, (faces, 3).
        n_samples: How many points.
        rng: Source of randomness.
    """
    from scipy.spatial import cKDTree

    areas = _areas(triangles)
    cumulated = np.cumsum(areas)
    n_candidates = _CANDIDATES_PER_SAMPLE * n_samples
    # one candidate in each of equal strips of the cumulated area: as uniform as independent ones, but less clumped
    strip = (np.arange(n_candidates) + rng.random(n_candidates)) / n_candidates
    face = np.minimum(np.searchsorted(cumulated, strip * cumulated[-1], side="right"), len(triangles) - 1)
    folded = rng.random((n_candidates, 2))
    beyond = folded.sum(axis=1) > 1.0
    folded[beyond] = 1.0 - folded[beyond]
    points = _points(triangles, face, folded)
    radius = widest_radius(float(cumulated[-1]), n_samples)
    pairs = cKDTree(points, balanced_tree=False).query_pairs(2 * radius, output_type="ndarray")
    same_side = np.einsum("ij,ij->i", normals[face[pairs[:, 0]]], normals[face[pairs[:, 1]]]) > OPPOSED
    kept = _eliminated(points, pairs[same_side], n_samples, radius)
    return SurfacePoints(points[kept], face[kept])


def widest_radius(area: float, n_samples: int) -> float:
    """Return half the distance of neighbours in the densest (hexagonal) packing of n points on an area, m."""
    return math.sqrt(area / (2.0 * math.sqrt(3.0) * n_samples))


def _eliminated(points: FloatArray, pairs: IntArray, n_samples: int, radius: float) -> BoolArray:
    n_candidates = len(points)
    least = radius * (1.0 - (n_samples / n_candidates) ** _GAMMA) * _BETA
    distance = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    weight = (1.0 - np.maximum(distance, 2.0 * least) / (2.0 * radius)).clip(0.0) ** _EXPONENT
    ends = np.concatenate([pairs[:, 0], pairs[:, 1]])
    order = np.lexsort((np.concatenate([pairs[:, 1], pairs[:, 0]]), ends))
    neighbour = np.concatenate([pairs[:, 1], pairs[:, 0]])[order].astype(np.int32)
    starts = np.searchsorted(ends[order], np.arange(n_candidates + 1))
    weights = np.concatenate([weight, weight])[order]
    return np.asarray(_eliminate(starts, neighbour, weights, n_candidates - n_samples))


@numba.njit(cache=True, nogil=True)
def _eliminate(starts: IntArray, neighbour: Int32Array, weight: FloatArray, n_remove: int) -> BoolArray:
    """Remove the most crowded candidates one by one, with a binary heap of their crowding; ties: the lowest row."""
    n = len(starts) - 1
    crowding = np.zeros(n)
    for i in range(n):
        for k in range(starts[i], starts[i + 1]):
            crowding[i] += weight[k]
    heap = np.arange(n)
    place = np.arange(n)
    size = n
    kept = np.ones(n, np.bool_)
    first = n // 2 - 1  # build the heap from the last parent up
    n_left = n_remove
    pending = neighbour[:0]
    while True:
        if first >= 0:
            item_place = first
            first -= 1
            n_pending = 0
        else:
            if n_left == 0:
                break
            n_left -= 1
            worst = heap[0]
            kept[worst] = False
            size -= 1
            heap[0] = heap[size]
            place[heap[0]] = 0
            place[worst] = -1
            pending = neighbour[starts[worst] : starts[worst + 1]]
            n_pending = len(pending)
            item_place = 0
        for turn in range(n_pending + 1):
            if turn > 0:
                i = pending[turn - 1]
                if place[i] < 0:
                    continue
                crowding[i] -= weight[starts[worst] + turn - 1]
                item_place = place[i]
            while True:  # crowding only falls, so an item only sinks
                child = 2 * item_place + 1
                if child >= size:
                    break
                a = heap[child]
                if child + 1 < size:
                    b = heap[child + 1]
                    if crowding[b] > crowding[a] or (crowding[b] == crowding[a] and b < a):
                        child += 1
                        a = b
                b = heap[item_place]
                if crowding[b] > crowding[a] or (crowding[b] == crowding[a] and b < a):
                    break
                heap[item_place], heap[child] = a, b
                place[a], place[b] = item_place, child
                item_place = child
    return kept


def _areas(triangles: FloatArray) -> FloatArray:
    sides = triangles[:, 1:] - triangles[:, :1]
    return np.asarray(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2)


def _points(triangles: FloatArray, face: IntArray, weights: FloatArray) -> FloatArray:
    corner = triangles[face]
    return np.asarray(
        corner[:, 0] + weights[:, :1] * (corner[:, 1] - corner[:, 0]) + weights[:, 1:] * (corner[:, 2] - corner[:, 0])
    )
