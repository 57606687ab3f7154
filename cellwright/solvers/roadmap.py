"""Find collision-free joint motions by one lazy probabilistic roadmap that serves all queries.

After Bohlin and Kavraki (2000): random free configurations are joined to their nearest neighbours, but an edge
is checked only when it lies on the shortest path of a query, from both ends of the path inwards; what a check
found is kept for all later queries. Edge lengths are the times that the slowest joint needs at full speed. When
no path is left, nodes are added, half of them around edges that collided, up to a limit: then the answer is that
no path was found, which is a proof only in the limit of many nodes. Deterministic for a given generator.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array


class CollisionChecker(Protocol):
    """What planning asks of a scene."""

    def collides(self, q: FloatArray, /) -> bool:
        """Whether the robot collides at ``q`` (joints,) in rad."""
        ...

    def first_colliding(self, states: FloatArray, /) -> int:
        """Return the first of many states (n, joints) in rad that collides, -1 if none does."""
        ...

    def motion_collides(self, q_a: FloatArray, q_b: FloatArray, step: float, /) -> bool:
        """Whether any state on the straight joint motion does, checked every ``step`` rad of the fastest joint."""
        ...


@dataclass(frozen=True)
class RoadmapSize:
    """How many nodes a roadmap starts with, adds at a time and may have, and neighbours that a node is joined to."""

    n_nodes: int = 600
    n_batch: int = 300
    n_most: int = 3000
    n_neighbours: int = 12


def travel_time(q_a: FloatArray, q_b: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the time that the slowest joint needs at its ``speed``, (...) of (..., joints)."""
    return np.asarray(np.max(np.abs(q_b - q_a) / speed, axis=-1))


class Roadmap:
    """A roadmap in the box ``lower`` to ``upper`` (joints,) in rad; queries extend and sharpen it.

    Attributes:
        n_checked_edges: Edges checked so far, for reports.
    """

    def __init__(
        self,
        checker: CollisionChecker,
        lower: FloatArray,
        upper: FloatArray,
        speed: FloatArray,
        *,
        size: RoadmapSize,
        rng: np.random.Generator,
    ) -> None:
        self._checker, self._size, self._rng = checker, size, rng
        self._lower, self._upper, self._speed = lower, upper, speed
        self._nodes = np.empty((0, len(lower)))
        self._ends = np.empty((0, 2), np.int32)
        self._blocked = np.empty(0, bool)
        self._checked_at = np.empty(0)  # the finest step at which an edge was found free
        self._length = np.empty(0)
        self._blocked_at: list[FloatArray] = []
        self._rows: tuple[Int32Array, Int32Array] | None = None
        self._random_nodes = 0
        self._terminals: dict[bytes, int] = {}
        self.n_checked_edges = 0

    @property
    def n_nodes(self) -> int:
        """The number of nodes, terminals of queries among them."""
        return len(self._nodes)

    def seed(self, nodes: FloatArray) -> None:
        """Add those of ``nodes`` (n, joints) that are free: places through which paths are likely to lead."""
        free = [q for q in nodes if not self._checker.collides(q)]
        if free:
            self._join(np.stack(free))

    def seed_path(self, path: FloatArray, step: float) -> None:
        """Add a path (points, joints) that was found free in steps of ``step`` rad; its ends become terminals."""
        inner = np.arange(len(path) - 2) + len(self._nodes)
        if len(inner):
            self._join(path[1:-1])
        nodes = [self._terminal(path[0]), *inner.tolist(), self._terminal(path[-1])]
        pairs = np.sort(np.stack([nodes[:-1], nodes[1:]], axis=1), axis=1).astype(np.int32)
        length = travel_time(self._nodes[pairs[:, 0]], self._nodes[pairs[:, 1]], self._speed)
        self._add_edges(pairs, length, np.full(len(pairs), step))

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """The joint positions between which its nodes lie."""
        return self._lower, self._upper

    def connect(self, q_a: FloatArray, q_b: FloatArray, step: float) -> FloatArray | None:
        """Return a free path (points, joints) from ``q_a`` to ``q_b``, ``None`` if none was found.

        Motions are checked every ``step`` rad of the fastest joint; those that were found free in coarser steps
        are checked again. The straight motion is tried first. Both ends are taken as free.
        """
        if not self._checker.motion_collides(q_a, q_b, step):
            return np.stack([q_a, q_b])
        if self._random_nodes == 0:
            self._grow(self._size.n_nodes)
        a, b = self._terminal(q_a), self._terminal(q_b)
        while True:
            path = self._free_path(a, b, step)
            if path is not None:
                return self._nodes[path]
            if self._random_nodes >= self._size.n_most:
                return None
            self._grow(min(self._size.n_batch, self._size.n_most - self._random_nodes))

    def _free_path(self, a: int, b: int, step: float) -> Int32Array | None:
        while True:
            first, edge_of = self._adjacency()
            path, edges = _shortest_path(
                self._nodes, self._speed, self._ends, self._length, self._blocked, first, edge_of, a, b
            )
            if len(path) == 0:
                return None
            # terminals sit in the tightest places: edges at the ends of the path are the likeliest to collide
            order = sorted(range(len(edges)), key=lambda i: (min(i, len(edges) - 1 - i), i))
            if all(self._is_free(int(edges[i]), step) for i in order):
                return np.asarray(path)

    def _is_free(self, edge: int, step: float) -> bool:
        if not self._blocked[edge] and self._checked_at[edge] > step:
            q_a, q_b = self._nodes[self._ends[edge]]
            self.n_checked_edges += 1
            if self._checker.motion_collides(q_a, q_b, step):
                self._blocked[edge] = True
                self._blocked_at.append(0.5 * (q_a + q_b))
            else:
                self._checked_at[edge] = step
        return not self._blocked[edge]

    def _grow(self, count: int) -> None:
        """Add ``count`` free random nodes: uniform, and once edges have collided, half of them near those."""
        span = self._upper - self._lower
        found: list[FloatArray] = []
        for _ in range(200 * count):
            q = self._rng.uniform(self._lower, self._upper)
            if self._blocked_at and len(found) % 2:
                seed = self._blocked_at[int(self._rng.integers(len(self._blocked_at)))]
                q = np.clip(seed + self._rng.normal(0.0, 0.1, len(q)) * span, self._lower, self._upper)
            if not self._checker.collides(q):
                found.append(q)
                if len(found) == count:
                    break
        self._random_nodes += count
        if found:
            self._join(np.stack(found))

    def _terminal(self, q: FloatArray) -> int:
        key = np.ascontiguousarray(q, float).tobytes()
        if key not in self._terminals:
            self._terminals[key] = len(self._nodes)
            self._join(q[None])
        return self._terminals[key]

    def _join(self, new: FloatArray) -> None:
        """Add nodes and an edge from each to its nearest nodes, old or new."""
        from scipy.spatial import cKDTree

        n_old = len(self._nodes)
        self._nodes = np.concatenate([self._nodes, new])
        tree = cKDTree(self._nodes / self._speed)
        n_near = min(self._size.n_neighbours + 1, len(self._nodes))
        _, near = tree.query(new / self._speed, k=np.arange(1, n_near + 1), p=np.inf)
        own = np.repeat(np.arange(n_old, len(self._nodes)), near.shape[1])
        pairs = np.stack([np.minimum(own, near.ravel()), np.maximum(own, near.ravel())], axis=1)
        pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0).astype(np.int32)
        length = travel_time(self._nodes[pairs[:, 0]], self._nodes[pairs[:, 1]], self._speed)
        self._add_edges(pairs, length, np.full(len(pairs), np.inf))

    def _add_edges(self, pairs: Int32Array, length: FloatArray, checked_at: FloatArray) -> None:
        self._ends = np.concatenate([self._ends, pairs])
        self._length = np.concatenate([self._length, length])
        self._blocked = np.concatenate([self._blocked, np.zeros(len(pairs), bool)])
        self._checked_at = np.concatenate([self._checked_at, checked_at])
        self._rows = None

    def _adjacency(self) -> tuple[Int32Array, Int32Array]:
        """Return for each node the first of its rows, and for each row its edge."""
        if self._rows is None:
            node = self._ends.T.ravel()
            order = np.argsort(node, kind="stable")
            first = np.searchsorted(node[order], np.arange(len(self._nodes) + 1)).astype(np.int32)
            self._rows = first, (order % len(self._ends)).astype(np.int32)
        return self._rows


@numba.njit(cache=True, nogil=True)
def _shortest_path(
    nodes: FloatArray,
    speed: FloatArray,
    ends: Int32Array,
    length: FloatArray,
    blocked: BoolArray,
    first: Int32Array,
    edge_of: Int32Array,
    source: int,
    target: int,
) -> tuple[Int32Array, Int32Array]:
    """A* over edges that are not blocked: nodes and edges from source to target, empty if there is no path."""
    n = len(nodes)
    estimate = np.zeros(n)
    for i in range(n):
        for j in range(nodes.shape[1]):
            estimate[i] = max(estimate[i], abs(nodes[i, j] - nodes[target, j]) / speed[j])
    distance = np.full(n, np.inf)
    via = np.full(n, -1, np.int32)
    closed = np.zeros(n, np.bool_)
    distance[source] = 0.0
    heap: list[tuple[float, int]] = [(estimate[source], source)]
    while len(heap) > 0:
        _, node = heapq.heappop(heap)
        if closed[node]:
            continue
        closed[node] = True
        if node == target:
            break
        for row in range(first[node], first[node + 1]):
            edge = edge_of[row]
            if blocked[edge]:
                continue
            other = ends[edge, 0] + ends[edge, 1] - node
            reached = distance[node] + length[edge]
            if reached < distance[other]:
                distance[other] = reached
                via[other] = edge
                heapq.heappush(heap, (reached + estimate[other], int(other)))
    count = 0
    node = target
    while closed[target] and node != source:
        node = ends[via[node], 0] + ends[via[node], 1] - node
        count += 1
    path = np.empty(count + 1 if closed[target] else 0, np.int32)
    edges = np.empty(count, np.int32)
    node = target
    for i in range(count, 0, -1):
        path[i] = node
        edges[i - 1] = via[node]
        node = ends[via[node], 0] + ends[via[node], 1] - node
    if closed[target]:
        path[0] = source
    return path, edges
