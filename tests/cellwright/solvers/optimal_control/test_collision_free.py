from __future__ import annotations

import itertools

import numpy as np
import pytest

from cellwright.cell.cell import Cell
from cellwright.cell.scene import Scene
from cellwright.solvers.motion_steps import MovingCorners, link_poses_of
from cellwright.solvers.optimal_control.clearance_boxes import clearance_boxes, joint_weights
from cellwright.solvers.optimal_control.collision_free import AvoidanceParams, avoid, collision_on, nodes_of
from tests.cellwright.cell.cells import scanning_cell
from tests.cellwright.solvers.optimal_control.planar_arm import planar_cell, planar_path, planar_program

CLEARANCE = 0.01
CELL = planar_cell()
CORNERS = MovingCorners.of(CELL)


def dense_distance(scene: Scene, q: np.ndarray) -> float:
    between = np.concatenate([np.linspace(a, b, 5) for a, b in itertools.pairwise(q)])
    return min(scene.distance(each) for each in between)


def test_the_rounds_lower_the_cost_and_keep_the_clearance() -> None:
    scene = Scene(CELL, CLEARANCE)
    path = planar_path(scene)
    found = avoid(planar_program(), scene, CORNERS, path)
    assert found.converged and len(found.stages) >= 3
    costs = [stage.motion.curve.cost for stage in found.stages]
    assert costs == sorted(costs, reverse=True)
    assert found.motion is not None and found.motion.curve.cost == costs[-1] < 0.985 * costs[0]
    for stage in found.stages:
        nodes, curve = stage.motion.discrete.q, stage.motion.curve.motion
        assert (nodes >= stage.lower - 1e-12).all() and (nodes <= stage.upper + 1e-12).all()
        # checked by distances at other states than the dense check's own
        assert dense_distance(scene, curve.position) > CLEARANCE - 2e-4
        np.testing.assert_array_equal(curve.position[[0, -1]], path.position[[0, -1]])


def test_every_motion_of_a_box_keeps_the_clearance_where_the_bound_is_exact_enough() -> None:
    scene = Scene(CELL, CLEARANCE)
    nodes = nodes_of(planar_path(scene), 20)
    lower, upper = clearance_boxes(scene, CORNERS, nodes)
    rng = np.random.default_rng(0)
    for node, low, high in zip(nodes, lower, upper):
        phi = scene.distance(node)
        for q in rng.uniform(low, high, (5, 2)):
            # first order: a box uses up at most the clearance above d_c, and its curvature is a small share of that
            assert scene.distance(q) >= CLEARANCE - 0.1 * (phi - CLEARANCE) ** 2 - 1e-9


@pytest.mark.parametrize("cell", [CELL, scanning_cell()])
def test_weights_bound_how_far_any_point_moves(cell: Cell) -> None:
    corners, chain = MovingCorners.of(cell), cell.robot.chain
    rng, h = np.random.default_rng(1), 1e-6
    q = rng.uniform(-1.0, 1.0, (4, chain.n_joints))
    weights = joint_weights(corners, q)
    for joint in range(chain.n_joints):
        step = np.zeros(chain.n_joints)
        step[joint] = h
        moved = np.zeros(len(q))
        before, after = link_poses_of(chain, q), link_poses_of(chain, q + step)
        for link, p in zip(corners.link.astype(int), corners.p_link):
            way = (after - before)[:, link, :3] @ np.append(p, 1.0)
            moved = np.maximum(moved, np.abs(way).sum(axis=1) / h)
        np.testing.assert_allclose(weights[:, :, joint].max(axis=0), moved, rtol=1e-4, atol=1e-6)


def test_without_room_a_box_is_its_node() -> None:
    scene = Scene(CELL, 0.5)  # more than there is anywhere near the posts
    q = np.array([[0.2, 1.0]])
    lower, upper = clearance_boxes(scene, CORNERS, q)
    assert scene.distance(q[0]) < 0.5
    np.testing.assert_array_equal(lower, upper)


def test_a_path_that_collides_gives_no_motion_but_the_reason() -> None:
    scene = Scene(CELL, CLEARANCE)
    through = planar_path(Scene(CELL, 0.0))
    straight = type(through)(np.array([0.0, 2.0]), through.position[[0, -1]], np.zeros((2, 2)), np.zeros((2, 2)))
    params = AvoidanceParams(most_halvings=1)
    assert collision_on(scene, CORNERS, straight, params) is not None
    found = avoid(planar_program(), scene, CORNERS, straight, params)
    assert not found.converged and found.motion is None and found.stages == []
    assert "collides between nodes" in found.fault or "solver stopped" in found.fault


def test_the_size_of_the_problem_does_not_depend_on_the_geometry() -> None:
    program = planar_program()
    sizes = len(program._cold.lower), len(program._cold.low)
    for clearance in (0.0, 0.02):
        scene = Scene(CELL, clearance)
        assert avoid(program, scene, CORNERS, planar_path(scene)).converged
        assert (len(program._cold.lower), len(program._cold.low)) == sizes


@pytest.mark.parametrize("cell", [CELL, scanning_cell()])
def test_what_separates_the_pairs_is_least_what_separates_the_bodies(cell: Cell) -> None:
    scene = Scene(cell)
    inner, outer = scene.pair_links.T
    assert (inner < outer).all() and outer.max() <= cell.robot.n_joints
    for q in np.random.default_rng(3).uniform(-1.5, 1.5, (20, cell.robot.n_joints)):
        exact = scene.pair_distances(q, np.inf)
        assert exact.min() == pytest.approx(scene.distance(q), abs=1e-9)
        rough = scene.pair_distances(q, 0.1)
        assert (rough <= exact + 1e-9).all()
        near = exact < 0.1
        np.testing.assert_allclose(rough[near], exact[near])
        # joints up to the inner link move both bodies alike: their distance stays
        turned = q.copy()
        turned[0] += 0.3
        fixed_to_each_other = inner > 0
        again = scene.pair_distances(turned, np.inf)
        np.testing.assert_allclose(again[fixed_to_each_other], exact[fixed_to_each_other], atol=1e-6)
