"""How fast are RoboTSP's 245 drilling targets sequenced, and drilled? Run: ``python -m benchmarks.drilling_targets``.

`tests/cells/drilling_targets.yaml` before a UR10e, from task list to verified motion; a number as argument limits the
motions that are planned. Processor seconds after one warm-up, which pays for compilation, beside the published figures
of five methods on the same targets (Suarez-Ruiz, Lembono and Pham 2018). Theirs are of another arm and another
computer: execution times tell about arms as much as about methods. What tells about ours is its gap to the lower bound.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import tasks
from cellwright.cell.hdf5_tables import read_dataset
from flows.sequence_requests import SequenceRequest, sequence_request
from schemas.sequence_file import load_sequence_file
from tests import small_sequence

PROJECT = Path(__file__).parents[1]
CELL = PROJECT / "tests" / "cells" / "drilling_targets.yaml"
TARGETS = PROJECT.parent / "shared" / "data" / "sequencing" / "robotsp-245-targets.hdf5"
METHODS = ("GLKH 1000", "GLKH 500", "GLKH 100", "TSP in C-space", "RoboTSP")


def timed(what: Callable[[], Any]) -> tuple[float, Any]:
    """Return processor seconds and result."""
    begun = time.process_time()
    result = what()
    return time.process_time() - begun, result


def published() -> list[tuple[str, float, float]]:
    """Return method, processor seconds and execution seconds for all targets; infinite where none was found."""
    content = TARGETS.read_bytes()
    cpu = read_dataset(TARGETS.name, content, "others/cpu_time")[:, -1]
    execution = read_dataset(TARGETS.name, content, "others/execution_time")[:, -1]
    return list(zip(METHODS, cpu.tolist(), execution.tolist(), strict=True))


def run(request: SequenceRequest) -> None:
    """Run the chain once and print what each stage took and gave."""
    cell = tasks.assemble_cell((), params=request.cell)
    listed = tasks.list_tasks(tasks.read_source(params=request.table), params=request.tasks)
    finding, found = timed(lambda: tasks.generate_alternatives(cell, listed, params=request.alternatives))
    reached = len(np.unique(found.task))
    print(f"{reached} of {len(listed.name)} targets reached, {len(found.task)} alternatives in {finding:.1f} s")
    ordering, plan = timed(lambda: tasks.sequence_tasks(cell, listed, found, params=request.sequence))
    checking, proof = timed(lambda: tasks.verify_sequence(cell, listed, found, plan, params=request.verification))
    gap = 1.0 - plan.lower_bound / plan.cost
    print(f"sequence and motions in {ordering:.1f} s: {plan.n_evaluated} of {plan.n_motions:,} motions planned")
    apart = f"bodies at least {1e3 * proof.proven_distance_m:.2f} mm apart"
    print(f"verified in {checking:.1f} s: {proof.n_states:,} states, {apart}")
    for name, cost in zip(plan.order, plan.order_cost.tolist(), strict=True):
        print(f"  {name:14s} {cost:7.2f} s")
    print(f"  {'lower bound':14s} {plan.lower_bound:7.2f} s (gap {gap:.1%}, stopped by {plan.stopped_by})")
    print(f"\n{'method':16s} {'processor s':>12s} {'execution s':>12s}")
    for name, cpu, execution in [*published(), ("cellwright", finding + ordering, float(plan.time_s[-1]))]:
        shown = f"{execution:12.1f}" if np.isfinite(execution) else f"{'none found':>12s}"
        print(f"{name:16s} {cpu:12.1f} {shown}")


def main(arguments: list[str]) -> int:
    if not TARGETS.is_file():
        print(f"the public drilling targets are not at {TARGETS}: nothing to run")
        return 0
    warming, _ = timed(small_sequence.verification)
    print(f"first call {warming:.1f} s, with compilation unless cached")
    overrides = [f"planner.max_motions={arguments[0]}"] if arguments else []
    run(sequence_request(load_sequence_file(CELL, overrides)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
