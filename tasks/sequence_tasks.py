"""Find the sequence of tasks, the alternative of each, and the collision-free motion through all of them.

Method in `cellwright.solvers.pose_tasks.route`: a generalised travelling-salesman problem on lower bounds, whose
motions are planned only as far as a sequence could win by them. Every motion that is used is confirmed in steps in
which no point of the robot moves further than ``confirm_step_m``. With ``optimal_control`` as the cost, motions are
those of `cellwright.solvers.optimal_control.motion` and torque limits take the place of acceleration limits, or, with
``keep_accelerations``, stand beside them.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from cellwright.errors import InvalidInputError
from schemas.params import Params
from schemas.payload import PayloadParams
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage
from schemas.tasks import TaskAlternatives, TaskList, TaskSequence

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from cellwright.arrays import FloatArray
    from cellwright.cell.cell import Cell
    from cellwright.cell.scene import Scene
    from cellwright.solvers.motion_cost import MotionCost, PlannedMotions
    from cellwright.solvers.path_timing import TimedMotion
    from cellwright.solvers.pose_tasks.alternatives import Alternative
    from cellwright.solvers.pose_tasks.dynamic_costs import WorkedWay
    from cellwright.solvers.pose_tasks.motion_costs import MotionTimes
    from cellwright.solvers.pose_tasks.route import Route
    from cellwright.solvers.pose_tasks.task import PoseTask
    from schemas.task_objects import PricedArm


class DynamicsParams(Params):
    """How time, torque and speed are weighed, and what the arm carries."""

    time_per_s: float = Field(default=1.0, gt=0, description="What a second costs.")
    effort: float = Field(default=1e-6, ge=0, description="What (N m)^2 s costs.")
    velocity: float = Field(default=1.0, ge=0, description="What rad^2/s costs.")
    n_steps: int = Field(default=20, ge=4, le=400, description="Steps of a motion.")
    payload: PayloadParams | None = Field(default=None, description="What the arm carries.")


class SequenceParams(Params):
    """Settings of the sequence."""

    cost: Literal["time", "velocity", "optimal_control"] = Field(
        default="time",
        description="Time of planned motions; of the slowest joint at full speed; time, torque and speed weighed.",
    )
    motions: Literal["by_cost", "optimal_control"] = Field(
        default="by_cost", description="Motions as the cost has them, or optimal ones in the order that it gives."
    )
    dynamics: DynamicsParams | None = Field(
        default=None, description="How dynamics are weighed; without it a sequence in time is not priced by them."
    )
    keep_accelerations: bool = Field(
        default=False, description="Whether optimal motions keep the joints' acceleration limits too."
    )
    from_start: bool = Field(default=True, description="Whether it begins at the start configuration.")
    returns: bool = Field(default=True, description="Whether it comes back to where it began.")
    end_rad: tuple[float, ...] | None = Field(default=None, description="Configuration at which it ends.")
    max_motions: int = Field(default=2000, ge=1, le=1_000_000, description="Motions to plan at most.")
    max_work: float | None = Field(default=None, gt=0, description="Sums and comparisons of each proof.")
    target_gap: float = Field(default=0.0, ge=0, lt=1, description="Share by which the bound may stay below the cost.")
    clearance_m: float = Field(default=0.0, ge=0, le=0.5, description="Distance to keep between bodies.")
    roadmap_nodes: int = Field(default=600, ge=10, le=20_000, description="Random configurations to begin with.")
    neighbours: int = Field(default=12, ge=1, le=200, description="Neighbours that a configuration is joined to.")
    step_rad: float = Field(
        default=0.02, ge=math.radians(0.05) * (1 - 1e-9), le=0.2, description="Joint turn between checked states."
    )
    confirm_step_m: float = Field(default=1e-3, gt=0, le=0.01, description="Motion of any point when confirming.")
    sample_s: float = Field(default=0.008, ge=1e-3, le=0.1, description="Time between states.")
    seed: int = Field(default=0, ge=0, description="Seed of roadmap, search and shortening.")

    @property
    def optimal_motions(self) -> bool:
        """Whether motions are optimal ones, and torque limits those that count."""
        return "optimal_control" in (self.cost, self.motions)

    @property
    def by_dynamics(self) -> bool:
        """Whether dynamics count: for the motions, or for prices alone."""
        return self.dynamics is not None or self.optimal_motions


@stage(version=6)
def sequence_tasks(
    cell: CellModel,
    tasks: TaskList,
    alternatives: TaskAlternatives,
    *,
    params: SequenceParams,
    progress: Progress = no_progress,
) -> TaskSequence:
    """Find the sequence and its motion.

    Raises:
        InfeasibleError: If no sequence is found whose motions all exist, or torque limits allow no alternative of a
            task; it names the tasks.
        InvalidInputError: If bodies come too close at the start, the end is no configuration of the robot, what comes
            before what contradicts itself, or dynamics count and the URDF states no masses or torque limits.
    """
    import numpy as np

    from cellwright.cell.scene import Scene
    from cellwright.cell.start_check import check_start
    from cellwright.solvers.motion_cost import VelocityCost
    from cellwright.solvers.pose_tasks.route import RouteRules, RouteWork, find_route
    from schemas.cell_objects import build_cell
    from schemas.task_objects import alternatives_of, pose_tasks, sequence_of

    if len(tasks.before) and not params.from_start and params.returns and params.end_rad is None:
        raise InvalidInputError(
            "a round trip that starts anywhere has no first task, so none comes after another: start at home, or let "
            "it end anywhere"
        )
    built, listed_tasks, ways = build_cell(cell), pose_tasks(tasks), alternatives_of(alternatives)
    scene = Scene(built, params.clearance_m)
    if params.from_start:
        check_start(scene, params.clearance_m)
    end = None if params.end_rad is None else _checked_end(built, scene, params.end_rad)
    motion_rng, search_rng = np.random.default_rng(params.seed).spawn(2)
    planned = _motion_times(built, scene, ways, end, params, motion_rng)
    dynamic = _Dynamic(built, scene, planned, params) if params.by_dynamics else None
    rows = list(range(len(ways)))
    strokes: Sequence[TimedMotion | None] | None = None
    stroke_costs: list[float] | None = None
    if dynamic is not None and params.optimal_motions:
        worked = dynamic.worked(listed_tasks, ways)
        rows, ways = [each.row for each in worked], [each.way for each in worked]
        strokes = [None if each.stroke is None else each.stroke.motion for each in worked]
        if params.cost == "optimal_control":
            stroke_costs = [0.0 if each.stroke is None else each.stroke.cost for each in worked]
    cost: MotionCost = planned if params.cost == "time" else VelocityCost(planned.limits.velocity, planned)
    if dynamic is not None and params.cost == "optimal_control":
        cost = dynamic.cost
    route = find_route(
        listed_tasks,
        ways,
        np.array(built.start, float),
        cost,
        RouteRules(params.from_start, params.returns, params.end_rad, tuple(map(tuple, tasks.before.tolist()))),
        RouteWork(params.max_motions, params.target_gap, params.max_work),
        search_rng,
        strokes=stroke_costs,
        progress=progress,
    )
    motions = route.motions
    if dynamic is not None and params.optimal_motions and params.cost != "optimal_control":
        motions = dynamic.along(route)
    work = _work(built, listed_tasks, ways, route, strokes, params.sample_s)
    progress(1.0)
    dwells = [listed_tasks[ways[stop].task].dwell for stop in route.stops]
    found = sequence_of(route, ways, work, dwells, motions=motions, arm=None if dynamic is None else dynamic.arm)
    return replace(
        found,
        alternative=np.array(rows, np.int32)[found.alternative],
        acceleration_share=_acceleration_share(built, found),
        keeps_torques=params.optimal_motions,
        keeps_accelerations=params.keep_accelerations or not params.optimal_motions,
    )


def _acceleration_share(cell: Cell, found: TaskSequence) -> float:
    """Return the greatest joint acceleration of the curve as a share of its limit."""
    from cellwright.solvers.hermite import peak_acceleration

    peak = peak_acceleration(found.time_s, found.position_rad, found.velocity_rad_s)  # (intervals, joints)
    return float((peak / cell.robot.chain.max_acceleration).max())


def _checked_end(cell: Cell, scene: Scene, end_rad: tuple[float, ...]) -> FloatArray:
    import numpy as np

    chain, q = cell.robot.chain, np.array(end_rad, float)
    if q.shape != (chain.n_joints,):
        raise InvalidInputError(f"the end has {len(q)} joints where the arm has {chain.n_joints}: correct end_rad")
    outside = np.flatnonzero((q < chain.lower) | (q > chain.upper))
    if len(outside):
        joint = int(outside[0])
        raise InvalidInputError(
            f"the end has joint {cell.robot.joint_names[joint]} at {q[joint]:.4g} rad, outside its limits "
            f"{chain.lower[joint]:.4g} to {chain.upper[joint]:.4g} rad: correct end_rad"
        )
    pair = scene.colliding_pair(q)
    if pair is not None:
        raise InvalidInputError(
            f"the end configuration brings {pair[0]!r} and {pair[1]!r} closer than their clearance: correct end_rad"
        )
    return q


def _motion_times(
    cell: Cell,
    scene: Scene,
    ways: Sequence[Alternative],
    end: FloatArray | None,
    params: SequenceParams,
    rng: np.random.Generator,
) -> MotionTimes:
    import numpy as np

    from cellwright.solvers.connections import ConnectionSteps
    from cellwright.solvers.pose_tasks.motion_costs import MotionTimes
    from cellwright.solvers.roadmap import RoadmapSize

    nodes = params.roadmap_nodes
    return MotionTimes(
        cell,
        scene,
        np.stack([*(way.q_entry for way in ways), *([] if end is None else [end])]),
        size=RoadmapSize(nodes, nodes // 2 or 1, 5 * nodes, params.neighbours),
        steps=ConnectionSteps(params.step_rad, params.sample_s, params.confirm_step_m, 0.01),
        rng=rng,
    )


def _work(
    cell: Cell,
    tasks: Sequence[PoseTask],
    ways: Sequence[Alternative],
    route: Route,
    strokes: Sequence[TimedMotion | None] | None,
    sample_s: float,
) -> list[TimedMotion | None]:
    """Return what is done at each stop: stroke, dwell and stroke; strokes are timed anew unless they are given."""
    from cellwright.errors import SolverError
    from cellwright.solvers.path_timing import Limits
    from cellwright.solvers.pose_tasks.strokes import at_work, time_stroke, trace_stroke

    limits, work = Limits(cell.robot.chain.max_velocity, cell.robot.chain.max_acceleration), []
    for stop in route.stops:
        way = ways[stop]
        task = tasks[way.task]
        if strokes is None:
            path = trace_stroke(cell, task, way.rotation, way.q_task)
            stroke = None if path is None or len(path) < 2 else time_stroke(path, task.approach, limits, sample_s)
        else:
            stroke = strokes[stop]
        if task.approach > 0.0 and stroke is None:
            raise SolverError(f"the stroke of task {task.name!r} was lost: generate the alternatives again")
        work.append(at_work(stroke, way.q_task, task.dwell))
    return work


class _Dynamic:
    """The arm with its payload, the cost of its optimal motions, and the prices of any."""

    def __init__(self, cell: Cell, scene: Scene, planned: MotionTimes, params: SequenceParams) -> None:
        from cellwright.solvers.optimal_control.program import CostWeights, effort_limits
        from cellwright.solvers.pose_tasks.dynamic_costs import DynamicSettings, dynamics_of, optimal_control_cost
        from schemas.task_objects import PricedArm

        own = params.dynamics or DynamicsParams()
        weights = CostWeights(own.time_per_s, own.effort, own.velocity)
        dynamics = dynamics_of(cell, None if own.payload is None else own.payload.payload())
        settings = DynamicSettings(
            weights, own.n_steps, params.confirm_step_m, params.sample_s, keep_accelerations=params.keep_accelerations
        )
        self._cell, self._sample, self._end = cell, params.sample_s, params.end_rad
        self.arm: PricedArm = PricedArm(dynamics, effort_limits(dynamics, None), weights)
        self.cost = optimal_control_cost(cell, scene, planned, dynamics, settings)

    def worked(self, tasks: Sequence[PoseTask], ways: Sequence[Alternative]) -> list[WorkedWay]:
        """Return the alternatives that torques allow; the start and a given end have to be held as well."""
        import numpy as np

        from cellwright.solvers.pose_tasks.dynamic_costs import worked_ways

        self.arm.dynamics.check_holds(np.array(self._cell.start), self.arm.max_effort, "the start")
        if self._end is not None:
            self.arm.dynamics.check_holds(np.array(self._end), self.arm.max_effort, "the end")
        return worked_ways(self._cell, tasks, ways, self.cost, self.arm.max_effort, self._sample)

    def along(self, route: Route) -> PlannedMotions:
        """Return the optimal motions along a route that was found by another cost.

        Raises:
            InfeasibleError: If one of them is not found.
        """
        from cellwright.errors import InfeasibleError
        from cellwright.solvers.motion_cost import PlannedMotions

        motions = PlannedMotions(self.cost, route.motions.q)
        nodes = [*route.nodes, *(route.nodes[:1] if route.closed else ())]
        for a, b in itertools.pairwise(nodes):
            if not math.isfinite(motions.evaluate(a, b)):
                raise InfeasibleError("a motion of the sequence exceeds the torque limits however slow: carry less")
        return motions
