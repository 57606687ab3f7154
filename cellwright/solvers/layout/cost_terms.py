"""The extra cost L in a layout program: its mean over the approaches' knots, or over the time of the cycle.

Along the path L is the integral of a configuration's cost over the time of transitions and timed approaches, divided by
that time. The integral is taken by Gauss's rule at fixed shares of every segment, so that a long straight segment
counts between its ends too; the time that all of it takes is one variable more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.solvers.layout.mesh import Mesh
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.symbols import LayoutSymbols, Place
from cellwright.solvers.structured_program import StructuredProgram

if TYPE_CHECKING:
    from cellwright.solvers.layout.nlp import Indices

_NODES = 16
"""Places on a transition at which the cost is evaluated, at least, and one a segment: within 2e-3 of what is measured
on straight motions of a six-axis arm, through singularities too."""


def add_extra_cost(
    symbols: LayoutSymbols, mesh: Mesh, program: StructuredProgram, at: Indices, *, speeds_vary: bool
) -> None:
    """Add L to a program's cost; with ``speeds_vary`` accelerations are constant over segments instead of speeds."""
    if not symbols.problem.cost.along_path:
        rows = np.concatenate(mesh.visit_rows)
        program.add_cost(symbols.extra_cost(), at.q[rows], np.zeros((len(rows), 0)), 1.0 / len(rows))
        return
    approach_s = sum(float(seconds.sum()) for _, seconds in knot_seconds(symbols.problem, mesh))
    total = program.add_variables("total", np.array([1e-6]), np.array([np.inf]))
    columns = np.concatenate([total, at.times])
    factors = np.concatenate([[1.0], -np.ones(len(at.times))])
    program.add_linear("total", columns[None], factors[None], approach_s, approach_s)
    for rows, seconds in knot_seconds(symbols.problem, mesh):
        index = np.column_stack([at.q[rows], np.tile(total, len(rows))])
        program.add_cost(symbols.knot_cost(), index, seconds[:, None], 1.0)
    place = Place.ARC if speeds_vary else Place.LINE
    share, weight = _gauss(-(-_NODES // mesh.n_segments))
    for number, rows in enumerate(mesh.transition_rows):
        before, after = np.repeat(rows[:-1], len(share)), np.repeat(rows[1:], len(share))
        part = np.repeat(mesh.segment_share[number], len(share))
        times = np.repeat(at.times[mesh.segment_time[number]], len(share))
        speeds = [at.velocity[before], at.velocity[after]] if speeds_vary else []
        index = np.column_stack([at.q[before], at.q[after], *speeds, times, np.tile(total, len(times))])
        constants = np.column_stack([np.tile(share, len(rows) - 1), part, np.tile(weight, len(rows) - 1)])
        program.add_cost(symbols.path_cost(place), index, constants, 1.0)


def knot_seconds(problem: LayoutProblem, mesh: Mesh) -> list[tuple[IntArray, FloatArray]]:
    """Return the rows of each timed approach's knots and the seconds that each stands for (trapezoidal rule)."""
    found = []
    for rows, knots in zip(mesh.visit_rows, mesh.knots):
        if knots is not None and knots.timed:
            half = 0.5 * knots.durations_s
            found.append((rows, np.append(half, 0.0) + np.append(0.0, half)))
    return found


def _gauss(n: int) -> tuple[FloatArray, FloatArray]:
    """Return the shares (n,) of a segment at which Gauss's rule evaluates, and their weights, which add up to 1."""
    x, weight = np.polynomial.legendre.leggauss(n)
    return 0.5 * (1.0 + x), 0.5 * weight
