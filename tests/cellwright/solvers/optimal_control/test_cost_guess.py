from __future__ import annotations

import numpy as np

from cellwright.cell.built_in_robots import built_in_arm
from cellwright.cell.symbolic_dynamics import Payload, symbolic_dynamics
from cellwright.solvers.optimal_control import cost_guess
from cellwright.solvers.optimal_control.cost_bounds import estimate, least_cost
from cellwright.solvers.optimal_control.program import CostWeights, MotionProgram
from cellwright.solvers.optimal_control.settled_motion import free_motion

WEIGHTS = CostWeights()
ARM = built_in_arm("irb6400")
DYNAMICS = symbolic_dynamics(ARM, payload=Payload.point(60.0, (0.0, 0.0, 0.2)))


def configurations(n: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(0.4 * ARM.lower, 0.4 * ARM.upper, (n, 6))


def test_guesses_are_nearer_to_the_costs_than_bounds_are():
    q = configurations(10)
    guess = cost_guess.guessed_costs(DYNAMICS, WEIGHTS, q)
    program = MotionProgram(DYNAMICS, WEIGHTS, n_steps=12)
    for a, b in ((0, 1), (2, 3), (4, 5), (6, 7)):
        found = free_motion(program, q[a], q[b])
        assert found.converged
        cost = found.curve.cost
        assert 0.6 < guess[a, b] / cost < 1.6
        bound = float(least_cost(DYNAMICS, WEIGHTS, q[a], q[b]))
        assert bound <= cost and abs(guess[a, b] - cost) < abs(bound - cost)


def test_guesses_are_the_same_both_ways_and_nothing_where_nothing_moves():
    q = configurations(4)
    q[3] = q[0]
    guess = cost_guess.guessed_costs(DYNAMICS, WEIGHTS, q)
    assert np.array_equal(guess, guess.T) and not guess.diagonal().any()
    assert guess[0, 3] < 1e-3


def test_many_pairs_are_guessed_from_their_ends(monkeypatch):
    q = configurations(5)
    monkeypatch.setattr(cost_guess, "MOST_PAIRS", 5)
    guess = cost_guess.guessed_costs(DYNAMICS, WEIGHTS, q)
    assert np.allclose(guess[1], estimate(DYNAMICS, WEIGHTS, q[1], q))
