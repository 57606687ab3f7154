"""Sequence the sweeps of a stitched plan anew under a cost of time, or of time, torque and speed together.

Beside the new plan stand the stitched one and the greedy one of Kaiser 2021, all measured alike. Under optimal control
sweeps are passed at speed and motions join them; where the cost is time, motions are the planned paths.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.motion_filter import FilteredScene
from cellwright.cell.scene import Scene
from cellwright.cell.symbolic_dynamics import SymbolicDynamics
from cellwright.errors import InfeasibleError
from cellwright.solvers.connections import first_collision
from cellwright.solvers.motion_cost import CostedMotion, PathCost
from cellwright.solvers.optimal_control.checked_motion import checked_curve
from cellwright.solvers.optimal_control.collision_free import AvoidanceParams
from cellwright.solvers.optimal_control.cost_bounds import least_cost
from cellwright.solvers.optimal_control.joining import JoiningMotions, JoiningScene
from cellwright.solvers.optimal_control.measures import Measures, measure
from cellwright.solvers.optimal_control.program import CostWeights, MotionProgram
from cellwright.solvers.path_timing import TimedMotion
from cellwright.solvers.stitched_plan import StitchSettings
from cellwright.solvers.sweeps.access import SweepAccess
from cellwright.solvers.sweeps.passing import STOPPING, PassedOption, passed_options
from cellwright.solvers.sweeps.planned import PlannedSweep
from cellwright.solvers.sweeps.sequence import SequencedSweeps, StoppingMotions, SweepLegs, sequence_sweeps

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
        InfeasibleError: If no sequence is found whose motions all exist, or the torque limits allow no way to execute
            a sweep or do not hold the arm.
    """
    checker = FilteredScene(scene)
    roadmap_rng, search_rng = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    access = SweepAccess(cell, checker, sweeps, settings, roadmap_rng, lambda share: None)
    options = [option for own in passed_options(cell, sweeps, settings, at_speed=arm is not None) for option in own]
    costs = SweepCosts(arm)
    if arm is not None:
        options = executable_options(options, arm, costs, access.start, sweeps)
    sweep_checker = FilteredScene(scene.with_clearance(settings.sweep_clearance))
    steps = settings.confirm_step, settings.confirm_angle
    free: dict[tuple[int, tuple[int, int]], bool] = {}

    def is_free(option: PassedOption) -> bool:
        key = option.sweep, option.path
        if key not in free:
            free[key] = first_collision(sweep_checker, access.corners, option.motions[STOPPING], *steps) is None
        return free[key]

    paths: StoppingMotions = (planned := PathCost(access.connections, access.limits))
    joining = None
    if arm is not None:
        paths = controlled = ControlledPaths(planned, arm)
        joining = _joining(access, scene, checker, settings, arm, controlled)
    legs = SweepLegs(options, access.start, costs, paths, joining, is_free)
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
    paths: ControlledPaths,
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


def executable_options(
    options: Sequence[PassedOption],
    arm: ControlledArm,
    costs: SweepCosts,
    q_start: FloatArray,
    sweeps: Sequence[PlannedSweep],
) -> list[PassedOption]:
    """Return the options that the torque limits allow, each with the ways to pass its ends that they allow.

    Raises:
        InfeasibleError: If they do not hold the arm at the start, or allow no option of a sweep.
    """
    arm.dynamics.check_holds(q_start, arm.max_effort, "the start")
    found, least = [], dict.fromkeys(range(len(sweeps)), math.inf)
    for option in options:
        shares = {ends: costs.torque_share(option, motion) for ends, motion in option.motions.items()}
        least[option.sweep] = min(least[option.sweep], shares[STOPPING])
        if shares[STOPPING] <= 1.0:
            found.append(
                replace(option, motions={ends: option.motions[ends] for ends in shares if shares[ends] <= 1.0})
            )
    for number in sorted({option.sweep for option in options} - {option.sweep for option in found}):
        raise InfeasibleError(
            f"the arm's torque limits allow no way to execute {sweeps[number].name}: the easiest asks for "
            f"{least[number]:.0%} of a limit: carry less, scan slower, or move the part"
        )
    return found


class SweepCosts:
    """What executing a sweep costs; branches share it among windings, and both directions cost the same."""

    def __init__(self, arm: ControlledArm | None) -> None:
        self._arm = arm
        self._known: dict[tuple[int, tuple[int, int], float, bool], Measures] = {}

    def __call__(self, option: PassedOption, motion: TimedMotion) -> float:
        return motion.duration if self._arm is None else self._measures(self._arm, option, motion).cost

    def torque_share(self, option: PassedOption, motion: TimedMotion) -> float:
        """Return the greatest share of a torque limit, 0 without an arm."""
        return 0.0 if self._arm is None else self._measures(self._arm, option, motion).torque_share

    def _measures(self, arm: ControlledArm, option: PassedOption, motion: TimedMotion) -> Measures:
        entered = bool(np.any(motion.velocity[0 if option.direction > 0 else -1]))
        key = option.sweep, option.path, motion.duration, entered
        if key not in self._known:
            self._known[key] = arm.measure(motion)
        return self._known[key]


class ControlledPaths:
    """Planned paths from rest to rest under the cost of an arm, slowed until its torques suffice; `StoppingMotions`."""

    def __init__(self, paths: PathCost, arm: ControlledArm) -> None:
        self._paths, self._arm = paths, arm

    def bound(self, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
        """Return what no motion from ``q_a`` to ``q_b``, both (..., joints), undercuts: (...)."""
        least = self._paths.bound(q_a, q_b)
        return least_cost(self._arm.dynamics, self._arm.weights, q_a, q_b, least_time=least)

    def path(self, q_a: FloatArray, q_b: FloatArray) -> TimedMotion | None:
        """Return the planned path as it is timed, torques aside."""
        found = self._paths.motion(q_a, q_b)
        return None if found is None else found.motion

    def motion(self, q_a: FloatArray, q_b: FloatArray) -> CostedMotion | None:
        """Return the path at a speed that the torque limits allow, or None if there is no such path."""
        found = self._paths.motion(q_a, q_b)
        if found is None:
            return None
        measures, motion = self._arm.measure(found.motion), found.motion
        if measures.torque_share > 1.0:
            curve = checked_curve(self._arm.dynamics, self._arm.weights, self._arm.max_effort, motion)
            if curve.fault:
                return None
            motion = motion.slowed(curve.slowed)
            measures = self._arm.measure(motion)
        return CostedMotion(measures.cost, motion, None, found.via)
