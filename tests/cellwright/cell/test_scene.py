from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import BASE, WORLD, Body, Box, Capsule, Cylinder, Mesh, Shape, Sphere
from cellwright.cell.built_in_robots import built_in, built_in_bodies, built_in_robot
from cellwright.cell.robot import Robot
from cellwright.cell.scene import Scene, halving_order
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.cell.urdf_geometry import collision_bodies, meshes_in
from cellwright.cell.verification_scene import VerificationScene
from tests.cellwright.cell.cells import at, bumpy_part, cell_of, one_joint_cell, scanning_cell
from tests.cellwright.cell.robots import published_crx, shared

ZERO = np.zeros(1)


def random_configurations(n: int, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(-math.pi, math.pi, (n, 6))


def assert_engines_agree(scene: Scene, peer: VerificationScene, configurations: FloatArray) -> None:
    for q in configurations:
        ours = sorted((min(pair), max(pair)) for pair in scene.colliding_pairs(q))
        theirs = peer.colliding_pairs(q)
        if ours != theirs:  # only a touch of less than the engines' tolerance may be judged differently
            assert set(theirs) < set(ours)
            assert not peer.collides(q) or len(theirs) > 0
            near = Scene(scene.cell, 0.0)
            assert near.distance(q) < 1e-5


def test_both_engines_agree_on_thousands_of_configurations() -> None:
    cell = scanning_cell(pose(np.array([0.1, -0.05, 0.2]), rotation_from_rpy(0.1, -0.2, 1.0)))
    cell = cell.with_part(bumpy_part(), pose(np.array([0.7, 0.1, 0.25]), rotation_from_rpy(0.4, 0.1, 2.0)))
    scene, peer = Scene(cell), VerificationScene(cell)
    configurations = random_configurations(4000)
    ours = scene.collide_all(configurations)
    assert 0.2 < ours.mean() < 0.95
    assert ours.tolist() == [peer.collides(q) for q in configurations]
    assert_engines_agree(scene, peer, configurations[:1000])
    for q in configurations[~ours][:100]:
        assert scene.distance(q) == pytest.approx(peer.distance(q), abs=1e-6)


@pytest.mark.parametrize("robot", ["ur10e", "crx10ia_l"])
def test_published_robots_can_be_checked_with_their_meshes(robot: str) -> None:
    folder = shared(f"robots/{robot}")
    text = (folder / "ur10e.urdf").read_text() if robot == "ur10e" else published_crx()[0]
    arm = Robot.from_urdf(text)
    cell = cell_of(arm, collision_bodies(arm, meshes_in(folder))).with_part(bumpy_part(), at(0.6, 0.2, 0.3))
    scene, peer = Scene(cell), VerificationScene(cell)
    configurations = random_configurations(300)
    ours = scene.collide_all(configurations)
    assert 0 < ours.mean() < 1
    assert ours.tolist() == [peer.collides(q) for q in configurations]


SHAPES: list[Shape] = [
    Box((0.2, 0.3, 0.1)),
    Cylinder(0.1, 0.3),
    Sphere(0.12),
    Capsule(0.08, 0.2),
    bumpy_part(2),
    Mesh(
        *(np.asarray(part) for part in (trimesh.creation.box((0.2, 0.2, 0.2)).vertices, trimesh.creation.box().faces))
    ),
]


@pytest.mark.parametrize(("moving", "standing"), list(itertools.product(range(len(SHAPES)), repeat=2)))
def test_all_kinds_of_shapes_agree_at_the_clearance_and_beyond(moving: int, standing: int) -> None:
    generator = np.random.default_rng(10 * moving + standing)
    for _ in range(6):
        place = pose(
            np.array([0.5, 0, 0]) + generator.uniform(-0.35, 0.35, 3), rotation_from_rpy(*generator.normal(size=3))
        )
        cell = one_joint_cell(SHAPES[moving], SHAPES[standing], place)
        peer = VerificationScene(cell)
        scene = Scene(cell)
        distance = peer.distance(ZERO)
        assert scene.distance(ZERO) == pytest.approx(distance, abs=2e-5)
        assert scene.collides(ZERO) == (distance == 0.0)
        if distance > 0.0:
            assert Scene(cell, distance + 1e-4).collides(ZERO)
            assert not Scene(cell, distance - 1e-4).collides(ZERO)


def hollow_ball(radius: float) -> Mesh:
    """Closed, not convex (so that it is a skin to the engine): a ball with a dent at its top."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    vertices = np.asarray(ball.vertices).copy()
    vertices[vertices[:, 2] > 0.9 * radius, 2] *= 0.8
    return Mesh(vertices, np.asarray(ball.faces, np.int32))


@pytest.mark.parametrize("small", SHAPES, ids=lambda shape: type(shape).__name__)
@pytest.mark.parametrize("swap", [False, True])
def test_a_body_inside_a_closed_mesh_collides_either_way(small: Shape, swap: bool) -> None:
    big = hollow_ball(0.6)
    moving, standing = (big, small) if swap else (small, big)
    cell = one_joint_cell(moving, standing, at(0.55, 0.02, 0.03))
    for scene in (Scene(cell), VerificationScene(cell)):
        assert scene.collides(ZERO)
        assert scene.distance(ZERO) == 0.0
        assert not scene.collides(np.array([2.9]))


def test_a_body_inside_a_shell_or_a_cavity_does_not_collide() -> None:
    big = hollow_ball(0.6)
    opened = Mesh(big.vertices, big.faces[1:])
    walls = trimesh.util.concatenate([trimesh.creation.box((2.0, 2.0, 2.0)), trimesh.creation.box((1.8, 1.8, 1.8))])
    room = Mesh(np.asarray(walls.vertices), np.asarray(walls.faces, np.int32))
    for outer in (opened, room):
        cell = one_joint_cell(Sphere(0.05), outer, at(0.4, 0, 0.1))
        for scene in (Scene(cell), VerificationScene(cell)):
            assert not scene.collides(ZERO)


def test_one_piece_of_several_inside_is_enough() -> None:
    pieces = [trimesh.creation.box((0.1, 0.1, 0.1)).apply_translation((x, 0, 0)) for x in (0.0, 5.0)]
    pair = trimesh.util.concatenate(pieces[::-1])
    cell = one_joint_cell(
        Mesh(np.asarray(pair.vertices), np.asarray(pair.faces, np.int32)), hollow_ball(0.6), at(0.5, 0, 0)
    )
    for scene in (Scene(cell), VerificationScene(cell)):
        assert scene.collides(ZERO)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), clearance=st.floats(0.001, 0.2))
def test_the_clearance_is_a_distance(seed: int, clearance: float) -> None:
    cell = scanning_cell()
    q = random_configurations(1, seed)[0]
    distance = Scene(cell).distance(q)
    if abs(distance - clearance) > 1e-5:
        assert Scene(cell, clearance).collides(q) == (distance < clearance)


def test_the_pair_that_collides_is_named() -> None:
    cell = scanning_cell()
    home = np.array(built_in("ur10e").home)
    assert Scene(cell).colliding_pair(home) is None
    lowered = (home + np.array([0, angle, 0, 0, 0, 0]) for angle in np.arange(0.0, 1.5, 0.05))
    low = next(q for q in lowered if Scene(cell).collides(q))
    named = Scene(cell).colliding_pair(low)
    assert named is not None
    assert "table" in named
    assert VerificationScene(cell).collision(low) is not None


def test_ignored_pairs_are_not_checked() -> None:
    small = one_joint_cell(Sphere(0.1), Sphere(0.1), at(0.5, 0, 0))
    assert Scene(small).collides(ZERO)
    from dataclasses import replace

    ignoring = replace(small, ignored_pairs=np.array([[1, 0]], np.int32))
    for scene in (Scene(ignoring), VerificationScene(ignoring)):
        assert not scene.collides(ZERO)
        assert scene.distance(ZERO) == math.inf


def test_bodies_that_stand_still_are_checked_against_what_moves_alone() -> None:
    from dataclasses import replace

    cell = scanning_cell().with_part(bumpy_part(), at(0.05, 0, 0.05))
    floor = Body("floor", Box((2.0, 2.0, 0.1)), WORLD, at(0, 0, -0.05))
    cell = replace(cell, bodies=(*cell.bodies, floor), ignored_pairs=np.empty((0, 2), np.int32))
    stands = [body.parent <= BASE for body in cell.bodies]
    for scene in (Scene(cell, 0.05), VerificationScene(cell)):
        assert not any(stands[a] and stands[b] for a, b in scene.pairs.tolist())
        for q in random_configurations(20):
            assert not any(stands[a] and stands[b] for a, b in scene.colliding_pairs(q))


@pytest.mark.parametrize("support", [Box((3.0, 3.0, 0.1)), Cylinder(0.1, 0.1)], ids=["floor", "pedestal"])
def test_a_robot_stands_on_the_floor_or_on_a_pedestal(support: Shape) -> None:
    from dataclasses import replace

    home = np.array(built_in("ur10e").home)
    bodies = (*built_in_bodies("ur10e"), Body("support", support, WORLD, at(0, 0, -0.05)))
    cell = cell_of(built_in_robot("ur10e"), bodies)
    touching = [pair for pair in cell.ignored_pairs.tolist() if pair != [0, len(bodies) - 1]]
    cell = replace(cell, ignored_pairs=np.array(touching, np.int32))
    for clearance in (0.0, 0.005, 0.015):
        assert Scene(cell, clearance).colliding_pair(home) is None
    assert VerificationScene(cell).collision(home) is None
    assert min(Scene(cell).distance(home), VerificationScene(cell).distance(home)) > 0.015


def test_a_motion_is_tried_at_every_step() -> None:
    cell = one_joint_cell(Sphere(0.01), Sphere(0.01), at(0.5 * math.cos(1.0), 0.5 * math.sin(1.0), 0))
    scene = Scene(cell)
    start, end = np.array([0.0]), np.array([2.0])
    assert not scene.collides(start)
    assert not scene.collides(end)
    assert scene.motion_collides(start, end, 0.02)
    assert not scene.motion_collides(start, np.array([0.9]), 0.02)
    assert scene.motion_collides(start, np.array([1.0]), 5.0)


@given(n=st.integers(1, 200))
def test_halving_visits_every_step_once(n: int) -> None:
    assert sorted(halving_order(n)) == list(range(1, n))


def test_bodies_stand_where_pinocchio_puts_them() -> None:
    cell = scanning_cell(pose(np.array([0.3, 0.2, 0.1]), rotation_from_rpy(0.3, 0.2, 0.1)))
    scene, peer = Scene(cell), VerificationScene(cell)
    for q in random_configurations(20):
        peer._pose(q)
        scene.collides(q)
        assert np.abs(scene._poses - peer._poses).max() < 1e-12


def test_the_same_question_has_the_same_answer_twice() -> None:
    cell = scanning_cell().with_part(bumpy_part(), at(0.7, 0.1, 0.12))
    first, second = Scene(cell), Scene(cell)
    configurations = random_configurations(500)
    assert first.collide_all(configurations).tolist() == second.collide_all(configurations[::-1]).tolist()[::-1]


def test_touching_meshes_are_not_overlooked() -> None:
    """Shallow overlaps of convex meshes, which coal misses when it is asked without margin and contacts."""
    cell = cell_of(built_in_robot("ur10e"), built_in_bodies("ur10e"))
    scene, peer = Scene(cell), VerificationScene(cell)
    shallow = 0
    for low, high in zip(random_configurations(400, 1), random_configurations(400, 2)):
        if scene.collides(low) == scene.collides(high):
            continue
        for _ in range(20):  # bisect to the edge of a collision
            middle = (low + high) / 2
            low, high = (middle, high) if peer.collides(middle) == peer.collides(low) else (low, middle)
        hit = low if peer.collides(low) else high
        shallow += 1
        assert scene.collides(hit)
    assert shallow > 50
