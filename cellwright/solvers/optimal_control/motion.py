"""Motions by optimal control as a `MotionCost`: time, torque and speed weighed together, obstacles avoided.

First the motion with nothing in the way is solved; if its curve is free of collision it stands. Else a collision-free
path is sought and improved inside trust regions, with more nodes where the first number is too coarse. Where even that
fails, the path itself, slowed until the torques suffice, is the motion: dearer, but true. Each motion returned has been
checked on a dense grid: collision, joint limits, speeds, torques.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.symbolic_dynamics import SymbolicDynamics
from cellwright.errors import InfeasibleError
from cellwright.solvers.hermite import peak_acceleration
from cellwright.solvers.motion_cost import CostedMotion, MotionCost
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.optimal_control.checked_motion import ROUNDING, CheckedMotion, checked_curve
from cellwright.solvers.optimal_control.clearance_boxes import ClearanceScene
from cellwright.solvers.optimal_control.collision_free import AvoidanceParams, avoid, is_free
from cellwright.solvers.optimal_control.cost_bounds import holding_cost, least_cost
from cellwright.solvers.optimal_control.cost_guess import guessed_costs
from cellwright.solvers.optimal_control.program import CostWeights, DiscreteMotion, MotionProgram
from cellwright.solvers.optimal_control.settled_motion import SettledMotion, free_motion
from cellwright.solvers.optimal_control.starts import check_configuration, neighbouring_start, straight_start
from cellwright.solvers.path_timing import TimedMotion

NEIGHBOUR_RAD = 0.3
"""A solved motion whose ends are both as near as this (rad or m, every joint) starts the next one warm."""
FINER = (1, 2, 4)
"""Multiples of the number of steps that are tried among obstacles."""
ENOUGH_SLOWINGS, SLOWER = 24, 1.25
"""Times, and by how much each, that a path is slowed until torques suffice."""


@dataclass(frozen=True, eq=False)
class Obstacles:
    """What motions have to avoid.

    Attributes:
        scene: Collision and distance queries; its ``clearance_m`` is kept.
        corners: Corners about the moving bodies.
        paths: Finds the collision-free motions to begin with, under at least that clearance: `PathCost`, say.
        params: Settings.
    """

    scene: ClearanceScene
    corners: MovingCorners
    paths: MotionCost
    params: AvoidanceParams


class OptimalControlCost:
    """The cost c_t T + c_e int u.u + c_v int qdot.qdot of the best motion found, a `MotionCost`.

    Motions are found in one direction and reversed for the other: without friction they cost the same, and each is
    found once. Solutions are remembered as starts for motions nearby, so results depend (in digits behind the solver's
    tolerance, or where a motion has several local optima) on the order of questions; the same questions give the same
    results. Not for several threads.
    """

    name = "optimal control"
    unit = ""
    symmetric = True

    def __init__(self, program: MotionProgram, obstacles: Obstacles | None = None, *, warm: bool = True) -> None:
        """Take the arm's program and what stands around it; ``warm`` starts from neighbouring solutions."""
        self._program, self._obstacles, self._warm = program, obstacles, warm
        self._finer = {program.n_steps: program}
        self._solved: list[DiscreteMotion] = []
        self._known: dict[bytes, tuple[CheckedMotion, str] | None] = {}

    @property
    def dynamics(self) -> SymbolicDynamics:
        """The arm."""
        return self._program.dynamics

    @property
    def weights(self) -> CostWeights:
        """Of the cost."""
        return self._program.weights

    def bound(self, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
        """Return `least_cost`: what no motion between the two, (..., joints), undercuts."""
        return least_cost(self.dynamics, self.weights, q_a, q_b)

    def guess(self, q: FloatArray) -> FloatArray:
        """Return `guessed_costs` of the motions between all configurations ``q`` (n, joints): no bound."""
        return guessed_costs(self.dynamics, self.weights, q)

    def holding(self, q: FloatArray, dwell: float) -> FloatArray:
        """Return the cost (...) of standing still at ``q`` (..., joints) for ``dwell`` s: time and holding torque."""
        return holding_cost(self.dynamics, self.weights, q, dwell) + self.weights.time * dwell

    def check(self, q: FloatArray, names: list[str]) -> None:
        """Check configurations (alternatives, joints), called ``names``, before motions between them are asked for.

        Raises:
            InvalidInputError: If one is malformed or outside the joint limits.
            InfeasibleError: If the torque limits do not hold the arm at one.
        """
        for row, name in zip(q, names):
            check_configuration(self._program, row, name)
            self.dynamics.check_holds(row, self._program.max_effort, name)

    def motion(self, q_a: FloatArray, q_b: FloatArray) -> CostedMotion | None:
        """Return the best motion found, rest to rest, from ``q_a`` to ``q_b`` (joints,); None if none was found.

        Raises:
            InvalidInputError: If a configuration is malformed or outside the joint limits.
            InfeasibleError: If the torque limits do not hold the arm at an end, or an end collides.
        """
        q_a, q_b = np.asarray(q_a, float), np.asarray(q_b, float)
        self.check(np.stack([q_a, q_b]), ["the start", "the goal"])
        forward = tuple(q_a.tolist()) <= tuple(q_b.tolist())
        ends = (q_a, q_b) if forward else (q_b, q_a)
        key = np.stack(ends).tobytes()
        if key not in self._known:
            self._known[key] = self._found(*ends)
        found = self._known[key]
        if found is None:
            return None
        curve, via = found
        motion, torque = curve.motion, curve.torque
        if not forward:
            motion, torque = motion.reversed(), torque[::-1]
        return CostedMotion(curve.cost, motion, torque, via)

    def of_motion(self, motion: TimedMotion) -> CheckedMotion:
        """Return a motion of another origin, a timed path say, under this cost: slowed if its torques ask for it."""
        return checked_curve(self.dynamics, self.weights, self._program.max_effort, motion)

    def _found(self, q_a: FloatArray, q_b: FloatArray) -> tuple[CheckedMotion, str] | None:
        program, obstacles = self._program, self._obstacles
        if np.array_equal(q_a, q_b):
            rest = TimedMotion(np.array([0.0, 1e-9]), np.stack([q_a, q_b]), *np.zeros((2, 2, len(q_a))))
            return CheckedMotion(rest, self.dynamics.holding_torque(rest.position), 0.0, 1.0), "optimal control"
        if obstacles is not None:
            _check_free(obstacles.scene, q_a, q_b)
        free = free_motion(program, q_a, q_b, start=self._neighbour(q_a, q_b))
        if free.converged:
            self._solved.append(free.discrete)
            curve = self._within_accelerations(free.curve)
            if not curve.fault and (
                obstacles is None or is_free(obstacles.scene, obstacles.corners, curve, obstacles.params)
            ):
                return curve, "optimal control"
        if obstacles is None:
            return self._slow_straight(q_a, q_b)
        return self._around(obstacles, q_a, q_b)

    def _around(self, obstacles: Obstacles, q_a: FloatArray, q_b: FloatArray) -> tuple[CheckedMotion, str] | None:
        path = obstacles.paths.motion(q_a, q_b)
        if path is None:
            return None
        for multiple in FINER:
            found = avoid(
                self._with_steps(multiple * self._program.n_steps),
                obstacles.scene,
                obstacles.corners,
                path.motion,
                obstacles.params,
            )
            curve = None if found.motion is None else self._within_accelerations(found.motion.curve)
            if curve is not None and not curve.fault:
                return curve, "optimal control"
        slow = self._slowed(path.motion)
        return None if slow is None else (slow, path.via)

    def _with_steps(self, n_steps: int) -> MotionProgram:
        if n_steps not in self._finer:
            self._finer[n_steps] = self._program.with_steps(n_steps)
        return self._finer[n_steps]

    def _slow_straight(self, q_a: FloatArray, q_b: FloatArray) -> tuple[CheckedMotion, str] | None:
        start = straight_start(self._program, q_a, q_b)
        slow = self._slowed(TimedMotion(start.time, start.q, start.node_velocity, np.zeros_like(start.q)))
        return None if slow is None else (slow, "direct")

    def _within_accelerations(self, curve: CheckedMotion) -> CheckedMotion:
        """Return a curve that keeps the program's acceleration limits, slowed where mending it has broken them."""
        limits = self._program.max_acceleration
        if limits is None:
            return curve
        motion = curve.motion
        share = float((peak_acceleration(motion.time, motion.position, motion.velocity) / limits).max())
        return curve if share <= 1.0 + ROUNDING else self.of_motion(motion.slowed(share**0.5))

    def _slowed(self, motion: TimedMotion) -> CheckedMotion | None:
        """Return a motion slowed until its torques suffice, None if they never do."""
        for _ in range(ENOUGH_SLOWINGS):
            curve = self.of_motion(motion)
            curve = curve if curve.fault else self._within_accelerations(curve)
            if not curve.fault:
                return curve
            motion = motion.slowed(SLOWER)
        return None

    def _neighbour(self, q_a: FloatArray, q_b: FloatArray) -> DiscreteMotion | None:
        if not (self._warm and self._solved):
            return None
        ends = np.array([[motion.q[0], motion.q[-1]] for motion in self._solved])
        apart = np.abs(ends - np.stack([q_a, q_b])).max(axis=(1, 2))
        nearest = int(np.argmin(apart))
        return neighbouring_start(self._solved[nearest], q_a, q_b) if apart[nearest] <= NEIGHBOUR_RAD else None


def _check_free(scene: ClearanceScene, q_a: FloatArray, q_b: FloatArray) -> None:
    for name, q in (("start", q_a), ("goal", q_b)):
        pair = scene.colliding_pair(q)
        if pair is not None:
            raise InfeasibleError(
                f"{pair[0]!r} and {pair[1]!r} are {scene.distance(q) * 1e3:.3g} mm apart at the {name}, but the "
                f"clearance is {scene.clearance_m * 1e3:g} mm: lower it or choose another configuration"
            )


__all__ = ["CostWeights", "MotionProgram", "Obstacles", "OptimalControlCost", "SettledMotion", "free_motion"]
