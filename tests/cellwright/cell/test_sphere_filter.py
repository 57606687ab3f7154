from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cellwright.cell.bodies import Body, Box
from cellwright.cell.cell import Cell
from cellwright.cell.robot import Robot
from cellwright.cell.scene import Scene
from cellwright.cell.sphere_filter import greatest_shift, sphere_filter
from cellwright.cell.transforms import pose
from cellwright.cell.urdf_geometry import collision_bodies, meshes_in
from cellwright.solvers.state_tests import CLEAR, COLLIDING, UNDECIDED
from cellwright.solvers.sweeps.states import classify_sweep
from tests.cellwright.cell.cells import at, bumpy_part, cell_of, scanning_cell
from tests.cellwright.cell.robots import published_crx

CLEARANCE = 0.005


@cache
def ur10e_at_a_part() -> Cell:
    T = pose(np.array([0.1, -0.2, 0.05]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    return scanning_cell(T).with_part(bumpy_part(3), at(0.7, 0.1, 0.3))


@cache
def crx_at_a_part() -> Cell:
    urdf, folder = published_crx()
    robot = Robot.from_urdf(urdf)
    bodies = collision_bodies(robot, meshes_in(folder))
    housing = Body("housing", Box((0.1, 0.08, 0.1)), 6, robot.chain.T_last_flange @ at(0, 0, 0.05))
    return cell_of(robot, (*bodies, housing)).with_part(bumpy_part(3), at(0.5, 0.0, 0.5))


CELLS = {"ur10e": ur10e_at_a_part, "crx10ia/l": crx_at_a_part}


def state_at(cell: Cell, arrays, q):
    """The filter's answer for one configuration, as a sweep of one pose."""
    chain = cell.robot.chain
    status, blocker = np.empty((1, 1), np.int8), np.empty((1, 1), np.int32)
    classify_sweep(
        arrays,
        chain.T_parent_joint,
        chain.axis,
        np.full(6, -10.0),
        np.full(6, 10.0),
        np.full(6, 0.1),
        cell.robot.link_poses(q)[-1:],
        q.reshape(1, 1, 6).copy(),
        True,
        0.0,
        CLEARANCE,
        0.05,
        np.empty((1, 1), np.bool_),
        status,
        blocker,
        np.empty((1, 1)),
    )
    return status[0, 0], blocker[0, 0]


def filter_of(cell: Cell):
    return sphere_filter(cell, link_overshoot=0.01, tool_overshoot=0.01, field_spacing=0.008, field_padding=0.1)


@pytest.mark.parametrize("name", CELLS)
def test_the_filter_never_contradicts_the_exact_scene_and_decides_nearly_always(name):
    cell = CELLS[name]()
    scene, arrays = Scene(cell, CLEARANCE), filter_of(cell).arrays()
    rng = np.random.default_rng(1)
    q = rng.uniform(-3.0, 3.0, (1500, 6))
    found = np.array([state_at(cell, arrays, row)[0] for row in q])
    exact = scene.collide_all(q)
    assert not exact[found == CLEAR].any()
    assert exact[found == COLLIDING].all()
    assert 0.15 < exact.mean() < 0.9, "the cell must ask something of the filter"
    assert (found == UNDECIDED).mean() < {"ur10e": 0.03, "crx10ia/l": 0.12}[name]


def test_the_body_in_the_way_is_named():
    cell = ur10e_at_a_part()
    arrays, scene = filter_of(cell).arrays(), Scene(cell, CLEARANCE)
    rng = np.random.default_rng(2)
    agreed = 0
    for q in cell.start + rng.uniform(-1.5, 1.5, (300, 6)):
        status, blocker = state_at(cell, arrays, q)
        if status == COLLIDING:
            assert any(blocker in pair for pair in scene.colliding_pairs(q))
            agreed += 1
    assert agreed > 50


def test_ignored_pairs_are_not_checked():
    cell = ur10e_at_a_part()
    ignored = {tuple(sorted(pair)) for pair in cell.ignored_pairs.tolist()}
    pairs = filter_of(cell).pair
    moving = [row for row, body in enumerate(cell.bodies) if body.parent > 0]
    checked = {tuple(sorted((moving[pair[0]], pair[4]))) for pair in pairs.tolist()}
    assert not checked & ignored
    n = len(cell.bodies)
    wanted = {
        (a, b)
        for a in range(n)
        for b in range(a + 1, n)
        if cell.bodies[a].parent != cell.bodies[b].parent
        and max(cell.bodies[a].parent, cell.bodies[b].parent) > 0
        and (a, b) not in ignored
    }
    assert checked == wanted


def test_no_point_of_a_body_moves_further_than_its_shift_and_levers_say():
    cell = ur10e_at_a_part()
    built = filter_of(cell)
    rng = np.random.default_rng(3)
    for _ in range(50):
        q = rng.uniform(-3, 3, 6)
        following = q + rng.uniform(-0.1, 0.1, 6)
        links, later = cell.robot.link_poses(q), cell.robot.link_poses(following)
        for row, (m, _, link, *_, hull, _solid) in enumerate(built.pair.tolist()):
            points = built.hull_points[slice(*built.hull_whole[hull, :2])]
            carrier = built.carrier[m]

            def seen(poses, points=points, carrier=carrier, link=link):
                T = np.linalg.inv(poses[link]) @ poses[carrier]
                return points @ T[:3, :3].T + T[:3, 3]

            relative = np.linalg.norm(seen(later) - seen(links), axis=1).max()
            assert relative <= np.abs(following - q) @ built.lever[row] + 1e-12
            moved = np.linalg.norm(
                points @ later[carrier, :3, :3].T
                + later[carrier, :3, 3]
                - points @ links[carrier, :3, :3].T
                - links[carrier, :3, 3],
                axis=1,
            ).max()
            assert moved <= greatest_shift(links, later, carrier, built.node, m) + 1e-12
