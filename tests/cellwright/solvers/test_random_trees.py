from __future__ import annotations

import itertools

import numpy as np
import pytest

from cellwright.solvers.random_trees import connect_by_trees
from cellwright.solvers.roadmap import Roadmap, RoadmapSize
from tests.cellwright.solvers.flat_worlds import BoxWorld

BOX = np.full(2, -2.0), np.full(2, 2.0)
NARROW = [((-2.0, -0.1), (-0.06, 0.1)), ((0.0, -0.1), (2.0, 0.1))]
"""A wall with a gap of 60 mm."""
LOCKED_IN = [
    ((-1.0, -1.0), (1.0, -0.8)),
    ((-1.0, 0.8), (1.0, 1.0)),
    ((-1.0, -1.0), (-0.8, 1.0)),
    ((0.8, -1.0), (1.0, 1.0)),
]

TIGHTLY_LOCKED_IN = [
    ((-0.1, -0.1), (0.1, -0.05)),
    ((-0.1, 0.05), (0.1, 0.1)),
    ((-0.1, -0.1), (-0.05, 0.1)),
    ((0.05, -0.1), (0.1, 0.1)),
]


def connect(world, q_a, q_b, seed=0, n_most=3000):
    rng = np.random.default_rng(seed)
    return connect_by_trees(world, np.array(q_a), np.array(q_b), BOX, np.ones(2), step=0.02, n_most=n_most, rng=rng)


@pytest.mark.parametrize("seed", range(4))
def test_a_path_leads_through_a_narrow_gap_and_is_free(seed):
    world = BoxWorld(NARROW)
    path = connect(world, [-1.5, -1.5], [1.5, 1.5], seed)
    assert path[0].tolist() == [-1.5, -1.5] and path[-1].tolist() == [1.5, 1.5]
    assert not any(world.motion_collides(a, b, 0.02) for a, b in itertools.pairwise(path))
    assert np.abs(np.diff(path, axis=0)).max(axis=1).min() > 0.0


def test_a_free_straight_way_needs_few_nodes():
    world = BoxWorld([])
    path = connect(world, [-1.0, 0.0], [1.0, 0.5])
    assert path is not None and world.n_states < 1000


def test_what_is_locked_in_is_not_connected():
    world = BoxWorld(LOCKED_IN)
    assert connect(world, [0.0, 0.0], [1.5, 1.5], n_most=800) is None


@pytest.mark.parametrize("ends", [([0.0, 0.0], [1.5, 1.5]), ([1.5, 1.5], [0.0, 0.0])])
def test_what_is_tightly_locked_in_is_given_up_soon(ends):
    """In a cage narrower than one edge no node can stand; the other tree would grow to thousands."""
    world = BoxWorld(TIGHTLY_LOCKED_IN)
    assert connect(world, *ends, n_most=20_000) is None
    assert world.n_states < 20_000


def test_one_seed_gives_one_path():
    a, b = (connect(BoxWorld(NARROW), [-1.5, -1.5], [1.5, 1.5], seed=3) for _ in range(2))
    assert a.tobytes() == b.tobytes()


def test_a_path_that_is_sown_into_a_roadmap_connects_its_ends():
    world = BoxWorld(NARROW)
    path = connect(world, [-1.5, -1.5], [1.5, 1.5])
    size = RoadmapSize(n_nodes=0, n_batch=0, n_most=0)
    roadmap = Roadmap(world, *BOX, np.ones(2), size=size, rng=np.random.default_rng(0))
    assert roadmap.connect(path[0], path[-1], 0.02) is None
    roadmap.seed_path(path, 0.02)
    found = roadmap.connect(path[0], path[-1], 0.02)
    assert np.array_equal(found[[0, -1]], path[[0, -1]])
    assert not any(world.motion_collides(a, b, 0.02) for a, b in itertools.pairwise(found))
