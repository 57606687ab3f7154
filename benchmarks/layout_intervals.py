"""What do N and k cost and hide? Run: ``python -m benchmarks.layout_intervals [--out FOLDER]``.

N: a robot whose motion is checked at N points may step over a thin wall between two of them (Baumgaertner 2025, section
5). Each row is the penetration that the gate finds, each millisecond, in the motion of the paper's direct form and of
ours with that N. k: the cycle time and processor time among posts whose hulls have k spheres. The direct form's
iterations are limited, since past a wall it may take minutes.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.layout_problems import quadrant_posts
from cellwright.figures.layout_charts import interval_chart
from cellwright.solvers.layout.direct import DirectSettings
from cellwright.solvers.layout.examples import thin_wall_problem
from cellwright.solvers.layout.optimiser import solve_layout
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.solution import LayoutSolution
from cellwright.solvers.layout.staged import StagedSettings

INTERVALS = (10, 20, 50, 100)
SPHERES = (1, 2, 5, 10)


def told(name: str, count: str, problem: LayoutProblem, method: str, settings: object, seed: int) -> LayoutSolution:
    """Print one row and return its solution."""
    begin = time.process_time()
    found = solve_layout(problem, method, rng=np.random.default_rng(seed), settings=settings)
    cpu = time.process_time() - begin
    print(
        f"  {name:8} {count:8} penetration {1e3 * found.report.path_violation_m:6.2f} mm"
        f"  cycle {found.cycle_time_s:7.3f} s  cpu {cpu:6.2f} s"
        f"  {'passed' if found.converged else found.report.blocking}",
        flush=True,
    )
    return found


def by_intervals(iterations: int) -> list[tuple[str, int, float]]:
    """Return solver, N and penetration in m at the thin wall."""
    print("thin wall")
    problem = thin_wall_problem()
    rows = []
    for n in INTERVALS:
        direct = DirectSettings(n_segments=n, most_iterations=iterations)
        for name, method, settings in (("direct", "direct", direct), ("ours", "staged", StagedSettings(n_segments=n))):
            found = told(name, f"N = {n}", problem, method, settings, 0)
            rows.append((name, n, found.report.path_violation_m))
    return rows


def by_spheres(seeds: int) -> None:
    """Print rows for posts of k spheres; with k = 1 stations are one sphere too, and the tool 0.1 m higher."""
    print("quadrant posts")
    for k in SPHERES:
        for seed in range(seeds):
            told("ours", f"k = {k}", quadrant_posts(k), "staged", StagedSettings(), seed)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    rows = by_intervals(given.iterations)
    by_spheres(given.seeds)
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
        title = "A wall of 2 cm, a tool of 4 cm: what is checked at few points is stepped over"
        (given.out / "intervals.png").write_bytes(interval_chart(rows, title=title))
    return 0


if __name__ == "__main__":
    sys.exit(main())
