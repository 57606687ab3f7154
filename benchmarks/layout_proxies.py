"""Do proxies find good layouts, and how fast? Run: ``python -m benchmarks.layout_proxies [--runs N] [--out FOLDER]``.

The four stations of Baumgaertner 2025, Fig. 5 (`four_station_problem`), solved by swarms on Euclidean and joint
proxies, by the iterative solver (a swarm over true cycle times) and by the integrated ones, each from ``--runs``
seeds (default 30). What a proxy proposes is timed by trajectory optimisation with N = 100, as in the paper. Times are
processor seconds of this process after one warm-up that pays for compilation. The bar: the integrated solver's median
cycle is at least 30 % shorter than that of the Euclidean and of the joint proxy. The paper's own claims stand beside.
With a folder the runs and the pictures are written there.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cellwright.figures.layout_charts import layout_view, time_scatter
from cellwright.solvers.layout.examples import four_station_problem
from cellwright.solvers.layout.iterative import IterativeSettings, solve_iteratively
from cellwright.solvers.layout.problem import LayoutProblem, TargetKind
from cellwright.solvers.layout.proxies import Proxy, ProxySettings, solve_by_proxy, time_layout
from cellwright.solvers.layout.solution import LayoutSolution
from cellwright.solvers.layout.staged import StagedSettings, solve_staged
from cellwright.solvers.layout.start import sample_design
from cellwright.solvers.layout.symbols import LayoutSymbols
from cellwright.solvers.particle_swarm import SwarmSettings

BAR = 0.30
Solver = Callable[[np.random.Generator], LayoutSolution]


def solvers_of(problem: LayoutProblem, swarm: SwarmSettings) -> dict[str, Solver]:
    symbols = LayoutSymbols(problem)

    def integrated(rng: np.random.Generator) -> LayoutSolution:
        return solve_staged(symbols, sample_design(problem, rng), rng, StagedSettings())

    def by(proxy: Proxy) -> Solver:
        settings = ProxySettings(proxy, swarm)
        return lambda rng: solve_by_proxy(symbols, None, rng, settings)

    found: dict[str, Solver] = {"integrated, staged": integrated}
    found |= {f"proxy: {proxy.value}": by(proxy) for proxy in Proxy}
    found["iterative"] = lambda rng: solve_iteratively(
        symbols, None, rng, IterativeSettings(swarm=swarm, n_processes=1)
    )
    return found


def run(name: str, solve: Solver, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    begin = time.process_time()
    solution = solve(rng)
    return {
        "solver": name,
        "seed": seed,
        "cpu_s": time.process_time() - begin,
        "cycle_s": solution.cycle_time_s,
        "converged": solution.converged,
        "blocking": solution.report.blocking,
        "design": solution.design.tolist(),
    }


def report(runs: list[dict[str, Any]]) -> bool:
    names = list(dict.fromkeys(each["solver"] for each in runs))
    print(f"{'solver':22} {'runs':>5} {'gated':>6} {'cycle median':>13} {'best':>8} {'worst':>8} {'cpu median':>11}")
    medians: dict[str, tuple[float, float]] = {}
    for name in names:
        mine = [each for each in runs if each["solver"] == name]
        cycles = np.array([each["cycle_s"] for each in mine if each["converged"]], float)
        cpu = float(np.median([each["cpu_s"] for each in mine]))
        medians[name] = (float(np.median(cycles)) if len(cycles) else float("nan"), cpu)
        low, high = (cycles.min(), cycles.max()) if len(cycles) else (np.nan, np.nan)
        spread = f"{medians[name][0]:11.3f} s {low:6.3f} s {high:6.3f} s"
        print(f"{name:22} {len(mine):5d} {len(cycles):6d} {spread} {cpu:9.2f} s")
    ours, our_cpu = medians["integrated, staged"]
    held = True
    for name in names[1:]:
        cycle, cpu = medians[name]
        print(
            f"integrated against {name}: cycle {100.0 * (1.0 - ours / cycle):.0f} % shorter, "
            + (f"{cpu / our_cpu:.1f} times faster" if cpu > our_cpu else f"{our_cpu / cpu:.1f} times slower")
        )
        if name in ("proxy: euclidean", "proxy: joint"):
            held &= ours <= (1.0 - BAR) * cycle
    if "iterative" in medians:
        for name in ("proxy: euclidean", "proxy: joint"):
            share = medians[name][0] / medians["iterative"][0] - 1.0
            speed = medians["iterative"][1] / medians[name][1]
            print(f"{name} against iterative: cycle {100.0 * share:+.0f} %, {speed:.1f} times faster")
    print("paper: proxies 33 % worse than iterative and 10 times faster; integrated 50 % better, faster than proxies")
    verdict = "met" if held else "MISSED"
    print(f"bar (cycle at least {100 * BAR:.0f} % shorter than by Euclidean and joint proxy): {verdict}")
    return held


def draw(folder: Path, problem: LayoutProblem, runs: list[dict[str, Any]]) -> None:
    points = [(each["solver"], each["cpu_s"], each["cycle_s"]) for each in runs if each["converged"]]
    (folder / "layout_proxies.png").write_bytes(time_scatter(points))
    shown = []
    for name in dict.fromkeys(name for name, _, _ in points):
        mine = sorted(
            (each for each in runs if each["solver"] == name and each["converged"]), key=lambda e: e["cycle_s"]
        )
        middle = mine[len(mine) // 2]
        solution = time_layout(problem, np.array(middle["design"]), np.random.default_rng(0), StagedSettings())
        shown.append((f"{name}, {solution.cycle_time_s:.2f} s", solution))
    (folder / "layouts.png").write_bytes(layout_view(problem, shown))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--robot", default="kr180_r2500_extra")
    parser.add_argument("--target", choices=[kind.value for kind in TargetKind], default=TargetKind.POSE.value)
    parser.add_argument("--whole-swarm", action="store_true", help="every particle knows the best one, not a ring")
    given = parser.parse_args()
    problem = four_station_problem(given.robot, TargetKind(given.target))
    swarm = SwarmSettings(n_neighbours=0 if given.whole_swarm else 1)
    runs: list[dict[str, Any]] = []
    for name, solve in solvers_of(problem, swarm).items():
        if not runs:
            # compiles the kernels that the first measured run would pay for
            small = ProxySettings(Proxy.JOINT, SwarmSettings(4, 2))
            solve_by_proxy(LayoutSymbols(problem), None, np.random.default_rng(0), small)
        for seed in range(given.runs):
            runs.append(run(name, solve, seed))
            print(f"\r{name} {seed + 1}/{given.runs}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    held = report(runs)
    if given.out is not None:
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "layout_proxies.json").write_text(json.dumps(runs, indent=1))
        draw(given.out, problem, runs)
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
