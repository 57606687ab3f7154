"""Turn the artefacts of a plan into the library's objects, and check that they belong together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cellwright.arrays import BoolArray, FloatArray
from cellwright.cell.transforms import pose, rotation_from_quaternion
from cellwright.errors import InvalidInputError
from cellwright.solvers.sweeps.planned import ExecutablePiece, PlannedSweep
from schemas.motion import Trajectory, Verification
from schemas.views import Measurability, Reachability, Viewpoints, ViewSelection

if TYPE_CHECKING:
    from cellwright.solvers.plan_verification import Check, CollisionProof, TimedPlan
    from cellwright.solvers.stitched_plan import StitchedPlan

SAME_TRAVEL = 1e-9
"""Metres within which two travels are one."""


def planned_sweeps(
    viewpoints: Viewpoints, reachability: Reachability, selection: ViewSelection, T_world_part: FloatArray
) -> list[PlannedSweep]:
    """Return the selected sweeps in the order of the selection, each with the pieces that can execute it.

    What must be executed is the interval of a view's first piece, its best one; the other pieces of the view
    that hold this interval are alternatives.

    Raises:
        InvalidInputError: If a selected view does not exist, has no piece, or is selected twice.
    """
    n_views = len(viewpoints.sample)
    chosen = selection.view
    if len(np.unique(chosen)) != len(chosen):
        raise InvalidInputError(f"{len(chosen)} views are selected but only {len(np.unique(chosen))} different ones")
    sweeps = []
    for view in chosen.tolist():
        if not 0 <= view < n_views:
            raise InvalidInputError(
                f"view {view} is selected but there are {n_views} viewpoints: these do not belong together"
            )
        first, last = np.searchsorted(reachability.view, [view, view + 1])
        if first == last:
            raise InvalidInputError(
                f"view {view} is selected but has no executable piece: select views after following them"
            )
        interval = float(reachability.start_m[first]), float(reachability.end_m[first])
        T_part_scanner = pose(viewpoints.position_m[view], rotation_from_quaternion(viewpoints.quaternion[view]))
        pieces = tuple(
            ExecutablePiece(
                int(reachability.branch[row]),
                float(reachability.start_m[row]),
                float(reachability.end_m[row]),
                reachability.q_start_rad[row],
            )
            for row in range(int(first), int(last))
            if reachability.start_m[row] <= interval[0] + SAME_TRAVEL
            and reachability.end_m[row] >= interval[1] - SAME_TRAVEL
        )
        sweeps.append(PlannedSweep(f"view {view}", T_world_part @ T_part_scanner, interval, pieces))
    return sweeps


def trajectory_of(plan: StitchedPlan, selection: ViewSelection, earlier: Trajectory | None = None) -> Trajectory:
    """Return the artefact of a stitched plan, with what it leaves out and what it replaces of ``earlier`` ones.

    Times rise strictly: the state at which a connection and a sweep meet is stored once, as one of the sweep.
    """
    before = {} if earlier is None else unconnected_views(earlier)
    replaced = {view: reason for view, reason in before.items() if view not in selection.view}
    left_out = {int(selection.view[sweep.sweep]): sweep.reason for sweep in plan.left_out}
    aside = _aside_columns(left_out, replaced)
    if not plan.segments:
        return _motionless(plan, aside)
    rows: dict[str, list[FloatArray]] = {name: [] for name in ("time", "q", "v", "a", "segment", "travel")}
    bounds = [0.0]
    for number, segment in enumerate(plan.segments):
        motion, sweeps = segment.motion, segment.sweep >= 0
        first = 1 if number > 0 and not sweeps else 0
        last = len(motion.time) - (1 if number < len(plan.segments) - 1 and not sweeps else 0)
        own = slice(first, last)
        n_joints = motion.position.shape[1] - (1 if sweeps else 0)
        rows["time"].append(bounds[-1] + motion.time[own])
        rows["q"].append(motion.position[own, :n_joints])
        rows["v"].append(motion.velocity[own, :n_joints])
        rows["a"].append(motion.acceleration[own, :n_joints])
        rows["segment"].append(np.full(last - first, number))
        rows["travel"].append(motion.position[own, n_joints] if sweeps else np.full(last - first, np.nan))
        bounds.append(bounds[-1] + motion.duration)
    joined = {name: np.concatenate(parts) for name, parts in rows.items()}
    segments = plan.segments
    return Trajectory(
        time_s=joined["time"],
        position_rad=joined["q"],
        velocity_rad_s=joined["v"],
        acceleration_rad_s2=joined["a"],
        segment=joined["segment"].astype(np.int32),
        travel_m=joined["travel"],
        kind=tuple("sweep" if segment.sweep >= 0 else "connection" for segment in segments),
        view=np.array([selection.view[s.sweep] if s.sweep >= 0 else -1 for s in segments], np.int32),
        branch=np.array([segment.branch for segment in segments], np.int8),
        direction=np.array([segment.direction for segment in segments], np.int8),
        start_s=np.array(bounds[:-1]),
        end_s=np.array(bounds[1:]),
        via=tuple(segment.via for segment in segments),
        order_method=tuple(plan.durations),
        order_duration_s=np.array(list(plan.durations.values())),
        order_chosen=np.array([name == plan.chosen for name in plan.durations]),
        **aside,
        order_lower_bound_s=plan.lower_bound,
        order_proven=plan.proven,
    )


def _motionless(plan: StitchedPlan, aside: dict[str, Any]) -> Trajectory:
    """Return the trajectory of a plan that executes no sweep: no state, no segment."""
    none, whole = np.zeros(0), np.zeros(0, np.int32)
    rest = np.zeros((0, plan.n_joints))
    return Trajectory(
        time_s=none,
        position_rad=rest,
        velocity_rad_s=rest,
        acceleration_rad_s2=rest,
        segment=whole,
        travel_m=none,
        kind=(),
        view=whole,
        branch=np.zeros(0, np.int8),
        direction=np.zeros(0, np.int8),
        start_s=none,
        end_s=none,
        via=(),
        order_method=(),
        order_duration_s=none,
        order_chosen=np.zeros(0, bool),
        **aside,
        order_lower_bound_s=0.0,
        order_proven=False,
    )


def _aside_columns(left_out: dict[int, str], replaced: dict[int, str]) -> dict[str, Any]:
    return {
        "left_out_view": np.array(sorted(left_out), np.int32),
        "left_out_reason": tuple(left_out[view] for view in sorted(left_out)),
        "replaced_view": np.array(sorted(replaced), np.int32),
        "replaced_reason": tuple(replaced[view] for view in sorted(replaced)),
    }


def unconnected_views(trajectory: Trajectory) -> dict[int, str]:
    """Return why views could not be executed or connected: those left out, and those replaced before."""
    return dict(
        zip(
            [*trajectory.replaced_view.tolist(), *trajectory.left_out_view.tolist()],
            [*trajectory.replaced_reason, *trajectory.left_out_reason],
            strict=True,
        )
    )


def covered_samples(measurability: Measurability, trajectory: Trajectory) -> BoolArray:
    """Return which samples the executed sweeps measure, (samples,)."""
    covered = np.zeros(len(measurability.cause), bool)
    executed = np.unique(trajectory.view[trajectory.view >= 0])
    covered[measurability.sample[np.isin(measurability.view, executed)]] = True
    return covered


def executed_views(selection: ViewSelection, trajectory: Trajectory) -> ViewSelection:
    """Return the selection without the views that the trajectory leaves out."""
    kept = ~np.isin(selection.view, trajectory.left_out_view)
    return replace(
        selection,
        view=selection.view[kept],
        n_samples=selection.n_samples[kept],
        n_only=selection.n_only[kept],
        max_uncertainty_m=selection.max_uncertainty_m[kept],
    )


def timed_plan(trajectory: Trajectory, selection: ViewSelection) -> TimedPlan:
    """Return a trajectory as verification takes it; segments name sweeps by their row in the selection.

    Raises:
        InvalidInputError: If the trajectory executes a view that is not selected.
    """
    from cellwright.solvers.plan_verification import ExecutedSegment, TimedPlan

    row_of = {view: row for row, view in enumerate(selection.view.tolist())}
    segments = []
    for kind, view, start, end in zip(
        trajectory.kind, trajectory.view.tolist(), trajectory.start_s.tolist(), trajectory.end_s.tolist(), strict=True
    ):
        if kind == "sweep" and view not in row_of:
            raise InvalidInputError(
                f"the trajectory executes view {view}, which is not selected: these do not belong together"
            )
        segments.append(ExecutedSegment(row_of[view] if kind == "sweep" else -1, start, end))
    return TimedPlan(
        trajectory.time_s,
        trajectory.position_rad,
        trajectory.velocity_rad_s,
        trajectory.acceleration_rad_s2,
        trajectory.segment,
        trajectory.travel_m,
        tuple(segments),
    )


def verification_of(checks: Sequence[Check], proof: CollisionProof, engine: str) -> Verification:
    """Return the artefact of a verification that has passed; ``engine`` names what looked for collisions.

    Raises:
        TypeError: If the proof knows no clearance, as it does only of a motion that collides.
    """
    clearance = proof.clearance
    if clearance is None:
        raise TypeError("a motion without collision has no clearance")
    return Verification(
        check=tuple(check.name for check in checks),
        found=np.array([check.found for check in checks]),
        permitted=np.array([check.permitted for check in checks]),
        unit=tuple(check.unit for check in checks),
        at_least=np.array([check.at_least for check in checks]),
        least_distance_m=clearance.found,
        proven_distance_m=clearance.proven,
        nearest_bodies=clearance.bodies,
        nearest_s=clearance.time,
        n_distances=clearance.n_measured,
        n_states=proof.n_states,
        engine=engine,
    )
