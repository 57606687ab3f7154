"""The check of a layout on a dense time grid, made of numbers alone: it shares no expression with the solvers.

Soft endpoints can cheat by centimetres and coarse grids cut into obstacles, so nothing that a program says of itself
counts. Every transition is sampled each millisecond, every approach each 5 mm; what misses its tolerance is named.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.transforms import inverse
from cellwright.solvers.layout.approach import Followed, follow_approach, target_error
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.mesh import Mesh
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.solution import Finding, GateReport, Transition

_CHUNK_ELEMENTS = 2_000_000
"""Gaps measured at once."""


@dataclass(frozen=True)
class GateTolerances:
    """What a solution may miss and still count as converged.

    Attributes:
        path_m: Penetration along the path: what a polished path may dip between the points of its program.
        layout_m: Penetration among stations, base and walls.
        endpoint_m, endpoint_rad: Tool pose at the ends of transitions.
        approach_m, approach_rad: Tool pose along an approach.
        limit: Excess over position and design limits, rad or m.
        ratio: Excess of speed and acceleration ratios over 1.
        approach_ratio: The same along timed approaches, which the programs know by their knots only.
        step_s: Time step of the grid.
    """

    path_m: float = 1e-3
    layout_m: float = 1e-4
    endpoint_m: float = 5e-4
    endpoint_rad: float = 1e-3
    approach_m: float = 1e-4
    approach_rad: float = 1e-4
    limit: float = 1e-6
    ratio: float = 1e-5
    approach_ratio: float = 0.05
    step_s: float = 1e-3


def check_layout(
    geometry: LayoutGeometry,
    mesh: Mesh,
    design: FloatArray,
    visit_q: Sequence[FloatArray],
    transitions: Sequence[Transition],
    tolerances: GateTolerances,
) -> tuple[GateReport, tuple[FloatArray, ...]]:
    """Measure a solution; return the report and the configurations at every pose of every visit's approach.

    ``visit_q`` holds the configurations at each visit's knots.
    """
    problem = geometry.problem
    arm = problem.arm
    findings: list[Finding] = []
    followed = _followed(problem, mesh, design, visit_q)
    path_q, path_s = _path_samples(transitions, tolerances.step_s)
    names = [f"{problem.visit_name(t.start)} to {problem.visit_name(t.end)}" for t in transitions]
    segments = [(f"from {name}", -1, q) for name, q in zip(names, path_q)]
    segments += [
        (f"along the approach of {problem.visit_name(visit)}", problem.visits[visit].station, each.dense_q)
        for visit, each in enumerate(followed)
        if each is not None and len(each.dense_q) > 1
    ]
    deepest, pair, place = _deepest(geometry, design, segments)
    layout = geometry.worst_layout_gaps(design)
    layout_violation = max(-layout[0].gap_m, 0.0) if layout else 0.0
    endpoint_m, endpoint_rad, which = _endpoints(problem, design, transitions)
    approach_m = max((each.error_m for each in followed if each is not None), default=0.0)
    approach_rad = max((each.error_rad for each in followed if each is not None), default=0.0)
    everything = np.concatenate([q for _, _, q in segments] + list(visit_q))
    beyond = np.maximum(arm.lower - everything, everything - arm.upper).max(axis=0)
    outside = np.maximum(problem.lower - design, design - problem.upper)
    speed, acceleration = _rates(problem, path_q, path_s, transitions)
    speed_on_approach = _approach_speed(problem, followed)

    def missed(requirement: str, value: float, tolerance: float, unit: str) -> None:
        if not value <= tolerance:
            findings.append(Finding(requirement, value, unit))

    missed(f"{pair[0]} enters {pair[1]} {place}", deepest, tolerances.path_m, "m")
    if layout and layout_violation > tolerances.layout_m:
        findings += [
            Finding(f"{each.first} and {each.second} overlap", -each.gap_m, "m")
            for each in layout
            if each.gap_m < -tolerances.layout_m
        ]
    missed(f"{which} is not met", endpoint_m, tolerances.endpoint_m, "m")
    missed(f"the orientation at {which} is not met", endpoint_rad, tolerances.endpoint_rad, "rad")
    jump = max(
        max(np.abs(t.q[0] - visit_q[t.start][-1]).max(), np.abs(t.q[-1] - visit_q[t.end][0]).max()) for t in transitions
    )
    missed("the joints jump between approach and transition", float(jump), tolerances.limit, "")
    missed("an approach is not followed", approach_m, tolerances.approach_m + endpoint_m, "m")
    missed("the orientation along an approach is not met", approach_rad, tolerances.approach_rad + endpoint_rad, "rad")
    worst = int(np.argmax(beyond))
    missed(f"joint {arm.joint_names[worst]!r} leaves its limits", float(beyond[worst]), tolerances.limit, "")
    if problem.n_design:
        worst = int(np.argmax(outside))
        missed(f"{problem.design_names[worst]} leaves its range", float(outside[worst]), tolerances.limit, "")
    missed("a joint is too fast", speed - 1.0, tolerances.ratio, "of its speed limit")
    missed("a joint is too fast on an approach", speed_on_approach - 1.0, tolerances.approach_ratio, "of its limit")
    missed("a joint accelerates too much", acceleration - 1.0, tolerances.ratio, "of its acceleration limit")
    report = GateReport(
        deepest,
        pair,
        layout_violation,
        endpoint_m,
        endpoint_rad,
        approach_m,
        approach_rad,
        max(float(beyond.max()), 0.0),
        max(float(outside.max()), 0.0) if problem.n_design else 0.0,
        max(speed, speed_on_approach),
        acceleration,
        len(everything),
        tuple(findings),
    )
    at_poses = tuple(visit_q[visit] if each is None else each.q for visit, each in enumerate(followed))
    return report, at_poses


def _followed(
    problem: LayoutProblem, mesh: Mesh, design: FloatArray, visit_q: Sequence[FloatArray]
) -> list[Followed | None]:
    T_base_world = inverse(problem.base_pose(design))
    T_stations = problem.station_poses(design)
    found: list[Followed | None] = []
    for visit, (knots, q) in enumerate(zip(mesh.knots, visit_q)):
        approach = problem.approach_of(visit)
        if approach is None or knots is None:
            found.append(None)
            continue
        T_base_station = T_base_world @ T_stations[problem.visits[visit].station]
        found.append(follow_approach(problem.arm, problem.T_flange_tool, approach, T_base_station, knots, q))
    return found


def _path_samples(transitions: Sequence[Transition], step_s: float) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return configurations and times of every transition on the grid, all of its own points included."""
    paths, times = [], []
    for transition in transitions:
        count = max(100, math.ceil(transition.duration_s / step_s))
        grid = np.unique(np.concatenate([np.linspace(0.0, transition.duration_s, count + 1), transition.times_s]))
        paths.append(transition.at(grid))
        times.append(grid)
    return paths, times


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
    links = problem.robot_spheres.link

    def link_name(sphere: int) -> str:
        return f"the link behind {problem.arm.joint_names[links[sphere] - 1]!r}" if links[sphere] else "robot base"

    options: list[tuple[float, tuple[str, str]]] = []
    hull = geometry.hull_gaps(robot, geometry.hull_world(design))[0]
    hull[:, geometry.hull_station == own] = np.inf
    for gaps, names in (
        (hull, [problem.stations[station].name for station in geometry.hull_station]),
        (geometry.wall_gaps(robot)[0], [wall.name for wall in problem.walls]),
    ):
        if gaps.size:
            one, other = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
            options.append((float(gaps[one, other]), (link_name(int(geometry.moving_spheres[one])), names[other])))
    if len(problem.robot_spheres.self_pairs):
        gaps = geometry.self_gaps(robot)[0]
        one, other = problem.robot_spheres.self_pairs[int(np.argmin(gaps))].tolist()
        options.append((float(gaps.min()), (link_name(one), link_name(other))))
    return min(options)[1]


def _endpoints(
    problem: LayoutProblem, design: FloatArray, transitions: Sequence[Transition]
) -> tuple[float, float, str]:
    """Return the largest position (m) and turn (rad) residual at the ends of transitions, and the visit's name."""
    T_base_world, T_stations = inverse(problem.base_pose(design)), problem.station_poses(design)
    position, turn, which = 0.0, 0.0, "a visit"
    for transition in transitions:
        for visit, row, pose in ((transition.start, -1, 0), (transition.end, 0, -1)):
            approach = problem.approach_of(visit)
            q = transition.q[pose]
            if approach is None:
                away = np.array([np.abs(q - problem.home_q).max(), 0.0])
            else:
                goal = T_base_world @ T_stations[problem.visits[visit].station] @ approach.T_station_tool[row]
                error = target_error(problem.arm.flange_pose(q) @ problem.T_flange_tool, goal, approach.target)
                away = np.array([np.linalg.norm(error[:3]), np.linalg.norm(error[3:])])
            if away[0] > position:
                position, which = float(away[0]), problem.visit_name(visit)
            turn = max(turn, float(away[1]))
    return position, turn, which


def _rates(
    problem: LayoutProblem, paths: Sequence[FloatArray], times: Sequence[FloatArray], transitions: Sequence[Transition]
) -> tuple[float, float]:
    """Return the largest joint speed and acceleration over their limits, by differences on the grid."""
    arm = problem.arm
    speed = acceleration = 0.0
    for path, grid, transition in zip(paths, times, transitions):
        steps = np.diff(grid)
        keep = steps > 1e-9
        rate = np.abs(np.diff(path, axis=0))[keep] / steps[keep, None]
        speed = max(speed, float((rate / arm.max_velocity).max(initial=0.0)))
        if transition.velocity is not None:
            h = np.diff(transition.times_s)[:, None]
            change = np.abs(np.diff(transition.velocity, axis=0)) / h
            acceleration = max(acceleration, float((change / arm.max_acceleration).max()))
            # positions and velocities must tell the same story
            shift = np.diff(transition.q, axis=0) - 0.5 * h * (transition.velocity[1:] + transition.velocity[:-1])
            drift = float(np.abs(shift / h / arm.max_velocity).max())
            speed = max(speed, 1.0 + drift if drift > 1e-6 else 0.0)
    return speed, acceleration


def _approach_speed(problem: LayoutProblem, followed: Sequence[Followed | None]) -> float:
    """Return the largest joint speed over its limit along timed approaches."""
    worst = 0.0
    for each in followed:
        if each is not None and len(each.dense_q) > 1 and np.isfinite(each.dense_s).all():
            rate = np.abs(np.diff(each.dense_q, axis=0)) / each.dense_s[:, None]
            worst = max(worst, float((rate / problem.arm.max_velocity).max()))
    return worst
