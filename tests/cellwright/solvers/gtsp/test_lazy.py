from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers.gtsp.known_costs import KnownCosts
from cellwright.solvers.gtsp.lazy import solve_known, solve_lazily, velocity_bounds
from cellwright.solvers.gtsp.problem import SequencingProblem
from cellwright.solvers.sequencing import solve_sequence
from tests.cellwright.solvers.sequencing_problems import PAPER_ALTERNATIVES, groups, robot_problem


def rng(seed=0):
    return np.random.default_rng(seed)


def lazily(problem, least, **settings):
    """The lazy result, and the motions it asked for."""
    asked = []

    def evaluate(a, b):
        asked.append((a, b))
        return float(problem.cost[a, b])

    bounds = SequencingProblem(
        least, problem.clusters, problem.service, problem.closed, problem.start, problem.end, problem.before
    )
    return solve_lazily(bounds, evaluate, rng(), **settings), asked


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=6, deadline=None)
def test_the_result_is_that_of_full_evaluation(seed, closed):
    problem, least = robot_problem(seed, (3, 5, 4, 2, 6, 3), closed=closed)
    lazy, asked = lazily(problem, least)
    full = solve_sequence(problem, rng())
    assert lazy.result.proven and full.proven
    assert lazy.result.cost == pytest.approx(full.cost, abs=1e-7)
    assert lazy.result.cost == pytest.approx(problem.cost_of(lazy.result.nodes), abs=1e-9)
    assert len(asked) == len(set(asked)) == lazy.n_evaluated == int(lazy.evaluated.sum())
    assert lazy.n_evaluated < 0.5 * lazy.n_motions


def test_few_motions_of_a_larger_problem_are_evaluated():
    problem, least = robot_problem(0, PAPER_ALTERNATIVES[:13], noise=0.1)
    lazy, _ = lazily(problem, least, target_gap=0.01)
    assert lazy.result.gap <= 0.01
    assert lazy.share_evaluated < 0.01


@pytest.mark.parametrize("seed", range(2))
def test_a_hundredth_of_the_motions_finds_what_all_of_them_find(seed):
    """Ten tasks of sixteen to twenty-four alternatives; bounds are up to a tenth low."""
    problem, least = robot_problem(seed, (16, 20, 24, 18, 22, 16, 20, 24, 18, 22), noise=0.1)
    lazy, asked = lazily(problem, least)
    full = solve_sequence(problem, rng())
    assert lazy.n_motions > 30_000 and len(asked) == lazy.n_evaluated
    assert lazy.share_evaluated <= 0.01
    assert lazy.result.proven and full.proven
    assert lazy.result.cost == pytest.approx(full.cost, rel=1e-9)


def test_motions_that_cost_the_same_backwards_are_evaluated_once():
    problem, least = robot_problem(1, (4, 4, 4, 4, 4))
    both = SequencingProblem(np.maximum(problem.cost, problem.cost.T), problem.clusters, problem.service)
    lazy, asked = lazily(both, least, symmetric=True)
    assert len({frozenset(pair) for pair in asked}) == len(asked)
    assert lazy.n_motions == 10 * 16
    assert lazy.result.cost == pytest.approx(solve_sequence(both, rng()).cost, abs=1e-7)


def test_motions_that_do_not_exist_are_gone_around():
    problem, least = robot_problem(2, (3, 3, 3, 3))
    missing = rng(3).random(problem.cost.shape) < 0.3
    cost = np.where(missing, np.inf, problem.cost)
    gone = SequencingProblem(cost, problem.clusters, problem.service)
    lazy, _ = lazily(gone, least)
    assert lazy.result.proven
    assert lazy.result.cost == pytest.approx(solve_sequence(gone, rng()).cost, abs=1e-7)


def test_no_motions_at_all_is_told():
    problem, least = robot_problem(2, (2, 2, 2))
    with pytest.raises(InfeasibleError, match="motions all exist"):
        lazily(SequencingProblem(np.full(least.shape, np.inf), problem.clusters), least)


def test_a_bound_that_is_none_is_told():
    problem, least = robot_problem(2, (2, 2, 2))
    with pytest.raises(InvalidInputError, match="its lower bound is"):
        lazily(problem, 3.0 * least)


def test_a_limit_of_evaluations_leaves_an_honest_gap():
    problem, least = robot_problem(6, (8, 9, 7, 8, 9, 10, 8, 9), noise=1.0)
    lazy, asked = lazily(problem, least, max_evaluations=12)
    assert len(asked) <= 12 + 8
    assert lazy.result.stopped_by in ("evaluations", "proof")
    full = solve_sequence(problem, rng())
    assert lazy.result.lower_bound <= full.cost + 1e-9 <= lazy.result.cost + 2e-9
    known = SequencingProblem(lazy.cost, problem.clusters, problem.service)
    on_known = solve_sequence(known, rng())
    assert on_known.proven, "what is known at the end is bounded as well as it can be"
    assert lazy.result.lower_bound == pytest.approx(on_known.cost, rel=1e-6)


@pytest.mark.parametrize("limits", [{"max_evaluations": 5}, {"stop": lambda: True}])
def test_limits_hold_where_no_sequence_exists(limits):
    """One task cannot be left by any motion: without a limit, all motions into it have to be evaluated."""
    problem, least = robot_problem(6, (8, 9, 7, 8, 9, 10, 8, 9))
    cost = problem.cost.copy()
    cost[problem.clusters[3]] = np.inf
    gone = SequencingProblem(cost, problem.clusters, problem.service)
    asked = []

    def evaluate(a, b):
        asked.append((a, b))
        return float(gone.cost[a, b])

    with pytest.raises(InfeasibleError, match=r"limit of .* was met, .* evaluated: allow more"):
        solve_lazily(SequencingProblem(least, gone.clusters, gone.service), evaluate, rng(), **limits)
    assert len(asked) <= 5 + 8


def test_a_sequence_to_begin_with_is_kept_where_others_have_missing_ways():
    problem, least = robot_problem(4, (3, 4, 3, 4, 3))
    nodes = [0, 3, 7, 10, 14]
    cost = np.full(problem.cost.shape, np.inf)
    for a, b in problem.legs(nodes):
        cost[a, b] = problem.cost[a, b]
    known = KnownCosts(SequencingProblem(least, problem.clusters, problem.service), lambda a, b: float(cost[a, b]))
    lazy = solve_known(known, rng(), start=nodes, max_evaluations=5)
    assert known.n_evaluated == lazy.n_evaluated == 5 and lazy.result.stopped_by == "evaluations"
    assert sorted(lazy.result.nodes.tolist()) == nodes and lazy.result.cost == pytest.approx(problem.cost_of(nodes))
    everything = solve_known(known, rng(), start=nodes)
    assert everything.result.proven and sorted(everything.result.nodes.tolist()) == nodes
    with pytest.raises(InvalidInputError, match="begin with does not fit"):
        solve_known(known, rng(), start=[0, 1])


def test_what_is_known_before_is_not_asked_for_again():
    problem, least = robot_problem(1, (4, 4, 4, 4, 4))
    first, asked = lazily(problem, least)
    again = []

    def evaluate(a, b):
        again.append((a, b))
        return float(problem.cost[a, b])

    known = KnownCosts(SequencingProblem(least, problem.clusters, problem.service), evaluate)
    for a, b in asked:
        known.put(a, b, float(problem.cost[a, b]))
    lazy = solve_known(known, rng(), start=first.result.nodes)
    assert not again and known.n_evaluated == 0 and lazy.result.proven
    assert lazy.result.cost == pytest.approx(first.result.cost)


def test_a_time_limit_returns_an_evaluated_sequence():
    problem, least = robot_problem(6, (8, 9, 7, 8, 9, 10))
    asked = itertools.count()
    lazy, _ = lazily(problem, least, stop=lambda: next(asked) > 0)
    assert lazy.result.cost == pytest.approx(problem.cost_of(lazy.result.nodes))
    assert lazy.result.lower_bound <= lazy.result.cost


def test_the_velocity_bound_is_the_slowest_joint():
    q = np.array([[0.0, 0.0], [1.0, -3.0]])
    assert velocity_bounds(q, np.array([0.5, 3.0])).tolist() == [[0.0, 2.0], [2.0, 0.0]]
    with pytest.raises(InvalidInputError, match="above 0"):
        velocity_bounds(q, np.array([0.5, 0.0]))
    with pytest.raises(InvalidInputError, match="shape"):
        velocity_bounds(q, np.array([0.5]))


def test_a_gap_that_is_no_share_is_refused():
    problem = SequencingProblem(np.ones((2, 2)), groups([1, 1]))
    with pytest.raises(InvalidInputError, match="target_gap"):
        solve_lazily(problem, lambda a, b: 1.0, rng(), target_gap=1.5)


def test_the_examples_of_the_documentation_run():
    text = (Path(__file__).parents[4] / "docs" / "sequence.md").read_text()
    section = text[text.index("## The solver") :].split("\n## ")[0]
    found = re.findall(r"^```python\n(.*?)^```$", section, flags=re.M | re.S)
    assert len(found) == 3
    exec(compile("\n".join(found), "sequence.md", "exec"), {})
