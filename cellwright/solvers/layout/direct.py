"""Layout and motion in one program from the start: equation (4) of Baumgaertner 2025, the baseline.

N segments a transition, every collision check at every point in time at once, tool poses as a tracking cost. Written
as well as the form allows: times instead of time steps are the variables, so that the robot's model is linear, and the
start is the shortest cycle through the branches at the given design. What remains of the form is its soft endpoints
(a residual of about 1 / (2 weight) per second and metre that the motion would gain) and its size.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.checks import all_checks_at_rows
from cellwright.solvers.layout.gate import GateTolerances
from cellwright.solvers.layout.mesh import build_mesh
from cellwright.solvers.layout.nlp import build_layout_nlp, run_layout_nlp
from cellwright.solvers.layout.solution import LayoutSolution, Phase
from cellwright.solvers.layout.staged import solution_of
from cellwright.solvers.layout.start import start_points
from cellwright.solvers.layout.symbols import LayoutSymbols


@dataclass(frozen=True)
class DirectSettings:
    """Settings of the direct solver.

    Attributes:
        n_segments: Segments of each transition.
        tracking: Seconds that a square metre or square radian of tracking error costs.
        most_iterations: Ipopt iterations.
        tolerances: Of the gate.
    """

    n_segments: int = 100
    tracking: float = 2e3
    most_iterations: int = 400
    tolerances: GateTolerances = field(default_factory=GateTolerances)


def solve_direct(
    symbols: LayoutSymbols, start: FloatArray, rng: np.random.Generator, settings: DirectSettings
) -> LayoutSolution:
    """Solve a layout problem from a design (n_design,)."""
    mesh = build_mesh(symbols.problem, settings.n_segments)
    point = start_points(symbols.problem, mesh, start, rng, 1)[0]
    checks = all_checks_at_rows(symbols.geometry, mesh)
    nlp = build_layout_nlp(
        symbols, mesh, checks, tracking=settings.tracking, slack_cost=np.inf, margin_m=0.0, lifted=True
    )
    result = run_layout_nlp(nlp, nlp.program.compiled(most_iterations=settings.most_iterations), point)
    sizes = (nlp.program.n_variables, nlp.program.n_constraints, checks.n_checks)
    phase = Phase("direct", result.status, result.iterations, *sizes)
    return solution_of(symbols, "direct", mesh, result, (phase,), settings.tolerances)
