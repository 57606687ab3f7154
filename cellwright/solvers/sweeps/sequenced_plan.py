"""Sequence the sweeps of a stitched plan anew under a cost of time, or of time, torque and speed together.

Beside the new plan stand the stitched one and the greedy one of Kaiser 2021, all measured alike. Under optimal control
sweeps are passed at speed and motions join them; where the cost is time, motions are the planned paths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.motion_filter import FilteredScene
from cellwright.cell.scene import Scene
from cellwright.cell.symbolic_dynamics import SymbolicDynamics
from cellwright.solvers.connections import first_collision
from cellwright.solvers.motion_cost import CostedMotion
from cellwright.solvers.optimal_control.collision_free import AvoidanceParams
from cellwright.solvers.optimal_control.cost_bounds import least_cost
from cellwright.solvers.optimal_control.joining import JoiningMotions, JoiningScene
from cellwright.solvers.optimal_control.measures import Measures, measure
from cellwright.solvers.optimal_control.program import CostWeights, MotionProgram
from cellwright.solvers.path_timing import Limits, TimedMotion, least_time
from cellwright.solvers.stitched_plan import StitchSettings
from cellwright.solvers.sweeps.access import SweepAccess
from cellwright.solvers.sweeps.passing import STOPPING, PassedOption, passed_options
from cellwright.solvers.sweeps.planned import PlannedSweep
from cellwright.solvers.sweeps.sequence import SequencedSweeps, SweepLegs, sequence_sweeps

RESERVE = (0.005, 0.05)
"""Shares of speed and acceleration limits, and of torque limits, left for what lies between the nodes of a motion."""
SAME_ANGLE = 1e-6
"""Rad within which configurations are one."""
SEARCH = AvoidanceParams(most_rounds=5, most_halvings=3, least_gain=5e-3)
"""How long a way around obstacles is improved: most of the gain comes with the first rounds."""


@dataclass(frozen=True, eq=False)
class ControlledArm:
    """An arm under optimal control: its dynamics with what it carries, the weights, and the steps of a motion."""

    dynamics: SymbolicDynamics
    max_effort: FloatArray
    weights: CostWeights
    n_steps: int

    def measure(self, motion: TimedMotion) -> Measures:
        """Return what a motion takes."""
        return measure(self.dynamics, self.weights, self.max_effort, motion)


@dataclass(frozen=True, eq=False)
class KnownSweep:
    """A sweep of a known plan: its number, direction, and the configuration (joints,) with which it begins."""

    sweep: int
    direction: int
    q: FloatArray

    def is_entry(self, option: PassedOption) -> bool:
        """Whether an option of the sweep is executed as the plan does."""
        begins = option.motions[STOPPING].position[0, :-1]
        return option.direction == self.direction and float(np.abs(begins - self.q).max()) < SAME_ANGLE


@dataclass(frozen=True)
class SequenceWork:
    """How far the search goes: motions found at most, and the gap that is good enough."""

    max_motions: int
    target_gap: float


def sequenced(
    cell: Cell,
    scene: Scene,
    sweeps: Sequence[PlannedSweep],
    settings: StitchSettings,
    arm: ControlledArm | None,
    work: SequenceWork,
    seed: int,
    known: Sequence[KnownSweep] = (),
    progress: Callable[[float], None] = lambda share: None,
) -> SequencedSweeps:
    """Return the cheapest sequence found of all sweeps: by time, or under optimal control of an ``arm``.

    ``scene`` keeps the planner's clearance; ``seed`` makes the roadmap of stitching again; the result costs
    no more than the sequence ``known``, if that is given.

    Raises:
        InfeasibleError: If no sequence is found whose motions all exist, or the torque limits do not hold the arm.
    """
    checker = FilteredScene(scene)
    roadmap_rng, search_rng = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    access = SweepAccess(cell, checker, sweeps, settings, roadmap_rng, lambda share: None)
    options = [option for own in passed_options(cell, sweeps, settings, at_speed=arm is not None) for option in own]
    if arm is not None:
        options = _held(options, arm, access.start, sweeps)
    sweep_checker = FilteredScene(scene.with_clearance(settings.sweep_clearance))
    steps = settings.confirm_step, settings.confirm_angle
    free: dict[tuple[int, tuple[int, int]], bool] = {}

    def is_free(option: PassedOption) -> bool:
        key = option.sweep, option.path
        if key not in free:
            free[key] = first_collision(sweep_checker, access.corners, option.motions[STOPPING], *steps) is None
        return free[key]

    paths = _Paths(access, arm)
    joining = None if arm is None else _joining(access, scene, checker, settings, arm, paths)
    legs = SweepLegs(options, access.start, _SweepCosts(arm), paths, joining, is_free)
    return sequence_sweeps(
        legs,
        [sweep.name for sweep in sweeps],
        search_rng,
        returns=settings.returns,
        target_gap=work.target_gap,
        max_motions=work.max_motions,
        known=_rows_of(known, options),
        progress=progress,
    )


def _rows_of(known: Sequence[KnownSweep], options: Sequence[PassedOption]) -> list[int] | None:
    """Return the options that a known sequence executes; None if one is not among them."""
    rows = [
        next((row for row, option in enumerate(options) if option.sweep == each.sweep and each.is_entry(option)), -1)
        for each in known
    ]
    return None if -1 in rows or not rows else rows


def _joining(
    access: SweepAccess,
    scene: Scene,
    checker: FilteredScene,
    settings: StitchSettings,
    arm: ControlledArm,
    paths: _Paths,
) -> JoiningMotions:
    program = MotionProgram(
        arm.dynamics,
        arm.weights,
        n_steps=arm.n_steps,
        max_effort=arm.max_effort,
        max_acceleration=access.limits.acceleration,
        reserve=RESERVE,
    )
    around = JoiningScene(
        scene, checker, access.corners, paths.path, SEARCH, settings.confirm_step, settings.confirm_angle
    )
    return JoiningMotions(program, access.limits, around)


def _held(
    options: Sequence[PassedOption], arm: ControlledArm, q_start: FloatArray, sweeps: Sequence[PlannedSweep]
) -> list[PassedOption]:
    """Return the options at whose ends the torque limits hold the arm.

    Raises:
        InfeasibleError: If they do not hold it at the start, or at no option of a sweep.
    """
    arm.dynamics.check_holds(q_start, arm.max_effort, "the start")
    held = []
    for option in options:
        ends = option.motions[STOPPING].position[[0, -1], :-1]
        if np.all(np.abs(arm.dynamics.holding_torque(ends)) <= arm.max_effort):
            held.append(option)
    for number, sweep in enumerate(sweeps):
        own = [option for option in options if option.sweep == number]
        if own and not any(option.sweep == number for option in held):
            for q in own[0].motions[STOPPING].position[[0, -1], :-1]:
                arm.dynamics.check_holds(q, arm.max_effort, sweep.name)
    return held


class _SweepCosts:
    """What executing a sweep costs; branches share it among windings, and both directions cost the same."""

    def __init__(self, arm: ControlledArm | None) -> None:
        self._arm = arm
        self._known: dict[tuple[int, tuple[int, int], float, bool], float] = {}

    def __call__(self, option: PassedOption, motion: TimedMotion) -> float:
        if self._arm is None:
            return motion.duration
        entered = bool(np.any(motion.velocity[0 if option.direction > 0 else -1]))
        key = option.sweep, option.path, motion.duration, entered
        if key not in self._known:
            self._known[key] = self._arm.measure(motion).cost
        return self._known[key]


class _Paths:
    """Planned paths from rest to rest, under time or under the cost of an arm; `StoppingMotions`."""

    def __init__(self, access: SweepAccess, arm: ControlledArm | None) -> None:
        self._access, self._arm = access, arm
        self._limits: Limits = access.limits

    def bound(self, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
        least = least_time(q_a, q_b, self._limits)
        if self._arm is None:
            return least
        return least_cost(self._arm.dynamics, self._arm.weights, q_a, q_b, least_time=least)

    def path(self, q_a: FloatArray, q_b: FloatArray) -> TimedMotion | None:
        found = self._connection(q_a, q_b)
        return None if found is None else found[0]

    def motion(self, q_a: FloatArray, q_b: FloatArray) -> CostedMotion | None:
        found = self._connection(q_a, q_b)
        if found is None:
            return None
        motion, via = found
        cost = motion.duration if self._arm is None else self._arm.measure(motion).cost
        return CostedMotion(cost, motion, None, via)

    def _connection(self, q_a: FloatArray, q_b: FloatArray) -> tuple[TimedMotion, str] | None:
        connections = self._access.connections
        connections.confirm(q_a, q_b)
        found = connections.between(q_a, q_b)
        return None if found is None else (found.motion, found.via)
