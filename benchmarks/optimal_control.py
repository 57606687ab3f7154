"""How fast and how surely are motions solved? Run ``python -m benchmarks.optimal_control [motions|posts|picture PNG]``.

``motions``: 200 random motions between configurations that the arm can hold, rest to rest, for the UR10e and the
IRB 6400, N = 20: how many are solved with a curve that keeps all limits, processor seconds cold and warm, what the
curve costs over the discrete solution and its lower bound, for the weights of Bjorkenstam 2014 and others. ``posts``:
a planar arm among posts, round by round. ``picture``: those rounds as in the paper's Fig. 2. Seconds are of one core.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.built_in_robots import built_in_arm
from cellwright.cell.scene import Scene
from cellwright.cell.symbolic_dynamics import symbolic_dynamics
from cellwright.figures.trust_regions import trust_region_stages
from cellwright.solvers.motion_steps import MovingCorners
from cellwright.solvers.optimal_control.collision_free import AvoidingMotion, avoid
from cellwright.solvers.optimal_control.cost_bounds import least_cost
from cellwright.solvers.optimal_control.program import CostWeights, MotionProgram
from cellwright.solvers.optimal_control.settled_motion import free_motion
from cellwright.solvers.optimal_control.starts import neighbouring_start
from tests.cellwright.solvers.optimal_control.planar_arm import planar_cell, planar_path, planar_program

N_MOTIONS = 200
NEIGHBOUR = 0.1
"""Standard deviation, rad, of the ends of a neighbouring motion."""
CASES = (
    ("ur10e", CostWeights(), True),
    ("ur10e", CostWeights(), False),
    ("irb6400", CostWeights(), True),
    ("irb6400", CostWeights(), False),
    ("ur10e", CostWeights(1.0, 1e-3, 0.01), True),
)


def held(program: MotionProgram, rng: np.random.Generator) -> FloatArray:
    """Return a random configuration that the arm can hold."""
    dynamics = program.dynamics
    while True:
        q = rng.uniform(dynamics.lower, dynamics.upper)
        if (np.abs(dynamics.holding_torque(q)) < 0.98 * program.max_effort).all():
            return np.asarray(q)


def near(program: MotionProgram, q: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return a configuration near ``q`` that the arm can hold."""
    dynamics = program.dynamics
    for _ in range(100):
        moved = np.clip(q + rng.normal(0.0, NEIGHBOUR, len(q)), dynamics.lower, dynamics.upper)
        if (np.abs(dynamics.holding_torque(moved)) < 0.98 * program.max_effort).all():
            return np.asarray(moved)
    return q


def motions() -> None:
    for name, weights, bound_nodes in CASES:
        own = time.process_time()
        program = MotionProgram(symbolic_dynamics(built_in_arm(name)), weights, bound_nodes=bound_nodes)
        built, rng = time.process_time() - own, np.random.default_rng(0)
        rows, optima, solved, faults = [], 0, 0, []
        for number in range(N_MOTIONS):
            q_a, q_b = held(program, rng), held(program, rng)
            own = time.process_time()
            found = free_motion(program, q_a, q_b)
            cold = time.process_time() - own
            optima, solved = optima + found.discrete.converged, solved + found.converged
            if not found.converged:
                faults.append(f"{number}: {found.fault}")
                continue
            near_a, near_b = near(program, q_a, rng), near(program, q_b, rng)
            own = time.process_time()
            start = neighbouring_start(found.discrete, near_a, near_b)
            free_motion(program, near_a, near_b, start=start)
            warm = time.process_time() - own
            least = float(least_cost(program.dynamics, weights, q_a, q_b))
            cost = found.curve.cost
            rows.append((cold, warm, cost / found.discrete.cost, found.curve.slowed, least / cost, cost))
        cold, warm, dearer, slowed, tight, cost = np.median(np.array(rows), axis=0)
        late = float(np.quantile([row[0] for row in rows], 0.95))
        print(
            f"{name:8s} c_t {weights.time:g} c_e {weights.effort:g} c_v {weights.velocity:g} "
            f"{'node speeds bounded' if bound_nodes else 'as in the paper    '}: {optima} optima, {solved} curves in "
            f"all limits of {N_MOTIONS}, "
            f"median {cold:.3f} s (95 %: {late:.3f} s), warm {warm:.3f} s, built in {built:.2f} s; curve/discrete "
            f"{dearer:.3f}, slowed {slowed:.3f}, bound/cost {tight:.2f}, cost {cost:.2f}",
            flush=True,
        )
        for fault in faults[:5]:
            print(f"    motion {fault}")


def among_posts() -> tuple[Scene, AvoidingMotion]:
    cell = planar_cell()
    scene = Scene(cell, 0.01)
    return scene, avoid(planar_program(), scene, MovingCorners.of(cell), planar_path(scene))


def posts() -> None:
    own = time.process_time()
    scene, found = among_posts()
    seconds = time.process_time() - own
    for number, stage in enumerate(found.stages, 1):
        least = min(scene.distance(q) for q in stage.motion.curve.motion.position)
        print(f"round {number}: cost {stage.motion.curve.cost:.4f}, nearest {1e3 * least:.1f} mm")
    print(f"{seconds:.2f} s of processor, path search included")


def picture(path: Path) -> None:
    scene, found = among_posts()
    shown = [0, len(found.stages) // 2, len(found.stages) - 1]
    box = np.array([-1.2, -0.2]), np.array([2.0, 2.4])
    path.write_bytes(trust_region_stages(scene, found.stages, shown, box))


def main() -> None:
    match sys.argv[1:] or ["motions"]:
        case ["motions"]:
            motions()
        case ["posts"]:
            posts()
        case ["picture", path]:
            picture(Path(path))
        case _:
            raise SystemExit(__doc__)


if __name__ == "__main__":
    main()
