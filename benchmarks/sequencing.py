"""How long does sequencing take, and how good is it? Run: ``python -m benchmarks.sequencing [paper|lib|hundred|lazy]``.

Bars that are missed are printed, and the exit code is 1.

``paper``: twenty clusters with the alternatives and welding costs of Bjorkenstam 2014, table 1, and random robot-like
travel costs, proven. ``lib``: public GTSPLIB problems (those beside the project, or the files given), searched for a
minute. ``hundred``: a hundred clusters of sixteen, ten seconds against a long search. ``lazy``: motions evaluated until
proof. Wall and processor seconds after one warm-up, which pays for compilation. OR-Tools' routing is shown beside the
GTSPLIB problems in a process of its own, as it does not go together with other solvers here: ``--ortools`` names an
interpreter that has it, of a virtual environment of its own.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cellwright.solvers.gtsp.gtsplib import read_gtsplib
from cellwright.solvers.gtsp.lazy import solve_lazily
from cellwright.solvers.gtsp.problem import SequencingProblem
from cellwright.solvers.sequencing import compile_kernels, solve_sequence
from tests.cellwright.solvers.sequencing_problems import plane_problem, robot_problem, uniform_problem

PUBLIC = Path(__file__).parents[2] / "shared" / "data" / "gtsp"
BEST_KNOWN = {"39rat195": 854.0, "107si535": 13502.0}
BARS = {"39rat195": 854.0, "107si535": 13505.0}
MISSED: list[str] = []


def asked(bar: str, met: bool) -> None:
    """Say that a bar is missed, if it is."""
    if not met:
        MISSED.append(bar)
        print(f"    MISSED: {bar}", flush=True)


OR_TOOLS = """
import json, sys
from ortools.constraint_solver import pywrapcp, routing_enums_pb2

given = json.load(sys.stdin)
cost, sets = given["cost"], given["sets"]
smallest, best = min(sets, key=len), None
for start in smallest:  # a tour begins in a node: each of the smallest set in turn
    left = [start] + [v for own in sets if own is not smallest for v in own]
    manager = pywrapcp.RoutingIndexManager(len(left), 1, 0)
    routing = pywrapcp.RoutingModel(manager)
    index = {v: manager.NodeToIndex(k) for k, v in enumerate(left)}
    way = lambda a, b: cost[left[manager.IndexToNode(a)]][left[manager.IndexToNode(b)]]
    routing.SetArcCostEvaluatorOfAllVehicles(routing.RegisterTransitCallback(way))
    for own in sets:
        if own is not smallest:
            routing.AddDisjunction([index[v] for v in own], 10**9, 1)
    search = pywrapcp.DefaultRoutingSearchParameters()
    search.local_search_metaheuristic = routing_enums_pb2.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    search.time_limit.FromMilliseconds(int(1000 * given["seconds"] / len(smallest)))
    solution = routing.SolveWithParameters(search)
    if solution and (best is None or solution.ObjectiveValue() < best):
        best = solution.ObjectiveValue()
print("inf" if best is None else best)
"""
"""What a process of its own runs: a tour through one node of each set, by disjunctions, with guided local search."""


def timed(what: Callable[[], Any]) -> tuple[float, float, Any]:
    """Return wall seconds, processor seconds and result."""
    wall, own = time.monotonic(), time.process_time()
    result = what()
    return time.monotonic() - wall, time.process_time() - own, result


def after(seconds: float) -> Callable[[], bool]:
    """Return a question that is answered with yes when so many seconds have passed."""
    deadline = time.monotonic() + seconds
    return lambda: time.monotonic() > deadline


def peak_memory() -> float:
    """Return the largest size of this process so far in GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def paper() -> None:
    for title, settings in (("welding", {}), ("travel only", {"service": False}), ("open", {"closed": False})):
        for seed in range(10):
            problem, _ = robot_problem(seed, **settings)
            wall, own, r = timed(lambda p=problem, s=seed: solve_sequence(p, np.random.default_rng(s), method="exact"))
            proof = "proven" if r.proven else f"gap {r.gap:.1%}"
            print(
                f"{title:12s} seed {seed}: {r.cost:8.1f} {proof} in {wall:5.2f} s ({own:5.2f} s of processor), "
                f"{r.n_states / 1e6:5.2f} M states, peak {peak_memory():.2f} GB",
                flush=True,
            )
            bar = f"{title}, seed {seed}: proven in 5 s and 1 GB"
            asked(bar, r.proven and wall <= 5.0 and peak_memory() <= 1.0)


def lib(paths: list[Path], peer: str | None, seconds: float = 60.0) -> None:
    if peer is None:
        print("no interpreter with OR-Tools is given (--ortools): its routing is not shown beside")
    problems = {path.stem: read_gtsplib(path) for path in paths}
    if not paths:
        problems = {
            "50 near in the plane": plane_problem(0, 50, 6),
            "50 anywhere": plane_problem(1, 50, 6, spread=np.inf),
            "60 robot tasks": robot_problem(2, [8] * 60)[0],
            "40 without structure": uniform_problem(3, [6] * 40),
        }
    for name, problem in problems.items():
        known = BEST_KNOWN.get(name)
        for limit in (1.0, 5.0, seconds):
            wall, own, r = timed(
                lambda p=problem, limit=limit: solve_sequence(
                    p,
                    np.random.default_rng(0),
                    method="search",
                    n_rounds=10**7,
                    stop=after(limit),
                    stop_bounds=after(0.4 * limit),
                )
            )
            beside = f", best known {known:.0f}" if known else ""
            print(
                f"{name:22s} {r.cost:9.1f} bound {r.lower_bound:9.1f} in {wall:5.1f} s ({own:.1f}){beside}", flush=True
            )
        asked(f"{name}: {BARS.get(name)} in {seconds:.0f} s", r.cost <= BARS.get(name, np.inf))
        if peer is not None and np.isfinite(problem.cost).all():
            theirs = or_tools(problem, seconds, peer)
            print(f"{name:22s} {theirs:9.1f} by OR-Tools routing in {seconds:.0f} s", flush=True)


def or_tools(problem: SequencingProblem, seconds: float, interpreter: str) -> float:
    """Return what OR-Tools' routing finds in a process of its own."""
    # it knows whole numbers and ways alone: half of what an alternative costs goes onto each way in and out
    cost = problem.cost + 0.5 * (problem.service[:, None] + problem.service[None, :])
    scale = 1 if np.array_equal(cost, np.floor(cost)) else 1000
    given = {"cost": np.rint(scale * cost).astype(int).tolist(), "sets": [c.tolist() for c in problem.clusters]}
    ran = subprocess.run(
        [interpreter, "-c", OR_TOOLS],
        input=json.dumps({**given, "seconds": seconds}), capture_output=True, text=True, check=True,
    )  # fmt: skip
    return float(ran.stdout) / scale


def hundred(n_rounds: int = 400_000) -> None:
    for title, problem in (
        ("robot tasks", robot_problem(5, [16] * 100)[0]),
        ("near in the plane", plane_problem(5, 100, 16)),
        ("anywhere", plane_problem(5, 100, 16, spread=np.inf)),
    ):
        short = timed(
            lambda p=problem: solve_sequence(
                p, np.random.default_rng(0), method="search", n_rounds=10**7, stop=after(10.0), stop_bounds=after(4.0)
            )
        )
        long = timed(
            lambda p=problem: solve_sequence(
                p, np.random.default_rng(1), method="search", n_rounds=n_rounds, max_work=1
            )
        )
        best = min(short[2].cost, long[2].cost)
        print(
            f"{title:18s} {short[2].cost:9.1f} in {short[0]:4.1f} s ({short[1]:.1f} s of processor, "
            f"{short[2].n_rounds} rounds), bound {short[2].lower_bound:.1f}; best known {best:9.1f} "
            f"(+{short[2].cost / best - 1:.2%}) after {long[0]:.0f} s more",
            flush=True,
        )
        asked(f"{title}: within 1% of the best known", short[2].cost <= 1.01 * best)


def lazy() -> None:
    for noise in (0.1, 0.25, 0.5):
        for seed in range(3):
            problem, least = robot_problem(seed, noise=noise)
            bounds = SequencingProblem(least, problem.clusters, problem.service)

            def solve(bounds: Any = bounds, cost: Any = problem.cost, seed: int = seed) -> Any:
                return solve_lazily(bounds, lambda a, b: float(cost[a, b]), np.random.default_rng(seed))

            wall, own, r = timed(solve)
            full = solve_sequence(problem, np.random.default_rng(seed))
            print(
                f"bounds up to {noise:.0%} low, seed {seed}: {r.result.cost:.1f} "
                f"{'proven' if r.result.proven else f'gap {r.result.gap:.2%}'} (all evaluated: {full.cost:.1f}), "
                f"{r.n_evaluated} of {r.n_motions} motions ({r.share_evaluated:.2%}), {r.n_proofs} proofs, "
                f"{wall:.1f} s ({own:.1f})",
                flush=True,
            )
            same = abs(r.result.cost - full.cost) <= 1e-9 * full.cost
            asked(f"lazy, {noise:.0%}, seed {seed}: 1% of all motions", r.share_evaluated <= 0.01)
            asked(f"lazy, {noise:.0%}, seed {seed}: the cost of full evaluation", same or not r.result.proven)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wanted", nargs="?", default="all", choices=["all", "paper", "lib", "hundred", "lazy"])
    parser.add_argument("files", nargs="*", type=Path, help="GTSPLIB files")
    parser.add_argument("--ortools", metavar="PYTHON", help="interpreter that has OR-Tools, to compare with")
    options = parser.parse_args()
    peer = options.ortools or (sys.executable if importlib.util.find_spec("ortools") else None)
    wall, own, _ = timed(compile_kernels)
    print(f"first call {wall:.1f} s ({own:.1f} s of processor), with compilation unless cached")
    print(f"peak {peak_memory():.2f} GB after it")
    if options.wanted in ("paper", "all"):
        paper()
    if options.wanted in ("lib", "all"):
        lib(options.files or sorted(PUBLIC.glob("*.gtsp")), peer)
        lib([], peer, 10.0)
    if options.wanted in ("hundred", "all"):
        hundred()
    if options.wanted in ("lazy", "all"):
        lazy()
    return 1 if MISSED else 0


if __name__ == "__main__":
    sys.exit(main())
