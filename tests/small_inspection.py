"""The smallest inspection worth its name, for tests that break something: a plate, a table, a dozen samples."""

from __future__ import annotations

from pathlib import Path

from cellwright.cell.parametric_parts import plate_with_pocket, stl_bytes

CELL = """\
cellwright: 1
name: small
part:
  file: plate.stl
  rests_on: table
  pose: {position: [700 mm, 0 mm]}
table:
  box: {size: [300 mm, 300 mm, 200 mm]}
  pose: {position: [700 mm, 0 mm, 100 mm]}
planner:
  sampling: {density: 0.0003 /mm^2}
  verification_cloud: {density_factor: 2}
  refinement: {rounds: 0}
  viewpoints: {theta_tilt: [0 deg], psi_tilt: [0 deg]}
  reachability: {step: 20 mm}
  selection: {method: greedy}
  stitching: {method: greedy, roadmap_nodes: 100}
"""


def write_cell(folder: Path, text: str = CELL) -> Path:
    """Write the cell file and its part into a folder; return the cell file's path."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plate.stl").write_bytes(stl_bytes(plate_with_pocket()))
    path = folder / "cell.yaml"
    path.write_text(text)
    return path
