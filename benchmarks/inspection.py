"""How fast is the whole inspection? Run: ``python -m benchmarks.inspection``.

Everything but one line is measured in this process, without a server, on the shipped example, after one warm-up that
pays for compilation; that line is what the command says of itself, with the server. Last, the planning chain at the
paper's highest density stands beside its own bare kernels of the same run: the rays that were cast, the poses solved,
the collision checks done (see `benchmarks.planning_chain`).
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

begun = time.perf_counter()
from flows import compile_kernels, inspection  # noqa: E402
from flows.examples import find_cell_file  # noqa: E402

IMPORT_S = time.perf_counter() - begun

from benchmarks import planning_chain  # noqa: E402

PLANNING = ("sample_surface planning", "sample_viewpoints", "measure_samples", "follow_sweeps", "trim_measurability")


def timed(what: Callable[[], Any]) -> tuple[float, Any]:
    """Return wall seconds and result."""
    started = time.perf_counter()
    result = what()
    return time.perf_counter() - started, result


def plan(lake: str, *overrides: str) -> tuple[float, Any]:
    """Run the example against a lake; return wall seconds and the result."""
    cell = find_cell_file("grooved_cylinder")
    return timed(lambda: inspection.run(cell, overrides=overrides, lake=lake, direct=True))


def through_server(lake: str) -> float:
    """Run the example by its command, which starts this machine's server if there is none; return the run's seconds."""
    command = [sys.executable, "-m", "flows.command_line", "inspect", "grooved_cylinder", "--json", "--lake", lake]
    found: float = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)["took_s"]
    return found


def main() -> int:
    """Print one line a bar."""
    compile_kernels.main()
    print(f"imports                                      {IMPORT_S:8.2f} s")
    with tempfile.TemporaryDirectory() as folder:
        density = "planner.sampling.density=0.01 /mm^2"
        _, dense = plan(f"{folder}/dense", density, "planner.refinement.rounds=0", "layout=null")
        steps = dense.stage_seconds
        chain = sum(steps[name] for name in PLANNING) + steps["select_views"]
        for name in (*PLANNING, "select_views"):
            print(f"  {name:42s} {steps[name]:8.2f} s")
        print(f"sampling to set cover, {dense.summary['candidates']:,} candidates     {chain:8.2f} s   (bar 15 s)")

        seconds, cold = plan(f"{folder}/example")
        print(f"whole inspection, cold lake                  {seconds:8.2f} s   (bar 60 s)")
        print(f"peak memory of this process                  {peak_gb():8.2f} GB  (bar 2 GB)")
        moved = cold.summary["placement"]
        before, after = moved["cycle_before_s"], moved["cycle_after_s"]
        print(f"cycle before and after layout                {before:8.2f} s, {after:.2f} s   (bar: shorter)")
        sequencing = cold.summary["sequencing"]
        greedy, final = sequencing["greedy_before_s"], cold.summary["duration_s"]
        here = sequencing["plans"].get("greedy", {}).get("duration_s", greedy)
        print(f"greedy stitching in the cell file's placement {greedy:7.2f} s, final plan {final:.2f} s")
        print(f"  shorter                                    {1.0 - final / greedy:8.1%}   (bar 15 %)")
        print(f"  than greedy in the same placement          {1.0 - final / here:8.1%}")
        print(f"sequencing stage                             {cold.stage_seconds['sequence_sweeps']:8.2f} s")
        print(f"layout stage                                 {cold.stage_seconds['optimise_placement']:8.2f} s")
        print(f"coverage of what any candidate can measure   {cold.summary['coverage_of_coverable']:8.2%}   (bar 99 %)")
        seconds, warm = plan(f"{folder}/example")
        computed = sum(not record.cached for record in warm.records)
        through_prefect = min(through_server(f"{folder}/example") for _ in range(3))
        print(f"the same again: {computed} stages computed            {seconds:8.2f} s   (bar 1 s)")
        print(f"the same again through Prefect, start-up apart   {through_prefect:8.2f} s   (bar 1 s)")
        _, changed = plan(f"{folder}/example", "planner.report.title=another title")
        computed_names = [record.name for record in changed.records if not record.cached]
        print(f"another report title computes: {', '.join(computed_names)}")

    return planning_chain.main(0.01)


def peak_gb() -> float:
    """Return the largest resident size of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


if __name__ == "__main__":
    sys.exit(main())
