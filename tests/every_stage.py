"""Every stage once in a small lake: an inspection that closes gaps, one in vain, and a part covered by spheres."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import tasks
from cellwright.errors import InfeasibleError
from flows import inspection
from flows.requests import request_of
from flows.runner import Steps
from storage.lake import Lake
from tests.small_inspection import CELL, write_cell

CLOSING_GAPS = CELL.replace("refinement: {rounds: 0}", "refinement: {rounds: 1, density_factor: 4}")
IN_VAIN = ("planner.measurability.max_uncertainty=1e-9 um",)
SPHERES = {"n_spheres": 3, "n_starts": 1}


def write_cell_with_gaps(folder: Path) -> Path:
    """Write the cell file of the small inspection, with a round that closes gaps, and its part."""
    return write_cell(folder, CLOSING_GAPS)


def run_every_stage(cell: Path, lake: str) -> dict[str, str]:
    """Run all stages that the lake does not have; return the digests of its artefacts by key."""
    inspection.run(cell, lake=lake, direct=True)
    with suppress(InfeasibleError):
        inspection.run(cell, overrides=IN_VAIN, lake=lake, direct=True)
    request = request_of(cell)
    with Steps(lake, direct=True) as step:
        part = step(tasks.read_source, request.part, label="part")
        mesh = step(tasks.preprocess_mesh, request.mesh, source=part)
        step(tasks.fit_spheres, SPHERES, cell=None, mesh=mesh)
    return {manifest.key: manifest.digest for manifest in Lake(lake).manifests()}
