"""Turn the artefacts of sequencing into the library's objects, and a sequence into its motion and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from cellwright.arrays import FloatArray, Int32Array
from cellwright.cell.cell import Cell
from cellwright.errors import InvalidInputError, listed
from cellwright.solvers.pose_tasks.task import PoseTask, working_cell
from schemas.tasks import TaskAlternatives, TaskList, TaskSequence

if TYPE_CHECKING:
    from cellwright.cell.symbolic_dynamics import SymbolicDynamics
    from cellwright.solvers.motion_cost import PlannedMotions
    from cellwright.solvers.optimal_control.program import CostWeights
    from cellwright.solvers.path_timing import TimedMotion
    from cellwright.solvers.plan_verification import TimedPlan
    from cellwright.solvers.pose_tasks.alternatives import Alternative
    from cellwright.solvers.pose_tasks.route import Route

MOTION, WORK = "motion", "work"

Mark = TypeVar("Mark")


def pose_tasks(tasks: TaskList) -> list[PoseTask]:
    """Return the tasks as solvers take them."""
    return [
        PoseTask(name, T.reshape(4, 4).copy(), int(rotations), float(dwell), float(approach))
        for name, T, rotations, dwell, approach in zip(
            tasks.name, tasks.T_world_tool, tasks.n_rotations, tasks.dwell_s, tasks.approach_m, strict=True
        )
    ]


def alternatives_of(model: TaskAlternatives) -> list[Alternative]:
    """Return the alternatives as solvers take them."""
    from cellwright.solvers.pose_tasks.alternatives import Alternative

    return [
        Alternative(
            int(model.task[k]),
            float(model.rotation_rad[k]),
            int(model.branch[k]),
            model.position_rad[k].copy(),
            model.entry_rad[k].copy(),
            float(model.stroke_s[k]),
        )
        for k in range(len(model.task))
    ]


def at_work(cell: Cell, touches: Sequence[tuple[str, str]]) -> Cell:
    """Return the cell in which pairs of bodies, by name, may touch; ``link`` stands for ``link.1``, ``link.2`` too.

    Raises:
        InvalidInputError: If a name is no body.
    """
    rows: dict[str, list[int]] = {}
    for row, body in enumerate(cell.bodies):
        rows.setdefault(body.name, []).append(row)
        stem, _, number = body.name.rpartition(".")
        if number.isdigit():
            rows.setdefault(stem, []).append(row)
    unknown = sorted({name for pair in touches for name in pair if name not in rows})
    if unknown:
        names = [body.name for body in cell.bodies]
        raise InvalidInputError(f"touches names {listed(unknown)}, but the bodies are {listed(names, 30)}")
    pairs = [sorted((a, b)) for one, other in touches for a in rows[one] for b in rows[other] if a != b]
    return working_cell(cell, np.array(pairs, np.int32).reshape(-1, 2))


def sequence_of(
    route: Route,
    alternatives: Sequence[Alternative],
    work: Sequence[TimedMotion | None],
    dwells: Sequence[float],
    *,
    motions: PlannedMotions | None = None,
    arm: PricedArm | None = None,
) -> TaskSequence:
    """Return the artefact of a route: its motions and what is done at its stops, one after the other.

    Args:
        route: The route.
        alternatives: Its alternatives.
        work: The motion at each alternative of the route, by stop: strokes and dwell, ``None`` if there is none.
        dwells: Time at each stop's task in s: strokes are what else there is of the work, half before and half after.
        motions: Motions between its nodes in place of its own.
        arm: The arm by which it is priced, if dynamics count.

    Raises:
        InvalidInputError: If nothing moves, or a motion of the route is missing.
    """
    legs_found = (motions or route.motions).found
    place = {alternative: stop for stop, alternative in enumerate(route.stops)}
    pieces: list[tuple[str, int, str, TimedMotion]] = []
    moments: list[tuple[float, float]] = []
    time = 0.0
    legs = dict(zip(route.nodes, route.nodes[1:]))
    last = route.nodes[-1]
    for node in route.nodes:
        if node in place:
            motion, dwell = work[place[node]], dwells[place[node]]
            stroke = 0.0 if motion is None else max(0.0, 0.5 * (motion.duration - dwell))
            moments.append((time + stroke, time + (0.0 if motion is None else motion.duration - stroke)))
            if motion is not None:
                pieces.append((WORK, place[node], "", motion))
                time += motion.duration
        following = legs.get(node) if node != last else (route.nodes[0] if route.closed else None)
        if following is not None:
            found = legs_found[node, following]
            if found is None:
                raise InvalidInputError("a motion of the route is missing: find the route again")
            pieces.append((MOTION, -1, found.via, found.motion))
            time += found.motion.duration
    if not pieces:
        raise InvalidInputError(
            "a single task that begins and ends where it is, without dwell and approach, asks for no motion: add a "
            "task, or begin at the start configuration"
        )
    states = _joined([motion for *_, motion in pieces])
    bounds = np.concatenate([[0.0], np.cumsum([motion.duration for *_, motion in pieces])])
    return TaskSequence(
        **states,
        torque_nm=_torques(states, arm),
        kind=tuple(kind for kind, *_ in pieces),
        stop=np.array([stop for _, stop, *_ in pieces], np.int32),
        start_s=bounds[:-1],
        end_s=bounds[1:],
        via=tuple(via for _, _, via, _ in pieces),
        **_prices([motion for *_, motion in pieces], [alternatives[k].q_task for k in route.stops],
                  np.array([leave - arrive for arrive, leave in moments]), arm),
        task=np.array([alternatives[k].task for k in route.stops], np.int32),
        alternative=np.array(route.stops, np.int32),
        arrive_s=np.array([arrive for arrive, _ in moments]),
        leave_s=np.array([leave for _, leave in moments]),
        order=tuple(route.orders),
        order_cost=np.array(list(route.orders.values())),
        cost_name=route.motions.cost.name,
        unit=route.motions.cost.unit,
        cost=route.cost,
        lower_bound=route.lower_bound,
        proven=route.proven,
        stopped_by=route.stopped_by,
        n_evaluated=route.n_evaluated,
        n_motions=route.n_motions,
        **_likely(route),
    )  # fmt: skip


def _likely(route: Route) -> dict[str, Any]:
    """Return the facts of the bound that is likely, where the cost guesses; without them their defaults stand."""
    if route.likely is None:
        return {}
    likely = route.likely
    return {"likely_bound": likely.value, "least_ratio": likely.least_ratio, "n_guessed": likely.n_motions}


def _prices(
    motions: Sequence[TimedMotion], q_task: Sequence[FloatArray], stays: FloatArray, arm: PricedArm | None
) -> dict[str, Any]:
    """Return the columns and facts that say what motions ask of the arm, not a number if nobody counts."""
    weights, share = (0.0, 0.0, 0.0), 0.0
    squares = np.full((len(motions), 2), np.nan)
    holding = np.full(len(q_task), np.nan)
    if arm is not None:
        from cellwright.solvers.optimal_control.measures import measure

        asked = [measure(arm.dynamics, arm.weights, arm.max_effort, motion) for motion in motions]
        squares = np.array([(each.effort, each.speed_squared) for each in asked])
        share = max(each.torque_share for each in asked)
        weights = (arm.weights.time, arm.weights.effort, arm.weights.velocity)
        holding = stays * np.sum(arm.dynamics.holding_torque(np.stack(q_task)) ** 2, axis=1)
    return {
        "torque_squared_n2m2s": squares[:, 0],
        "speed_squared_rad2_s": squares[:, 1],
        "holding_n2m2s": holding,
        "weight_time": weights[0],
        "weight_torque": weights[1],
        "weight_speed": weights[2],
        "torque_share": share,
    }


def _torques(states: dict[str, Any], arm: PricedArm | None) -> FloatArray:
    """Return the torques (states, joints) at the states of a sequence, no column of them if nobody counts."""
    if arm is None:
        return np.zeros((len(states["time_s"]), 0))
    from cellwright.solvers.motion_torques import state_torques
    from cellwright.solvers.path_timing import TimedMotion

    columns = ("time_s", "position_rad", "velocity_rad_s", "acceleration_rad_s2")
    return state_torques(arm.dynamics, TimedMotion(*(states[name] for name in columns)))


@dataclass(frozen=True, eq=False)
class PricedArm:
    """The arm, its torque limits (joints,) and the weights by which motions are priced."""

    dynamics: SymbolicDynamics
    max_effort: FloatArray
    weights: CostWeights


def _joined(motions: Sequence[TimedMotion]) -> dict[str, Any]:
    """Return the columns of the states of motions one after the other; where two meet the earlier's state stays."""
    rows: dict[str, list[FloatArray]] = {"time_s": [], "position_rad": [], "velocity_rad_s": []}
    rows["acceleration_rad_s2"] = []
    segment: list[Int32Array] = []
    begin = 0.0
    for number, motion in enumerate(motions):
        own = slice(1 if number else 0, None)
        rows["time_s"].append(begin + motion.time[own])
        rows["position_rad"].append(motion.position[own])
        rows["velocity_rad_s"].append(motion.velocity[own])
        rows["acceleration_rad_s2"].append(motion.acceleration[own])
        segment.append(np.full(len(motion.time) - (1 if number else 0), number, np.int32))
        begin += motion.duration
    return {name: np.concatenate(parts) for name, parts in rows.items()} | {"segment": np.concatenate(segment)}


def timed_plan(sequence: TaskSequence, segments: slice | None = None) -> TimedPlan:
    """Return the sequence's motion as verification takes it, all of it or that of some segments in a row."""
    from cellwright.solvers.plan_verification import ExecutedSegment, TimedPlan

    first, last, _ = (segments or slice(None)).indices(len(sequence.kind))
    begin = int(np.searchsorted(sequence.segment, first))
    end = int(np.searchsorted(sequence.segment, last))
    begin -= begin > 0  # the state at which it meets the segment before
    own = slice(begin, end)
    time, count = sequence.time_s[own], end - begin
    return TimedPlan(
        time,
        sequence.position_rad[own],
        sequence.velocity_rad_s[own],
        sequence.acceleration_rad_s2[own],
        sequence.segment[own],
        np.full(count, np.nan),
        tuple(ExecutedSegment(-1, float(sequence.start_s[k]), float(sequence.end_s[k])) for k in range(first, last)),
    )


def runs_of(marks: Sequence[Mark]) -> list[tuple[Mark, slice]]:
    """Return the segments in runs of one mark: their kinds, say."""
    found: list[tuple[Mark, slice]] = []
    for number, mark in enumerate(marks):
        if found and found[-1][0] == mark:
            found[-1] = (mark, slice(found[-1][1].start, number + 1))
        else:
            found.append((mark, slice(number, number + 1)))
    return found
