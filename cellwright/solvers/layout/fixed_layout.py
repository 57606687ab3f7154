"""The fastest cycle in one layout as it stands, judged like a layout that may move.

With everything held fixed, configurations and paths alone are optimised. Bodies that stand still are not compared with
each other, so overlaps and harness ranges are judged by the problem in which the layout may move.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.gate import rejudge_design
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.second_order import SecondOrderSettings, solve_second_order
from cellwright.solvers.layout.solution import LayoutSolution
from cellwright.solvers.layout.staged import StagedSettings, solve_staged
from cellwright.solvers.layout.symbols import LayoutSymbols


def time_layout(
    problem: LayoutProblem,
    design: FloatArray,
    rng: np.random.Generator,
    settings: StagedSettings | SecondOrderSettings,
) -> LayoutSolution:
    """Return the fastest cycle that trajectory optimisation finds in one layout (n_design,) held fixed.

    The settings say whether accelerations are limited.
    """
    symbols, at = LayoutSymbols(problem.with_design(design)), np.zeros(0)
    if isinstance(settings, SecondOrderSettings):
        solution = solve_second_order(symbols, at, rng, settings)
    else:
        solution = solve_staged(symbols, at, rng, settings)
    held = np.array(design, float)
    report = rejudge_design(solution.report, LayoutGeometry(problem), held, settings.tolerances)
    return replace(solution, design=held, report=report)
