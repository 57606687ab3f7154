"""What a layout and its motions measure on a dense time grid: numbers alone, with the name of what is worst.

Transitions are sampled in time, approaches every 5 mm and closer where the arm turns fast; speeds and accelerations of
transitions are exact. Nothing here is judged: that is the gate's work.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.transforms import inverse
from cellwright.solvers.layout.approach import Followed, follow_approach, target_error
from cellwright.solvers.layout.bodies import ROBOT_BASE, link_name
from cellwright.solvers.layout.geometry import LayoutGap, LayoutGeometry
from cellwright.solvers.layout.mesh import Mesh
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.solution import Transition

_CHUNK_ELEMENTS = 2_000_000
"""Gaps measured at once."""
_DRIFT = 1e-6
"""Difference, in speed limits, between velocities and what positions say that still counts as none."""


@dataclass(frozen=True)
class Worst:
    """The largest value of a kind, the name of what has it, and its unit."""

    value: float = 0.0
    name: str = ""
    unit: str = ""

    def or_of(self, value: float, name: str, unit: str = "") -> Worst:
        """Return the larger one of this and another, this one where they are equal; what is no number is largest."""
        return self if value <= self.value or math.isnan(self.value) else Worst(float(value), name, unit)


@dataclass(frozen=True)
class LayoutMeasures:
    """What a layout and its motions measure, each with the name of what is worst.

    Attributes:
        path, pair: Deepest penetration of the robot in m and where it is; what touches there.
        gaps: Between bodies of the layout, smallest first.
        position, turn: Residuals at the ends of transitions, m and rad.
        approach_position, approach_turn: The same along approaches.
        jump: Largest step along an approach, rad or m.
        seam: Largest step between an approach and the transition beside it, rad or m.
        joint, design: Largest excess over position limits and ranges; negative inside.
        speed, acceleration: Over their limits, on transitions.
        approach_speed, approach_acceleration: The same on timed approaches.
        rest: Speed over its limit where the arm has to stand still.
        handover: Time in s to take up the speed of a timed approach.
        n_samples: Configurations that were checked.
    """

    path: Worst
    pair: tuple[str, str]
    gaps: tuple[LayoutGap, ...]
    position: Worst
    turn: Worst
    approach_position: Worst
    approach_turn: Worst
    jump: Worst
    seam: Worst
    joint: Worst
    design: Worst
    speed: Worst
    acceleration: Worst
    approach_speed: Worst
    approach_acceleration: Worst
    rest: Worst
    handover: Worst
    n_samples: int


def measure_layout(
    geometry: LayoutGeometry,
    design: FloatArray,
    visit_q: Sequence[FloatArray],
    followed: Sequence[Followed | None],
    transitions: Sequence[Transition],
    *,
    step_s: float,
    blend_s: float,
) -> LayoutMeasures:
    """Return what a solution measures.

    Args:
        geometry: Of the problem.
        design: Design joints, (n_design,).
        visit_q: Configurations at each visit's knots.
        followed: The same approaches pose by pose; none at home.
        transitions: One motion a pair of `LayoutProblem.transitions`.
        step_s: Time step of the grid on which transitions are sampled.
        blend_s: Time over which steps in speed along timed approaches are spread.
    """
    problem = geometry.problem
    segments = [
        (f"from {problem.visit_name(each.start)} to {problem.visit_name(each.end)}", -1, _path(each, step_s))
        for each in transitions
    ]
    segments += [
        (f"along the approach of {problem.visit_name(visit)}", problem.visits[visit].station, each.dense_q)
        for visit, each in enumerate(followed)
        if each is not None and len(each.dense_q) > 1
    ]
    deepest, pair, place = _deepest(geometry, design, segments)
    everything = np.concatenate([q for _, _, q in segments] + list(visit_q))
    position, turn = _endpoints(problem, design, transitions)
    approach_position, approach_turn, jump = _along_approaches(problem, followed)
    speed, acceleration = _rates(problem, transitions)
    approach_speed, approach_acceleration = _approach_rates(problem, followed, blend_s)
    rest, handover = _end_speeds(problem, followed, transitions)
    accelerated = all(each.velocity is not None for each in transitions)
    return LayoutMeasures(
        Worst(deepest, place),
        pair,
        tuple(geometry.worst_layout_gaps(design)),
        position,
        turn,
        approach_position,
        approach_turn,
        jump,
        _seam(problem, visit_q, transitions),
        _beyond_limits(problem, everything),
        beyond_range(problem, design),
        speed,
        acceleration,
        approach_speed,
        approach_acceleration if accelerated else Worst(),
        rest,
        handover,
        len(everything),
    )


def followed_approaches(
    problem: LayoutProblem, mesh: Mesh, design: FloatArray, visit_q: Sequence[FloatArray], *, smooth: bool = False
) -> list[Followed | None]:
    """Return each visit's approach, followed pose by pose through its knots ``visit_q``; None at home.

    ``smooth`` is for motions with acceleration limits: see `follow_approach`.
    """
    T_base_world = inverse(problem.base_pose(design))
    T_stations = problem.station_poses(design)
    found: list[Followed | None] = []
    for visit, (knots, q) in enumerate(zip(mesh.knots, visit_q)):
        approach = problem.approach_of(visit)
        if approach is None or knots is None:
            found.append(None)
            continue
        T_base_station = T_base_world @ T_stations[problem.visits[visit].station]
        found.append(
            follow_approach(problem.arm, problem.T_flange_tool, approach, T_base_station, knots, q, smooth=smooth)
        )
    return found


def _path(transition: Transition, step_s: float) -> FloatArray:
    """Return the configurations of a transition on the grid, all of its own points included."""
    count = max(100, math.ceil(transition.duration_s / step_s))
    grid = np.concatenate([np.linspace(0.0, transition.duration_s, count + 1), transition.times_s])
    return transition.at(np.unique(grid))


def _deepest(
    geometry: LayoutGeometry, design: FloatArray, segments: Sequence[tuple[str, int, FloatArray]]
) -> tuple[float, tuple[str, str], str]:
    """Return the deepest penetration in m, the names of what touches, and where along the cycle."""
    problem = geometry.problem
    nothing = (0.0, ("nothing", "nothing"), "")
    if not len(problem.robot_spheres):
        return nothing
    n_others = len(geometry.hull_radii) + len(problem.walls)
    per_row = max(1, len(geometry.moving_spheres) * n_others + len(problem.robot_spheres.self_pairs))
    chunk = max(1, _CHUNK_ELEMENTS // per_row)
    best, where = 0.0, None
    for place, own, q in segments:
        for begin in range(0, len(q), chunk):
            rows = q[begin : begin + chunk]
            gaps = geometry.motion_gap(design, rows, own)
            row = int(np.argmin(gaps))
            if -gaps[row] > best:
                best, where = -float(gaps[row]), (place, own, rows[row])
    if where is None:
        return nothing
    place, own, row_q = where
    return best, touching_bodies(geometry, design, row_q, own), place


def touching_bodies(geometry: LayoutGeometry, design: FloatArray, q: FloatArray, own: int) -> tuple[str, str]:
    """Return the names of the two bodies with the smallest gap at a configuration (joints,)."""
    problem = geometry.problem
    robot = geometry.robot_world(problem.base_pose(design), q[None])
    bodies = robot_bodies(problem)
    options: list[tuple[float, tuple[str, str]]] = []
    hull = geometry.hull_gaps(robot, geometry.hull_world(design))[0]
    hull[:, geometry.hull_station == own] = np.inf
    for gaps, names in (
        (hull, [problem.stations[station].name for station in geometry.hull_station]),
        (geometry.wall_gaps(robot)[0], [wall.name for wall in problem.walls]),
    ):
        if gaps.size:
            one, other = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
            options.append((float(gaps[one, other]), (bodies[geometry.moving_spheres[one]], names[other])))
    if len(problem.robot_spheres.self_pairs):
        gaps = geometry.self_gaps(robot)[0]
        one, other = problem.robot_spheres.self_pairs[int(np.argmin(gaps))].tolist()
        options.append((float(gaps.min()), (bodies[one], bodies[other])))
    return min(options)[1]


def robot_bodies(problem: LayoutProblem) -> list[str]:
    """Return what each sphere of the robot stands for: its base, a URDF link, or the tool."""
    arm, spheres = problem.arm, problem.robot_spheres
    if spheres.body:
        return list(spheres.body)
    path = arm.tree.path(arm.base_link, arm.flange_link)
    behind = {joint.name: joint.child for joint in path}
    return [link_name(behind[arm.joint_names[link - 1]]) if link else ROBOT_BASE for link in spheres.link.tolist()]


def _endpoints(problem: LayoutProblem, design: FloatArray, transitions: Sequence[Transition]) -> tuple[Worst, Worst]:
    """Return the largest residuals of position (m) and orientation (rad) at the ends of transitions, by visit.

    At home the joints count: those that slide as positions, those that turn as orientations.
    """
    T_base_world, T_stations = inverse(problem.base_pose(design)), problem.station_poses(design)
    revolute = problem.arm.revolute
    position, turn = Worst(name="a visit"), Worst(name="a visit")
    for transition in transitions:
        for visit, row, pose in ((transition.start, -1, 0), (transition.end, 0, -1)):
            approach, q, name = problem.approach_of(visit), transition.q[pose], problem.visit_name(visit)
            if approach is None:
                away = np.abs(q - problem.home_q)
                missed, turned = away[~revolute].max(initial=0.0), away[revolute].max(initial=0.0)
            else:
                goal = T_base_world @ T_stations[problem.visits[visit].station] @ approach.T_station_tool[row]
                error = target_error(problem.arm.flange_pose(q) @ problem.T_flange_tool, goal, approach.target)
                missed, turned = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
            position, turn = position.or_of(missed, name), turn.or_of(turned, name)
    return position, turn


def _along_approaches(problem: LayoutProblem, followed: Sequence[Followed | None]) -> tuple[Worst, Worst, Worst]:
    """Return the largest residuals in m and rad along approaches, and the largest step between neighbours."""
    position, turn, jump = Worst(name="a visit"), Worst(name="a visit"), Worst(name="a visit")
    for visit, each in enumerate(followed):
        if each is not None:
            name = problem.visit_name(visit)
            position, turn = position.or_of(each.error_m, name), turn.or_of(each.error_rad, name)
            steps = np.abs(np.diff(each.dense_q, axis=0)).max(axis=0, initial=0.0)
            jump = jump.or_of(steps.max(), name, _unit(problem.arm.revolute[np.argmax(steps)]))
    return position, turn, jump


def _unit(revolute: bool) -> str:
    return "rad" if revolute else "m"


def _seam(problem: LayoutProblem, visit_q: Sequence[FloatArray], transitions: Sequence[Transition]) -> Worst:
    worst = Worst(name="a visit")
    for each in transitions:
        for visit, q, knot in ((each.start, each.q[0], -1), (each.end, each.q[-1], 0)):
            step = np.abs(q - visit_q[visit][knot])
            joint = int(np.argmax(step))
            worst = worst.or_of(step[joint], problem.visit_name(visit), _unit(problem.arm.revolute[joint]))
    return worst


def _beyond_limits(problem: LayoutProblem, q: FloatArray) -> Worst:
    """Return the largest excess of configurations (n, joints) over a joint's limits; negative inside."""
    arm = problem.arm
    beyond = np.maximum(arm.lower - q, q - arm.upper).max(axis=0)
    joint = int(np.argmax(beyond))
    return Worst(float(beyond[joint]), f"joint {arm.joint_names[joint]!r}", _unit(arm.revolute[joint]))


def beyond_range(problem: LayoutProblem, design: FloatArray) -> Worst:
    """Return the largest excess of a design (n_design,) over a harness range; negative inside, 0 without joints."""
    if not problem.n_design:
        return Worst()
    outside = np.maximum(problem.lower - design, design - problem.upper)
    row = int(np.argmax(outside))
    turns = np.concatenate([harness.revolute for harness in problem.harnesses])
    return Worst(float(outside[row]), problem.design_names[row], _unit(turns[row]))


def _rates(problem: LayoutProblem, transitions: Sequence[Transition]) -> tuple[Worst, Worst]:
    """Return the largest joint speed and acceleration over their limits.

    Both are exact, since a motion has one speed, or one acceleration, between each two of its points.
    """
    arm = problem.arm
    speed, acceleration = Worst(), Worst()
    for each in transitions:
        h = np.diff(each.times_s)[:, None]
        rate = np.diff(each.q, axis=0) / h
        if each.velocity is None:
            speed = _worst_joint(speed, problem, rate / arm.max_velocity)
            continue
        speed = _worst_joint(speed, problem, each.velocity / arm.max_velocity)
        acceleration = _worst_joint(acceleration, problem, np.diff(each.velocity, axis=0) / h / arm.max_acceleration)
        # positions and velocities must tell the same story: what is missing between them comes on top
        drift = np.abs(rate - 0.5 * (each.velocity[1:] + each.velocity[:-1])) / arm.max_velocity
        if not drift.max() <= _DRIFT:
            speed = _worst_joint(speed, problem, 1.0 + drift)
    return speed, acceleration


def _worst_joint(worst: Worst, problem: LayoutProblem, ratio: FloatArray) -> Worst:
    most = np.abs(ratio).max(axis=0)
    joint = int(np.argmax(most))
    return worst.or_of(most[joint], f"joint {problem.arm.joint_names[joint]!r}")


def _approach_rates(problem: LayoutProblem, followed: Sequence[Followed | None], blend_s: float) -> tuple[Worst, Worst]:
    """Return the largest joint speed and acceleration over their limits along timed approaches, by visit.

    Accelerations are changes of the mean speed from before a sample to after it, each over ``blend_s`` or, where
    samples lie farther apart, over the time between them.
    """
    arm = problem.arm
    speed, acceleration = Worst(name="a visit"), Worst(name="a visit")
    for visit, each in enumerate(followed):
        if each is None or not each.timed:
            continue
        name, times = problem.visit_name(visit), np.concatenate([[0.0], np.cumsum(each.dense_s)])
        rate = np.abs(np.diff(each.dense_q, axis=0)) / each.dense_s[:, None]
        speed = speed.or_of((rate / arm.max_velocity).max(), name)
        inner = times[1:-1]
        if not len(inner):
            continue
        apart = np.maximum(np.maximum(each.dense_s[:-1], each.dense_s[1:]), blend_s)
        h = np.minimum(apart, np.minimum(inner, times[-1] - inner))
        before, now, after = (_at(t, times, each.dense_q) for t in (inner - h, inner, inner + h))
        change = np.abs(after - 2.0 * now + before) / (h * apart)[:, None]
        acceleration = acceleration.or_of((change / arm.max_acceleration).max(), name)
    return speed, acceleration


def _at(t: FloatArray, times: FloatArray, q: FloatArray) -> FloatArray:
    return np.stack([np.interp(t, times, column) for column in q.T], axis=1)


def _end_speeds(
    problem: LayoutProblem, followed: Sequence[Followed | None], transitions: Sequence[Transition]
) -> tuple[Worst, Worst]:
    """Return speeds over their limits where transitions have to begin and end at rest, and handover times in s.

    Beside a timed approach a transition has the speed of the approach's end; a handover lasts as long as the slowest
    joint needs, at its acceleration limit, for the difference.
    """
    arm = problem.arm
    rest, handover = Worst(name="a visit"), Worst(name="a visit")
    for each in transitions:
        if each.velocity is None:
            continue
        for visit, velocity, piece in ((each.start, each.velocity[0], -1), (each.end, each.velocity[-1], 0)):
            beside, name = followed[visit], problem.visit_name(visit)
            if beside is None or not beside.timed:
                rest = rest.or_of((np.abs(velocity) / arm.max_velocity).max(), name)
                continue
            row = len(beside.dense_q) - 2 if piece else 0
            pace = (beside.dense_q[row + 1] - beside.dense_q[row]) / beside.dense_s[row]
            handover = handover.or_of((np.abs(velocity - pace) / arm.max_acceleration).max(), name)
    return rest, handover
