"""A small station: an arm that touches four places on a wall with a post before it, and what its stages make."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import tasks
from flows.sequence_requests import SequenceRequest, sequence_request
from schemas.sequence_file import load_sequence_file

CELL = """\
cellwright: 1
name: small station
robot:
  model: ur10e
  start: [-167 deg, -150 deg, 123 deg, 27 deg, -77 deg, 0 deg]
tool:
  tip: {position: [0 mm, 0 mm, 200 mm]}
  bodies:
    - {name: spindle, cylinder: {radius: 30 mm, length: 140 mm}, pose: {position: [0 mm, 0 mm, 70 mm]}}
    - {name: bit, cylinder: {radius: 4 mm, length: 60 mm}, pose: {position: [0 mm, 0 mm, 170 mm]}}
  touches: [[bit, wall]]
part:
  name: wall
  box: {size: [10 mm, 800 mm, 600 mm]}
  pose: {position: [805 mm, 0 mm, 450 mm]}
obstacles:
  - {name: post, box: {size: [80 mm, 60 mm, 500 mm]}, pose: {position: [740 mm, 0 mm, 400 mm]}}
tasks:
  frame: part
  pose: {position: [-5 mm, 0 mm, 0 mm]}
  approach: 30 mm
  dwell: 500 ms
  rotations: 4
  list:
    - {name: a, position: [0 mm, -300 mm, 100 mm], direction: [1, 0, 0]}
    - {name: b, position: [0 mm, 250 mm, 100 mm], direction: [1, 0, 0]}
    - {name: c, position: [0 mm, -150 mm, -100 mm], direction: [1, 0, 0], dwell: 1 s}
    - {name: d, position: [0 mm, 150 mm, -100 mm], direction: [1, 0, 0], after: [a]}
planner:
  max_alternatives: 6
  max_motions: 60
  roadmap_nodes: 200
"""


def write_cell(folder: Path, text: str = CELL) -> Path:
    """Write the sequence file."""
    path = folder / "station.yaml"
    path.write_text(text)
    return path


@cache
def request() -> SequenceRequest:
    """Return what the station asks of every stage."""
    with TemporaryDirectory() as folder:
        return sequence_request(load_sequence_file(write_cell(Path(folder))))


@cache
def cell():
    return tasks.assemble_cell((), params=request().cell)


@cache
def task_list():
    return tasks.list_tasks(None, params=request().tasks)


@cache
def alternatives():
    return tasks.generate_alternatives(cell(), task_list(), params=request().alternatives)


@cache
def sequence():
    return tasks.sequence_tasks(cell(), task_list(), alternatives(), params=request().sequence)


@cache
def verification():
    return tasks.verify_sequence(cell(), task_list(), alternatives(), sequence(), params=request().verification)
