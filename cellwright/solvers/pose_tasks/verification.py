"""Check that a timed motion performs tasks: the tool is where each wants it, as long, once, in a permitted order.

Beside `cellwright.solvers.plan_verification`, which checks limits and collisions, and of the planner's results it takes
the motion alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import BoolArray, FloatArray, Int32Array
from cellwright.cell.cell import Cell
from cellwright.cell.transforms import inverse
from cellwright.errors import listed
from cellwright.solvers.clearance_proof import Clearance
from cellwright.solvers.hermite import states_at
from cellwright.solvers.motion_steps import MovingCorners, dense_times, link_poses_of
from cellwright.solvers.plan_verification import (
    Check,
    CollisionProof,
    StateChecker,
    TimedPlan,
    Tolerances,
    check_collisions,
)
from cellwright.solvers.pose_tasks.task import PoseTask

SAME_TIME = 1e-9
"""Seconds within which two times are one."""
NO_OWN_STOP = "segments called work of no stop of their own"


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


def is_own_work(is_work: BoolArray, stop: Int32Array, n_stops: int) -> BoolArray:
    """Return which segments are the work of a stop at which no other segment works, (segments,).

    Args:
        is_work: Which segments are said to be work, (segments,).
        stop: The stops that they name, (segments,).
        n_stops: How many stops there are.
    """
    known = is_work & (stop >= 0) & (stop < n_stops)
    workers = np.bincount(stop[known], minlength=n_stops + 1)
    return np.asarray(known & (workers[np.where(known, stop, 0)] == 1))


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
    moments = np.stack([stops.begin, stops.arrive, stops.leave, stops.end])  # (4, stops)
    back = float(np.max(-np.diff(moments, axis=0), initial=0.0))
    checks.append(Check("stop whose times are out of order", back, SAME_TIME, "s"))
    dense = dense_times(plan, MovingCorners.of(cell), step=tolerances.step, step_angle=tolerances.step_angle)
    worst: dict[str, Check] = {}
    for number, row in enumerate(done):
        for check in _stop_checks(plan, cell, tasks[row], stops, number, dense, tolerances):
            if check.name not in worst or not check.found <= worst[check.name].found:
                worst[check.name] = check
    return checks + list(worst.values())


def _stop_checks(
    plan: TimedPlan,
    cell: Cell,
    task: PoseTask,
    stops: Stops,
    number: int,
    dense: FloatArray,
    tolerances: Tolerances,
) -> list[Check]:
    begin, arrive, leave, end = (float(each[number]) for each in (stops.begin, stops.arrive, stops.leave, stops.end))
    off, turned = _deviation(plan, cell, task, _between(dense, arrive, leave))
    lacking = task.dwell - (leave - arrive)
    if number:
        lacking = max(lacking, float(stops.leave[number - 1]) - arrive)
    where = f"of task {task.name!r} at {arrive:.3f} s"
    checks = [
        Check("tool off its task", float(off.max()), tolerances.position, "m", where),
        Check("tool turned off its task", float(turned.max()), tolerances.angle, "rad", where),
        Check("time missing at a task", lacking, SAME_TIME, "s", where),
    ]
    if task.approach <= 0.0:
        besides = max(arrive - begin, end - leave)
        return [*checks, Check("motion at a task outside its strokes", besides, SAME_TIME, "s", where)]
    for outer, inner in ((begin, arrive), (end, leave)):
        checks += _stroke_checks(plan, cell, task, _between(dense, outer, inner), tolerances, where)
    return checks


def _between(dense: FloatArray, first: float, last: float) -> FloatArray:
    """Return both times and those of ``dense`` between them, in the order from ``first`` to ``last``."""
    low, high = min(first, last), max(first, last)
    inner = dense[(dense > low) & (dense < high)]
    return np.concatenate([[first], inner if first <= last else inner[::-1], [last]])


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
