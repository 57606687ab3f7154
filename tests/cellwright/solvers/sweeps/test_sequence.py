"""Sequences of sweeps against brute force, on options and motions made up for it."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from cellwright.errors import InfeasibleError
from cellwright.solvers.motion_cost import CostedMotion
from cellwright.solvers.path_timing import TimedMotion
from cellwright.solvers.sweeps.passing import ALL_ENDS, PassedOption
from cellwright.solvers.sweeps.sequence import SweepLegs, sequence_sweeps

START = np.zeros(2)


def motion(q_a, q_b, speeds=(0.0, 0.0)) -> TimedMotion:
    way = np.array(q_b) - np.array(q_a)
    velocity = np.stack([speed * way for speed in speeds])
    return TimedMotion(np.array([0.0, 1.0]), np.stack([q_a, q_b]), velocity, np.zeros_like(velocity))


def made_up(seed: int, n_sweeps: int) -> list[PassedOption]:
    rng, options = np.random.default_rng(seed), []
    for sweep in range(n_sweeps):
        ends = rng.uniform(-2.0, 2.0, (2, 3))
        for direction, (a, b) in ((1, ends), (-1, ends[::-1])):
            motions = {moving: motion(a, b, tuple(map(float, moving))) for moving in ALL_ENDS}
            options.append(PassedOption(sweep, (0, 0, ()), (0, 0), 0, direction, motions))
    return options


class Straight:
    """Motions as dear as they are long; those beyond a wall at x = 1 do not exist."""

    def bound(self, q_a, q_b):
        return np.linalg.norm(q_b - q_a, axis=-1)

    def motion(self, q_a, q_b):
        if (q_a[0] > 1.0) and (q_b[0] > 1.0):
            return None
        return CostedMotion(1.1 * float(self.bound(q_a, q_b)), motion(q_a, q_b), None, "direct")


class Joining:
    """Cheaper motions, but not between everything; around what is in the way they cost a little more."""

    def bound(self, a, b):
        return 0.8 * np.linalg.norm(b.q - a.q, axis=-1)

    def direct(self, a, b):
        found = self.around(a, b)
        return None if a.q[1] * b.q[1] < 0.0 else found

    def around(self, a, b):
        return CostedMotion(0.9 * float(np.linalg.norm(b.q - a.q)), motion(a.q, b.q), None, "optimal control")


def legs_of(options: list[PassedOption], joining: Any = None) -> SweepLegs:
    def cost_of(option, timed):
        return 1.0 + 0.1 * sum(not np.any(timed.velocity[row]) for row in (0, -1))  # each stop a tenth

    return SweepLegs(options, START, cost_of, Straight(), joining, lambda option: True)


def brute_force(legs: SweepLegs, n_sweeps: int, returns: bool) -> float:
    return min(
        legs.total([2 * sweep + way for sweep, way in zip(order, ways)], returns)
        for order in itertools.permutations(range(n_sweeps))
        for ways in itertools.product((0, 1), repeat=n_sweeps)
    )


def solved(legs: SweepLegs, n_sweeps: int, returns: bool, **changes: Any) -> Any:
    names = [f"view {number}" for number in range(n_sweeps)]
    settings = {"target_gap": 0.0, "max_motions": 10_000} | changes
    return sequence_sweeps(legs, names, np.random.default_rng(0), returns=returns, **settings)


@pytest.mark.parametrize("returns", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_by_stops_alone_it_is_the_cheapest_there_is(seed: int, returns: bool) -> None:
    options = made_up(seed, 4)
    least = brute_force(legs_of(options), 4, returns)
    if math.isinf(least):
        with pytest.raises(InfeasibleError):
            solved(legs_of(options), 4, returns)
        return
    found = solved(legs_of(options), 4, returns)
    assert found.cost == pytest.approx(least, abs=1e-9) and found.proven and found.n_joined == 0
    assert [segment.sweep >= 0 for segment in found.segments[:8]] == [False, True] * 4
    assert len(found.segments) == 8 + returns


@pytest.mark.parametrize("seed", range(4))
def test_with_joining_motions_no_sequence_over_the_motions_found_is_cheaper(seed: int) -> None:
    legs = legs_of(made_up(seed, 4), Joining())
    found = solved(legs, 4, False)
    assert found.cost == pytest.approx(brute_force(legs, 4, False), abs=1e-9)
    assert found.lower_bound <= found.cost + 1e-9


def test_only_ends_at_which_the_arm_stops_are_timed_with_a_stop() -> None:
    found = solved(legs_of(made_up(1, 3), Joining()), 3, False)
    for before, sweep, after in zip(found.segments[0::2], found.segments[1::2], (*found.segments[2::2], None)):
        joins = before.via == "optimal control", after is not None and after.via == "optimal control"
        assert [bool(np.any(sweep.motion.velocity[row])) for row in (0, -1)] == list(joins)


def test_a_known_sequence_is_never_beaten_by_a_dearer_one() -> None:
    options = made_up(2, 5)
    best = solved(legs_of(options, Joining()), 5, False)
    rows = [2 * segment.sweep + (segment.direction < 0) for segment in best.segments if segment.sweep >= 0]
    hasty = solved(legs_of(options, Joining()), 5, False, max_motions=1, known=rows)
    assert hasty.cost <= best.cost + 1e-9


class GainingLate(Joining):
    """Ways around gain the more, the more of them were sought: so does the last one."""

    def __init__(self) -> None:
        self.asked = 0

    def bound(self, a, b):
        return 0.1 * np.linalg.norm(b.q - a.q, axis=-1)

    def direct(self, a, b):
        return None

    def around(self, a, b):
        self.asked += 1
        share = max(0.2, 1.05 - 0.02 * self.asked)
        return CostedMotion(share * float(np.linalg.norm(b.q - a.q)), motion(a.q, b.q), None, "optimal control")


@pytest.mark.parametrize("seed", range(6))
def test_the_bound_holds_over_the_motions_found_though_the_last_refinement_gains(seed: int) -> None:
    legs = legs_of(made_up(seed, 5), GainingLate())
    found = solved(legs, 5, False)
    least = brute_force(legs, 5, False)
    assert found.lower_bound <= least + 1e-9 <= found.cost + 2e-9
    assert found.proven and found.cost == pytest.approx(least, abs=1e-9)


@pytest.mark.parametrize("returns", [False, True])
@pytest.mark.parametrize("most", [1, 20])
def test_the_limit_on_motions_holds_for_all_refinements_together(most: int, returns: bool) -> None:
    legs = legs_of(made_up(2, 5), GainingLate())
    found = solved(legs, 5, returns, max_motions=most)
    assert found.n_evaluated == len(legs.found) <= most + 6 + returns
    assert found.lower_bound <= found.cost


def test_options_that_collide_are_not_executed() -> None:
    options = made_up(0, 3)
    legs = SweepLegs(
        options, START, lambda option, timed: 1.0, Straight(), Joining(), lambda option: option.direction > 0
    )
    assert {segment.direction for segment in solved(legs, 3, False).segments if segment.sweep >= 0} == {1}
