"""Every stage once in a small lake: an inspection that moves its part, one in vain, spheres, a layout, a sequence."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import tasks
from cellwright.errors import InfeasibleError
from flows import inspection, layout, sequence
from flows.requests import request_of
from flows.runner import Steps
from storage.lake import Lake
from tests import small_sequence
from tests.small_inspection import CELL, write_cell
from tests.small_layout import table, write_layout

PLACING = """\
layout:
  harness: {planar: {x: [-100 mm, 100 mm], y: [-100 mm, 100 mm], yaw: [-90 deg, 90 deg]}}
  evaluations: 60
  stitched: 1
"""
"""A round that moves part and table."""
SEQUENCING = "sequencing: {steps: 6, max_motions: 4}\n"
"""Optimal control, coarse."""
ROUNDS = "refinement: {rounds: 1, density_factor: 4}\n  hulls: {part_spheres: 3, body_spheres: 2}"
CLOSING_GAPS = CELL.replace("refinement: {rounds: 0}", ROUNDS) + PLACING + SEQUENCING
IN_VAIN = ("planner.measurability.max_uncertainty=1e-9 um",)
SPHERES = {"n_spheres": 3, "n_starts": 1}
FLAT = [{"box": {"size": ["0.2 m", "0.2 m", "0.1 m"]}, "pose": {"position": ["0 m", "0 m", "50 mm"]}, "count": 1}]
LAYOUT = {
    "robot": {"model": "pr_robot", "hull": {"spheres": 2, "self_collision": False}},
    "stations": [table("blue", hull=FLAT), table("red", hull=FLAT)],
    "solver": {"starts": 1},
}
"""A layout that covers robot and stations with spheres."""


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
    layout.run(write_layout(cell.parent, **LAYOUT), lake=lake, direct=True)
    sequence.run(small_sequence.write_cell(cell.parent), lake=lake, direct=True)
    return {manifest.key: manifest.digest for manifest in Lake(lake).manifests()}
