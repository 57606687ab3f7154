from __future__ import annotations

import numpy as np
import pytest

from cellwright.cell.robot import Chain
from cellwright.solvers.connections import Connections, ConnectionSteps, first_collision
from cellwright.solvers.hermite import shares_of_limits, states_at
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.path_timing import Limits, time_straight
from cellwright.solvers.roadmap import Roadmap, RoadmapSize
from tests.cellwright.solvers.flat_worlds import PlanarArm

LIMITS = Limits(np.array([2.0, 2.0]), np.array([8.0, 10.0]))
ALONG_X = np.array([[1.0, 0, 0, 1.0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])
CHAIN = Chain(
    np.stack([np.eye(4), ALONG_X]),
    np.array([[0.0, 0, 1], [0, 0, 1]]),
    np.eye(4),
    np.full(2, -3.0),
    np.full(2, 3.0),
    LIMITS.velocity,
    LIMITS.acceleration,
)
CORNERS = MovingCorners(CHAIN, np.array([1.0, 2.0]), np.array([[1.0, 0, 0], [1.0, 0, 0]]))


def connections(world, step=0.1, **settings):
    roadmap = Roadmap(
        world, CHAIN.lower, CHAIN.upper, LIMITS.velocity, size=RoadmapSize(200, 100, 600), rng=np.random.default_rng(0)
    )  # fmt: skip
    steps = ConnectionSteps(search=step, sample=0.02, confirm=0.01, confirm_angle=0.05)
    return Connections(world, roadmap, CORNERS, LIMITS, steps, np.random.default_rng(1), **settings)


Q_A, Q_B = np.array([-1.5, 0.2]), np.array([1.5, -0.2])


def test_a_free_connection_is_straight_and_as_fast_as_the_closed_form():
    found = connections(PlanarArm([])).between(Q_A, Q_B)
    assert found.via == "direct"
    assert found.motion.duration == pytest.approx(time_straight(Q_A, Q_B, LIMITS, 0.02).duration)


def test_a_way_around_is_free_smooth_and_within_limits():
    world = PlanarArm([(1.6, 0.0, 0.3)])
    planner = connections(world, step=0.03)
    found = planner.between(Q_A, Q_B)
    assert found.via == "roadmap"
    assert planner.confirm(Q_A, Q_B)
    motion = found.motion
    assert motion.position[[0, -1]] == pytest.approx(np.stack([Q_A, Q_B]), abs=1e-12)
    assert motion.duration > time_straight(Q_A, Q_B, LIMITS, 0.02).duration
    dense, _ = states_at(motion.time, motion.position, motion.velocity, np.linspace(0, motion.duration, 2000))
    assert not any(world.collides(q) for q in dense)
    shares = shares_of_limits(motion.time, motion.position, motion.velocity, LIMITS.velocity, LIMITS.acceleration)
    assert max(shares[0].max(), shares[1].max()) < 1.006


def test_both_directions_are_one_connection():
    planner = connections(PlanarArm([(1.6, 0.0, 0.3)]), step=0.03)
    there, back = planner.between(Q_A, Q_B).motion, planner.between(Q_B, Q_A).motion
    assert there.duration == back.duration == planner.duration(Q_B, Q_A)
    assert back.position[::-1] == pytest.approx(there.position, abs=0)
    assert back.velocity[::-1] == pytest.approx(-there.velocity, abs=0)


def test_confirmation_replaces_a_connection_that_coarse_steps_let_through():
    world = PlanarArm([(1.5, 0.05, 0.02)])
    planner = connections(world, step=1.0)
    assert planner.between(Q_A, Q_B).via == "direct"
    before = planner.duration(Q_A, Q_B)
    assert not planner.confirm(Q_A, Q_B)
    replaced = planner.between(Q_A, Q_B)
    assert replaced.via == "roadmap" and replaced.motion.duration > before
    assert first_collision(world, CORNERS, replaced.motion, 0.01, 0.05) is None
    assert planner.confirm(Q_B, Q_A)


def test_where_there_is_no_way_the_duration_is_infinite():
    ring = [(0.7 * np.cos(a), 0.7 * np.sin(a), 0.2) for a in (0.6, -0.6)]
    planner = connections(PlanarArm(ring), step=0.03)
    inside, outside = np.array([0.0, 0.0]), np.array([2.0, 0.0])
    assert planner.between(inside, outside) is None
    assert planner.duration(outside, inside) == np.inf


def test_a_connection_is_shortened_alike_whatever_was_planned_before_it():
    world, turn = PlanarArm([(1.6, 0.0, 0.3)]), np.array([0.1, 0.1])

    def after(others, **settings):
        planner = connections(world, step=0.03, **settings)
        for shift in range(1, others + 1):
            assert planner.between(Q_A - 0.5 * shift * turn, Q_B + 0.5 * shift * turn).via == "roadmap"
        return planner.between(Q_B, Q_A).motion.duration

    assert after(0, own_shortenings=True) == after(3, own_shortenings=True)
    assert after(0) != after(3)  # they share random numbers
