"""How good and how fast are the integrated layout solvers? Run: ``python -m benchmarks.layout [--starts N]``.

Each start is a random layout without overlap and its own seed. Times are processor seconds of this process, which
includes everything a solve needs but the imports. The bars are those of the issue: the staged solver against the
paper's direct form on four stations, the cluttered cell with posts, and acceleration limits warm from the staged one.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.layout_problems import four_stations, quadrant_posts
from cellwright.solvers.layout.direct import DirectSettings, solve_direct
from cellwright.solvers.layout.problem import LayoutProblem
from cellwright.solvers.layout.rounds import Stage
from cellwright.solvers.layout.second_order import SecondOrderSettings, continue_second_order
from cellwright.solvers.layout.solution import LayoutSolution
from cellwright.solvers.layout.staged import StagedSettings, solve_staged, staged_outcome
from cellwright.solvers.layout.start import sample_design
from cellwright.solvers.layout.symbols import LayoutSymbols

Run = tuple[float, LayoutSolution]


def timed(solve: Callable[[], LayoutSolution]) -> Run:
    """Return processor seconds and solution."""
    begin = time.process_time()
    solution = solve()
    return time.process_time() - begin, solution


def staged(problem: LayoutProblem, seed: int) -> LayoutSolution:
    rng = np.random.default_rng(seed)
    return solve_staged(LayoutSymbols(problem), sample_design(problem, rng), rng, StagedSettings())


def direct(problem: LayoutProblem, seed: int) -> LayoutSolution:
    rng = np.random.default_rng(seed)
    return solve_direct(LayoutSymbols(problem), sample_design(problem, rng), rng, DirectSettings())


def told(name: str, runs: list[Run], bar: str, met: bool) -> bool:
    """Print one line; return whether the bar is met."""
    converged = [solution for _, solution in runs if solution.converged]
    cpu = np.array([seconds for seconds, _ in runs])
    cycles = [solution.cycle_time_s for solution in converged] or [np.nan]
    print(
        f"{name:34} {len(converged):3}/{len(runs)} converged  cpu median {np.median(cpu):6.2f} max {cpu.max():6.2f} s"
        f"  cycle median {np.median(cycles):.3f} best {min(cycles):.3f} s  [{bar}] {'met' if met else 'MISSED'}",
        flush=True,
    )
    for _, solution in runs:
        if not solution.converged:
            print(f"    not converged: {solution.report.blocking}")
    return met


def four(n_starts: int) -> list[bool]:
    """The staged solver against the direct one."""
    problem = four_stations()
    staged(problem, 999)
    ours = [timed(partial(staged, problem, seed)) for seed in range(n_starts)]
    paper = [timed(partial(direct, problem, seed)) for seed in range(n_starts)]
    good, theirs = (sum(s.converged for _, s in runs) for runs in (ours, paper))
    cpu, paper_cpu = (float(np.median([seconds for seconds, _ in runs])) for runs in (ours, paper))
    cycle, paper_cycle = (
        float(np.median([s.cycle_time_s for _, s in runs if s.converged] or [np.inf])) for runs in (ours, paper)
    )
    cycles = np.array([s.cycle_time_s if s.converged else np.inf for _, s in ours])
    best = min([*cycles, *(s.cycle_time_s for _, s in paper if s.converged)])
    fives = cycles[: n_starts // 5 * 5].reshape(-1, 5).min(axis=1) if n_starts >= 5 else cycles.min(keepdims=True)
    return [
        told("four stations, direct", paper, ">= 28/30, <= 2.5 s", theirs >= n_starts * 28 / 30 and paper_cpu <= 2.5),
        told(
            "four stations, staged",
            ours,
            f"30/30, cpu {cpu / paper_cpu:.2f} <= 0.4 of direct's, cycle <= direct's",
            good == n_starts and cpu <= 0.4 * paper_cpu and cycle <= paper_cycle,
        ),
        told(
            "four stations, staged, best of 5",
            ours,
            f"median {np.median(fives) / best - 1:.1%}, worst {fives.max() / best - 1:.1%} above best known, <= 2%",
            bool(np.median(fives) <= 1.02 * best),
        ),
    ]


def cluttered(n_starts: int) -> list[bool]:
    """Posts between the stations, the whole arm in spheres."""
    met = []
    for k, most in ((10, 8.0), (1, 2.0)):
        problem = quadrant_posts(k)
        staged(problem, 999)
        runs = [timed(partial(staged, problem, seed)) for seed in range(n_starts)]
        good = sum(solution.converged for _, solution in runs)
        cpu = float(np.median([seconds for seconds, _ in runs]))
        met.append(
            told(f"quadrant posts, k = {k}", runs, f">= 9/10, <= {most:g} s", good >= 0.9 * n_starts and cpu <= most)
        )
    return met


def accelerated(n_starts: int) -> list[bool]:
    """Acceleration limits with N = 50, from the staged outcome on, closed form switched off."""
    met = []
    settings = SecondOrderSettings(trapezoids=False)
    for name, problem in (("four stations", four_stations()), ("quadrant posts, k = 10", quadrant_posts(10))):
        runs = []
        for seed in range(n_starts):
            rng = np.random.default_rng(seed)
            symbols = LayoutSymbols(problem)
            first: Stage = staged_outcome(symbols, sample_design(problem, rng), rng, settings.staged)[0]
            runs.append(timed(partial(continue_second_order, symbols, first, [], settings)))
        cpu = float(np.median([seconds for seconds, _ in runs]))
        converged = all(solution.converged for _, solution in runs)
        met.append(told(f"{name}, N = 50", runs, "warm, <= 3 s", converged and cpu <= 3.0))
    return met


def main() -> int:
    """Print one line a bar; return 1 if one is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=30)
    parser.add_argument("--only", choices=["four", "cluttered", "accelerated"])
    options = parser.parse_args()
    met: list[bool] = []
    if options.only in (None, "four"):
        met += four(options.starts)
    if options.only in (None, "cluttered"):
        met += cluttered(max(1, options.starts // 3))
    if options.only in (None, "accelerated"):
        met += accelerated(max(1, options.starts // 10))
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
