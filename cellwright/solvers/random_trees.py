"""Find one collision-free joint motion where a roadmap finds none: two random trees that grow towards each other.

RRT-Connect (Kuffner and LaValle 2000): one tree takes a step towards a random configuration, the other then walks
towards the new node until something is in its way; then they change places. A tree that starts in a narrow place
follows it outwards, which random nodes of a roadmap rarely hit. Nodes are tried up to a limit: no path found proves
nothing. Deterministic for a given generator; cost of a node about that of one checked edge.
"""

from __future__ import annotations

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.roadmap import CollisionChecker

LONGEST_EDGE = 0.3
"""Rad of the fastest joint: short enough to turn in narrow places, long enough to leave them soon."""
HOPELESS, FEWEST = 300, 8
"""Tries after which a tree of fewer nodes is taken as locked in."""
NEAR_SHARE = 0.25
"""Share of random configurations drawn near the first end: its surroundings are what is narrow."""
NEAR_SPREAD = 0.5
"""Rad, standard deviation of those."""


class _Tree:
    """Nodes with room for more, and the parent of each."""

    def __init__(self, root: FloatArray, room: int) -> None:
        self.nodes = np.empty((room + 1, len(root)))
        self.parent = np.full(room + 1, -1)
        self.nodes[0] = root
        self.count = 1

    def nearest(self, q: FloatArray, speed: FloatArray) -> int:
        return int(np.argmin(np.max(np.abs(self.nodes[: self.count] - q) / speed, axis=1)))

    def add(self, q: FloatArray, parent: int) -> int:
        self.nodes[self.count], self.parent[self.count] = q, parent
        self.count += 1
        return self.count - 1

    def path_to(self, node: int) -> list[FloatArray]:
        """Return the nodes from the root to ``node``."""
        found = []
        while node >= 0:
            found.append(self.nodes[node].copy())
            node = int(self.parent[node])
        return found[::-1]


def connect_by_trees(
    checker: CollisionChecker,
    q_a: FloatArray,
    q_b: FloatArray,
    box: tuple[FloatArray, FloatArray],
    speed: FloatArray,
    *,
    step: float,
    n_most: int,
    rng: np.random.Generator,
) -> FloatArray | None:
    """Return a free path (points, joints) from ``q_a`` to ``q_b``, ``None`` if ``n_most`` nodes did not find one.

    Args:
        checker: What motions are checked with, every ``step`` rad of the fastest joint.
        q_a, q_b: Ends, (joints,) in rad, taken as free; random nodes are drawn near ``q_a`` more often.
        box: Lower and upper joint positions between which nodes may lie.
        speed: Joint speeds, which weigh distances, rad/s.
        step: Largest turn of any joint between two checked states, rad.
        n_most: Most nodes of both trees together.
        rng: Source of the random configurations.
    """
    own, other = _Tree(q_a, n_most), _Tree(q_b, n_most)
    grown_from_a = True
    lower, upper = box
    for number in range(2 * n_most):
        locked_in = number >= HOPELESS and min(own.count, other.count) < FEWEST
        if locked_in or own.count + other.count >= n_most:
            return None
        wanted = rng.uniform(lower, upper)
        if rng.random() < NEAR_SHARE:
            wanted = np.clip(q_a + rng.normal(0.0, NEAR_SPREAD, len(q_a)), lower, upper)
        near = own.nearest(wanted, speed)
        q = _towards(own.nodes[near], wanted)
        if not checker.motion_collides(own.nodes[near], q, step):
            new = own.add(q, near)
            met = _walk(checker, other, q, speed, step, n_most - own.count)
            if met is not None:
                halves = own.path_to(new), other.path_to(met)
                first, second = halves if grown_from_a else halves[::-1]
                return np.stack([*first, *second[-2::-1]])
        own, other, grown_from_a = other, own, not grown_from_a
    return None


def _walk(
    checker: CollisionChecker, tree: _Tree, goal: FloatArray, speed: FloatArray, step: float, n_most: int
) -> int | None:
    """Grow a tree straight towards ``goal`` until it is there or something is in the way; return the node there."""
    node = tree.nearest(goal, speed)
    while not np.array_equal(tree.nodes[node], goal):
        q = _towards(tree.nodes[node], goal)
        if tree.count >= n_most or checker.motion_collides(tree.nodes[node], q, step):
            return None
        node = tree.add(q, node)
    return node


def _towards(q: FloatArray, goal: FloatArray) -> FloatArray:
    """Return the configuration on the way to ``goal`` that is at most one edge away."""
    furthest = float(np.abs(goal - q).max())
    return goal if furthest <= LONGEST_EDGE else q + LONGEST_EDGE / furthest * (goal - q)
