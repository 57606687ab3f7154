"""Optimal control in sequencing: the arm with its payload, ways that torques cannot hold, strokes and what all costs.

Tasks are worked on at rest, so holding the arm there is part of the cost, and may be more of it than the motions are
(Bjorkenstam 2014, section 4). Strokes keep their straight paths; their timing is slowed where torques do not suffice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.cell import Cell
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_dynamics import Payload, SymbolicDynamics, symbolic_dynamics
from cellwright.errors import InfeasibleError, listed
from cellwright.solvers.motion_cost import MotionCost
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.optimal_control.checked_motion import CheckedMotion
from cellwright.solvers.optimal_control.clearance_boxes import ClearanceScene
from cellwright.solvers.optimal_control.collision_free import AvoidanceParams
from cellwright.solvers.optimal_control.motion import Obstacles, OptimalControlCost
from cellwright.solvers.optimal_control.program import CostWeights, MotionProgram
from cellwright.solvers.path_timing import Limits
from cellwright.solvers.pose_tasks.alternatives import Alternative
from cellwright.solvers.pose_tasks.strokes import time_stroke, trace_stroke
from cellwright.solvers.pose_tasks.task import PoseTask

RESERVE, NO_RESERVE = (0.005, 0.0), (0.0, 0.0)
"""Shares of speed and acceleration limits, and of torque limits, that programs leave unused."""
LEAST_GAIN, MOST_ROUNDS = 0.01, 6
"""Share of its cost that a round among obstacles must save, and rounds at most: many motions are asked for here."""


@dataclass(frozen=True)
class DynamicSettings:
    """How motions are weighed and cut up.

    Attributes:
        weights: Of time, torque and speed.
        n_steps: N, the steps of a motion.
        check: Furthest that any point moves between two states of the dense check, m.
        sample: Time between states of a timed stroke, s.
        keep_accelerations: Whether motions keep the joints' acceleration limits too.
    """

    weights: CostWeights
    n_steps: int = 20
    check: float = 1e-3
    sample: float = 0.008
    keep_accelerations: bool = False


def dynamics_of(cell: Cell, payload: Payload | None) -> SymbolicDynamics:
    """Return the dynamics of the cell's arm, standing as its base stands, with a payload on its flange.

    Raises:
        InvalidInputError: If the URDF states no masses, or masses that make no sense.
    """
    arm = SerialArm.from_robot(cell.robot)
    return symbolic_dynamics(arm, payload=payload, T_world_base=cell.T_world_base)


def optimal_control_cost(
    cell: Cell, scene: ClearanceScene, paths: MotionCost, dynamics: SymbolicDynamics, settings: DynamicSettings
) -> OptimalControlCost:
    """Return the cost of optimal motions among the bodies of a cell, begun on the motions that ``paths`` finds.

    Raises:
        InvalidInputError: If a joint has no torque limit.
    """
    limit, reserve = (cell.robot.chain.max_acceleration, RESERVE) if settings.keep_accelerations else (None, NO_RESERVE)
    program = MotionProgram(
        dynamics, settings.weights, n_steps=settings.n_steps, max_acceleration=limit, reserve=reserve
    )
    params = AvoidanceParams(check_m=settings.check, check_rad=0.01, least_gain=LEAST_GAIN, most_rounds=MOST_ROUNDS)
    return OptimalControlCost(program, Obstacles(scene, MovingCorners.of(cell), paths, params))


@dataclass(frozen=True, eq=False)
class WorkedWay:
    """An alternative that the torque limits allow.

    Attributes:
        row: Its row among all alternatives.
        way: The alternative, its stroke's time slowed as torques ask for.
        stroke: The stroke to the task, ``None`` without approach.
    """

    row: int
    way: Alternative
    stroke: CheckedMotion | None


def worked_ways(
    cell: Cell,
    tasks: Sequence[PoseTask],
    alternatives: Sequence[Alternative],
    cost: OptimalControlCost,
    effort: FloatArray,
    sample: float,
) -> list[WorkedWay]:
    """Return the alternatives that torques ``effort`` (joints,) can hold and stroke.

    Raises:
        InfeasibleError: If a task is left with none; it names them.
    """
    limits = Limits(cell.robot.chain.max_velocity, cell.robot.chain.max_acceleration)
    at = np.stack([[each.q_task, each.q_entry] for each in alternatives])  # (alternatives, 2, joints)
    share = np.max(np.abs(cost.dynamics.holding_torque(at)) / effort, axis=1)  # (alternatives, joints)
    found: list[WorkedWay] = []
    faults: dict[int, str] = {}
    for row in np.flatnonzero(np.all(share <= 1.0, axis=1)).tolist():
        way = alternatives[row]
        task = tasks[way.task]
        if task.approach <= 0.0:
            found.append(WorkedWay(row, way, None))
            continue
        path = trace_stroke(cell, task, way.rotation, way.q_task)
        stroke = None if path is None else time_stroke(path, task.approach, limits, sample)
        checked = None if stroke is None else cost.of_motion(stroke)
        if checked is None or checked.fault:
            faults[way.task] = "no stroke was found" if checked is None else f"on the stroke {checked.fault}"
            continue
        found.append(WorkedWay(row, replace(way, stroke=checked.motion.duration), checked))
    weak = sorted(set(range(len(tasks))) - {each.way.task for each in found})
    if weak:
        own = np.array([way.task for way in alternatives]) == weak[0]
        why = faults.get(weak[0]) or _holding_words(cost, share[own], effort)
        raise InfeasibleError(
            f"the arm's torque limits allow no alternative of {listed([repr(tasks[row].name) for row in weak])} "
            f"({tasks[weak[0]].name!r}: {why}): carry less (payload_kg), move the base, or give more rotations"
        )
    return found


def _holding_words(cost: OptimalControlCost, share: FloatArray, effort: FloatArray) -> str:
    """Say what holding the arm asks for, by shares of the limits (alternatives, joints), where it asks for least."""
    easiest = share[int(np.argmin(share.max(axis=1)))]
    joint = int(np.argmax(easiest))
    return (
        f"joint {cost.dynamics.joint_names[joint]!r} needs at least {easiest[joint] * effort[joint]:.6g} to hold the "
        f"arm, but its limit is {effort[joint]:.6g}"
    )
