"""Layouts by proxy objectives: what the literature minimises in place of the cycle time, by a particle swarm.

Baumgaertner 2025 compares its integrated solver with swarms on Euclidean and on joint distance. Here they get every
advantage: inverse kinematics by all branches, the best sequence of branches around the cycle, the same constraints as
everybody (reach, joint limits, spheres at the stations, stations against each other), and a third, stronger proxy, the
time of the slowest joint ``max |dq| / v`` of each transition. Each violated constraint costs 1000, as in the paper.
What a proxy proposes is then timed by trajectory optimisation with its layout held fixed.

None of the proxies sees what lies between the stations; the joint ones do not see the limits of joints that can turn
on by whole turns either (they take the short way round).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.serial_arm import SerialArm
from cellwright.solvers.layout.configurations import ConfigurationFinder, VisitConfigurations
from cellwright.solvers.layout.fixed_layout import time_layout
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.sequences import StepMetric, cheapest_sums, cheapest_walk
from cellwright.solvers.layout.solution import LayoutSolution
from cellwright.solvers.layout.staged import StagedSettings
from cellwright.solvers.layout.symbols import LayoutSymbols
from cellwright.solvers.particle_swarm import SwarmResult, SwarmSettings, minimise

PENALTY = 1000.0
"""Added for every violated constraint (Baumgaertner 2025, section 5.1)."""
_TOUCHING_M = 1e-6


class Proxy(Enum):
    """What stands for the cycle time."""

    EUCLIDEAN = "euclidean"
    """Metres between the end of each approach and the start of the next."""
    TO_ROBOT = "to robot"
    """Metres between the robot's base and the start of each approach, as in the paper's Fig. 2."""
    JOINT = "joint"
    """Length of each transition's straight line in joint space (rad, prismatic joints in m)."""
    JOINT_TIME = "joint time"
    """Seconds of each transition's slowest joint at full speed: the cycle time if nothing is in the way."""


@dataclass(frozen=True, eq=False)
class Sequence:
    """One configuration at both ends of each visit's approach, (visits, joints) each; NaN where there is none."""

    first: FloatArray
    last: FloatArray
    joint_time_s: float


@dataclass(frozen=True, eq=False)
class ProxyObjective:
    """A proxy as a function of many designs at once, with its penalties.

    Attributes:
        finder: Finds the configurations of the problem's visits.
        proxy: What is measured.
    """

    finder: ConfigurationFinder
    proxy: Proxy
    geometry: LayoutGeometry = field(init=False)

    def __post_init__(self) -> None:
        """Share the finder's spheres."""
        object.__setattr__(self, "geometry", self.finder.geometry)

    @property
    def problem(self) -> LayoutProblem:
        """The problem."""
        return self.finder.problem

    def __call__(self, designs: FloatArray, to_beat: FloatArray) -> FloatArray:
        """Return the penalised proxy (n,) of designs (n, n_design)."""
        broken = self.n_layout_violations(designs)
        values = PENALTY * broken
        # whoever cannot improve because of the stations alone needs no inverse kinematics
        alive = np.flatnonzero(values < to_beat)
        if len(alive):
            found = self.finder.find(designs[alive])
            values[alive] += PENALTY * found.unserved.sum(axis=1) + self.measured(designs[alive], found)
        return np.asarray(values)

    def n_layout_violations(self, designs: FloatArray) -> FloatArray:
        """Return how many pairs of spheres, or sphere and wall, interpenetrate, (n,)."""
        total = np.zeros(len(designs))
        for gaps in self.geometry.layout_gaps(designs):
            total += (gaps < -_TOUCHING_M).sum(axis=-1)
        return total

    def measured(self, designs: FloatArray, found: VisitConfigurations) -> FloatArray:
        """Return the proxy itself (n,); transitions of visits without configuration count nothing."""
        problem = self.problem
        if self.proxy in (Proxy.EUCLIDEAN, Proxy.TO_ROBOT):
            first, last = approach_ends(problem, designs)
            if self.proxy is Proxy.TO_ROBOT:
                base = problem.base_pose(designs)[:, None, :3, 3]
                return np.asarray(np.linalg.norm(first - base, axis=2).sum(axis=1))
            steps = [np.linalg.norm(first[:, end] - last[:, start], axis=1) for start, end in problem.transitions]
            return np.asarray(np.sum(steps, axis=0))
        metric = step_metric(problem.arm, self.proxy)
        return cheapest_sums(metric, found.first, found.last, problem.transitions, cyclic=problem.cyclic)


def approach_ends(problem: LayoutProblem, designs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the tool is at the first and the last pose of each visit in the world, (n, visits, 3) in m each."""
    T_world_base = problem.base_pose(designs)
    T_world_station = problem.station_poses(designs) if problem.stations else np.zeros((len(designs), 0, 4, 4))
    first, last = [], []
    for visit, where in enumerate(problem.visits):
        approach = problem.approach_of(visit)
        if approach is None:
            home = T_world_base @ problem.arm.flange_pose(np.asarray(problem.home_q, float)) @ problem.T_flange_tool
            first.append(home[:, :3, 3])
            last.append(home[:, :3, 3])
        else:
            T = T_world_station[:, where.station, None] @ approach.T_station_tool[[0, -1]]
            first.append(T[:, 0, :3, 3])
            last.append(T[:, 1, :3, 3])
    return np.stack(first, axis=1), np.stack(last, axis=1)


def step_metric(arm: SerialArm, proxy: Proxy) -> StepMetric:
    """Return what a step in joint space costs under a joint proxy."""
    circular = arm.revolute & (arm.upper - arm.lower >= 3.0 * math.pi)
    if proxy is Proxy.JOINT:
        return StepMetric(np.ones(arm.n_joints), circular, False)
    return StepMetric(1.0 / arm.max_velocity, circular, True)


def best_sequence(finder: ConfigurationFinder, design: FloatArray, proxy: Proxy = Proxy.JOINT_TIME) -> Sequence:
    """Return the best configurations of one design (n_design,) under a joint proxy, unwound into the limits."""
    found = finder.find(np.asarray(design, float)[None])
    return sequence_of(finder.problem, found.first[0], found.last[0], proxy)


def sequence_of(problem: LayoutProblem, first: FloatArray, last: FloatArray, proxy: Proxy) -> Sequence:
    """Return the best sequence through candidates (visits, candidates, joints) of one layout, unwound."""
    metric = step_metric(problem.arm, proxy)
    walk, _ = cheapest_walk(metric, first, last, problem.transitions, cyclic=problem.cyclic)
    visits = np.arange(len(problem.visits))
    begin, end = unwound(problem.arm, first[visits, walk], last[visits, walk])
    times = [
        (np.abs(begin[after] - end[before]) / problem.arm.max_velocity).max() for before, after in problem.transitions
    ]
    return Sequence(begin, end, float(np.sum(times)))


def unwound(arm: SerialArm, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shift visits (visits, joints) by whole turns within the limits so that each is nearest to the one before."""
    first, last = first.copy(), last.copy()
    turn = 2.0 * math.pi
    for visit in range(1, len(first)):
        low = np.ceil((arm.lower - np.minimum(first[visit], last[visit])) / turn - 1e-9)
        high = np.floor((arm.upper - np.maximum(first[visit], last[visit])) / turn + 1e-9)
        wanted = np.round((last[visit - 1] - first[visit]) / turn)
        shift = np.where(arm.revolute & (low <= high), turn * np.clip(wanted, low, np.maximum(low, high)), 0.0)
        first[visit] += shift
        last[visit] += shift
    return first, last


def propose_layout(
    problem: LayoutProblem,
    proxy: Proxy,
    rng: np.random.Generator,
    settings: SwarmSettings | None = None,
    *,
    first: FloatArray | None = None,
) -> tuple[SwarmResult, ConfigurationFinder]:
    """Search the design that minimises a proxy; its value is 1000 or more if no layout met all constraints.

    ``first`` (n_design,) is where one particle starts; the others start anywhere.

    Raises:
        InvalidInputError: If the problem's arm cannot be solved by any inverse kinematics.
    """
    finder = ConfigurationFinder(problem, rng)
    objective = ProxyObjective(finder, proxy)
    return minimise(objective, problem.lower, problem.upper, rng, settings, first=first), finder


@dataclass(frozen=True)
class ProxySettings:
    """Settings of a solver by proxy.

    Attributes:
        proxy: What the swarm minimises.
        swarm: How it moves.
        trajectory: How the proposed layout is timed, with everything in it held fixed.
    """

    proxy: Proxy = Proxy.JOINT_TIME
    swarm: SwarmSettings = field(default_factory=SwarmSettings)
    trajectory: StagedSettings = field(default_factory=lambda: StagedSettings(n_branches=3, n_sweeps=0))


def solve_by_proxy(
    symbols: LayoutSymbols, start: FloatArray | None, rng: np.random.Generator, settings: ProxySettings
) -> LayoutSolution:
    """Return the layout that a proxy proposes with its true cycle, gated like every other solution.

    ``start`` (n_design,) is where one particle starts; without one all start anywhere, as in the paper.

    Raises:
        InvalidInputError: If no inverse kinematics fits the arm.
    """
    problem = symbols.problem
    result, finder = propose_layout(problem, settings.proxy, rng, settings.swarm, first=start)
    timed = time_layout(problem, result.position, rng, settings.trajectory)
    claimed = best_sequence(finder, result.position).joint_time_s
    note = f"{settings.proxy.value} {result.value:.6g}, joint time of its best branches {claimed:.6g} s"
    return replace(timed, method=f"proxy: {settings.proxy.value}", notes=(note, *timed.notes))
