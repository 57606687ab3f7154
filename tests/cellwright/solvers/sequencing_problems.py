"""Small and large sequencing problems for tests and benchmarks, and the answers of brute force."""

from __future__ import annotations

import itertools

import numpy as np

from cellwright.solvers.gtsp.problem import SequencingProblem

PAPER_ALTERNATIVES = (6, 8, 16, 22, 27, 18, 10, 16, 20, 30, 16, 36, 16, 13, 16, 9, 9, 7, 6, 6)
"""Alternatives of the twenty studs, Bjorkenstam 2014, table 1."""
PAPER_COSTS = (
    (41.16, 41.44), (79.11, 80.73), (110.8, 223.3), (95.69, 240.0), (33.78, 330.0), (58.36, 339.6), (240.8, 350.8),
    (176.9, 448.6), (89.64, 307.2), (48.63, 282.2), (35.49, 295.5), (50.55, 471.6), (73.29, 228.7), (140.1, 447.8),
    (44.07, 417.3), (173.1, 324.9), (181.1, 329.3), (174.5, 181.5), (241.5, 242.5), (222.9, 223.3),
)  # fmt: skip
"""Range of the welding costs of each stud, from the same table."""
SPEEDS = np.array([1.5, 1.4, 1.6, 3.0, 3.0, 4.0])
"""Joint speeds of a heavy six-axis arm, rad/s."""


def groups(sizes):
    first = np.concatenate([[0], np.cumsum(sizes)])
    return tuple(np.arange(a, b) for a, b in itertools.pairwise(first))


def configurations(rng, sizes):
    """A few inverse-kinematics branches for each task, and free rotation about the tool within each."""
    found = []
    for size in sizes:
        branches = rng.uniform(-2, 2, (max(1, size // 4), 6))
        found.append(branches[rng.integers(len(branches), size=size)] + rng.normal(0, 0.6, (size, 6)))
    return np.concatenate(found)


def robot_problem(seed, sizes=PAPER_ALTERNATIVES, *, service=True, noise=0.5, scale=60.0, **rest):
    """Travel costs that are the slowest joint's time and up to ``noise`` more; welding costs from the paper's ranges.

    Returns the problem with the true costs, and its costs' lower bounds.
    """
    rng = np.random.default_rng(seed)
    q = configurations(rng, sizes)
    least = scale * (np.abs(q[:, None] - q[None]) / SPEEDS).max(-1)
    cost = least * (1.0 + noise * rng.random(least.shape))
    own = [rng.uniform(*PAPER_COSTS[i % len(PAPER_COSTS)], size) for i, size in enumerate(sizes)]
    weld = np.concatenate(own) if service else np.zeros(len(q))
    return SequencingProblem(cost, groups(sizes), weld, **rest), least


def plane_problem(seed, n_clusters, n_alternatives, *, spread=60.0, **rest):
    """Rounded distances between points around random centres of a square of side 1000; infinite spread: anywhere."""
    rng = np.random.default_rng(seed)
    centre = np.repeat(rng.uniform(0, 1000, (n_clusters, 2)), n_alternatives, axis=0)
    points = centre + rng.normal(0, spread, centre.shape) if np.isfinite(spread) else rng.uniform(0, 1000, centre.shape)
    distance = np.sqrt(((points[:, None] - points[None]) ** 2).sum(-1))
    return SequencingProblem(np.floor(distance + 0.5), groups([n_alternatives] * n_clusters), **rest)


def uniform_problem(seed, sizes, *, share_missing=0.0, service=False, **rest):
    """Costs without any structure, some ways missing."""
    rng = np.random.default_rng(seed)
    m = sum(sizes)
    cost = rng.uniform(0, 100, (m, m))
    cost[rng.random((m, m)) < share_missing] = np.inf
    return SequencingProblem(cost, groups(sizes), rng.uniform(0, 50, m) if service else np.zeros(m), **rest)


def brute_force(problem):
    """The least cost of any sequence that respects the problem, infinite if there is none."""
    least = np.inf
    for order in itertools.permutations(range(problem.n_clusters)):
        if problem.closed and problem.start is None and order[0] != 0:
            continue
        for nodes in itertools.product(*(problem.clusters[i].tolist() for i in order)):
            if problem.violation(nodes) is None:
                least = min(least, problem.cost_of(nodes))
    return least
