from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cellwright.cell.motion_filter import FilteredScene
from cellwright.cell.scene import Scene
from tests.cellwright.solvers import scanning_cell


@cache
def scenes(clearance=0.005):
    scene = Scene(scanning_cell.cell(), clearance)
    return scene, FilteredScene(scene)


def near_the_part(rng):
    """A motion around the sweeps, where much is close."""
    sweep = scanning_cell.sweeps()[rng.integers(5)]
    q = sweep.pieces[rng.integers(len(sweep.pieces))].q_start
    return q + rng.uniform(-0.3, 0.3, 6), q + rng.uniform(-0.5, 0.5, 6)


@pytest.mark.parametrize("clearance", [0.0, 0.005, 0.015])
def test_motions_collide_where_the_exact_scene_says_so(clearance):
    scene, filtered = scenes(clearance)
    rng, answers = np.random.default_rng(0), []
    for _ in range(60):
        q_a, q_b = near_the_part(rng)
        answers.append(scene.motion_collides(q_a, q_b, 0.03))
        assert filtered.motion_collides(q_a, q_b, 0.03) == answers[-1]
    assert 0 < sum(answers) < 60


def test_the_first_colliding_state_is_that_of_the_exact_scene():
    scene, filtered = scenes()
    rng = np.random.default_rng(1)
    for _ in range(40):
        states = np.linspace(*near_the_part(rng), 25)
        assert filtered.first_colliding(states) == scene.first_colliding(states)


def test_states_in_any_order_and_far_apart_are_judged_alike():
    scene, filtered = scenes()
    states = np.random.default_rng(2).uniform(-2.5, 2.5, (300, 6))
    exact = scene.collide_all(states)
    assert 20 < exact.sum() < 280
    assert [filtered.collides(q) for q in states] == exact.tolist()
    free = states[~exact]
    assert filtered.first_colliding(free) == -1
    assert filtered.first_colliding(np.concatenate([free, states[exact]])) == len(free)


def test_few_states_of_free_motions_are_left_to_the_exact_scene():
    scene, filtered = scenes()
    asked, collides = [], scene.collides
    scene.collides = lambda q: asked.append(q) or collides(q)
    rng, n_states = np.random.default_rng(3), 0
    try:
        for _ in range(60):
            states = np.linspace(*near_the_part(rng), 25)
            n_states += len(states) if filtered.first_colliding(states) < 0 else 0
    finally:
        del scene.collides
    assert len(asked) < 0.1 * n_states


def test_another_clearance_shares_the_bodies_and_nothing_else():
    scene, _ = scenes()
    wide = scene.with_clearance(0.05)
    states = np.stack([near_the_part(np.random.default_rng(seed))[0] for seed in range(60)])
    expected = Scene(scanning_cell.cell(), 0.05).collide_all(states)
    before = scene.collide_all(states)
    assert np.array_equal(wide.collide_all(states), expected)
    assert np.array_equal(scene.collide_all(states), before)
    assert expected.sum() > before.sum()
