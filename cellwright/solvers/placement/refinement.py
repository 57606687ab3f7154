"""Shorten the cycle of a placement by following its gradient: placement and configurations together, between hulls.

The integrated form of Baumgaertner 2025 on the plan that a trial has stitched. Its sweeps are approaches of the
workpiece, in the plan's order, directions and branches; design joints and configurations form the program of
`cellwright.solvers.layout.nlp` with acceleration limits, whose transitions are trapezoids of speed. What moves (the
workpiece with what it carries, or the robot's base) keeps clear of what stands by their certified hulls of spheres,
and so does the arm, at the poses of the sweeps, of everything but the workpiece: scanners look at it from nearer than
the hulls of few spheres stick out.

A local minimum, and the straight motions between sweeps may be blocked: what comes out is a proposal, to be judged and
tried like any other. Cost: tenths of a second.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.bodies import WORLD
from cellwright.cell.cell import Cell
from cellwright.cell.harness import Harness, fixed
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.transforms import apply, inverse
from cellwright.solvers.layout.bodies import RobotSpheres, Spheres
from cellwright.solvers.layout.checks import all_layout_checks
from cellwright.solvers.layout.geometry import LayoutGeometry
from cellwright.solvers.layout.mesh import build_mesh
from cellwright.solvers.layout.nlp import LayoutPoint
from cellwright.solvers.layout.problem import HOME, Approach, LayoutProblem, Station, Visit
from cellwright.solvers.layout.rounds import solve_lazily
from cellwright.solvers.layout.second_order import least_times
from cellwright.solvers.layout.symbols import LayoutSymbols
from cellwright.solvers.placement.problem import PlacementProblem

MOVED = "what moves"
"""Name of the station that the sweeps belong to."""
N_POSES = 5
"""Poses of a sweep: its ends, and between them so that no branch is lost."""
SOLVED = 1e-6
"""Violation of a program's constraints that is rounding."""


@dataclass(frozen=True, eq=False)
class ExecutedSweep:
    """A sweep as a plan executes it.

    Attributes:
        name: What to call it.
        q: Configurations at evenly spaced travels, in the direction of execution, (`N_POSES`, joints).
    """

    name: str
    q: FloatArray


@dataclass(frozen=True)
class RefinementSettings:
    """How much work a refinement is.

    Attributes:
        most_rounds: Programs, each with the checks that the one before it violates.
        most_iterations: Ipopt iterations a program.
    """

    most_rounds: int = 4
    most_iterations: int = 100


@dataclass(frozen=True, eq=False)
class Refinement:
    """What following the gradient came to.

    Attributes:
        values: Design joints, (joints,).
        connections: Time of the straight motions between the sweeps before and after, s.
        iterations: Of Ipopt.
        bodies: Names of the standing bodies whose hulls were kept clear of.
    """

    values: FloatArray
    connections: tuple[float, float]
    iterations: int
    bodies: tuple[str, ...]


def refine_design(
    problem: PlacementProblem,
    hulls: Mapping[str, Spheres],
    plan: tuple[ExecutedSweep, ...],
    values: FloatArray,
    settings: RefinementSettings | None = None,
    *,
    trust: float = 1.0,
) -> Refinement | None:
    """Return a design near ``values`` (joints,) whose straight motions take less time, or ``None`` if none was found.

    Args:
        problem: What may move.
        hulls: Certified spheres of bodies by name, each in its body's frame; bodies without stay out of sight.
        plan: The sweeps at ``values``, in order.
        values: Where the gradient is followed from.
        settings: How much work it is.
        trust: Share of its range by which a design joint may change.
    """
    layout = layout_problem(problem, hulls, plan, values, trust)
    symbols, mesh = LayoutSymbols(layout), build_mesh(layout, 1)
    sweeps = iter(plan)
    q = np.empty((mesh.n_configs, layout.arm.n_joints))
    for rows, knots in zip(mesh.visit_rows, mesh.knots):
        if knots is None:
            q[rows] = problem.cell.start
            continue
        known = next(sweeps).q
        q[rows] = np.stack([np.interp(knots.place, np.arange(len(known)), column) for column in known.T], axis=1)
    away = np.array([q[rows[-1]] - q[rows[0]] for rows in mesh.transition_rows])
    times = least_times(away, layout.arm.max_velocity, layout.arm.max_acceleration).max(axis=1)
    stage = solve_lazily(
        symbols,
        mesh,
        LayoutPoint(np.asarray(values, float), q, times + 1e-3, np.zeros_like(q)),
        all_layout_checks(symbols.geometry),
        settings or RefinementSettings(),
        name="placement",
        transitions=False,
        order=2,
    )
    before, after = float(times.sum()), stage.time_s
    if stage.result.violation > SOLVED or after >= before:
        return None
    at = np.clip(stage.result.point.design, problem.harness.lower, problem.harness.upper)
    bodies = tuple(station.name for station in layout.stations[1:])
    return Refinement(at, (before, after), sum(phase.iterations for phase in stage.phases), bodies)


def layout_problem(
    problem: PlacementProblem,
    hulls: Mapping[str, Spheres],
    plan: tuple[ExecutedSweep, ...],
    values: FloatArray,
    trust: float = 1.0,
) -> LayoutProblem:
    """Return the layout problem of a plan at a design: one station with all sweeps, and what stands about it.

    Bodies whose hulls touch what moves at ``values`` already, as a floor or a table do, are left to exact tests: hulls
    are larger than bodies, and no motion would take them apart.
    """
    cell = problem.moved_cell(values)
    arm, T_world_part = SerialArm.from_robot(cell.robot), cell.bodies[-1].T_parent_body
    T_part_base = inverse(T_world_part) @ cell.T_world_base
    approaches = tuple(
        Approach(T_part_base @ arm.flange_pose(sweep.q) @ cell.T_flange_scanner, name=sweep.name) for sweep in plan
    )
    carried = [row for row, body in enumerate(cell.bodies) if body.parent == WORLD and _goes_along(problem, row)]
    base, part = fixed(cell.T_world_base), fixed(T_world_part)
    harness = _trusted(problem.harness, np.asarray(values, float), trust)
    if problem.moves_base:
        base = replace(harness, T_last_carried=harness.T_last_carried @ problem.cell.T_world_base)
    else:
        part = replace(harness, T_last_carried=harness.T_last_carried @ problem.cell.bodies[-1].T_parent_body)
    standing = tuple(
        Station(body.name, fixed(body.T_parent_body), hulls[body.name])
        for row, body in enumerate(cell.bodies)
        if body.parent == WORLD and row not in carried and body.name in hulls
    )
    visits = (HOME, *(Visit(0, number) for number in range(len(approaches))))
    whole = LayoutProblem(
        arm,
        (Station(MOVED, part, _joined(cell, carried, hulls), approaches), *standing),
        visits=visits,
        cyclic=problem.returns,
        base=base,
        T_flange_tool=cell.T_flange_scanner,
        robot_spheres=_robot_spheres(problem, hulls),
        home_q=np.clip(cell.start, arm.lower, arm.upper),
    )
    touching = {
        name
        for gap in LayoutGeometry(whole).worst_layout_gaps(np.asarray(values, float))
        if gap.gap_m < 0.0
        for name in (gap.first, gap.second)
    }
    return replace(whole, stations=(whole.stations[0], *(each for each in standing if each.name not in touching)))


def _trusted(harness: Harness, values: FloatArray, trust: float) -> Harness:
    """Return the harness with ranges of the share ``trust`` about a design."""
    joints = [
        replace(
            joint,
            lower=max(joint.lower, at - trust * (joint.upper - joint.lower)),
            upper=min(joint.upper, at + trust * (joint.upper - joint.lower)),
        )
        for joint, at in zip(harness.joints, values.tolist())
    ]
    return replace(harness, joints=tuple(joints))


def _joined(cell: Cell, rows: Sequence[int], hulls: Mapping[str, Spheres]) -> Spheres:
    """Return the hulls of standing bodies in the frame of the part."""
    T_part_world = inverse(cell.bodies[-1].T_parent_body)
    bodies = [cell.bodies[row] for row in rows if cell.bodies[row].name in hulls]
    centres = [apply(T_part_world @ body.T_parent_body, hulls[body.name].centres) for body in bodies]
    radii = [hulls[body.name].radii for body in bodies]
    return Spheres(np.concatenate([np.zeros((0, 3)), *centres]), np.concatenate([np.zeros(0), *radii]))


def _goes_along(problem: PlacementProblem, row: int) -> bool:
    """Whether a standing body of the world is fixed to the part in every design."""
    return problem.is_part(row) or (not problem.moves_base and problem.is_shifted(row))


def _robot_spheres(problem: PlacementProblem, hulls: Mapping[str, Spheres]) -> RobotSpheres:
    links, centres, radii = [np.zeros(0, np.int64)], [np.zeros((0, 3))], [np.zeros(0)]
    for body in problem.cell.bodies:
        if body.parent != WORLD and body.name in hulls:
            hull = hulls[body.name]
            links.append(np.full(len(hull), body.parent))
            centres.append(apply(body.T_parent_body, hull.centres))
            radii.append(hull.radii)
    return RobotSpheres(np.concatenate(links), np.concatenate(centres), np.concatenate(radii))


def proven_gaps(
    problem: PlacementProblem, hulls: Mapping[str, Spheres], values: FloatArray
) -> dict[tuple[str, str], float]:
    """Return how far what moves certainly keeps from the other standing bodies and from the robot's base, in m.

    By pairs of names, what moves first. Above zero the two bodies are apart by at least that; below, nothing is proven.
    """
    cell = problem.moved_cell(values)
    placed: dict[int, tuple[FloatArray, FloatArray]] = {}
    for row, body in enumerate(cell.bodies):
        if body.parent <= 0 and body.name in hulls:
            T = body.T_parent_body if body.parent == WORLD else cell.T_world_base @ body.T_parent_body
            placed[row] = apply(T, hulls[body.name].centres), hulls[body.name].radii

    def moves(row: int) -> bool:
        return cell.bodies[row].parent == 0 if problem.moves_base else problem.is_shifted(row)

    found = {}
    for one in filter(moves, placed):
        for other in placed:
            if not moves(other):
                (a, r), (b, s) = placed[one], placed[other]
                gap = (np.linalg.norm(a[:, None] - b, axis=-1) - r[:, None] - s).min()
                found[cell.bodies[one].name, cell.bodies[other].name] = float(gap)
    return found
