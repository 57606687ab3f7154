from __future__ import annotations

import itertools

import numpy as np
import pytest

from cellwright.solvers.roadmap import Roadmap, RoadmapSize, travel_time
from tests.cellwright.solvers.flat_worlds import BoxWorld, PlanarArm, grid_distance

LOWER, UPPER, SPEED = np.full(2, -2.0), np.full(2, 2.0), np.ones(2)
STEP = 0.02
MAZE = [((-2.0, -0.6), (1.2, -0.4)), ((-1.2, 0.4), (2.0, 0.6))]
CLOSED_ROOM = [
    ((-1.0, 0.5), (1.0, 0.6)),
    ((-1.0, -0.6), (1.0, -0.5)),
    ((-1.0, -0.6), (-0.9, 0.6)),
    ((0.9, -0.6), (1.0, 0.6)),
]


def roadmap(world, *, seed=0, **size):
    return Roadmap(
        world,
        LOWER,
        UPPER,
        SPEED,
        size=RoadmapSize(**size),
        rng=np.random.default_rng(seed),
    )


def length(path):
    return float(travel_time(path[:-1], path[1:], SPEED).sum())


def test_a_free_straight_motion_is_taken_without_any_node():
    planner = roadmap(BoxWorld([]))
    path = planner.connect(np.array([-1.0, 0.0]), np.array([1.0, 0.5]), STEP)
    assert np.array_equal(path, [[-1.0, 0.0], [1.0, 0.5]])
    assert planner.n_nodes == 0


@pytest.mark.parametrize("seed", range(4))
def test_a_way_through_the_maze_is_free_and_little_longer_than_a_grid_search_finds(seed):
    world = BoxWorld(MAZE)
    q_a, q_b = np.array([-1.8, -1.8]), np.array([1.8, 1.8])
    path = roadmap(world, seed=seed).connect(q_a, q_b, STEP)
    shortest = grid_distance(world, LOWER, UPPER, q_a, q_b, 121)
    assert np.array_equal(path[[0, -1]], [q_a, q_b])
    assert not any(world.motion_collides(a, b, 0.02) for a, b in itertools.pairwise(path))
    assert shortest * 0.95 <= length(path) <= shortest * 1.35


@pytest.mark.parametrize("seed", range(3))
def test_a_planar_arm_finds_a_way_exactly_where_a_grid_search_does(seed):
    rng = np.random.default_rng(seed)
    lower, upper = np.full(2, -3.0), np.full(2, 3.0)
    found = []
    for _ in range(6):
        discs = [(*rng.uniform(-2, 2, 2), 0.3) for _ in range(3)]
        world = PlanarArm([disc for disc in discs if np.hypot(*disc[:2]) > 0.5])
        q_a, q_b = rng.uniform(lower, upper, (2, 2))
        if world.collides(q_a) or world.collides(q_b):
            continue
        planner = Roadmap(world, lower, upper, SPEED, size=RoadmapSize(300, 150, 900), rng=np.random.default_rng(seed))
        path = planner.connect(q_a, q_b, STEP)
        shortest = grid_distance(world, lower, upper, q_a, q_b, 81)
        found.append(path is not None)
        assert found[-1] == np.isfinite(shortest)
    assert found


def test_no_way_out_of_a_closed_room_is_found_and_the_roadmap_stops_growing():
    planner = roadmap(BoxWorld(CLOSED_ROOM), n_nodes=100, n_batch=50, n_most=200)
    inside, outside = np.zeros(2), np.array([1.8, 1.8])
    assert planner.connect(inside, outside, STEP) is None
    assert planner.n_nodes <= 200 + 2
    nodes = planner.n_nodes
    assert planner.connect(inside, outside, STEP) is None
    assert planner.n_nodes == nodes


def test_what_a_check_found_is_remembered_by_later_queries():
    world = BoxWorld(MAZE)
    planner = roadmap(world)
    q_a, q_b = np.array([-1.8, -1.8]), np.array([1.8, 1.8])
    first = planner.connect(q_a, q_b, STEP)
    checked = planner.n_checked_edges
    assert checked > 0
    assert np.array_equal(planner.connect(q_a, q_b, STEP), first)
    assert planner.n_checked_edges == checked


def test_only_edges_on_best_paths_are_checked():
    planner = roadmap(BoxWorld(MAZE))
    planner.connect(np.array([-1.8, -1.8]), np.array([1.8, 1.8]), STEP)
    assert planner.n_checked_edges < 0.2 * planner.n_nodes * 12 / 2


def test_thin_walls_that_coarse_steps_missed_are_respected_by_finer_queries_on_the_same_roadmap():
    world = BoxWorld([((-2.0, -0.005), (1.0, 0.005))])
    planner = roadmap(world, n_nodes=200)
    q_a, q_b = np.array([-1.0, -1.01]), np.array([-1.0, 1.0])
    assert len(planner.connect(q_a, q_b, 0.16)) == 2
    path = planner.connect(q_a, q_b, 0.0025)
    assert not any(world.motion_collides(a, b, 0.0025) for a, b in itertools.pairwise(path))
    assert path[:, 0].max() > 1.0


def test_a_seed_gives_one_result():
    q_a, q_b = np.array([-1.8, -1.8]), np.array([1.8, 1.8])
    paths = [roadmap(BoxWorld(MAZE), seed=5).connect(q_a, q_b, STEP) for _ in range(2)]
    assert paths[0].tobytes() == paths[1].tobytes()
