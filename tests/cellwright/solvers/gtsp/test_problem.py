from __future__ import annotations

import numpy as np
import pytest

from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.gtsp.form import tour_form
from cellwright.solvers.gtsp.problem import SequencingProblem, ancestors
from tests.cellwright.solvers.sequencing_problems import groups, uniform_problem

SQUARE = np.ones((4, 4))
TWO = ((0, 1), (2, 3))


def refused(message, **fields):
    with pytest.raises(InvalidInputError, match=message):
        SequencingProblem(**{"cost": SQUARE, "clusters": TWO, **fields})


def test_a_cluster_without_alternatives_is_named():
    refused("without alternatives: stud 7", clusters=((0, 1, 2, 3), ()), names=("stud 1", "stud 7"))


def test_a_cost_that_is_not_a_number_is_named_with_its_clusters():
    cost = SQUARE.copy()
    cost[1, 2] = np.nan
    refused(r"alternative 1 \(cluster 0\) to 2 \(cluster 1\) is nan, not a number \(1 such", cost=cost)


def test_a_negative_cost_is_named():
    cost = SQUARE.copy()
    cost[3, 0] = -2.0
    refused(r"3 \(cluster 1\) to 0 \(cluster 0\) is -2.0, negative.*shift", cost=cost)


def test_costs_inside_a_cluster_are_not_looked_at():
    cost = SQUARE.copy()
    cost[0, 1] = cost[2, 2] = np.nan
    assert SequencingProblem(cost, TWO).cost_of([0, 2]) == 2.0


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_a_service_cost_that_is_none_is_named(value):
    refused(r"service cost of alternative 2 \(cluster 1\)", service=np.array([0.0, 0.0, value, 0.0]))


def test_contradictory_precedence_is_told_as_the_loop_it_is():
    refused(
        "cluster 0 before cluster 2 before cluster 1 before cluster 0: drop",
        clusters=((0,), (1,), (2,), (3,)), before=((0, 2), (2, 1), (1, 0), (0, 3)), closed=False,
    )  # fmt: skip


def test_something_before_the_start_is_a_contradiction():
    refused("cluster 1 before cluster 0 before cluster 1", start=0, before=((1, 0),))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"cost": np.ones((2, 3))}, "square matrix"),
        ({"clusters": ()}, "no clusters"),
        ({"clusters": ((0, 1), (1, 2, 3))}, "alternative 1 is in clusters 2 times"),
        ({"clusters": ((0, 1), (2,))}, "alternative 3 is in no cluster"),
        ({"clusters": ((0, 1), (2, 7))}, "alternative 7"),
        ({"service": np.ones(3)}, "3 entries for 4"),
        ({"start": 5}, "start is cluster 5"),
        ({"start": 1, "end": 1}, "both start and end"),
        ({"before": ((0, 9),)}, r"pair \(0, 9\)"),
        (
            {"before": ((0, 1),)},
            "before asks for cluster 0 before cluster 1, but .* give start, the cluster from which",
        ),
        ({"before": ((0, 1), (0, 1))}, r"cluster 0 before cluster 1 \(2 such pairs\), but a closed sequence without"),
        ({"end": 1}, "cluster 1 is the end of a closed sequence without start, .* give start too, or closed=False"),
        ({"names": ("a",)}, "1 names for 2"),
        ({"cost": [["a", 1], [1, 2]]}, "not made of numbers"),
    ],
)
def test_malformed_problems_are_refused(fields, message):
    refused(message, **fields)


def test_inputs_are_not_edited_and_cannot_be():
    cost = SQUARE.copy()
    problem = SequencingProblem(cost, TWO)
    cost[0, 2] = 5.0  # the caller's own array stays the caller's
    with pytest.raises(ValueError, match="read-only"):
        problem.cost[0, 2] = 1.0


def test_consequences_of_what_comes_first_are_known():
    problem = SequencingProblem(SQUARE, ((0,), (1,), (2,), (3,)), closed=False, end=3, before=((0, 1), (1, 2)))
    assert ancestors(problem).tolist() == np.triu(np.ones((4, 4), bool), 1).tolist()


def test_a_cluster_that_no_way_leads_into_is_named():
    problem = uniform_problem(0, [2, 2, 2])
    cost = problem.cost.copy()
    cost[:, 2:4] = np.inf
    with pytest.raises(InfeasibleError, match="no way leads into cluster 1"):
        tour_form(SequencingProblem(cost, groups([2, 2, 2])))


@pytest.mark.parametrize("fields", [{}, {"closed": False}, {"start": 1}, {"closed": False, "start": 2, "end": 0}])
def test_the_one_form_prices_tours_as_the_problem_does(fields):
    problem = uniform_problem(3, [2, 3, 2], service=True, **fields)
    form = tour_form(problem)
    rng = np.random.default_rng(0)
    for _ in range(20):
        tour = np.array([rng.integers(form.first[i], form.first[i + 1]) for i in range(form.n_clusters)], np.int32)
        nodes = form.node[tour]
        nodes = nodes[nodes >= 0]
        assert form.tour_cost(tour) == pytest.approx(problem.cost_of(nodes), abs=1e-9)


def test_costs_whose_sums_overflow_are_refused():
    cost = np.array([[0.0, 1e308], [1e308, 0.0]])
    with pytest.raises(InvalidInputError, match=r"is 1e\+308, above 1e\+100"):
        SequencingProblem(cost, ((0,), (1,)))
