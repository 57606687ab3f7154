"""Motions by optimal control that join movements: they begin and end with given velocities instead of at rest.

What precedes and follows need not stop then. The optimal control problem takes the velocities as its boundary
conditions (discrete Legendre transforms, Bjorkenstam 2014, section 2.3), and the acceleration limits of the joints are
kept by the curve itself, so that a motion never has to be slowed as a whole, which would change its ends. `direct`
solves it with nothing in the way, a tenth of a second; `around` improves a collision-free path in trust regions, some
seconds. What comes back was checked on a dense grid: collisions, joint limits, speeds, accelerations, torques.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.connections import first_collision
from cellwright.solvers.hermite import shares_of_limits
from cellwright.solvers.motion_cost import CostedMotion
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.optimal_control.checked_motion import CheckedMotion
from cellwright.solvers.optimal_control.clearance_boxes import ClearanceScene
from cellwright.solvers.optimal_control.collision_free import AvoidanceParams, avoid
from cellwright.solvers.optimal_control.cost_bounds import least_cost
from cellwright.solvers.optimal_control.program import CostWeights, DiscreteMotion, MotionProgram
from cellwright.solvers.optimal_control.settled_motion import settle
from cellwright.solvers.optimal_control.starts import straight_start
from cellwright.solvers.path_timing import LIMIT_TOLERANCE, Limits, TimedMotion
from cellwright.solvers.roadmap import CollisionChecker

SAME_WAY = 1e-9
"""Rad within which two ways are one."""
OPTIMAL_CONTROL = "optimal control"
"""How such a motion was found, as `CostedMotion.via` says it."""

FindPath = Callable[[FloatArray, FloatArray], TimedMotion | None]
"""Returns a collision-free motion, rest to rest, between two configurations, or None."""


@dataclass(frozen=True, eq=False)
class MovingState:
    """A configuration and its velocity, both (joints,) in rad and rad/s."""

    q: FloatArray
    v: FloatArray

    def reversed(self) -> MovingState:
        """Return the state of the same movement run backwards."""
        return MovingState(self.q, -self.v)

    @property
    def key(self) -> tuple[float, ...]:
        """What tells it from other states."""
        return (*self.q.tolist(), *(self.v + 0.0).tolist())


@dataclass(frozen=True, eq=False)
class JoiningScene:
    """What motions have to avoid, and how finely it is looked at.

    Attributes:
        scene: Collision and distance queries; its ``clearance_m`` is kept.
        checker: The same collision queries, faster where there are many.
        corners: Corners about the moving bodies.
        path: Finds the collision-free motions to begin with.
        search: How the search for a motion among obstacles looks.
        confirm_m, confirm_rad: Furthest that any point moves, any joint turns between two states of the last check.
    """

    scene: ClearanceScene
    checker: CollisionChecker
    corners: MovingCorners
    path: FindPath
    search: AvoidanceParams
    confirm_m: float
    confirm_rad: float


class JoiningMotions:
    """The best motions found between moving states, each found once, for both directions.

    Without friction a motion costs the same backwards, so every motion is found in one direction and reversed for the
    other. Each is found from the same start whatever was asked before.
    """

    def __init__(self, program: MotionProgram, limits: Limits, around: JoiningScene) -> None:
        """Take the arm's program, which knows the acceleration limits, and what stands around it."""
        self._program, self._limits, self._scene = program, limits, around
        self._known: dict[tuple[bool, tuple[float, ...], tuple[float, ...]], CostedMotion | None] = {}

    @property
    def weights(self) -> CostWeights:
        """Of the cost."""
        return self._program.weights

    def bound(self, a: MovingState, b: MovingState) -> FloatArray:
        """Return what no motion from ``a`` to ``b`` undercuts, (...) of states (..., joints)."""
        dynamics = self._program.dynamics
        return least_cost(
            dynamics,
            self.weights,
            a.q,
            b.q,
            least_time=least_joining_time(a, b, self._limits),
            gained=_kinetic(self._program, b) - _kinetic(self._program, a),
        )

    def direct(self, a: MovingState, b: MovingState) -> CostedMotion | None:
        """Return the best motion from ``a`` to ``b`` where nothing is in the way; None if something is."""
        return self._either_way(a, b, around=False)

    def around(self, a: MovingState, b: MovingState) -> CostedMotion | None:
        """Return the best motion found from ``a`` to ``b`` around what is in the way; None if none was found."""
        return self._either_way(a, b, around=True)

    def _either_way(self, a: MovingState, b: MovingState, *, around: bool) -> CostedMotion | None:
        forward = a.key <= b.reversed().key
        ends = (a, b) if forward else (b.reversed(), a.reversed())
        key = around, ends[0].key, ends[1].key
        if key not in self._known:
            self._known[key] = (self._around if around else self._direct)(*ends)
        found = self._known[key]
        if found is None or forward or found.torque is None:
            return found
        return replace(found, motion=found.motion.reversed(), torque=found.torque[::-1])

    def _direct(self, a: MovingState, b: MovingState) -> CostedMotion | None:
        start = straight_start(self._program, a.q, b.q)
        free = settle(self._program, _entered(start, a.v, b.v), v_a=a.v, v_b=b.v)
        return _costed(free.curve) if free.converged and self._is_sound(free.curve) else None

    def _around(self, a: MovingState, b: MovingState) -> CostedMotion | None:
        around = self._scene
        path = around.path(a.q, b.q)
        if path is None:
            return None
        avoiding = avoid(self._program, around.scene, around.corners, path, around.search, v_a=a.v, v_b=b.v).motion
        if avoiding is None or not self._is_sound(avoiding.curve):
            return None
        return _costed(avoiding.curve)

    def _is_sound(self, curve: CheckedMotion) -> bool:
        """Whether a curve keeps the clearance in small steps, and its limits as planned motions do."""
        motion, around = curve.motion, self._scene
        shares = shares_of_limits(
            motion.time, motion.position, motion.velocity, self._limits.velocity, self._limits.acceleration
        )
        if curve.slowed > 1.0 or max(float(share.max()) for share in shares) > 1.0 + LIMIT_TOLERANCE:
            return False
        # coarse steps first: they find most collisions, and soon
        steps = (around.search.check_m, around.search.check_rad), (around.confirm_m, around.confirm_rad)
        return all(first_collision(around.checker, around.corners, motion, *each) is None for each in steps)


def least_joining_time(a: MovingState, b: MovingState, limits: Limits) -> FloatArray:
    """Return a time (...) that no motion from ``a`` to ``b``, states (..., joints), undercuts.

    Each joint alone: accelerating as hard as it may, at full speed for a while if it gets there, braking as hard.
    """
    v_0, v_1, way = a.v, b.v, b.q - a.q
    A, V = limits.acceleration, limits.velocity
    turned = 0.5 * (v_0 + v_1) * np.abs(v_1 - v_0) / A  # the way of the shortest change of speed
    sign = np.where(way >= turned, 1.0, -1.0)
    begin, end, distance = sign * v_0, sign * v_1, sign * way
    peak = np.sqrt(np.maximum(0.5 * (begin**2 + end**2) + A * distance, 0.0))
    peak = np.maximum(peak, np.maximum(begin, end))
    top = np.minimum(peak, V)
    ramps = (2.0 * top - begin - end) / A
    ramp_way = (2.0 * top**2 - begin**2 - end**2) / (2.0 * A)
    cruise = np.where(peak > V, np.maximum(distance - ramp_way, 0.0) / V, 0.0)
    direct = np.abs(v_1 - v_0) / A  # where changing speed is the whole way, neither sign is right
    return np.asarray(np.max(np.where(np.abs(way - turned) <= SAME_WAY, direct, ramps + cruise), axis=-1))


def _kinetic(program: MotionProgram, state: MovingState) -> FloatArray:
    dynamics, n = program.dynamics, program.dynamics.n_joints
    q, v = (np.asarray(each, float).reshape(-1, n) for each in (state.q, state.v))
    return np.asarray(dynamics.energies_function(q.T, v.T)[0], np.float64).reshape(state.q.shape[:-1])


def _entered(start: DiscreteMotion, v_a: FloatArray, v_b: FloatArray) -> DiscreteMotion:
    velocity = start.node_velocity.copy()
    velocity[0], velocity[-1] = v_a, v_b
    return replace(start, node_velocity=velocity)


def _costed(curve: CheckedMotion) -> CostedMotion:
    return CostedMotion(curve.cost, curve.motion, curve.torque, OPTIMAL_CONTROL)
