"""Spheres from a point cloud by k-means clustering, as Baumgaertner 2025 makes collision hulls (section 3, figure 3).

Seeds by k-means++ (Arthur & Vassilvitskii 2007), then Lloyd's iteration. A sphere stands about the mean of each
cluster; its radius is the distance of the cluster's furthest point, so the spheres hold the whole cloud. They hold the
body only as far as the cloud does: `cellwright.solvers.spheres.certificate` finds and closes what is left.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray

N_ROUNDS = 25
"""Lloyd's iteration is stopped after so many rounds if it has not settled: the cost hardly falls any more."""


def cluster_spheres(
    cloud: FloatArray, n_spheres: int, generator: np.random.Generator, *, n_rounds: int = N_ROUNDS
) -> tuple[FloatArray, FloatArray]:
    """Return centres (k, 3) and radii (k,) of spheres that hold a cloud (n, 3), in its unit."""
    from scipy.spatial import cKDTree

    centres = _seeds(cloud, n_spheres, generator)
    nearest = np.full(len(cloud), -1)
    for _ in range(n_rounds):
        moved = np.asarray(cKDTree(centres).query(cloud)[1])
        if np.array_equal(moved, nearest):
            break
        nearest = moved
        size = np.bincount(nearest, minlength=n_spheres)
        total = np.stack([np.bincount(nearest, cloud[:, k], n_spheres) for k in range(3)], axis=1)
        # a cluster that has lost all its points keeps its centre
        centres = np.where(size[:, None] > 0, total / np.maximum(size, 1)[:, None], centres)
    distance, nearest = cKDTree(centres).query(cloud)
    radii = np.zeros(n_spheres)
    np.maximum.at(radii, nearest, distance)
    return centres, radii


def _seeds(cloud: FloatArray, n_spheres: int, generator: np.random.Generator) -> FloatArray:
    seeds = np.empty((n_spheres, 3))
    seeds[0] = cloud[generator.integers(len(cloud))]
    way = ((cloud - seeds[0]) ** 2).sum(axis=1)
    for row in range(1, n_spheres):
        cumulated = np.cumsum(way)
        drawn = np.searchsorted(cumulated, generator.random() * cumulated[-1], side="right")
        seeds[row] = cloud[min(int(drawn), len(cloud) - 1)]
        way = np.minimum(way, ((cloud - seeds[row]) ** 2).sum(axis=1))
    return seeds
