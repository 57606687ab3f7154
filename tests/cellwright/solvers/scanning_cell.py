"""A UR10e with a scanner before a cylinder on a table, sweeps around it, and the plan through them; made once."""

from __future__ import annotations

from functools import cache

import numpy as np

from cellwright.cell.bodies import WORLD, Body, Box, Mesh
from cellwright.cell.built_in_robots import built_in_bodies, built_in_robot
from cellwright.cell.cell import Cell
from cellwright.cell.ignored_pairs import ignored_pairs
from cellwright.cell.inverse_kinematics import inverse_kinematics_for
from cellwright.cell.parametric_parts import revolve
from cellwright.cell.scene import Scene
from cellwright.cell.transforms import pose
from cellwright.solvers.roadmap import RoadmapSize
from cellwright.solvers.stitched_plan import StitchedPlan, StitchSettings
from cellwright.solvers.stitching import stitch
from cellwright.solvers.sweeps.alternatives import flange_targets, trace_sweep
from cellwright.solvers.sweeps.planned import ExecutablePiece, PlannedSweep
from schemas.motion import Trajectory
from schemas.plan_objects import trajectory_of
from schemas.views import ViewSelection

PART_AT = np.array([0.7, 0.0, 0.0])
RADIUS, HEIGHT, HALF_TRAVEL, STANDOFF = 0.12, 0.30, 0.06, 0.182
START = np.array([0.0, -1.8, 2.0, -1.77, -np.pi / 2, 0.0])
SETTINGS = StitchSettings(
    scan_speed=0.2, step=0.035, max_alternatives=4, roadmap=RoadmapSize(300, 150, 1200), trace_step=0.004
)
ANGLES = ((-2.6, 0.4), (-1.2, 0.5), (0.9, 0.8), (2.4, 0.3), (3.1, 1.2))


@cache
def cell_without_part() -> Cell:
    robot, links = built_in_robot("ur10e"), built_in_bodies("ur10e")
    flange = robot.chain.T_last_flange
    housing = Body("scanner", Box((0.10, 0.08, 0.09)), 6, flange @ pose(np.array([0.0, 0.0, 0.05]), np.eye(3)))
    table = Body("table", Box((1.2, 1.6, 0.04)), WORLD, pose(np.array([0.8, 0.0, -0.025]), np.eye(3)))
    T_flange_scanner = pose(np.array([0.0, 0.0, 0.10]), np.eye(3))
    bare = Cell(robot, (*links, housing, table), np.empty((0, 2), np.int32), np.eye(4), T_flange_scanner, START)
    ignored = ignored_pairs(bare, range(len(links)), np.random.default_rng(0), n_samples=300)
    return Cell(robot, bare.bodies, ignored.pairs, bare.T_world_base, T_flange_scanner, START)


@cache
def part() -> Mesh:
    return revolve(np.array([[RADIUS, 0.0], [RADIUS, HEIGHT]]), 24)


def cell(position=PART_AT) -> Cell:
    return cell_without_part().with_part(part(), pose(np.asarray(position, float), np.eye(3)))


def sweep_pose(angle: float, tilt: float):
    """The scanner looks at the cylinder's side from ``angle`` about its axis, ``tilt`` above the horizontal."""
    side, up = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, 1.0])
    z = -(np.cos(tilt) * side + np.sin(tilt) * up)
    x = np.cross(up, side)
    looked_at = PART_AT + RADIUS * side + 0.7 * HEIGHT * up
    return pose(looked_at - STANDOFF * z, np.stack([x, np.cross(z, x), z], 1))


@cache
def sweeps(n: int = len(ANGLES)) -> tuple[PlannedSweep, ...]:
    built = cell()
    scene, solver = Scene(built, 0.005), inverse_kinematics_for(built.robot.chain)
    interval = (-HALF_TRAVEL, HALF_TRAVEL)
    found = []
    for number, (angle, tilt) in enumerate(ANGLES[:n]):
        T = sweep_pose(angle, tilt)
        pieces = []
        for branch, q in enumerate(solver.solve(flange_targets(built, T, np.array([-HALF_TRAVEL])))[0]):
            if np.isfinite(q).all():
                path = trace_sweep(built, T, q, branch, -HALF_TRAVEL, interval, 0.004)
                if path is not None and not scene.collide_all(path.position).any():
                    pieces.append(ExecutablePiece(branch, *interval, q))
        found.append(PlannedSweep(f"view {number}", T, interval, tuple(pieces)))
    return tuple(found)


@cache
def plan() -> StitchedPlan:
    built = cell()
    return stitch(built, Scene(built, 0.005), sweeps(), settings=SETTINGS, method="best", rng=np.random.default_rng(0))


def selection(n: int = len(ANGLES)) -> ViewSelection:
    """The sweeps as views 0, 1, 2, ... in order."""
    return ViewSelection(
        view=np.arange(n, dtype=np.int32),
        n_samples=np.ones(n, np.int32),
        n_only=np.ones(n, np.int32),
        max_uncertainty_m=np.full(n, 5e-5),
        cause=np.zeros(0, np.int8),
        greedy_view=np.arange(n, dtype=np.int32),
        method="greedy",
        lower_bound=float(n),
        gap=0.0,
        proven=True,
        stopped_by="optimality",
    )


@cache
def trajectory() -> Trajectory:
    return trajectory_of(plan(), selection())
