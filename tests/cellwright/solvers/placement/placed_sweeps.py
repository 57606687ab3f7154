"""The scanning cell of the solvers' tests as a placement problem: its part may be moved on the table."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.harness import Harness, planar
from cellwright.cell.transforms import inverse, pose
from cellwright.solvers.placement.judge import PlacementJudge
from cellwright.solvers.placement.problem import PlacementProblem
from cellwright.solvers.sweeps.poses import CandidateSweeps, FollowSettings
from tests.cellwright.solvers import scanning_cell

MARGIN = 0.03
FOLLOW = FollowSettings(margin=MARGIN, step=0.01, scan_speed=0.2, shortest=0.05, clearance=0.005)
HALF = scanning_cell.HALF_TRAVEL
POST = Body("post", Box((0.1, 0.1, 0.4)), WORLD, pose(np.array([0.7, 0.45, 0.2]), np.eye(3)))


def harness(reach: float = 0.15, turn: float = 1.0) -> Harness:
    """Two slides and a turn about the upright through the middle of the part; the identity at zero."""
    at = pose(scanning_cell.PART_AT, np.eye(3))
    moving = planar((-reach, reach), (-reach, reach), (-turn, turn))
    first = replace(moving.joints[0], T_parent_joint=at)
    return Harness((first, *moving.joints[1:]), inverse(at))


def sweeps(n: int) -> CandidateSweeps:
    """The first sweeps, each of which measures a sample in its middle and at both ends of its useful interval."""
    useful = HALF - MARGIN
    return CandidateSweeps(
        np.stack([sweep.T_world_scanner for sweep in scanning_cell.sweeps()[:n]]),
        np.full(n, -useful),
        np.full(n, useful),
        np.repeat(np.arange(n), 3).astype(np.int32),
        np.tile([-useful, 0.0, useful], n),
    )


def problem(n: int = 5, **changes: Any) -> PlacementProblem:
    """The problem of the first sweeps; keywords replace what it is made of."""
    given = {
        "cell": scanning_cell.cell(),
        "harness": harness(),
        "moves_base": False,
        "carried": (),
        "sweeps": sweeps(n),
        "required": np.tile([-HALF, HALF], (n, 1)),
        "names": tuple(f"view {number}" for number in range(n)),
        "follow": FOLLOW,
        "scan_speed": FOLLOW.scan_speed,
        "tool_acceleration": 1.0,
        "returns": False,
        "most_alternatives": 4,
    }
    return PlacementProblem(**(given | changes))


@cache
def judge() -> PlacementJudge:
    """Judges the problem of all sweeps."""
    return PlacementJudge(problem())
