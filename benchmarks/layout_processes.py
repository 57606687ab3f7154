"""Does it pay to time particles in several processes? Run: ``python -m benchmarks.layout_processes [--particles N]``.

The iterative solver's objective on the paper's Fig. 1 (a wall between two tables, so that most particles need a path),
in this process and in as many as there are cores, after these have begun. Wall time, with the processor's load before.
"""

from __future__ import annotations

import argparse
import os
import sys
import time

import numpy as np

from cellwright.solvers.layout.configurations import ConfigurationFinder
from cellwright.solvers.layout.examples import walled_station_problem
from cellwright.solvers.layout.iterative import CycleObjective, CycleTimes, IterativeSettings
from cellwright.worker_processes import WorkerProcesses


def main() -> int:
    """Print one line a number of processes; return 1 if results differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--particles", type=int, default=160)
    options = parser.parse_args()
    problem, settings, rng = walled_station_problem(), IterativeSettings(), np.random.default_rng(0)
    finder = ConfigurationFinder(problem, rng)
    designs = rng.uniform(problem.lower, problem.upper, (options.particles, problem.n_design))
    found = []
    for n_processes in (1, None):
        with WorkerProcesses(CycleTimes, (problem, settings.inner), n_processes) as workers:
            objective = CycleObjective(finder, settings, 0, workers)
            objective(designs[:40], np.full(40, np.inf))  # compiled, and begun
            load, begun = os.getloadavg()[0], time.perf_counter()
            found.append(objective(designs, np.full(len(designs), np.inf)))
            seconds = time.perf_counter() - begun
        print(f"{workers.n_processes} processes: {seconds:.2f} s for {len(designs)} particles (load {load:.1f})")
    same = bool((found[0] == found[1]).all())
    print("the same values" if same else "OTHER VALUES")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
