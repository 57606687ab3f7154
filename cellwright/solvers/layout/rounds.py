"""Rounds of nonlinear programs on one mesh: lazy checks until nothing touches, and refinement of what is clear already.

`solve_lazily` starts with few checks and adds what its solution violates. `refine` starts from a clear motion and
keeps it clear: each round may move configurations and design joints a little only, a round that touches something is
taken back and made smaller, so that the motion never jumps through an obstacle to find out on its other side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.checks import MOST_A_PAIR, missing_checks, samples_of
from cellwright.solvers.layout.mesh import Checks, Mesh
from cellwright.solvers.layout.motions import measured_cost
from cellwright.solvers.layout.nlp import (
    MARGIN_M,
    SLACK_COST,
    LayoutNLP,
    LayoutPoint,
    NLPResult,
    build_layout_nlp,
    run_layout_nlp,
)
from cellwright.solvers.layout.solution import Phase
from cellwright.solvers.layout.symbols import LayoutSymbols
from cellwright.solvers.structured_program import CompiledProgram

CLEAR_M = 2e-4
"""Penetration at a sample below which lazy checking stops; less than the margin that checks keep."""
NEAR_M = 0.02
"""Where a clear motion is so close to something, its refinement knows of it from the beginning."""
_TRUST = 0.25
"""Largest change of a configuration or design joint in the first round of a refinement, rad or m."""
_LEAST_TRUST = 0.02
_TRIES = 3
"""Rounds that may touch something within one trust region, each adding what it touched, before it is made smaller."""
_JUMP_M = 0.05
"""Penetration that more checks will not mend: the round went into an obstacle."""
_LEAST_GAIN = 1e-3
"""Share of the cost that a round has to gain for another one."""


Programs = dict[Checks, tuple[LayoutNLP, CompiledProgram]]
"""Programs of one mesh by the checks that they know: by the object, since `Checks` with equal rows are not equal. Who
wants a program again asks with the very `Checks` that it was built for."""


class RoundLimits(Protocol):
    """What bounds the work of a stage."""

    @property
    def most_rounds(self) -> int:
        """Programs a stage."""

    @property
    def most_iterations(self) -> int:
        """Ipopt iterations a program."""


@dataclass(frozen=True, eq=False)
class Stage:
    """The outcome of lazy rounds on one mesh: the last result, its checks, and how clear it is."""

    mesh: Mesh
    result: NLPResult
    checks: Checks
    deepest_m: float
    phases: tuple[Phase, ...]

    @property
    def clear(self) -> bool:
        """Whether the program was solved and no sample touches anything."""
        return self.deepest_m <= CLEAR_M and self.result.violation < 1e-6

    @property
    def time_s(self) -> float:
        """Time of all transitions."""
        return float(self.result.point.times.sum())

    @property
    def cost(self) -> float:
        """The time of all transitions plus the extra cost, which decides; and the price of slack, none if clear.

        With an extra cost along the path both are measured on the motion, so that stages on different meshes compare.
        """
        return self.result.objective


def solve_lazily(
    symbols: LayoutSymbols,
    mesh: Mesh,
    start: LayoutPoint,
    checks: Checks,
    limits: RoundLimits,
    *,
    name: str,
    transitions: bool = True,
    order: int = 1,
    warm: bool = False,
    most_rounds: int | None = None,
    pinned: FloatArray | None = None,
    programs: Programs | None = None,
    motion_margin_m: float = MARGIN_M,
    most_iterations: int | None = None,
) -> Stage:
    """Solve a program again and again, adding the checks its solution violates, until it violates none.

    With ``pinned`` configurations (n_configs, joints; NaN is free) the design stays as it is too. Calls on one mesh
    that begin with the same checks may share their ``programs``. ``motion_margin_m`` is what the robot keeps.
    """
    point = start
    phases: list[Phase] = []
    best: Stage | None = None
    for number in range(most_rounds or limits.most_rounds):
        kept = programs if number == 0 and programs is not None else {}
        if checks not in kept:
            held = None if pinned is None else start.design
            nlp = build_layout_nlp(
                symbols, mesh, checks, order=order, pinned=pinned, pinned_design=held, motion_margin_m=motion_margin_m
            )
            limit = most_iterations or limits.most_iterations
            kept[checks] = nlp, nlp.program.compiled(most_iterations=limit, warm=warm or number > 0)
        nlp, compiled = kept[checks]
        result = _solved(symbols, nlp, compiled, point)
        sizes = (nlp.program.n_variables, nlp.program.n_constraints, checks.n_checks)
        phases.append(Phase(name, result.status, result.iterations, *sizes))
        samples = samples_of(symbols.geometry, mesh, result.point, transitions=transitions)
        missing, deepest = missing_checks(symbols.geometry, result.point, samples, motion_only=pinned is not None)
        stage = Stage(mesh, result, checks, deepest, tuple(phases))
        if best is None or (result.violation > 1e-6, deepest) <= (best.result.violation > 1e-6, best.deepest_m):
            best = stage
        more = checks.joined(missing)
        # paths are sought between station configurations, which therefore have to keep clear themselves
        if (stage.clear and (transitions or not missing.n_checks)) or more.n_checks == checks.n_checks:
            break
        checks, point = more, result.point
    if best is None:
        raise ValueError("no round was allowed")
    return replace(best, checks=checks, phases=tuple(phases))


def clear_stage(symbols: LayoutSymbols, mesh: Mesh, point: LayoutPoint, checks: Checks) -> Stage:
    """Return a stage for a point that no program made, measured at its samples."""
    samples = samples_of(symbols.geometry, mesh, point)
    _, deepest = missing_checks(symbols.geometry, point, samples, motion_only=not mesh.visit_rows)
    cost = measured_cost(symbols.problem, mesh, point) if mesh.visit_rows else float(point.times.sum())
    return Stage(mesh, NLPResult(point, cost, "given", 0, 0.0), checks, deepest, ())


def _solved(symbols: LayoutSymbols, nlp: LayoutNLP, compiled: CompiledProgram, point: LayoutPoint) -> NLPResult:
    """Return what Ipopt finds from a point; where the extra cost counts along the path it is measured there."""
    result = run_layout_nlp(nlp, compiled, point)
    mesh, cost = nlp.mesh, symbols.problem.cost
    closed_form = nlp.order == 2 and mesh.n_segments == 1
    if not (cost.counts and cost.along_path and mesh.visit_rows) or closed_form:
        return result
    price = SLACK_COST * float(result.point.slack.sum())
    return replace(result, objective=measured_cost(symbols.problem, mesh, result.point) + price)


def refine(
    symbols: LayoutSymbols,
    mesh: Mesh,
    start: LayoutPoint,
    checks: Checks,
    limits: RoundLimits,
    *,
    name: str,
    order: int = 1,
    pinned: FloatArray | None = None,
    beat: float = np.inf,
    least_gain: float = _LEAST_GAIN,
) -> Stage:
    """Shorten a clear motion by rounds within a trust region; return the best clear stage, at worst the start.

    A start that is not quite clear is made so first. Of the second order the start only has to keep clear; if no round
    meets all limits the stage is not clear. The rounds end where even a program that lacks checks gains nothing more
    on the best so far or on the cost to ``beat``, than the share ``least_gain``.
    """
    geometry, motion_only = symbols.geometry, pinned is not None
    best = clear_stage(symbols, mesh, start, checks)
    if order == 2:
        # a start with accelerations keeps clear of obstacles, not yet to its limits
        best = replace(best, result=replace(best.result, violation=np.inf, objective=np.inf))
    trust, phases = _TRUST, []
    # on a fine mesh a path slips by between few checks
    most_a_pair = max(MOST_A_PAIR, mesh.n_segments // 2)
    known, tries = checks, 0
    for _ in range(limits.most_rounds):
        point = best.result.point
        samples = samples_of(geometry, mesh, point)
        near, _ = missing_checks(
            geometry, point, samples, tolerated_m=-NEAR_M, motion_only=motion_only, most_a_pair=most_a_pair
        )
        current = known.joined(near)
        held = None if pinned is None else start.design
        nlp = build_layout_nlp(symbols, mesh, current, order=order, pinned=pinned, pinned_design=held)
        compiled = nlp.program.compiled(most_iterations=limits.most_iterations, warm=True)
        for part, centre in (("q", point.q.ravel()), ("design", point.design)):
            rows = nlp.program.variables[part]
            compiled.lower[rows] = np.maximum(compiled.lower[rows], centre - trust)
            compiled.upper[rows] = np.minimum(compiled.upper[rows], centre + trust)
        result = _solved(symbols, nlp, compiled, point)
        sizes = (nlp.program.n_variables, nlp.program.n_constraints, current.n_checks)
        phases.append(Phase(name, result.status, result.iterations, *sizes))
        samples = samples_of(geometry, mesh, result.point)
        missing, deepest = missing_checks(
            geometry, result.point, samples, motion_only=motion_only, most_a_pair=most_a_pair
        )
        stage = Stage(mesh, result, current, deepest, tuple(phases))
        was_clear = best.clear
        least = min(beat, best.cost if was_clear else np.inf)
        gains = least - stage.cost >= least_gain * abs(stage.cost)
        if stage.clear and (stage.cost < best.cost or not was_clear):
            best, tries = stage, 0
        if not gains:
            # with all checks a round would gain still less
            break
        if best is stage:
            continue
        known, tries = known.joined(missing), tries + 1
        if was_clear and (tries == _TRIES or deepest > _JUMP_M):
            trust, tries = 0.4 * trust, 0
        if trust < _LEAST_TRUST:
            break
    return replace(best, phases=tuple(phases))
