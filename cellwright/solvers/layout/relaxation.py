"""Why a layout has no solution: the smallest relaxation that would make it feasible, by name.

The station program is solved once more with every requirement elastic: tool poses, overlaps, walls. What slack is left
at the least sum names what blocks, and by how much it would have to give. The program is not convex: it is the smallest
relaxation found from a few starts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.transforms import inverse
from cellwright.errors import InfeasibleError, listed
from cellwright.solvers.layout.approach import target_error
from cellwright.solvers.layout.checks import all_layout_checks, missing_checks, samples_of
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.mesh import Checks, Mesh, build_mesh
from cellwright.solvers.layout.nlp import LayoutPoint, build_layout_nlp, run_layout_nlp
from cellwright.solvers.layout.solution import Finding
from cellwright.solvers.layout.start import start_points
from cellwright.solvers.layout.symbols import LayoutSymbols
from cellwright.solvers.structured_program import StructuredProgram

_PRICE = 100.0
"""Seconds a metre (or radian) of relaxation: the cycle's time hardly counts."""
_WORTH_NAMING = 1e-5
_ROUNDS = 5
_MOST_LAYOUT = 1000


@dataclass(frozen=True)
class Relaxation:
    """What would have to give: one finding a requirement, largest first, and their sum in m and rad."""

    findings: tuple[Finding, ...]

    @property
    def total(self) -> float:
        """The sum of all excesses."""
        return sum(finding.excess for finding in self.findings)

    def message(self) -> str:
        """Return the findings as a sentence for people."""
        return listed(
            f"{finding.requirement}: relax it by {finding.excess:.4g} {finding.unit}" for finding in self.findings
        )


def smallest_relaxation(
    symbols: LayoutSymbols, start: FloatArray, rng: np.random.Generator, n_branches: int = 3
) -> Relaxation:
    """Return the smallest relaxation found from a design (n_design,); empty if every station can be served."""
    problem, geometry = symbols.problem, symbols.geometry
    mesh = build_mesh(problem, 1)
    best: Relaxation | None = None
    layout = all_layout_checks(geometry)
    for point in start_points(problem, mesh, start, rng, n_branches):
        checks = layout if layout.n_checks <= _MOST_LAYOUT else Checks()
        for _ in range(_ROUNDS):
            nlp = build_layout_nlp(symbols, mesh, checks, slack_cost=_PRICE, margin_m=0.0)
            _relax_targets(mesh, nlp.program)
            result = run_layout_nlp(nlp, nlp.program.compiled(), point)
            point = result.point
            samples = samples_of(geometry, mesh, point, transitions=False)
            missing, _ = missing_checks(geometry, point, samples, tolerated_m=_WORTH_NAMING)
            more = checks.joined(missing)
            if more.n_checks == checks.n_checks:
                break
            checks = more
        found = _measured(geometry, mesh, point)
        if best is None or found.total < best.total:
            best = found
    return best if best is not None else Relaxation(())


def require_feasible(symbols: LayoutSymbols, start: FloatArray, rng: np.random.Generator) -> None:
    """Pass if a relaxation of nothing was found.

    Raises:
        InfeasibleError: If stations cannot be served as they stand: which requirement, and by how much it misses.
    """
    relaxation = smallest_relaxation(symbols, start, rng)
    if relaxation.findings:
        raise InfeasibleError(
            f"the layout has no solution; the smallest relaxation found is {relaxation.total:.4g} in all: "
            f"{relaxation.message()}"
        )


def _relax_targets(mesh: Mesh, program: StructuredProgram) -> None:
    """Let every tool pose give way in both directions, at a price."""
    for visit in range(len(mesh.visit_rows)):
        part = program.constraints.get(f"target {visit}")
        if part is None:
            continue
        rows = np.arange(part.start, part.stop)
        for sign in (1.0, -1.0):
            n = len(rows)
            give = program.add_variables(f"give {visit} {sign:+.0f}", np.zeros(n), np.full(n, np.inf))
            program.relax(rows, give, sign)
            program.add_linear_cost(give, _PRICE)


def _measured(geometry: LayoutGeometry, mesh: Mesh, point: LayoutPoint) -> Relaxation:
    """Return what a point misses, measured as numbers."""
    problem = geometry.problem
    T_base_world = inverse(problem.base_pose(point.design))
    T_stations = problem.station_poses(point.design)
    findings: list[Finding] = []
    for visit, (rows, knots) in enumerate(zip(mesh.visit_rows, mesh.knots)):
        approach = problem.approach_of(visit)
        if approach is None or knots is None:
            continue
        goals = T_base_world @ T_stations[problem.visits[visit].station] @ knots.T_station_tool
        q = point.q[rows]
        error = target_error(problem.arm.flange_pose(q) @ problem.T_flange_tool, goals, approach.target)
        away = float(np.linalg.norm(error[:, :3], axis=1).max())
        turned = float(np.linalg.norm(error[:, 3:], axis=1).max())
        if away > _WORTH_NAMING:
            findings.append(Finding(f"{problem.visit_name(visit)} is out of reach", away, "m"))
        if turned > 10.0 * _WORTH_NAMING:
            findings.append(Finding(f"{problem.visit_name(visit)} cannot be reached at its angle", turned, "rad"))
        own = problem.visits[visit].station if len(rows) > 1 else -1
        deep = -float(geometry.motion_gap(point.design, q, own).min())
        if deep > _WORTH_NAMING:
            findings.append(Finding(f"the robot at {problem.visit_name(visit)} touches something", deep, "m"))
    findings += [
        Finding(f"{gap.first} and {gap.second} overlap", -gap.gap_m, "m")
        for gap in geometry.worst_layout_gaps(point.design)
        if gap.gap_m < -_WORTH_NAMING
    ]
    return Relaxation(tuple(sorted(findings, key=lambda finding: -finding.excess)))
