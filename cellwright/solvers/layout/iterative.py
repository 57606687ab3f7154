"""A swarm over layouts with trajectory optimisation inside: the "iterative solver" of Baumgaertner 2025.

Each particle's layout is held fixed and its cycle is optimised: the best branches around the cycle by shortest paths,
the free part of the configurations (turn about the tool's axis, targets by position alone) by a small program, and,
where a straight motion in joint space is not clear, the path around what stands in the way. Three things save most of
the work and change nothing: layouts whose stations overlap or cannot be served never get as far as a trajectory; where
every target is a full pose, ``sum max|dq|/v`` of the best branches bounds the cycle from below, so that particles
that cannot beat their own best are dropped; and the small program is built once and run with its design held fixed.

Particles of a generation are independent and come back in order, so the number of processes cannot change the result.
(Threads would not help: the nonlinear programs hold the interpreter's lock.) Straight motions between full poses need
no program: they are timed on the spot, and processes begin only when something has to be optimised.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.layout.approach import base_goals, newton_steps
from cellwright.solvers.layout.checks import missing_checks, samples_of
from cellwright.solvers.layout.configurations import ConfigurationFinder, VisitConfigurations
from cellwright.solvers.layout.fixed_layout import time_layout
from cellwright.solvers.layout.mesh import Checks, build_mesh
from cellwright.solvers.layout.nlp import LayoutPoint, build_layout_nlp, run_layout_nlp
from cellwright.solvers.layout.problem import LayoutProblem, TargetKind
from cellwright.solvers.layout.proxies import (
    PENALTY,
    Proxy,
    ProxyObjective,
    Sequence,
    sequence_of,
    step_metric,
)
from cellwright.solvers.layout.rounds import CLEAR_M
from cellwright.solvers.layout.sequences import cheapest_sums
from cellwright.solvers.layout.solution import LayoutSolution
from cellwright.solvers.layout.staged import StagedSettings, path_between
from cellwright.solvers.layout.start import segment_times
from cellwright.solvers.layout.symbols import LayoutSymbols
from cellwright.solvers.particle_swarm import SwarmSettings, minimise
from cellwright.worker_processes import WorkerProcesses

_LEAST_SHARED = 8
"""Particles of a generation that need a program before other processes are asked: these take a second or two to
begin."""


@dataclass(frozen=True)
class IterativeSettings:
    """Settings of the iterative solver.

    Attributes:
        swarm: How the swarm moves.
        inner: The trajectory optimisation of each particle, where a motion must lead around something.
        trajectory: The one that times the final layout.
        reject_early: Whether particles that provably cannot improve are dropped; off only to measure what it saves.
        n_processes: Processes that evaluate particles; None: as many as there are cores.
    """

    swarm: SwarmSettings = field(default_factory=SwarmSettings)
    inner: StagedSettings = field(default_factory=lambda: StagedSettings(n_coarse=6, n_bends=1, most_rounds=6))
    trajectory: StagedSettings = field(default_factory=lambda: StagedSettings(n_branches=3, n_sweeps=0))
    reject_early: bool = True
    n_processes: int | None = None


class CycleTimes:
    """Optimised cycle times of single layouts of one problem; the programs are built once."""

    def __init__(self, problem: LayoutProblem, settings: StagedSettings) -> None:
        self.problem, self.settings = problem, settings
        self.symbols = LayoutSymbols(problem)
        self.mesh = build_mesh(problem, 1)
        self.bound_by_poses = all_full_poses(problem)
        self._nlp = build_layout_nlp(self.symbols, self.mesh, Checks())
        self._program = self._nlp.program.compiled(most_iterations=settings.most_iterations)

    def __call__(self, design: FloatArray, sequence: Sequence, seed: int) -> float:
        """Return the cycle time in s of a design (n_design,) from a sequence of configurations.

        1000 and more if no clear cycle was found, as for a proxy's penalty.
        """
        point = self._stations(design, sequence)
        if point is None:
            return self._approach_s + PENALTY + sequence.joint_time_s
        time, blocked = self._straight(point)
        if time is not None:
            return time
        return self._approach_s + self._around(point, blocked, np.random.default_rng(seed))

    def without_program(self, design: FloatArray, sequence: Sequence) -> float | None:
        """Return the same where it takes no program, else None."""
        if not self._nothing_free:
            return None
        return self._straight(self._straight_point(design, sequence))[0]

    def _straight(self, point: LayoutPoint) -> tuple[float | None, set[int]]:
        """Return the cycle time of straight motions, and which transitions are blocked where there is none yet."""
        samples = samples_of(self.symbols.geometry, self.mesh, point)
        missing, deepest = missing_checks(self.symbols.geometry, point, samples, motion_only=True)
        straight = self._approach_s + float(point.times.sum())
        if deepest <= CLEAR_M:
            return straight, set()
        blocked = set(missing.motion[:, 2].tolist())
        # along an approach no path can help
        return (PENALTY + straight if -1 in blocked else None), blocked

    @property
    def _approach_s(self) -> float:
        approaches = [self.problem.approach_of(visit) for visit in range(len(self.problem.visits))]
        return sum(approach.duration_s for approach in approaches if approach is not None)

    @property
    def _single(self) -> bool:
        return self.mesh.n_configs == len(self.problem.visits)

    @property
    def _nothing_free(self) -> bool:
        """Whether every visit is a single full pose, or home."""
        return self.bound_by_poses and self._single

    def _straight_point(self, design: FloatArray, sequence: Sequence) -> LayoutPoint:
        q = self.mesh.interpolated(self._knots(design, sequence))
        return LayoutPoint(np.array(design, float), q, segment_times(self.problem, self.mesh, q))

    def _stations(self, design: FloatArray, sequence: Sequence) -> LayoutPoint | None:
        """Return straight motions with the fastest configurations near those of the sequence; None if there are none.

        Single full poses leave nothing free.
        """
        point = self._straight_point(design, sequence)
        if self._nothing_free:
            return point
        compiled, part = self._program, self._nlp.program.variables["design"]
        compiled.lower[part] = compiled.upper[part] = design
        result = run_layout_nlp(self._nlp, compiled, point)
        if result.violation < 1e-6:
            return result.point
        return point if self._single else None

    def _knots(self, design: FloatArray, sequence: Sequence) -> list[FloatArray]:
        """Return configurations (knots, joints) along each visit's approach, followed from where it begins."""
        problem = self.problem
        T_world_base, T_world_station = problem.base_pose(design), problem.station_poses(design)
        visit_q = []
        for visit, knots in enumerate(self.mesh.knots):
            approach, q = problem.approach_of(visit), sequence.first[visit][None]
            found = [q[0]]
            if approach is not None and knots is not None:
                station = T_world_station[problem.visits[visit].station]
                for goal in base_goals(T_world_base, station, knots.T_station_tool[1:]):
                    q, _ = newton_steps(problem.arm, problem.T_flange_tool, q, goal[None], approach.target, steps=8)
                    found.append(q[0])
            visit_q.append(np.array(found))
        return visit_q

    def _around(self, point: LayoutPoint, blocked: set[int], rng: np.random.Generator) -> float:
        """Return the time of all transitions with those that are ``blocked`` led around what they touch."""
        total = 0.0
        for number, rows in enumerate(self.mesh.transition_rows):
            if number not in blocked:
                total += float(point.times[number])
                continue
            share = np.linspace(0.0, 1.0, self.settings.n_coarse + 1)[:, None]
            straight = (1.0 - share) * point.q[rows[0]] + share * point.q[rows[-1]]
            stage = path_between(self.symbols, point.design, straight, rng, self.settings, [])
            total += stage.time_s if stage.clear else PENALTY
        return total


@dataclass(frozen=True, eq=False)
class CycleObjective:
    """The true cycle time as a function of many designs at once, with the penalties of the proxies.

    Attributes:
        finder: Finds the configurations of the problem's visits.
        settings: Of the solver.
        seed: Of the random bends in paths that do not come clear at once.
        workers: Processes that time what needs a program, or None for this one.
    """

    finder: ConfigurationFinder
    settings: IterativeSettings
    seed: int
    workers: WorkerProcesses | None = None
    cycles: CycleTimes = field(init=False)
    stations: ProxyObjective = field(init=False)

    def __post_init__(self) -> None:
        """Build the programs."""
        object.__setattr__(self, "cycles", CycleTimes(self.finder.problem, self.settings.inner))
        object.__setattr__(self, "stations", ProxyObjective(self.finder, Proxy.JOINT_TIME))

    def __call__(self, designs: FloatArray, to_beat: FloatArray) -> FloatArray:
        """Return the penalised cycle time (n,) of designs (n, n_design)."""
        problem = self.finder.problem
        values = PENALTY * self.stations.n_layout_violations(designs)
        limit = to_beat if self.settings.reject_early else np.full(len(designs), np.inf)
        alive = np.flatnonzero((values == 0.0) & (values < limit))
        if not len(alive):
            return values
        found = self.finder.find(designs[alive])
        values[alive] = PENALTY * found.unserved.sum(axis=1)
        metric = step_metric(problem.arm, Proxy.JOINT_TIME)
        bound = cheapest_sums(metric, found.first, found.last, problem.transitions, cyclic=problem.cyclic)
        served = values[alive] == 0.0
        values[alive[~served]] += bound[~served]
        hopeless = served & (bound >= limit[alive]) & self.cycles.bound_by_poses
        values[alive[hopeless]] = bound[hopeless]
        rows = np.flatnonzero(served & ~hopeless)
        work = [(designs[alive[row]], self._sequence(found, int(row)), self.seed) for row in rows]
        values[alive[rows]] = self._times(work)
        return values

    def _sequence(self, found: VisitConfigurations, row: int) -> Sequence:
        return sequence_of(self.finder.problem, found.first[row], found.last[row], Proxy.JOINT_TIME)

    def _times(self, work: list[tuple[FloatArray, Sequence, int]]) -> list[float]:
        if self.workers is None or self.workers.n_processes <= 1:
            return [self.cycles(*each) for each in work]
        known = [self.cycles.without_program(design, sequence) for design, sequence, _ in work]
        others = [each for each, time in zip(work, known) if time is None]
        if len(others) < _LEAST_SHARED:
            found = iter([self.cycles(*each) for each in others])
        else:
            found = iter(self.workers.map(others))
        return [next(found) if time is None else time for time in known]


def all_full_poses(problem: LayoutProblem) -> bool:
    """Whether every visit asks for a full pose of a six-axis arm, so that the branches found are all there are."""
    approaches = [problem.approach_of(visit) for visit in range(len(problem.visits))]
    six = problem.arm.n_joints == 6 and bool(problem.arm.revolute.all())
    return six and all(each is None or each.target is TargetKind.POSE for each in approaches)


def solve_iteratively(
    symbols: LayoutSymbols, start: FloatArray | None, rng: np.random.Generator, settings: IterativeSettings
) -> LayoutSolution:
    """Return the best layout of a swarm over true cycle times, its cycle polished and gated like every other.

    ``start`` (n_design,) is where one particle starts; without one all start anywhere, as in the paper.

    Raises:
        InvalidInputError: If no inverse kinematics fits the arm.
    """
    problem = symbols.problem
    finder = ConfigurationFinder(problem, rng)
    seed = int(rng.integers(2**32))
    with WorkerProcesses(CycleTimes, (problem, settings.inner), settings.n_processes) as workers:
        objective = CycleObjective(finder, settings, seed, workers)
        result = minimise(objective, problem.lower, problem.upper, rng, settings.swarm, first=start)
    timed = time_layout(problem, result.position, rng, settings.trajectory)
    note = f"the swarm's best cycle: {result.value:.6g} s"
    return replace(timed, method="iterative", notes=(note, *timed.notes))
