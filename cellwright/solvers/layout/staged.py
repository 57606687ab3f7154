"""Layout and motion in stages, each a small program that warms the next: ours.

1. Station configurations only. Without obstacles the fastest first-order motion between two configurations is the
   straight one at full speed of its slowest joint, ``T = max|dq|/v``, so design and configurations alone form an exact
   program of some forty variables. If the straight motions are clear, this is the optimum and nothing is left to do.
2. Few segments of free duration with checks between them. A polyline is a whole first-order motion, checked at every
   sample, so this already is a valid cycle.
3. N segments of equal duration, endpoints hard, where motions are bent, or where the extra cost counts along them and
   may bend them; kept if it costs less and passes. It ends after the first program that cannot undercut the second
   stage, whatever checks it still lacks.

Collision checks are added lazily with elastic slack (`checks`). Each start runs through several branches of the
inverse kinematics; once a cycle is finished only those branches are followed that without obstacles undercut it by the
share `StagedSettings.worth`, since paths round obstacles take some of that back.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.checks import all_layout_checks, missing_checks, samples_of
from cellwright.solvers.layout.gate import GateTolerances, check_layout
from cellwright.solvers.layout.mesh import Checks, Mesh, build_mesh, path_mesh
from cellwright.solvers.layout.motions import extra_cost, transitions_of
from cellwright.solvers.layout.nlp import LayoutPoint, NLPResult
from cellwright.solvers.layout.paths import promising_paths
from cellwright.solvers.layout.rounds import (
    CLEAR_M,
    NEAR_M,
    Programs,
    Stage,
    clear_stage,
    refine,
    solve_lazily,
)
from cellwright.solvers.layout.solution import LayoutSolution, Phase
from cellwright.solvers.layout.start import segment_times, spread_points, start_points
from cellwright.solvers.layout.symbols import LayoutSymbols

_STATION_MARGIN_M = 2e-3
"""What station configurations keep from everything in the first stage: a path that begins on a surface has no room to
leave it on. The later stages move them on to the margin of all checks."""
_PATH_ITERATIONS = 100
"""Ipopt iterations a program of one transition's path: what takes longer is not on its way to a clear one."""
_PATH_LEAST_GAIN = 0.05
"""Share of its time that a round must gain on one transition's path, which is refined with all others afterwards."""

__all__ = ["Stage", "StagedSettings", "path_between", "solution_of", "solve_lazily", "solve_staged"]


@dataclass(frozen=True)
class StagedSettings:
    """Settings of the staged solver.

    Attributes:
        n_segments: Segments of each transition in the last stage, and at least in the solution.
        n_coarse: Segments of each transition in the second stage.
        n_branches: Starts through different branches at the given design.
        n_sweeps: Rounds of further starts about the best design so far.
        n_spread: Starts a round: the best cycles through random places of all stations.
        n_places: Random places of each station for them.
        most_paths: Outcomes of the first stage, best first, whose paths are tried.
        worth: Share by which an outcome's time without obstacles must undercut a finished cycle to be tried.
        hope: Share by which an outcome with its paths may exceed a finished cycle and still be refined.
        n_bends: Bent paths a transition that the second stage may start from, most promising first.
        most_rounds: Rounds of lazy checks a stage.
        most_iterations: Ipopt iterations a program.
        most_layout: Layout checks that are all taken at once; more are added lazily too.
        polish: Whether the third stage runs.
        tolerances: Of the gate.
    """

    n_segments: int = 100
    n_coarse: int = 8
    n_branches: int = 2
    n_sweeps: int = 2
    n_spread: int = 4
    n_places: int = 12
    most_paths: int = 4
    worth: float = 0.15
    hope: float = 0.1
    n_bends: int = 2
    most_rounds: int = 12
    most_iterations: int = 200
    polish: bool = True
    most_layout: int = 400
    tolerances: GateTolerances = field(default_factory=GateTolerances)


def solve_staged(
    symbols: LayoutSymbols, start: FloatArray, rng: np.random.Generator, settings: StagedSettings
) -> LayoutSolution:
    """Solve a layout problem from a design (n_design,)."""
    best, phases = staged_outcome(symbols, start, rng, settings)
    return solution_of(
        symbols, "staged", best.mesh, best.result, tuple(phases), settings.tolerances, settings.n_segments
    )


def staged_outcome(
    symbols: LayoutSymbols, start: FloatArray, rng: np.random.Generator, settings: StagedSettings
) -> tuple[Stage, list[Phase]]:
    """Return the best stage from a design, not gated yet, and the programs that led to it."""
    phases: list[Phase] = []
    stations = _stations(symbols, start, rng, settings, phases)
    best: Stage | None = None
    worth = settings.worth
    for stage in stations:
        # shares of the size of a cost, which is negative where manipulability outweighs the time
        if best is not None and best.clear and not (stage.clear and stage.cost < best.cost - worth * abs(best.cost)):
            continue
        beat = best.cost if best is not None and best.clear else np.inf
        whole = _with_path(symbols, stage, rng, settings, phases, beat)
        if best is None or (not whole.clear, whole.cost) < (not best.clear, best.cost):
            best = whole
    if best is None:
        raise ValueError("a start without a point")
    # a motion that is cheaper along its way may be bent where the fastest one is straight
    bends = best.mesh.n_segments > 1 or (symbols.problem.cost.along_path and symbols.problem.cost.counts)
    if settings.polish and bends and best.clear:
        best = _polished(symbols, best, settings, phases)
    return best, phases


def _stations(
    symbols: LayoutSymbols, start: FloatArray, rng: np.random.Generator, settings: StagedSettings, phases: list[Phase]
) -> list[Stage]:
    """Return the first stage's outcomes, clear ones first, then cheapest first.

    Starts are the best branches at the start's design, then rounds of places for all stations about the best so far.
    """
    problem = symbols.problem
    mesh = build_mesh(problem, 1)
    layout = all_layout_checks(symbols.geometry)
    known = layout if layout.n_checks <= settings.most_layout else Checks()
    found: list[Stage] = []
    programs: Programs = {}
    for sweep in range(settings.n_sweeps + 1):
        if sweep == 0:
            points = start_points(problem, mesh, start, rng, settings.n_branches)
        else:
            about = found[0].result.point.design
            points = spread_points(problem, mesh, about, rng, settings.n_spread, settings.n_places)
        for point in points:
            stage = solve_lazily(
                symbols,
                mesh,
                point,
                known,
                settings,
                name="stations",
                transitions=False,
                programs=programs,
                motion_margin_m=_STATION_MARGIN_M,
            )
            phases += stage.phases
            more = known.joined(stage.checks)
            if more.n_checks > known.n_checks:
                known, programs = more, {}
            if not any(_same(stage, other) for other in found):
                found.append(stage)
        found.sort(key=lambda each: (not each.clear, each.cost))
    return found[: settings.most_paths]


def _same(one: Stage, other: Stage) -> bool:
    return abs(one.cost - other.cost) < 1e-6 and bool(np.abs(one.result.point.q - other.result.point.q).max() < 1e-4)


def _with_path(
    symbols: LayoutSymbols,
    stations: Stage,
    rng: np.random.Generator,
    settings: StagedSettings,
    phases: list[Phase],
    beat: float,
) -> Stage:
    """Return the stage itself if its straight motions are clear, else the second stage from it.

    Given up, and returned as not clear, where a path is not found or paths take so much longer than straight motions
    that refinement will not undercut the cost to ``beat``.
    """
    samples = samples_of(symbols.geometry, stations.mesh, stations.result.point)
    _, deepest = missing_checks(symbols.geometry, stations.result.point, samples)
    if not stations.clear:
        # what blocks the stations themselves no path can mend
        return stations
    if deepest <= CLEAR_M:
        if not len(stations.checks.motion):
            return stations
        stage = refine(symbols, stations.mesh, stations.result.point, stations.checks, settings, name="straight")
        phases += stage.phases
        return stage
    mesh = build_mesh(symbols.problem, settings.n_coarse, free_times=True)
    point = stations.result.point
    q = mesh.interpolated([point.q[rows] for rows in stations.mesh.visit_rows])
    blocked = replace(stations, deepest_m=max(deepest, 2.0 * CLEAR_M))
    cost = stations.cost
    for number, rows in enumerate(mesh.transition_rows):
        path = path_between(symbols, point.design, q[rows], rng, settings, phases)
        q[rows] = path.result.point.q
        cost += path.cost - float(point.times[number])
        if not path.clear or (np.isfinite(beat) and cost > beat + settings.hope * abs(beat)):
            return blocked
    start = LayoutPoint(point.design, q, segment_times(symbols.problem, mesh, q))
    samples = samples_of(symbols.geometry, mesh, start)
    near, _ = missing_checks(symbols.geometry, start, samples, tolerated_m=-NEAR_M)
    checks = Checks(layout=stations.checks.layout).joined(near)
    stage = refine(symbols, mesh, start, checks, settings, name="coarse")
    phases += stage.phases
    return stage


def path_between(
    symbols: LayoutSymbols,
    design: FloatArray,
    straight: FloatArray,
    rng: np.random.Generator,
    settings: StagedSettings,
    phases: list[Phase],
) -> Stage:
    """Return the fastest clear motion found between two fixed configurations at a fixed design.

    ``straight`` (segments + 1, joints) is the straight motion; if it is not clear the search begins at bent ones.
    """
    mesh = path_mesh(len(straight) - 1)
    pinned = np.full_like(straight, np.nan)
    pinned[[0, -1]] = straight[[0, -1]]
    best: Stage | None = None
    least = float(segment_times(symbols.problem, path_mesh(1), straight[[0, -1]])[0])
    for q in promising_paths(symbols.geometry, design, straight, rng, settings.n_bends):
        point = LayoutPoint(design, q, segment_times(symbols.problem, mesh, q))
        samples = samples_of(symbols.geometry, mesh, point)
        near, _ = missing_checks(symbols.geometry, point, samples, motion_only=True, tolerated_m=-NEAR_M)
        if clear_stage(symbols, mesh, point, near).clear:
            stage = refine(
                symbols, mesh, point, near, settings, name="path", pinned=pinned, least_gain=_PATH_LEAST_GAIN
            )
        elif best is not None and best.clear:
            break
        else:
            stage = solve_lazily(
                symbols,
                mesh,
                point,
                near,
                settings,
                name="path",
                pinned=pinned,
                warm=True,
                most_rounds=6,
                most_iterations=_PATH_ITERATIONS,
            )
        phases += stage.phases
        if best is None or (not stage.clear, stage.cost) < (not best.clear, best.cost):
            best = stage
        if best.clear and best.cost <= least * (1.0 + _PATH_LEAST_GAIN):
            # no motion between these configurations is faster than the straight one
            break
    if best is None:
        raise ValueError("no path was allowed")
    return best


def _polished(symbols: LayoutSymbols, coarse: Stage, settings: StagedSettings, phases: list[Phase]) -> Stage:
    """Return the stage on N segments of equal duration if it is shorter and clear, else the coarse one."""
    problem = symbols.problem
    mesh = build_mesh(problem, settings.n_segments)
    point = coarse.result.point
    q = mesh.interpolated([point.q[rows] for rows in coarse.mesh.visit_rows])
    for rows, transition in zip(mesh.transition_rows, transitions_of(problem, coarse.mesh, point)):
        q[rows] = transition.at(np.linspace(0.0, transition.duration_s, len(rows)))
    start = LayoutPoint(point.design, q, segment_times(problem, mesh, q))
    fine = refine(
        symbols,
        mesh,
        start,
        Checks(layout=coarse.checks.layout),
        settings,
        name="polish",
        beat=coarse.cost,
    )
    phases += fine.phases
    return fine if fine.clear and fine.cost < coarse.cost else coarse


def solution_of(
    symbols: LayoutSymbols,
    method: str,
    mesh: Mesh,
    result: NLPResult,
    phases: tuple[Phase, ...],
    tolerances: GateTolerances,
    least_segments: int = 1,
    notes: tuple[str, ...] = (),
) -> LayoutSolution:
    """Gate a result and return it as a solution."""
    problem, point = symbols.problem, result.point
    transitions = transitions_of(problem, mesh, point, least_segments)
    visit_q = [point.q[rows] for rows in mesh.visit_rows]
    report, at_poses = check_layout(symbols.geometry, mesh, point.design, visit_q, transitions, tolerances)
    timed = [problem.approach_of(visit) for visit in range(len(problem.visits))]
    return LayoutSolution(
        method,
        point.design,
        at_poses,
        transitions,
        sum(approach.duration_s for approach in timed if approach is not None),
        extra_cost(problem, mesh, point.q, transitions),
        report,
        phases,
        float(point.slack.sum()),
        notes,
    )
