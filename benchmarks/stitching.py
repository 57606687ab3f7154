"""How long do ordering, connecting, timing and verifying take? Run: ``python -m benchmarks.stitching [sweeps]``.

A UR10e before a cylinder among posts, sweeps from random directions around it with every branch that is free. Times are
processor seconds after one warm-up run, which pays for imports and compilation. Shares of one run say where time
goes; the collision checks are timed apart as the bare kernel that the rest is compared with.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from cellwright.cell.bodies import WORLD, Body, Cylinder
from cellwright.cell.cell import Cell
from cellwright.cell.inverse_kinematics import inverse_kinematics_for
from cellwright.cell.motion_filter import FilteredScene
from cellwright.cell.scene import Scene
from cellwright.cell.transforms import pose
from cellwright.cell.verification_scene import VerificationScene
from cellwright.solvers.plan_verification import Tolerances, check_collisions
from cellwright.solvers.stitched_plan import StitchedPlan, StitchSettings
from cellwright.solvers.stitching import stitch
from cellwright.solvers.sweeps.access import NamingChecker
from cellwright.solvers.sweeps.alternatives import flange_targets, trace_sweep
from cellwright.solvers.sweeps.order_kernels import held_karp
from cellwright.solvers.sweeps.planned import ExecutablePiece, PlannedSweep
from schemas.plan_objects import timed_plan, trajectory_of
from tests.cellwright.solvers import scanning_cell

HALF_TRAVEL = 0.08


class CountingScene(Scene):
    """A scene that counts the configurations that it is asked about."""

    n_checked = 0

    def _first_colliding(self, q: Any) -> int:
        self.n_checked += 1
        return super()._first_colliding(q)


def cluttered_cell() -> Cell:
    """Return the cell with posts between the sweeps, so that few of them are connected by straight motions."""
    cell = scanning_cell.cell()
    posts = []
    for number, angle in enumerate((-2.5, -1.5, -0.5, 0.5, 1.5, 2.5)):
        at = scanning_cell.PART_AT + np.array([0.33 * np.cos(angle), 0.33 * np.sin(angle), 0.3])
        posts.append(Body(f"post {number}", Cylinder(0.015, 0.6), WORLD, pose(at, np.eye(3))))
    return dataclasses.replace(cell, bodies=(*cell.bodies, *posts))


def random_sweeps(cell: Cell, n: int, seed: int) -> list[PlannedSweep]:
    """Return sweeps around the part that have at least one free branch."""
    rng = np.random.default_rng(seed)
    scene, solver = Scene(cell, 0.005), inverse_kinematics_for(cell.robot.chain)
    interval = (-HALF_TRAVEL, HALF_TRAVEL)
    found: list[PlannedSweep] = []
    while len(found) < n:
        T = scanning_cell.sweep_pose(rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 1.3))
        pieces = []
        for branch, q in enumerate(solver.solve(flange_targets(cell, T, np.array([-HALF_TRAVEL])))[0]):
            if np.isfinite(q).all():
                path = trace_sweep(cell, T, q, branch, -HALF_TRAVEL, interval, 0.004)
                if path is not None and not scene.collide_all(path.position).any():
                    pieces.append(ExecutablePiece(branch, *interval, q))
        if pieces:
            found.append(PlannedSweep(f"view {len(found)}", T, interval, tuple(pieces)))
    return found


def timed(what: Callable[[], Any]) -> tuple[float, Any]:
    """Return processor seconds and result."""
    start = time.process_time()
    result = what()
    return time.process_time() - start, result


def main(n_sweeps: int) -> None:
    cell, settings = cluttered_cell(), StitchSettings(step=0.035)
    sweeps = random_sweeps(cell, n_sweeps, 1)
    scene = CountingScene(cell, 0.005)

    def plan(checker: NamingChecker = scene) -> StitchedPlan:
        return stitch(cell, checker, sweeps, settings=settings, method="best", rng=np.random.default_rng(0))

    plan(FilteredScene(scene))
    plan()
    scene.n_checked = 0
    t_stitch, stitched = timed(plan)
    n_checked = scene.n_checked
    configurations = np.concatenate([s.motion.position[:, :6] for s in stitched.segments])
    t_check = timed(lambda: scene.collide_all(configurations))[0] / len(configurations)
    filtered = FilteredScene(scene)
    t_filtered, fast = timed(lambda: plan(filtered))
    n_roadmap = sum(segment.via == "roadmap" for segment in stitched.segments)
    print(f"{n_sweeps} sweeps, {sum(len(sweep.pieces) for sweep in sweeps)} branches")
    print(f"durations {stitched.durations}, connections by roadmap {n_roadmap} of {n_sweeps}")
    print(f"stitch           {t_stitch:7.2f} s, {n_checked} collision checks of {t_check * 1e6:.0f} us")
    same = fast.durations == stitched.durations
    print(f"  filtered       {t_filtered:7.2f} s, {t_filtered / t_stitch:.2f} of asking the engine; same plan {same}")
    print(f"  its checks     {n_checked * t_check:7.2f} s, ratio to them {t_stitch / (n_checked * t_check):.1f}")
    if n_sweeps <= settings.exact_up_to:
        m = 2 * settings.max_alternatives * n_sweeps
        first = np.arange(0, m + 1, 2 * settings.max_alternatives, dtype=np.int32)
        cost = np.random.default_rng(0).uniform(0.3, 3.0, (m + 1, m + 1))
        held_karp(cost, np.ones(m), first, np.inf)
        t_order, _ = timed(lambda: held_karp(cost, np.ones(m), first, np.inf))
        print(f"  one ordering   {t_order:7.2f} s for {m} options")
    selection = scanning_cell.selection(n_sweeps)
    timed_states = timed_plan(trajectory_of(stitched, selection), selection)
    engine = VerificationScene(cell)
    t_verify, proof = timed(lambda: check_collisions(timed_states, cell, engine, Tolerances()))
    each = t_verify / proof.n_states * 1e6
    print(f"verify           {t_verify:7.2f} s, {proof.n_states} states, {each:.0f} us each")
    print(f"  passed {all(check.passed for check in proof.checks)}, {proof.clearance}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 15)
