"""The motions that a point of a layout program stands for, and their extra cost L as a number.

L along the path is measured on the motion itself, at places that do not depend on the program's mesh, so that motions
of different programs compare and what is reported is the mean over the time of the cycle.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.cost_terms import knot_seconds
from cellwright.solvers.layout.costs import extra_costs
from cellwright.solvers.layout.mesh import Mesh
from cellwright.solvers.layout.nlp import LayoutPoint
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.solution import Transition

_PLACES = 200
"""Places on a transition at which its cost is measured, at least."""


def transitions_of(
    problem: LayoutProblem, mesh: Mesh, point: LayoutPoint, least_segments: int = 1
) -> tuple[Transition, ...]:
    """Return the motions of a point; first-order segments are divided until each has ``least_segments`` in all."""
    found = []
    for (start, end), rows, which, share in zip(
        problem.transitions, mesh.transition_rows, mesh.segment_time, mesh.segment_share
    ):
        steps = point.times[which] * share
        q = point.q[rows]
        velocity = None
        if point.velocity.size:
            velocity = point.velocity[rows] * problem.arm.max_velocity
        else:
            # never faster than the joints are, whatever a program left below its tolerance
            steps = np.maximum(steps, (np.abs(np.diff(q, axis=0)) / problem.arm.max_velocity).max(axis=1))
        motion = Transition(start, end, np.concatenate([[0.0], np.cumsum(steps)]), q, velocity)
        if velocity is None and len(steps) < least_segments and motion.duration_s > 0.0:
            parts = -(-least_segments // len(steps))
            corners = motion.times_s
            fine = [np.linspace(a, b, parts, endpoint=False) for a, b in itertools.pairwise(corners)]
            times = np.concatenate([*fine, corners[-1:]])
            motion = Transition(start, end, times, motion.at(times))
        found.append(motion)
    return tuple(found)


def extra_cost(problem: LayoutProblem, mesh: Mesh, q: FloatArray, transitions: Sequence[Transition]) -> float:
    """Return L in s of configurations (n_configs, joints) at the approaches' knots and the motions between them.

    Along the path the mean over the time of transitions and timed approaches, otherwise the mean over the knots.
    """
    cost = problem.cost
    if not cost.counts:
        return 0.0
    if not cost.along_path:
        rows = np.concatenate(mesh.visit_rows)
        return float(extra_costs(problem.arm, q[rows], cost, problem.T_flange_tool).mean())
    configurations, seconds = [], []
    for rows, each in knot_seconds(problem, mesh):
        configurations.append(q[rows])
        seconds.append(each)
    for transition in transitions:
        steps = np.diff(transition.times_s)
        n = -(-_PLACES // len(steps))
        middles = transition.times_s[:-1, None] + steps[:, None] * (np.arange(n) + 0.5) / n
        configurations.append(transition.at(middles.ravel()))
        seconds.append(np.repeat(steps / n, n))
    costs = extra_costs(problem.arm, np.concatenate(configurations), cost, problem.T_flange_tool)
    weight = np.concatenate(seconds)
    return float(costs @ weight / weight.sum())


def measured_cost(problem: LayoutProblem, mesh: Mesh, point: LayoutPoint) -> float:
    """Return the time of all transitions plus L in s, both measured on the motions of a point."""
    transitions = transitions_of(problem, mesh, point)
    duration = sum(transition.duration_s for transition in transitions)
    return duration + extra_cost(problem, mesh, point.q, transitions)
