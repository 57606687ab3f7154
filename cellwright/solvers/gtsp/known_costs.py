"""What is known of the costs of motions: true ones where they were evaluated, lower bounds elsewhere.

Shared by all searches of one problem (`cellwright.solvers.gtsp.guided`, `cellwright.solvers.gtsp.lazy`): each motion is
evaluated once, whoever asks, and there is one count of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.errors import InvalidInputError
from cellwright.solvers.gtsp.problem import SequencingProblem

Evaluate = Callable[[int, int], float]
"""True cost of going from one alternative to another; infinite if there is no motion."""

BELOW = 1e-6
"""Share of a bound by which a true cost may be below it: rounding."""


class KnownCosts:
    """Costs of a problem as they become known.

    Args:
        problem: The problem, its ``cost`` being lower bounds of the true costs.
        evaluate: True cost of one motion. Called at most once a motion.
        symmetric: Whether motions cost the same backwards, so that one evaluation is worth two.

    Attributes:
        problem: As given.
        symmetric: As given.
        cost: True costs where ``evaluated``, else lower bounds, (alternatives, alternatives).
        evaluated: Which are true costs.
        n_evaluated: How often ``evaluate`` was called.
        n_motions: Motions that there are: ordered pairs of alternatives of different clusters, or unordered ones where
            both directions cost the same.
    """

    def __init__(self, problem: SequencingProblem, evaluate: Evaluate, *, symmetric: bool = False) -> None:
        self.problem, self.symmetric, self._evaluate = problem, symmetric, evaluate
        self.cost: FloatArray = problem.cost.copy()
        self.evaluated: BoolArray = np.zeros(self.cost.shape, bool)
        self.n_evaluated = 0
        sizes = np.array([len(own) for own in problem.clusters])
        self.n_motions = int((sizes.sum() ** 2 - (sizes**2).sum()) // (2 if symmetric else 1))

    def present(self) -> SequencingProblem:
        """Return the problem on what is known now."""
        return replace(self.problem, cost=self.cost)

    def open_legs(self, nodes: Int32Array) -> list[tuple[int, int]]:
        """Return the motions of a sequence that are not evaluated yet."""
        return [leg for leg in self.problem.legs(nodes) if not self.evaluated[leg]]

    def evaluate(self, a: int, b: int) -> float:
        """Return the true cost of a motion.

        Raises:
            InvalidInputError: If it is below its lower bound, or not a number.
        """
        if not self.evaluated[a, b]:
            true = float(self._evaluate(a, b))
            self.n_evaluated += 1
            self.put(a, b, true)
        return float(self.cost[a, b])

    def put(self, a: int, b: int, true: float) -> None:
        """Take in a true cost that was found elsewhere; it does not count as evaluated here.

        Raises:
            InvalidInputError: If it is below its lower bound, or not a number.
        """
        least = float(self.problem.cost[a, b])
        if math.isnan(true) or true < least - BELOW * max(1.0, abs(least)):
            raise InvalidInputError(
                f"the motion from alternative {a} to {b} costs {true:g}, but its lower bound is {least:g}: no proof "
                "holds on bounds that are none; lower them"
            )
        self.cost[a, b], self.evaluated[a, b] = max(true, least), True
        if self.symmetric:
            self.cost[b, a], self.evaluated[b, a] = self.cost[a, b], True

    def settle(self, nodes: Int32Array, ceiling: float, is_over: Callable[[], bool]) -> float:
        """Evaluate the motions of a sequence while it can cost less than ``ceiling``; return its cost if all are.

        Infinite if it turns out to cost as much, or if ``is_over`` says before that no more may be evaluated.
        """
        legs = self.problem.legs(nodes)
        own = math.fsum(float(self.problem.service[v]) for v in nodes)
        # the longest first: where most can be lost, so that what cannot win is found out soon
        for leg in sorted(self.open_legs(nodes), key=lambda leg: (-self.cost[leg], leg)):
            total = own + math.fsum(float(self.cost[each]) for each in legs)
            if total >= ceiling or is_over():
                return math.inf
            self.evaluate(*leg)
        total = own + math.fsum(float(self.cost[each]) for each in legs)
        return total if total < ceiling else math.inf
