"""How good and how fast is the set cover? Run: ``python -m benchmarks.set_cover [density per mm² ...]``.

The measurability matrices of the example part after reachability (default densities 0.001, 0.005, 0.01), and the
crew schedules rail507 and rail516 of the OR-Library where they lie beside the project (best known: 174 and 182).
Times are of this process, after one warm-up that pays for compilation; ``wall`` counts waiting for a busy machine.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import tasks
from cellwright.solvers.set_cover import cover_best, cover_greedily, cover_matrix
from flows.requests import InspectionRequest, request_of
from tests.cellwright.solvers.cover_instances import COVER_DATA, rail_problem, strips_on_cylinder

EXAMPLE = Path(__file__).parents[1] / "examples" / "grooved_cylinder.yaml"
DENSITIES = ("0.001", "0.005", "0.01")
HEADER = ("instance", "rows", "columns", "greedy", "ours", "ratio", "bound", "proven", "wall s", "cpu s")


def measured(density: str) -> tuple[Any, Any]:
    """Return samples x views of the example at a density, as the inspection chain makes it, and the ties."""
    request = request_of(EXAMPLE, [f"planner.sampling.density={density} /mm^2"])
    source = tasks.read_source(params=request.part)
    cell = tasks.assemble_cell(
        tuple(tasks.read_source(params=file) for file in request.cell_files), params=request.cell
    )
    mesh = tasks.preprocess_mesh(source, params=request.mesh)
    samples = tasks.sample_surface(mesh, params=request.samples)
    views = tasks.sample_viewpoints(samples, params=request.viewpoints)
    placed = {"T_world_part": resting(request, mesh, cell)}
    around = tasks.place_surroundings(cell, params=request.surroundings.model_copy(update=placed))
    seen = tasks.measure_samples(mesh, around, samples, views, params=request.sensing)
    reach = tasks.follow_sweeps(cell, mesh, views, seen, params=request.sweeps.model_copy(update=placed))
    found = tasks.trim_measurability(samples, views, seen, reach, params=request.trimming)
    order = np.lexsort((found.sample, found.view))
    starts = np.searchsorted(found.view[order], np.arange(len(views.sample) + 1))
    tie = np.full(len(views.sample), np.inf)
    used = np.diff(starts) > 0
    tie[used] = np.maximum.reduceat(found.uncertainty_m[order], starts[:-1][used])
    return (starts, found.sample[order], len(samples.points_m)), tie


def resting(request: InspectionRequest, mesh: Any, cell: Any) -> Any:
    """Return the pose of the part on the body that it rests on."""
    from cellwright.cell.part import resting_pose, top_height
    from schemas.cell_objects import build_cell
    from schemas.poses import Pose

    if request.rests_on is None:
        return request.part_pose
    support = next(body for body in build_cell(cell).bodies if body.name == request.rests_on)
    stated = request.part_pose.matrix()
    top = top_height(support.shape, support.T_parent_body)
    return Pose.of(resting_pose(mesh.vertices_m, stated[:3, :3], (stated[0, 3], stated[1, 3]), top))


def report(name: str, matrix: Any, costs: Any = None, tie: Any = None) -> None:
    given = cover_matrix(matrix, costs)
    greedy = cover_greedily(given, tie=tie)
    wall, cpu = time.perf_counter(), time.process_time()
    ours = cover_best(given, tie=tie)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    row = (
        name,
        given.n_rows,
        given.n_columns,
        f"{greedy.cost:g}",
        f"{ours.cost:g}",
        f"{greedy.cost / ours.cost:.2f}",
        f"{ours.lower_bound:.2f}",
        "yes" if ours.proven else f"no ({ours.stopped_by})",
        f"{wall:.2f}",
        f"{cpu:.2f}",
    )
    print("  ".join(f"{word!s:>10}" for word in row), flush=True)


def main() -> None:
    cover_best(strips_on_cylinder(80, 500, seed=1))  # compiles
    print("  ".join(f"{word:>10}" for word in HEADER))
    for density in sys.argv[1:] or DENSITIES:
        matrix, tie = measured(density)
        report(f"rho {density}", matrix, tie=tie)
    for name in ("rail507", "rail516"):
        if (COVER_DATA / name).exists():
            report(name, *rail_problem(name))


if __name__ == "__main__":
    main()
