from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.motion_cost import CostedMotion
from cellwright.solvers.path_timing import TimedMotion
from cellwright.solvers.pose_tasks.alternatives import Alternative
from cellwright.solvers.pose_tasks.route import RouteRules, RouteWork, find_route
from cellwright.solvers.pose_tasks.task import PoseTask

START = np.zeros(2)


class Detours:
    """Costs a distance times a factor that each pair of configurations has for itself."""

    name, unit, symmetric = "detours", "", True

    def __init__(self, seed: int) -> None:
        self.seed, self.asked = seed, 0

    def bound(self, q_a, q_b):
        return np.linalg.norm(q_b - q_a, axis=-1)

    def holding(self, q, dwell):
        return np.full(np.shape(q)[:-1], float(dwell))

    def cost(self, q_a, q_b):
        low, high = sorted([tuple(q_a), tuple(q_b)])
        factor = 1.0 + abs(np.sin(self.seed + 7.0 * np.dot(low, [1.0, 3.0]) + 13.0 * np.dot(high, [2.0, 5.0])))
        return float(factor * self.bound(q_a, q_b))

    def motion(self, q_a, q_b):
        self.asked += 1
        rest = np.zeros((2, 2))
        motion = TimedMotion(np.array([0.0, 1.0]), np.stack([q_a, q_b]), rest, rest)
        return CostedMotion(self.cost(q_a, q_b), motion, None, "detour")


def station(seed: int, n_tasks: int = 4, n_ways: int = 2):
    rng = np.random.default_rng(seed)
    tasks = [PoseTask(f"t{k}", np.eye(4), dwell=float(rng.uniform(0, 1))) for k in range(n_tasks)]
    ways = []
    for row in range(n_tasks):
        for _ in range(n_ways):
            q = rng.uniform(-1, 1, 2)
            ways.append(Alternative(row, 0.0, 0, q, q, float(rng.uniform(0, 0.2))))
    return tasks, ways


def best_by_trying_all(tasks, ways, cost, rules: RouteRules) -> float:
    own = [[way for way in ways if way.task == row] for row in range(len(tasks))]
    best = np.inf
    for order in itertools.permutations(range(len(tasks))):
        if any(order.index(i) > order.index(j) for i, j in rules.before):
            continue
        for chosen in itertools.product(*(own[row] for row in order)):
            stops = [way.q_entry for way in chosen]
            if rules.from_start:
                stops = [START, *stops]
            if rules.end is not None:
                stops = [*stops, np.array(rules.end)]
            elif rules.returns:
                stops = [*stops, stops[0]]
            total = sum(2 * way.stroke + tasks[way.task].dwell for way in chosen)
            best = min(best, total + sum(cost.cost(a, b) for a, b in itertools.pairwise(stops)))
    return best


RULES = st.sampled_from(
    [
        RouteRules(),
        RouteRules(returns=False),
        RouteRules(from_start=False),
        RouteRules(from_start=False, returns=False),
        RouteRules(returns=False, end=(0.5, -0.5)),
        RouteRules(before=((2, 0), (0, 1))),
    ]
)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), RULES)
def test_a_proven_route_is_the_cheapest_of_all(seed, rules):
    tasks, ways = station(seed)
    cost = Detours(seed)
    route = find_route(tasks, ways, START, cost, rules, RouteWork(), np.random.default_rng(0))
    assert route.proven and route.cost == pytest.approx(best_by_trying_all(tasks, ways, Detours(seed), rules))
    assert route.lower_bound <= route.cost * (1 + 1e-9) and len(route.stops) == 4
    assert all(order >= route.cost - 1e-9 for order in route.orders.values())


def test_not_every_motion_is_planned():
    tasks, ways = station(1, 6, 4)
    cost = Detours(1)
    route = find_route(tasks, ways, START, cost, RouteRules(), RouteWork(), np.random.default_rng(0))
    assert route.proven and cost.asked < 0.5 * route.n_motions


def test_a_limit_on_motions_gives_a_route_and_an_honest_bound():
    tasks, ways = station(2, 6, 3)
    full = find_route(tasks, ways, START, Detours(2), RouteRules(), RouteWork(), np.random.default_rng(0))
    few = find_route(tasks, ways, START, Detours(2), RouteRules(), RouteWork(max_motions=1), np.random.default_rng(0))
    assert few.n_evaluated <= 1 + 7 < full.n_evaluated and few.stopped_by == "evaluations"
    assert few.lower_bound <= full.cost <= few.cost and sorted(ways[k].task for k in few.stops) == list(range(6))


class Guessing(Detours):
    """The same with bounds that say little and guesses that are within a fifth."""

    def __init__(self, seed: int, too_high: float = 1.0) -> None:
        super().__init__(seed)
        self.too_high = too_high

    def bound(self, q_a, q_b):
        return 0.05 * super().bound(q_a, q_b)

    def cost(self, q_a, q_b):
        return 20.0 * super().cost(q_a, q_b)

    def guess(self, q):
        true = np.array([[self.cost(a, b) for b in q] for a in q])
        spread = np.random.default_rng(self.seed).uniform(0.8, 1.0, true.shape)
        return self.too_high * true * np.minimum(spread, spread.T)


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 40))
def test_a_cost_that_guesses_keeps_to_the_limit_on_motions(seed, most):
    tasks, ways = station(seed, 6, 4)
    rules = RouteRules()
    route = find_route(tasks, ways, START, Guessing(seed), rules, RouteWork(most), np.random.default_rng(0))
    assert route.n_evaluated <= most + 7
    assert route.stopped_by in ("evaluations", "proof")


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([1.0, 1.5]), RULES)
def test_no_sequence_undercuts_the_likely_bound_where_guesses_are_as_assumed(seed, too_high, rules):
    tasks, ways = station(seed)
    cost = Guessing(seed, too_high)
    route = find_route(tasks, ways, START, cost, rules, RouteWork(6), np.random.default_rng(0))
    assert route.likely is not None and route.likely_bound is not None and route.least_ratio is not None
    q = route.motions.q
    guess = cost.guess(q)
    true = np.array([[cost.cost(a, b) for b in q] for a in q])
    planned = {tuple(sorted(pair)) for pair in route.motions.found}
    told = np.array([true[pair] / guess[pair] for pair in planned if guess[pair] > 0])
    assert route.least_ratio <= told.min() < route.least_ratio + 0.01 and route.likely.n_motions == len(told)
    assert route.lower_bound <= route.likely_bound <= route.cost * (1 + 1e-9)
    between = guess > 0
    if np.all(true[between] >= route.least_ratio * guess[between]):
        least = best_by_trying_all(tasks, ways, cost, rules)
        assert route.likely_bound <= least * (1 + 1e-9)


def test_the_likely_bound_says_more_than_a_weak_proof():
    tasks, ways = station(5, 7, 5)
    route = find_route(tasks, ways, START, Guessing(5), RouteRules(), RouteWork(40), np.random.default_rng(0))
    assert not route.proven and route.gap > 0.2
    assert route.likely_bound is not None and route.likely_bound > 0.9 * route.cost


def test_a_cost_that_does_not_guess_has_no_likely_bound():
    tasks, ways = station(1)
    route = find_route(tasks, ways, START, Detours(1), RouteRules(), RouteWork(), np.random.default_rng(0))
    assert route.likely is None and route.likely_bound is None and route.least_ratio is None


def test_the_time_limit_is_told_as_what_it_is():
    tasks, ways = station(5, 6, 4)
    rules, work = RouteRules(), RouteWork()
    asked = itertools.count()
    route = find_route(
        tasks, ways, START, Guessing(5), rules, work, np.random.default_rng(0), stop=lambda: next(asked) > 3
    )
    assert route.stopped_by == "stop" and not route.proven and route.lower_bound <= route.cost


class Barred(Detours):
    """No motion leads to or from configurations at the right."""

    def motion(self, q_a, q_b):
        found = super().motion(q_a, q_b)
        return None if max(q_a[0], q_b[0]) > 5.0 else found


def test_a_limit_on_motions_holds_where_a_task_is_cut_off_and_the_task_is_named():
    tasks, ways = station(3, 5, 6)
    away = [Alternative(2, 0.0, 0, way.q_task + 10.0, way.q_task + 10.0, 0.0) for way in ways if way.task == 2]
    ways = [way for way in ways if way.task != 2] + away
    cost = Barred(3)
    with pytest.raises(InfeasibleError, match="no collision-free motion was found between 't2' and"):
        find_route(tasks, ways, START, cost, RouteRules(), RouteWork(5), np.random.default_rng(0))
    assert cost.asked <= 5 + 6


def test_a_single_task_is_gone_to_and_come_back_from():
    tasks, ways = station(3, 1, 3)
    for rules in (RouteRules(), RouteRules(from_start=False)):
        route = find_route(tasks, ways, START, Detours(3), rules, RouteWork(), np.random.default_rng(0))
        assert route.cost == pytest.approx(best_by_trying_all(tasks, ways, Detours(3), rules))


def test_contradicting_orders_are_named():
    tasks, ways = station(4)
    with pytest.raises(InvalidInputError, match="contradicts itself: t0 before t1 before t0"):
        find_route(
            tasks, ways, START, Detours(4), RouteRules(before=((0, 1), (1, 0))), RouteWork(), np.random.default_rng(0)
        )
