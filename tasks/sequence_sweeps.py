"""Sequence the sweeps under a cost: time, or optimal control of the arm's dynamics (Bjorkenstam 2014, section 2).

Clusters are the executed sweeps, alternatives their directions, branches and windings. Under optimal control a motion
ends with the velocity that the next sweep begins with, so that the arm does not stop in between; it keeps the planner's
clearance and all joint, speed, acceleration and torque limits. Motions are found only as far as a sequence could win
by them. The greedy plan of Kaiser 2021 and the stitched one are measured beside it. A sequence that is not cheaper
than the stitched plan is not taken, and the result says so.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from cellwright.errors import InfeasibleError, InvalidInputError
from schemas.motion import Trajectory
from schemas.params import Params
from schemas.part import PartMesh
from schemas.poses import Pose
from schemas.sequencing import MOTION_COLUMNS, SweepSequence
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage
from schemas.sweep_params import StitchParams
from schemas.views import Reachability, Viewpoints, ViewSelection

if TYPE_CHECKING:
    from cellwright.arrays import FloatArray
    from cellwright.cell.cell import Cell
    from cellwright.solvers.optimal_control.measures import Measures
    from cellwright.solvers.path_timing import TimedMotion
    from cellwright.solvers.sweeps.sequence import SequencedSweeps
    from cellwright.solvers.sweeps.sequenced_plan import ControlledArm, KnownSweep

NAMES = {"time": "sequence", "optimal_control": "optimal control"}
"""What the plan is called, by its cost."""
LEAST_GAIN = 1e-6
"""Share of the cost that a sequence must save, or the stitched plan stays."""


class SweepSequenceParams(Params):
    """Settings of the sequencing stage."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    cost: Literal["time", "optimal_control"] = Field(default="optimal_control", description="What is minimised.")
    weight_time_per_s: float = Field(default=1.0, gt=0, description="c_t.")
    weight_torque_per_n2m2s: float = Field(default=1e-6, ge=0, description="c_e.")
    weight_speed_s_per_rad2: float = Field(default=0.01, ge=0, description="c_v.")
    payload_kg: float = Field(default=2.0, ge=0, description="Mass that the flange carries.")
    payload_centre_m: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="Its centre, on the flange."
    )
    n_steps: int = Field(default=16, ge=4, le=200, description="Steps of a motion.")
    max_motions: int = Field(
        default=60, ge=1, description="Motions found at most, but for those of the first sequence."
    )
    target_gap: float = Field(default=0.002, ge=0, lt=1, description="Share that may be missing to the proof.")
    stitching: StitchParams = Field(
        default=StitchParams(), description="How paths are found; as the plan was stitched."
    )


@stage(version=4)
def sequence_sweeps(
    cell: CellModel,
    mesh: PartMesh,
    viewpoints: Viewpoints,
    reachability: Reachability,
    selection: ViewSelection,
    trajectory: Trajectory,
    before: Trajectory | None = None,
    *,
    params: SweepSequenceParams,
    progress: Progress = no_progress,
) -> SweepSequence:
    """Find the cheapest sequence of the sweeps that the stitched ``trajectory`` executes, and compare.

    ``before`` is the stitched plan in the cell file's placement, where part or robot have been moved.

    Raises:
        InvalidInputError: If the robot has no dynamics: masses or torque limits are missing in its URDF.
        InfeasibleError: If the torque limits do not hold the arm at the start, or at no alternative of a sweep.
    """
    import numpy as np

    from cellwright.cell.motion_filter import FilteredScene
    from cellwright.cell.scene import Scene
    from cellwright.solvers.path_timing import TimedMotion
    from cellwright.solvers.stitching import stitch
    from cellwright.solvers.sweeps.sequenced_plan import SequenceWork, sequenced
    from schemas.cell_objects import build_cell
    from schemas.plan_objects import executed_views, planned_sweeps

    T_world_part = params.T_world_part.matrix()
    built, executed = build_cell(cell, mesh, T_world_part), executed_views(selection, trajectory)
    sweeps = planned_sweeps(viewpoints, reachability, executed, T_world_part)
    scene, settings = Scene(built, params.stitching.clearance_m), params.stitching.settings()
    arm = _arm(built, params)
    greedy = stitch(
        built,
        FilteredScene(scene),
        sweeps,
        settings=settings,
        method="greedy",
        rng=np.random.default_rng(params.stitching.seed),
        sweep_checker=FilteredScene(scene.with_clearance(settings.sweep_clearance)),
        progress=lambda share: progress(0.2 * share),
    )
    stitched = TimedMotion(
        trajectory.time_s, trajectory.position_rad, trajectory.velocity_rad_s, trajectory.acceleration_rad_s2
    )
    plans = {} if greedy.left_out else {"greedy": _measured(greedy.segments, arm)}
    plans[_chosen(trajectory)] = arm.measure(stitched) if arm else _timed(stitched.duration)
    controlled = arm if params.cost == "optimal_control" else None
    found, reason = None, ""
    try:
        found = sequenced(
            built, scene, sweeps, settings, controlled,
            SequenceWork(params.max_motions, params.target_gap), params.stitching.seed,
            known=_known(trajectory, executed), progress=lambda share: progress(0.2 + 0.8 * share),
        )  # fmt: skip
    except InfeasibleError as error:
        if controlled is not None:
            _require_held(controlled, built.start, stitched)
        reason = str(error)
    progress(1.0)
    return _result(found, reason, plans, trajectory, executed, arm, before, params)


def _known(trajectory: Trajectory, executed: ViewSelection) -> list[KnownSweep]:
    """Return the sweeps of the stitched plan in its order."""
    import numpy as np

    from cellwright.solvers.sweeps.sequenced_plan import KnownSweep

    row_of = {view: row for row, view in enumerate(executed.view.tolist())}
    return [
        KnownSweep(
            row_of[int(trajectory.view[number])],
            int(trajectory.direction[number]),
            trajectory.position_rad[int(np.argmax(trajectory.segment == number))],
        )
        for number, kind in enumerate(trajectory.kind)
        if kind == "sweep"
    ]


def _arm(built: Cell, params: SweepSequenceParams) -> ControlledArm | None:
    """Return the arm with its payload; None where only time counts and it has no dynamics.

    Raises:
        InvalidInputError: If it has no dynamics, but they are asked for.
    """
    from cellwright.cell.serial_arm import SerialArm
    from cellwright.cell.symbolic_dynamics import Payload, symbolic_dynamics
    from cellwright.solvers.optimal_control.program import CostWeights, effort_limits
    from cellwright.solvers.sweeps.sequenced_plan import ControlledArm

    serial, T_world_base = SerialArm.from_robot(built.robot), built.T_world_base
    try:
        symbolic_dynamics(serial, T_world_base=T_world_base)  # a payload would hide links without mass
        payload = Payload.point(params.payload_kg, params.payload_centre_m)
        dynamics = symbolic_dynamics(serial, payload=payload, T_world_base=T_world_base)
        weights = CostWeights(params.weight_time_per_s, params.weight_torque_per_n2m2s, params.weight_speed_s_per_rad2)
        return ControlledArm(dynamics, effort_limits(dynamics, None), weights, params.n_steps)
    except InvalidInputError as error:
        if params.cost == "time":
            return None
        raise InvalidInputError(f"{error}; or sequence by time alone: write time for `cost`") from error


def _require_held(arm: ControlledArm, q_start: Any, stitched: TimedMotion) -> None:
    """Raise the error itself where the arm cannot be held: no plan of these sweeps is sound then."""
    arm.dynamics.check_holds(q_start, arm.max_effort, "the start")
    for row in (0, len(stitched.time) // 2, -1):
        arm.dynamics.check_holds(stitched.position[row], arm.max_effort, f"{stitched.time[row]:.2f} s of the plan")


def _chosen(trajectory: Trajectory) -> str:
    chosen = [name for name, is_plan in zip(trajectory.order_method, trajectory.order_chosen.tolist()) if is_plan]
    return chosen[0] if chosen else "stitched"


def _timed(duration: float) -> Measures:
    from cellwright.solvers.optimal_control.measures import Measures

    return Measures(duration, math.nan, math.nan, duration, math.nan)


def _measured(segments: Any, arm: ControlledArm | None) -> Measures:
    from cellwright.solvers.optimal_control.measures import together

    motions = [segment.motion for segment in segments]
    if arm is None:
        return _timed(sum(motion.duration for motion in motions))
    return together(arm.measure(motion) for motion in motions)


def _result(
    found: SequencedSweeps | None,
    reason: str,
    plans: dict[str, Measures],
    trajectory: Trajectory,
    executed: ViewSelection,
    arm: ControlledArm | None,
    before: Trajectory | None,
    params: SweepSequenceParams,
) -> SweepSequence:
    import numpy as np

    name, stitched = NAMES[params.cost], _chosen(trajectory)
    if found is not None:
        plans = {**plans, name: _measured(found.segments, arm)}
    costs = {each: _cost(measures, params) for each, measures in plans.items()}
    taken = found is not None and costs[name] < costs[stitched] * (1.0 - LEAST_GAIN)
    if found is not None and not taken:
        reason = (
            f"the best sequence found costs {costs[name]:.6g}, not less than the stitched plan's {costs[stitched]:.6g}"
        )
    motion = _motion_columns(found if taken else None, executed, trajectory)
    weighed = arm if params.cost == "optimal_control" else None
    rows = list(plans.values())
    return SweepSequence(
        plan=tuple(plans),
        duration_s=np.array([each.duration for each in rows]),
        effort_n2m2s=np.array([each.effort for each in rows]),
        work_j=np.array([each.work for each in rows]),
        cost=np.array(list(costs.values())),
        torque_share=np.array([each.torque_share for each in rows]),
        taken=np.array([each == (name if taken else stitched) for each in plans]),
        **(motion | {"torque_nm": _torques(weighed, motion)}),
        stitched_torque_nm=_stitched_torques(weighed, trajectory),
        cost_kind=params.cost,
        name=name,
        is_taken=taken,
        reason=_reason(found, reason, taken, params),
        lower_bound=math.nan if found is None else found.lower_bound,
        proven=found is not None and found.proven,
        n_evaluated=0 if found is None else found.n_evaluated,
        n_motions=0 if found is None else found.n_motions,
        n_joined=0 if found is None else found.n_joined,
        n_stopped=0 if found is None else found.n_stopped,
        greedy_before_s=_greedy_before(before),
        picture=_picture(arm, trajectory, motion, name) if taken and arm is not None else b"",
    )


def _cost(measures: Measures, params: SweepSequenceParams) -> float:
    return measures.duration if params.cost == "time" else measures.cost


def _reason(found: SequencedSweeps | None, reason: str, taken: bool, params: SweepSequenceParams) -> str:
    if found is None or not taken:
        return reason
    proof = "no other sequence over the motions found is cheaper"
    if found.stopped_by == "gap":
        proof += f" by more than {params.target_gap:.1%}"
    if found.stopped_by not in ("proof", "gap"):
        proof = f"at most {1.0 - found.lower_bound / found.cost:.1%} could be saved by another sequence"
    return f"{proof}; {found.n_evaluated:,} of {found.n_motions:,} motions were found for that"


def _greedy_before(before: Trajectory | None) -> float:
    if before is None:
        return math.nan
    durations: dict[str, float] = dict(zip(before.order_method, before.order_duration_s.tolist()))
    return durations.get("greedy", math.nan)


def _motion_columns(found: SequencedSweeps | None, executed: ViewSelection, trajectory: Trajectory) -> dict[str, Any]:
    """Return states and segments of the sequence; none where it is not taken."""
    from cellwright.solvers.stitched_plan import StitchedPlan
    from schemas.plan_objects import trajectory_of

    segments = () if found is None else found.segments
    n_joints = trajectory.position_rad.shape[1]
    plan = StitchedPlan(segments, {"": 0.0}, "", 0.0, False, (), n_joints)
    made = trajectory_of(plan, executed)
    return {name: getattr(made, name) for name in MOTION_COLUMNS}


def _torques(arm: ControlledArm | None, motion: dict[str, Any]) -> FloatArray | None:
    """Return the torques at the states of a motion, nothing without dynamics or motion."""
    from cellwright.solvers.motion_torques import state_torques

    return None if arm is None or not len(motion["time_s"]) else state_torques(arm.dynamics, _timed_motion(motion))


def _stitched_torques(arm: ControlledArm | None, trajectory: Trajectory) -> FloatArray:
    """Return the torques at the states of the stitched plan, no row without dynamics."""
    found = _torques(arm, {column: getattr(trajectory, column) for column in MOTION_COLUMNS})
    return trajectory.position_rad[:0] if found is None else found


def _timed_motion(columns: dict[str, Any]) -> TimedMotion:
    from cellwright.solvers.path_timing import TimedMotion

    states = ("time_s", "position_rad", "velocity_rad_s", "acceleration_rad_s2")
    return TimedMotion(*(columns[name] for name in states))


def _picture(arm: ControlledArm, trajectory: Trajectory, motion: dict[str, Any], name: str) -> bytes:
    from cellwright.figures.power_chart import PoweredPlan, power_chart
    from cellwright.solvers.optimal_control.measures import power_over_time

    plans = []
    stitched = {column: getattr(trajectory, column) for column in MOTION_COLUMNS}
    for title, each in ((f"stitched: {_chosen(trajectory)} order", stitched), (f"sequenced by {name}", motion)):
        time, power = power_over_time(arm.dynamics, _timed_motion(each))
        sweeps = [
            (begin, end)
            for begin, end, kind in zip(each["start_s"].tolist(), each["end_s"].tolist(), each["kind"])
            if kind == "sweep"
        ]
        plans.append(PoweredPlan(f"{title}, {each['time_s'][-1]:.2f} s", time, power, sweeps))
    return power_chart(plans)
