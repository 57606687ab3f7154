"""The least distance of a motion: never more than any that is measured, proven, and found without measuring all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import BASE, WORLD, Body, Box, Sphere
from cellwright.cell.cell import Cell
from cellwright.cell.robot import Robot
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.cell.verification_scene import VerificationScene
from cellwright.solvers.clearance_proof import CONTACT, prove_clearance
from cellwright.solvers.hermite import states_at, subdivide
from cellwright.solvers.motion_steps import MovingCorners, dense_times
from tests.cellwright.cell.cells import at
from tests.cellwright.solvers import scanning_cell

URDF = """<robot name="two"><link name="base_link"/><link name="one"/><link name="two"/><link name="flange"/>
<joint name="a" type="revolute"><parent link="base_link"/><child link="one"/><axis xyz="0 0 1"/>
<origin xyz="0 0 0.3"/><limit lower="-3" upper="3" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/><axis xyz="0 1 0"/>
<origin xyz="0.4 0 0" rpy="0.2 0.3 0"/><limit lower="-3" upper="3" velocity="1"/></joint>
<joint name="c" type="fixed"><parent link="two"/><child link="flange"/><origin xyz="0.1 0 0"/></joint></robot>"""


@dataclass
class Motion:
    time: FloatArray
    position: FloatArray
    velocity: FloatArray


def cell_with(*world: Body, base: FloatArray | None = None) -> Cell:
    bodies = (
        Body("foot", Box((0.1, 0.1, 0.1)), BASE, at(0, 0, 0.05)),
        Body("beam", Box((0.4, 0.04, 0.05)), 1, at(0.2, 0, 0)),
        Body("hand", Box((0.2, 0.05, 0.03)), 2, at(0.15, 0, 0.02)),
        *world,
    )
    T = pose(np.array([0.3, -0.2, 0.1]), rotation_from_rpy(0.1, 0.2, 0.3)) if base is None else base
    robot = Robot.from_urdf(URDF, max_acceleration=[20.0, 20.0])
    return Cell(robot, bodies, np.array([[1, 2]], np.int32), T, np.eye(4), np.zeros(2))


def wandering(rng: np.random.Generator, n: int = 4) -> Motion:
    return Motion(np.cumsum(rng.uniform(0.1, 0.5, n)), rng.uniform(-1.0, 1.0, (n, 2)), rng.uniform(-2.0, 2.0, (n, 2)))


def steps_of(motion: Motion, cell: Cell, step: float = 1e-3) -> FloatArray:
    return dense_times(motion, MovingCorners.of(cell), step=step, step_angle=0.01)


def distances(motion: Motion, scene: VerificationScene, time: FloatArray) -> FloatArray:
    q, _ = states_at(motion.time, motion.position, motion.velocity, time)
    return np.array([min(scene.pair_distance(pair, row) for pair in range(len(scene.pairs))) for row in q])


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6), step=st.sampled_from([5e-3, 0.03]))
def test_no_moment_of_a_motion_is_nearer_than_what_is_proven(seed: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform([-0.6, -0.6, 0.0], [1.0, 0.6, 0.8], (3, 3))
    cell = cell_with(*(Body(f"ball {k}", Sphere(0.05), WORLD, at(*place)) for k, place in enumerate(places)))
    motion, scene = wandering(rng), VerificationScene(cell)
    time = steps_of(motion, cell, step)
    proof = prove_clearance(motion, time, cell, scene)
    everywhere = distances(motion, scene, subdivide(time, np.full(len(time) - 1, 3 if step > 0.01 else 1)))
    if proof.found <= CONTACT:
        assert proof.proven <= CONTACT
        return
    assert proof.proven - 1e-9 <= everywhere.min()
    assert 0.99 * proof.found - 2e-6 <= proof.proven <= proof.found
    names = [body.name for body in cell.bodies]
    pair = tuple(names.index(name) for name in proof.bodies)
    assert pair in [tuple(row) for row in scene.pairs.tolist()]
    q, _ = states_at(motion.time, motion.position, motion.velocity, np.array([proof.time]))
    assert scene.pair_distance(scene.pairs.tolist().index(list(pair)), q[0]) == pytest.approx(proof.found, abs=1e-9)


def test_contact_between_two_states_is_found() -> None:
    """The arm swings forth and back within one step, of which both ends are the same free state."""
    motion = Motion(np.array([0.0, 1.0]), np.zeros((2, 2)), np.array([[2.0, 0.0], [-2.0, 0.0]]))
    furthest, _ = states_at(motion.time, motion.position, motion.velocity, np.array([0.5]))
    assert furthest[0, 0] == pytest.approx(0.5)
    bare = cell_with()
    hand = bare.T_world_base @ bare.robot.flange_pose(furthest[0]) @ at(0.1, 0.0, 0.0)
    blocked = cell_with(Body("pin", Sphere(0.03), WORLD, hand))
    scene = VerificationScene(blocked)
    assert distances(motion, scene, motion.time).min() > 0.02
    proof = prove_clearance(motion, motion.time, blocked, scene)
    assert proof.found <= CONTACT
    assert proof.proven <= CONTACT
    assert "pin" in proof.bodies


def test_a_limit_on_measurements_leaves_a_proof_that_is_weaker_but_of_no_contact() -> None:
    rng = np.random.default_rng(3)
    cell = cell_with(Body("ball", Sphere(0.05), WORLD, at(0.9, 0.9, 0.9)))
    motion, scene = wandering(rng), VerificationScene(cell)
    time = steps_of(motion, cell)
    exact, coarse = (prove_clearance(motion, time, cell, scene, measurements=n) for n in (3000, 1))
    assert coarse.n_measured < exact.n_measured
    assert CONTACT < coarse.proven <= exact.proven <= exact.found <= coarse.found


def test_a_cell_in_which_nothing_can_be_hit_has_no_least_distance() -> None:
    cell = replace(cell_with(), ignored_pairs=np.array([[0, 1], [0, 2], [1, 2]], np.int32))
    motion = wandering(np.random.default_rng(0))
    proof = prove_clearance(motion, motion.time, cell, VerificationScene(cell))
    assert proof.found == proof.proven == np.inf
    assert proof.n_measured == 0


def test_a_whole_plan_is_proven_to_a_hundredth_without_measuring_all() -> None:
    from schemas.plan_objects import timed_plan

    plan, cell = timed_plan(scanning_cell.trajectory(), scanning_cell.selection()), scanning_cell.cell()
    scene = VerificationScene(cell)
    time = dense_times(plan, MovingCorners.of(cell), step=1e-3, step_angle=np.deg2rad(0.1))
    shares: list[float] = []
    proof = prove_clearance(plan, time, cell, scene, progress=shares.append)
    assert proof == prove_clearance(plan, time, cell, scene), "to be told changes nothing"
    assert len(shares) > 3
    assert shares == sorted(shares) and shares[0] >= 0.0 and 0.1 < shares[-1] <= 1.0
    sampled = distances(plan, scene, time[:: len(time) // 60])
    assert 0.0 < proof.proven <= proof.found <= sampled.min()
    assert proof.proven >= 0.99 * proof.found - 1e-6
    assert proof.n_measured < 0.01 * len(time) * len(scene.pairs)
