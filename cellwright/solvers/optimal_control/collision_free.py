"""Optimal motions among obstacles: a collision-free path improved inside trust regions, Bjorkenstam 2014, section 2.4.

Each round solves the optimal control problem with every node kept in its box (`clearance_boxes`), checks the curve on
a dense grid against the scene, and takes it as the next path. A curve that collides between the nodes, where boxes
promise nothing, halves all boxes and the round is solved again. It ends when the cost falls no more. The size of the
problem does not depend on the geometry.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.solvers.connections import first_collision
from cellwright.solvers.hermite import states_at
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.optimal_control.checked_motion import CheckedMotion
from cellwright.solvers.optimal_control.clearance_boxes import ClearanceScene, clearance_boxes
from cellwright.solvers.optimal_control.program import DiscreteMotion, MotionProgram
from cellwright.solvers.optimal_control.settled_motion import SettledMotion, settle
from cellwright.solvers.optimal_control.starts import nodes_start
from cellwright.solvers.path_timing import TimedMotion


@dataclass(frozen=True)
class AvoidanceParams:
    """Settings of collision avoidance.

    Attributes:
        check_m: Furthest that any point of the arm moves between two states of the dense check, m.
        check_rad: Largest joint turn between them, rad.
        least_gain: Share of the cost that a round must save, or it is the last.
        most_rounds: Rounds at most.
        most_halvings: Times that boxes are halved in a round because the curve collides.
    """

    check_m: float = 0.005
    check_rad: float = 0.05
    least_gain: float = 1e-3
    most_rounds: int = 40
    most_halvings: int = 6


@dataclass(frozen=True, eq=False)
class Stage:
    """One round: the nodes it began with, their boxes, and the motion found in them."""

    q: FloatArray
    lower: FloatArray
    upper: FloatArray
    motion: SettledMotion


@dataclass(frozen=True, eq=False)
class AvoidingMotion:
    """What collision avoidance came to.

    Attributes:
        motion: The best motion whose curve keeps everything, None if no round found one.
        stages: The rounds that were taken.
        fault: Why there is no motion; empty if there is one.
    """

    motion: SettledMotion | None
    stages: list[Stage] = field(default_factory=list)
    fault: str = ""

    @property
    def converged(self) -> bool:
        """Whether there is a result."""
        return self.motion is not None


def is_free(scene: ClearanceScene, corners: MovingCorners, curve: CheckedMotion, params: AvoidanceParams) -> bool:
    """Whether a curve keeps the scene's clearance on a dense grid."""
    return collision_on(scene, corners, curve.motion, params) is None


def collision_on(
    scene: ClearanceScene, corners: MovingCorners, motion: TimedMotion, params: AvoidanceParams
) -> tuple[float, FloatArray] | None:
    """Return time (s) and configuration (joints,) of the first state of a dense grid that collides, or None."""
    return first_collision(scene, corners, motion, params.check_m, params.check_rad)


def nodes_of(motion: TimedMotion, n_steps: int) -> FloatArray:
    """Return the positions (n_steps + 1, joints) of a motion at equal times."""
    at = np.linspace(motion.time[0], motion.time[-1], n_steps + 1)
    return states_at(motion.time, motion.position, motion.velocity, at)[0]


def avoid(
    program: MotionProgram,
    scene: ClearanceScene,
    corners: MovingCorners,
    path: TimedMotion,
    params: AvoidanceParams | None = None,
    *,
    v_a: FloatArray | None = None,
    v_b: FloatArray | None = None,
) -> AvoidingMotion:
    """Return a cheap motion that keeps the scene's clearance, improved from a path that does.

    Args:
        program: The arm's optimal control problem.
        scene: Its ``clearance_m`` is d_c.
        corners: Corners about the moving bodies, which bound w_i.
        path: A timed motion, rest to rest, without collision.
        params: Settings.
        v_a, v_b: Velocities at the ends, (joints,); at rest if left out.
    """
    params = params or AvoidanceParams()
    current = nodes_start(program, nodes_of(path, program.n_steps), path.duration)
    best: SettledMotion | None = None
    stages: list[Stage] = []
    fault = ""
    for _ in range(params.most_rounds):
        stage, fault = _round(program, scene, corners, current, params, best is not None, (v_a, v_b))
        if stage is None:
            break
        stages.append(stage)
        before, best = best, _cheaper(best, stage.motion)
        current = stage.motion.discrete
        if before is not None and best.curve.cost > before.curve.cost * (1.0 - params.least_gain):
            break
    return AvoidingMotion(best, stages, "" if best is not None else fault)


def _cheaper(one: SettledMotion | None, other: SettledMotion) -> SettledMotion:
    return other if one is None or other.curve.cost < one.curve.cost else one


def _round(
    program: MotionProgram,
    scene: ClearanceScene,
    corners: MovingCorners,
    current: DiscreteMotion,
    params: AvoidanceParams,
    warm: bool,
    v: tuple[FloatArray | None, FloatArray | None],
) -> tuple[Stage | None, str]:
    """Return the next stage, or None and why no box was small enough."""
    share, fault = 1.0, ""
    for _ in range(params.most_halvings + 1):
        lower, upper = clearance_boxes(scene, corners, current.q, share)
        found = settle(program, current, v_a=v[0], v_b=v[1], boxes=(lower, upper), warm=warm)
        if found.converged:
            hit = collision_on(scene, corners, found.curve.motion, params)
            if hit is None:
                return Stage(current.q, lower, upper, found), ""
            pair = scene.colliding_pair(hit[1])
            touching = "" if pair is None else f": {pair[0]!r} and {pair[1]!r}"
            fault = f"the curve collides between nodes at {hit[0]:.4g} s{touching}"
        else:
            fault = found.fault
        share *= 0.5
    return None, fault
