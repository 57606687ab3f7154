"""Layout with acceleration limits: what Baumgaertner 2025 names as future work.

From rest to rest and without obstacles every joint's fastest motion is a trapezoid of speed in closed form, and a
transition takes as long as its slowest joint: the station program stays exact with that law in place of max|dq|/v. If
the trapezoids are clear, they are the answer. Else, and where timed approaches are met at speed, N segments of constant
acceleration are optimised, warm from the first-order solution.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.checks import missing_checks, samples_of
from cellwright.solvers.layout.gate import GateTolerances, check_layout
from cellwright.solvers.layout.mesh import Checks, Mesh, build_mesh
from cellwright.solvers.layout.motions import extra_cost
from cellwright.solvers.layout.nlp import LayoutPoint
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.rounds import Stage, refine, solve_lazily
from cellwright.solvers.layout.solution import LayoutSolution, Phase, Transition
from cellwright.solvers.layout.staged import StagedSettings, solution_of, staged_outcome
from cellwright.solvers.layout.symbols import LayoutSymbols


@dataclass(frozen=True)
class SecondOrderSettings:
    """Settings of the second-order solver.

    Attributes:
        n_segments: Segments of each transition where trapezoids do not do.
        trapezoids: Whether to try the closed form first.
        most_rounds: Rounds of lazy checks.
        most_iterations: Ipopt iterations a program.
        staged: Of the first-order solver that warms this one.
        tolerances: Of the gate.
    """

    n_segments: int = 50
    trapezoids: bool = True
    most_rounds: int = 6
    most_iterations: int = 300
    staged: StagedSettings = field(default_factory=lambda: StagedSettings(polish=False))
    tolerances: GateTolerances = field(default_factory=GateTolerances)


def least_times(distance: FloatArray, speed: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the shortest times from rest to rest over distances, under speed and acceleration limits; all (...,).

    A triangle of speed while the limit is not reached, else a trapezoid.
    """
    away = np.abs(distance)
    return np.asarray(
        np.where(
            away * acceleration < speed**2,
            2.0 * np.sqrt(away / acceleration),
            away / speed + speed / acceleration,
        )
    )


def trapezoids(start: int, end: int, q: FloatArray, goal: FloatArray, problem: LayoutProblem, n: int) -> Transition:
    """Return the joints' trapezoids from ``q`` to ``goal`` (joints,), all as long as the slowest; ``n`` points or more.

    A joint with time to spare keeps its acceleration and cruises more slowly.
    """
    arm = problem.arm
    away = goal - q
    T = max(float(least_times(away, arm.max_velocity, arm.max_acceleration).max()), 1e-4)
    a = arm.max_acceleration
    # d = v (T - v / a), the smaller root: the slowest cruise that arrives in time
    root = np.sqrt(np.maximum((a * T) ** 2 - 4.0 * a * np.abs(away), 0.0))
    cruise = 0.5 * (a * T - root)
    ramp = cruise / a
    times = np.unique(np.concatenate([np.linspace(0.0, T, n + 1), ramp, T - ramp]))
    times = times[np.append(True, np.diff(times) > 1e-9)]
    times[-1] = T
    t = times[:, None]
    speed = np.minimum(np.minimum(a * t, cruise), a * (T - t))
    rising, falling = np.minimum(t, ramp), np.maximum(t - (T - ramp), 0.0)
    level = np.clip(t - ramp, 0.0, np.maximum(T - 2.0 * ramp, 0.0))
    covered = 0.5 * a * rising**2 + cruise * level + cruise * falling - 0.5 * a * falling**2
    sign = np.sign(away)
    path = q + sign * covered
    path[-1] = goal
    return Transition(start, end, times, path, sign * speed)


def solve_second_order(
    symbols: LayoutSymbols, start: FloatArray, rng: np.random.Generator, settings: SecondOrderSettings
) -> LayoutSolution:
    """Solve a layout problem with acceleration limits from a design (n_design,)."""
    first, phases = staged_outcome(symbols, start, rng, settings.staged)
    return continue_second_order(symbols, first, phases, settings)


def continue_second_order(
    symbols: LayoutSymbols, first: Stage, phases: list[Phase], settings: SecondOrderSettings
) -> LayoutSolution:
    """Return the solution with acceleration limits, warm from a first-order outcome and after its phases."""
    point = first.result.point
    cost = symbols.problem.cost
    exact: LayoutSolution | None = None
    if not any(knots is not None and knots.timed for knots in first.mesh.knots):
        stations = _stations(symbols, first, settings, phases)
        if settings.trapezoids:
            exact = _exact(symbols, stations, tuple(phases), settings)
            if exact.converged and not (cost.along_path and cost.counts):
                return exact
        if first.mesh.n_segments == 1:
            point = stations.result.point
    mesh = build_mesh(symbols.problem, settings.n_segments)
    warm = _warm(symbols.problem, first.mesh, point, mesh)
    layout = Checks(layout=first.checks.layout)
    stage = refine(symbols, mesh, warm, layout, _lazy(settings), name="second order", order=2)
    phases += stage.phases
    if not stage.clear:
        missing, _ = missing_checks(symbols.geometry, warm, samples_of(symbols.geometry, mesh, warm))
        checks = layout.joined(missing)
        stage = solve_lazily(symbols, mesh, warm, checks, _lazy(settings), name="second order, free", order=2)
        phases += stage.phases
    bent = solution_of(symbols, "second_order", mesh, stage.result, tuple(phases), settings.tolerances)
    if exact is None or not exact.converged:
        return bent
    # where the extra cost counts along the motion, trapezoids are the fastest but not the cheapest
    better = bent.converged and bent.cycle_time_s + bent.extra_cost < exact.cycle_time_s + exact.extra_cost
    return bent if better else replace(exact, phases=tuple(phases))


def _lazy(settings: SecondOrderSettings) -> StagedSettings:
    return replace(settings.staged, most_rounds=settings.most_rounds, most_iterations=settings.most_iterations)


def _stations(symbols: LayoutSymbols, first: Stage, settings: SecondOrderSettings, phases: list[Phase]) -> Stage:
    """Return the station program with the law of trapezoids, from the first-order outcome."""
    problem = symbols.problem
    mesh = build_mesh(problem, 1)
    point = first.result.point
    q = mesh.interpolated([point.q[rows] for rows in first.mesh.visit_rows])
    times = np.zeros(mesh.n_times)
    for number, rows in enumerate(mesh.transition_rows):
        away = q[rows[-1]] - q[rows[0]]
        times[number] = least_times(away, problem.arm.max_velocity, problem.arm.max_acceleration).max()
    warm = LayoutPoint(point.design, q, times + 1e-3, np.zeros_like(q))
    known = Checks(layout=first.checks.layout)
    stage = solve_lazily(
        symbols, mesh, warm, known, _lazy(settings), name="stations, accelerated", transitions=False, order=2
    )
    phases += stage.phases
    return stage


def _exact(
    symbols: LayoutSymbols, stations: Stage, phases: tuple[Phase, ...], settings: SecondOrderSettings
) -> LayoutSolution:
    """Return the trapezoids between station configurations as a gated solution."""
    problem, mesh, point = symbols.problem, stations.mesh, stations.result.point
    transitions = tuple(
        trapezoids(start, end, point.q[rows[0]], point.q[rows[-1]], problem, settings.n_segments)
        for (start, end), rows in zip(problem.transitions, mesh.transition_rows)
    )
    visit_q = [point.q[rows] for rows in mesh.visit_rows]
    report, at_poses = check_layout(symbols.geometry, mesh, point.design, visit_q, transitions, settings.tolerances)
    cost = extra_cost(problem, mesh, point.q, transitions)
    return LayoutSolution("second_order", point.design, at_poses, transitions, 0.0, cost, report, phases)


def _warm(problem: LayoutProblem, coarse: Mesh, point: LayoutPoint, mesh: Mesh) -> LayoutPoint:
    """Return a start on the fine mesh: the first-order path, begun and ended softly and slowed until limits hold."""
    arm = problem.arm
    q = mesh.interpolated([point.q[rows] for rows in coarse.visit_rows])
    velocity = np.zeros_like(q)
    times = np.zeros(mesh.n_times)
    for number, (rows, old) in enumerate(zip(mesh.transition_rows, coarse.transition_rows)):
        steps = (np.abs(np.diff(point.q[old], axis=0)) / arm.max_velocity).max(axis=1)
        clock = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-6))])
        s = np.linspace(0.0, 1.0, len(rows))
        soft = clock[-1] * s * s * (3.0 - 2.0 * s)
        path = np.stack([np.interp(soft, clock, column) for column in point.q[old].T], axis=1)
        q[rows] = path
        h = 1.0 / (len(rows) - 1)
        slope = np.gradient(path, h, axis=0)
        bend = np.abs(np.gradient(slope, h, axis=0)) / arm.max_acceleration
        T = max(float((np.abs(slope) / arm.max_velocity).max()), float(np.sqrt(bend.max())), 1e-2)
        times[number] = T
        velocity[rows[1:-1]] = slope[1:-1] / T / arm.max_velocity
    for rows, knots in zip(mesh.visit_rows, mesh.knots):
        if knots is not None and knots.timed:
            pace = np.diff(q[rows], axis=0) / knots.durations_s[:, None] / arm.max_velocity
            velocity[rows[0]], velocity[rows[-1]] = pace[0], pace[-1]
    return LayoutPoint(point.design, q, times, np.clip(velocity, -1.0, 1.0))
