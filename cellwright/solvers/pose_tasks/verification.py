"""Check that a timed motion performs tasks: the tool is where each wants it, as long, once, in a permitted order.

Beside `cellwright.solvers.plan_verification`, which checks limits and collisions, and of the planner's results it takes
the motion alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.cell.cell import Cell
from cellwright.cell.transforms import inverse
from cellwright.errors import listed
from cellwright.solvers.clearance_proof import Clearance
from cellwright.solvers.hermite import states_at
from cellwright.solvers.motion_steps import link_poses_of
from cellwright.solvers.plan_verification import (
    Check,
    CollisionProof,
    StateChecker,
    TimedPlan,
    Tolerances,
    check_collisions,
)
from cellwright.solvers.pose_tasks.task import PoseTask

if TYPE_CHECKING:
    from cellwright.cell.symbolic_dynamics import Payload

SAME_TIME = 1e-9
"""Seconds within which two times are one."""
TORQUE = "joint torque"
TORQUE_STATES = 4
"""States of each interval at which torques are looked at."""
STROKE_STATES = 200
"""States at which each stroke is looked at."""


@dataclass(frozen=True, eq=False)
class Stops:
    """The stops of a sequence, (stops,), times in s.

    Attributes:
        task: Row of the task.
        begin, end: When its work begins and ends: at the outer ends of its strokes.
        arrive, leave: When the tool arrives at the task's pose, and when it leaves it.
    """

    task: Int32Array
    begin: FloatArray
    end: FloatArray
    arrive: FloatArray
    leave: FloatArray


def check_tasks(
    plan: TimedPlan,
    cell: Cell,
    tasks: Sequence[PoseTask],
    stops: Stops,
    before: Int32Array,
    tolerances: Tolerances,
    end: FloatArray | None = None,
) -> list[Check]:
    """Check that every task is performed once, where, how long and after what it has to be.

    Args:
        plan: The motion.
        cell: The cell; its ``T_flange_scanner`` is the pose of the tool point on the flange.
        tasks: The tasks.
        stops: When each is said to be performed.
        before: Pairs of tasks, (pairs, 2), the first somewhere before the second.
        tolerances: What may deviate.
        end: Configuration (joints,) at which the motion has to end, if any.
    """
    done = stops.task.tolist()
    place = {task: number for number, task in enumerate(done)}
    missing = [task.name for row, task in enumerate(tasks) if row not in place]
    doubled = [task.name for row, task in enumerate(tasks) if done.count(row) > 1]
    late = [
        f"{tasks[i].name} after {tasks[j].name}"
        for i, j in before.tolist()
        if i in place and j in place and place[i] > place[j]
    ]
    checks = [
        Check("tasks not performed", float(len(missing)), 0.0, "tasks", listed(missing)),
        Check("tasks performed more than once", float(len(doubled)), 0.0, "tasks", listed(doubled)),
        Check("tasks in an order that is not permitted", float(len(late)), 0.0, "pairs", listed(late)),
    ]
    if end is not None:
        off = float(np.abs(plan.position[-1] - end).max())
        checks.append(Check("end off the given configuration", off, tolerances.joint_angle, "rad"))
    worst: dict[str, Check] = {}
    for number, row in enumerate(done):
        for check in _stop_checks(plan, cell, tasks[row], stops, number, tolerances):
            if check.name not in worst or not check.found <= worst[check.name].found:
                worst[check.name] = check
    return checks + list(worst.values())


def check_torques(plan: TimedPlan, cell: Cell, payload: Payload | None, tolerances: Tolerances) -> Check:
    """Check the torques of a motion, by inverse dynamics of the URDF's masses and a payload on the flange.

    The motion is read as the curve through its states; each interval is looked at at both ends and between.

    Raises:
        InvalidInputError: If the URDF states no masses or torque limits that make sense.
    """
    from cellwright.cell.serial_arm import SerialArm
    from cellwright.cell.symbolic_dynamics import symbolic_dynamics
    from cellwright.solvers.optimal_control.program import effort_limits

    dynamics = symbolic_dynamics(
        SerialArm.from_robot(cell.robot), payload=payload, T_world_base=np.asarray(cell.T_world_base)
    )
    limits = effort_limits(dynamics, None)
    lengths = np.diff(plan.time)
    mean = np.diff(plan.position, axis=0) / lengths[:, None]
    v_0, v_1 = plan.velocity[:-1], plan.velocity[1:]
    worst, where, when = 0.0, "", None
    for u in np.linspace(0.0, 1.0, TORQUE_STATES).tolist():
        time = plan.time[:-1] + u * lengths
        position, velocity = states_at(plan.time, plan.position, plan.velocity, time)
        if u == 1.0:
            position, velocity = plan.position[1:], v_1
        # the second derivative of the cubic Hermite curve
        change = ((6.0 - 12.0 * u) * mean + (6.0 * u - 4.0) * v_0 + (6.0 * u - 2.0) * v_1) / lengths[:, None]
        share = np.abs(dynamics.torques(position, velocity, change)) / limits
        row, joint = np.unravel_index(int(np.argmax(share)), share.shape)
        if share[row, joint] > worst:
            worst, when = float(share[row, joint]), float(time[row])
            where = f"at {when:.3f} s in joint {int(joint) + 1}"
    return Check(TORQUE, worst, 1.0 + tolerances.limit_share, "of its limit", where, time=when)


def _stop_checks(
    plan: TimedPlan, cell: Cell, task: PoseTask, stops: Stops, number: int, tolerances: Tolerances
) -> list[Check]:
    arrive, leave = float(stops.arrive[number]), float(stops.leave[number])
    times = np.linspace(arrive, max(leave, arrive), 3)
    off, turned = _deviation(plan, cell, task, times)
    lacking = task.dwell - (leave - arrive)
    if number:
        lacking = max(lacking, float(stops.leave[number - 1]) - arrive)
    where = f"of task {task.name!r} at {arrive:.3f} s"
    checks = [
        Check("tool off its task", float(off.max()), tolerances.position, "m", where),
        Check("tool turned off its task", float(turned.max()), tolerances.angle, "rad", where),
        Check("time missing at a task", lacking, SAME_TIME, "s", where),
    ]
    if task.approach > 0.0:
        for outer, inner in ((float(stops.begin[number]), arrive), (float(stops.end[number]), leave)):
            times = np.linspace(outer, inner, STROKE_STATES)
            checks += _stroke_checks(plan, cell, task, times, tolerances, where)
    return checks


def _stroke_checks(
    plan: TimedPlan, cell: Cell, task: PoseTask, times: FloatArray, tolerances: Tolerances, where: str
) -> list[Check]:
    """Check that the tool is straight behind its task at all ``times`` (n,), the first of which is its outer end."""
    seen = _tool_in_task(plan, cell, task, times)
    aside = np.linalg.norm(seen[:, :2, 3], axis=1)
    turned = np.arctan2(np.linalg.norm(seen[:, :2, 2], axis=1), seen[:, 2, 2])
    ahead = float(seen[:, 2, 3].max())
    return [
        Check("tool beside its straight stroke", float(aside.max()), tolerances.position, "m", where),
        Check("tool axis turned on its stroke", float(turned.max()), tolerances.angle, "rad", where),
        Check("stroke cut short", task.approach + float(seen[0, 2, 3]), tolerances.position, "m", where),
        Check("tool beyond its task", ahead, tolerances.position, "m", where),
    ]


def _deviation(plan: TimedPlan, cell: Cell, task: PoseTask, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far the tool is off its task in m, and how far turned in rad, free turns left out, (times,)."""
    seen = _tool_in_task(plan, cell, task, times)
    off = np.linalg.norm(seen[:, :3, 3], axis=1)
    if task.n_rotations > 1:
        turned = np.arctan2(np.linalg.norm(seen[:, :2, 2], axis=1), seen[:, 2, 2])
    else:
        R = seen[:, :3, :3]
        sine = np.linalg.norm(
            np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1), axis=1
        )
        turned = np.arctan2(0.5 * sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    return off, turned


def _tool_in_task(plan: TimedPlan, cell: Cell, task: PoseTask, times: FloatArray) -> FloatArray:
    """Return the pose of the tool in the task's frame at times (n,): (n, 4, 4)."""
    position, _ = states_at(plan.time, plan.position, plan.velocity, times)
    chain = cell.robot.chain
    T_base_flange = link_poses_of(chain, position)[:, -1] @ chain.T_last_flange
    return np.asarray(inverse(task.T_world_tool) @ cell.T_world_base @ T_base_flange @ cell.T_flange_scanner)


def joined_proof(
    runs: Sequence[tuple[TimedPlan, Cell, StateChecker]],
    tolerances: Tolerances,
    progress: Callable[[float], None] = lambda share: None,
) -> CollisionProof:
    """Check runs of a motion for collisions, each in the cell and by the scene that it goes by.

    It ends with the first run that collides.
    """
    worst: dict[str, Check] = {}
    n_states, nearest = 0, None
    total = sum(float(plan.time[-1] - plan.time[0]) for plan, _, _ in runs) or 1.0
    begun = 0.0
    for plan, cell, scene in runs:
        share = float(plan.time[-1] - plan.time[0]) / total

        def told(part: float, begun: float = begun, share: float = share) -> None:
            progress(begun + share * part)

        proof = check_collisions(plan, cell, scene, tolerances, told)
        begun, n_states = begun + share, n_states + proof.n_states
        for check in proof.checks:
            known = worst.get(check.name)
            if known is None or (check.found < known.found if check.at_least else check.found > known.found):
                worst[check.name] = check
        if proof.clearance is None:
            return CollisionProof(list(worst.values()), n_states, None)
        nearest = _nearer(nearest, proof.clearance)
    return CollisionProof(list(worst.values()), n_states, nearest)


def _nearer(one: Clearance | None, other: Clearance) -> Clearance:
    """Return what is proven of both together."""
    if one is None:
        return other
    nearest = one if one.found <= other.found else other
    return Clearance(
        found=nearest.found,
        proven=min(one.proven, other.proven),
        bodies=nearest.bodies,
        time=nearest.time,
        n_measured=one.n_measured + other.n_measured,
    )
