"""Small worlds whose answers are known: a point among boxes, and a planar arm among discs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra


@dataclass
class BoxWorld:
    """A point in the plane (or space) among boxes ``(low, high)``; counts the states it is asked about."""

    boxes: list[tuple[tuple[float, ...], tuple[float, ...]]]
    n_states: int = field(default=0)

    def collides(self, q):
        self.n_states += 1
        return any(np.all(q >= low) and np.all(q <= high) for low, high in self.boxes)

    def first_colliding(self, states):
        return next((row for row, q in enumerate(states) if self.collides(q)), -1)

    def motion_collides(self, q_a, q_b, step):
        n = int(np.ceil(np.abs(q_b - q_a).max() / step)) + 1
        return any(self.collides(q) for q in np.linspace(q_a, q_b, max(n, 2)))


@dataclass
class PlanarArm:
    """Two links of length 1 among discs ``(x, y, radius)``; free if no point of a link lies in a disc."""

    discs: list[tuple[float, float, float]]

    def collides(self, q):
        elbow = np.array([np.cos(q[0]), np.sin(q[0])])
        tip = elbow + np.array([np.cos(q[0] + q[1]), np.sin(q[0] + q[1])])
        return any(
            _distance(np.array([x, y]), a, b) <= radius
            for x, y, radius in self.discs
            for a, b in ((np.zeros(2), elbow), (elbow, tip))
        )

    def first_colliding(self, states):
        return next((row for row, q in enumerate(states) if self.collides(q)), -1)

    def motion_collides(self, q_a, q_b, step):
        n = int(np.ceil(np.abs(q_b - q_a).max() / step)) + 1
        return any(self.collides(q) for q in np.linspace(q_a, q_b, max(n, 2)))


def grid_distance(world, lower, upper, q_a, q_b, n):
    """Shortest way on an n x n grid in the chessboard metric (both speeds 1); infinite if there is none."""
    axes = [np.linspace(low, high, n) for low, high in zip(lower, upper, strict=True)]
    free = np.array([[not world.collides(np.array([x, y])) for y in axes[1]] for x in axes[0]])
    number = np.arange(n * n).reshape(n, n)
    rows, columns, lengths = [], [], []
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = np.s_[max(0, -dx) : n - max(0, dx), max(0, -dy) : n - max(0, dy)]
        b = np.s_[max(0, dx) : n - max(0, -dx), max(0, dy) : n - max(0, -dy)]
        both = free[a] & free[b]
        rows.append(number[a][both])
        columns.append(number[b][both])
        lengths.append(np.full(both.sum(), max(dx * (axes[0][1] - axes[0][0]), abs(dy) * (axes[1][1] - axes[1][0]))))
    graph = coo_array(
        (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), shape=(n * n, n * n)
    ).tocsr()
    source, target = (
        number[tuple(int(np.abs(axis - x).argmin()) for axis, x in zip(axes, q, strict=True))] for q in (q_a, q_b)
    )
    return float(dijkstra(graph, directed=False, indices=source)[target])


def _distance(p, a, b):
    along = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return float(np.linalg.norm(p - a - along * (b - a)))
