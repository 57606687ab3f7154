"""Would generated C code pay for the functions of layout programs? Run: ``python -m benchmarks.compiled_functions``.

For programs of three sizes: what Ipopt spends in gradient, Jacobian and Hessian as CasADi evaluates them, what the same
functions take as C code, and what the C compiler takes to make that, which nobody needs otherwise. The last column is
how many solves of the very same program it takes to win the compile time back; every round of lazy checks is another
program. Without a C compiler there is nothing to measure, and it says so.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi
import numpy as np

from cellwright.solvers.layout.checks import all_checks_at_rows, all_layout_checks
from cellwright.solvers.layout.examples import four_station_problem
from cellwright.solvers.layout.mesh import build_mesh
from cellwright.solvers.layout.nlp import LayoutNLP, build_layout_nlp, run_layout_nlp
from cellwright.solvers.layout.problem import LayoutCost
from cellwright.solvers.layout.start import sample_design, start_points
from cellwright.solvers.layout.symbols import LayoutSymbols

CALLS = 20


def programs() -> list[tuple[str, LayoutSymbols, LayoutNLP]]:
    """Return the station program, the paper's, and one whose cost counts along the path."""
    plain = LayoutSymbols(four_station_problem())
    weighed = LayoutSymbols(replace(four_station_problem(), cost=LayoutCost(manipulability=0.5, along_path=True)))
    coarse, fine = build_mesh(plain.problem, 1), build_mesh(plain.problem, 100)
    layout = all_layout_checks(plain.geometry)
    everything = all_checks_at_rows(plain.geometry, fine)
    whole = build_layout_nlp(plain, fine, everything, tracking=2e3, slack_cost=np.inf, margin_m=0.0, lifted=True)
    return [
        ("stations", plain, build_layout_nlp(plain, coarse, layout)),
        ("direct, N = 100", plain, whole),
        ("along the path, N = 100", weighed, build_layout_nlp(weighed, fine, layout)),
    ]


def seconds_a_call(function: Any, arguments: list[Any]) -> float:
    """Return the processor seconds of one evaluation."""
    begin = time.process_time()
    for _ in range(CALLS):
        function(*arguments)
    return (time.process_time() - begin) / CALLS


def compiled_seconds(functions: list[Any], arguments: list[list[Any]], folder: Path) -> tuple[float, list[float]]:
    """Return how long the compiler takes, and the seconds of one evaluation of each function that it made."""
    generator = casadi.CodeGenerator("generated.c")
    for function in functions:
        generator.add(function)
    generator.generate(f"{folder}/")
    library = folder / "generated.so"
    begin = time.perf_counter()
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", library, folder / "generated.c", "-lm"], check=True)
    taken = time.perf_counter() - begin
    made = [casadi.external(function.name(), str(library)) for function in functions]
    return taken, [seconds_a_call(*each) for each in zip(made, arguments)]


def measured(name: str, symbols: LayoutSymbols, nlp: LayoutNLP) -> None:
    """Print one program's line."""
    rng = np.random.default_rng(0)
    start = start_points(symbols.problem, nlp.mesh, sample_design(symbols.problem, rng), rng, 1)[0]
    compiled = nlp.program.compiled()
    x, lam = np.clip(nlp.pack(start), compiled.lower, compiled.upper), np.ones(nlp.program.n_constraints)
    functions = [compiled.functions[key] for key in ("grad_f", "jac_g", "hess_lag")]
    arguments = [[x, []], [x, []], [x, [], 1.0, lam]]
    interpreted = [seconds_a_call(*each) for each in zip(functions, arguments)]
    begin = time.process_time()
    iterations = run_layout_nlp(nlp, compiled, start).iterations
    solved = time.process_time() - begin
    with tempfile.TemporaryDirectory() as folder:
        taken, generated = compiled_seconds(functions, arguments, Path(folder))
    saved = iterations * (sum(interpreted) - sum(generated))
    print(
        f"{name:24} solve {solved:6.3f} s of which evaluation {iterations * sum(interpreted):6.3f} s"
        f"  a call {1e3 * sum(interpreted):7.2f} ms, as C {1e3 * sum(generated):7.2f} ms"
        f"  compiler {taken:6.2f} s  pays after {taken / saved if saved > 0.0 else np.inf:7.0f} solves",
        flush=True,
    )


def main() -> int:
    """Print one line a program."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    if shutil.which("cc") is None:
        print("there is no C compiler on this machine, and none is needed: nothing to compare with")
        return 0
    for each in programs():
        measured(*each)
    return 0


if __name__ == "__main__":
    sys.exit(main())
