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
from cellwright.solvers.layout.measures import robot_bodies, touching_bodies
from cellwright.solvers.layout.mesh import Checks, Mesh, build_mesh
from cellwright.solvers.layout.nlp import Indices, LayoutPoint, build_layout_nlp, run_layout_nlp
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.program_checks import add_checks
from cellwright.solvers.layout.solution import ITSELF, Finding
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
    points = start_points(problem, mesh, start, rng, n_branches)
    if geometry.layout_violation(start) > 0.0:
        # where bodies overlap, also from where they overlap least
        points += start_points(problem, mesh, _pushed_apart(symbols, start, start), rng, n_branches)
    for point in points:
        best = _smaller(best, _measured(geometry, mesh, point))
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
        best = _smaller(best, _measured(geometry, mesh, point))
    return best if best is not None else Relaxation(())


def _smaller(one: Relaxation | None, other: Relaxation) -> Relaxation:
    return other if one is None or other.total < one.total else one


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


def nearest_clear_design(symbols: LayoutSymbols, design: FloatArray) -> FloatArray | None:
    """Return the design (n_design,) nearest to an overlapping one whose stations, base and walls keep clear.

    Nearest by the sum of all changes in m and rad, so that few joints change; the nearest found from the design itself
    and a few places about it. None if no clear design was found within the harnesses.
    """
    problem, geometry = symbols.problem, symbols.geometry
    rng = np.random.default_rng(0)
    best: FloatArray | None = None
    for share in (0.0, 0.1, 0.3, 1.0):
        other = rng.uniform(problem.lower, problem.upper)
        found = _pushed_apart(symbols, design, (1.0 - share) * design + share * other)
        if geometry.layout_violation(found) > 0.0:
            continue
        if best is None or np.abs(found - design).sum() < np.abs(best - design).sum() - _WORTH_NAMING:
            best = found
    return best


def _pushed_apart(symbols: LayoutSymbols, design: FloatArray, start: FloatArray) -> FloatArray:
    """Return the outcome of least change from ``design`` that the program finds from ``start``, both (n_design,)."""
    problem = symbols.problem
    program = StructuredProgram()
    moved = program.add_variables("design", problem.lower, problem.upper)
    n = len(moved)
    more, less = (program.add_variables(name, np.zeros(n), np.full(n, np.inf)) for name in ("more", "less"))
    columns = np.stack([moved, more, less], axis=1)
    program.add_linear("change", columns, np.array([1.0, -1.0, 1.0]), design, design)
    program.add_linear_cost(np.concatenate([more, less]), 1.0)
    parts = problem.design_slices()
    none = np.zeros((0, problem.arm.n_joints), np.int64)
    at = Indices(moved, none, none, none[:, 0], moved[parts[0]], tuple(moved[part] for part in parts[1:]))
    checks = all_layout_checks(symbols.geometry)
    rows, _ = add_checks(symbols, build_mesh(problem, 1), checks, program, at, (0.0, _WORTH_NAMING))
    slack = program.add_variables("slack", np.zeros(len(rows)), np.full(len(rows), np.inf))
    program.relax(rows, slack)
    program.add_linear_cost(slack, _PRICE)
    compiled = program.compiled()
    x0 = np.zeros(program.n_variables)
    x0[moved], x0[more], x0[less] = start, np.maximum(start - design, 0.0), np.maximum(design - start, 0.0)
    x0[slack] = np.maximum(compiled.low[rows] - np.asarray(compiled.constraint(x0))[rows, 0], 0.0)
    return np.asarray(compiled.solve(x0).x[moved])


def _itself_or_other(problem: LayoutProblem, one: str, other: str) -> str:
    """Return what a robot touches: `ITSELF` and its two parts, or the other body and with what."""
    if other in robot_bodies(problem):
        return f"{ITSELF}, {one} and {other}"
    return f"{other} with {one}"


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
        gaps = geometry.motion_gap(point.design, q, own)
        if -float(gaps.min()) > _WORTH_NAMING:
            touching = touching_bodies(geometry, point.design, q[int(np.argmin(gaps))], own)
            what = f"the robot at {problem.visit_name(visit)} touches {_itself_or_other(problem, *touching)}"
            findings.append(Finding(what, -float(gaps.min()), "m"))
    findings += [
        Finding(f"{gap.first} and {gap.second} overlap", -gap.gap_m, "m")
        for gap in geometry.worst_layout_gaps(point.design)
        if gap.gap_m < -_WORTH_NAMING
    ]
    return Relaxation(tuple(sorted(findings, key=lambda finding: -finding.excess)))
