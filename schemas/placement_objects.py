"""Between the artefacts of a plan and the library's placement problem: which sweeps must be executed wherever."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import FloatArray, IntArray
from cellwright.errors import InvalidInputError, listed
from schemas.cell_objects import build_cell
from schemas.motion import Trajectory
from schemas.part import PartMesh
from schemas.reach_objects import sweeps_to_follow
from schemas.sources import CellModel
from schemas.views import Measurability, Reachability, Viewpoints

if TYPE_CHECKING:
    from cellwright.cell.harness import Harness
    from cellwright.solvers.placement.problem import PlacementProblem
    from cellwright.solvers.stitched_plan import StitchSettings
    from cellwright.solvers.sweeps.poses import CandidateSweeps, FollowSettings


def executed_spans(trajectory: Trajectory) -> dict[int, tuple[float, float]]:
    """Return first and last travel (m) of each view that a trajectory executes, in its order."""
    spans: dict[int, tuple[float, float]] = {}
    for segment, (kind, view) in enumerate(zip(trajectory.kind, trajectory.view.tolist())):
        if kind == "sweep":
            travel = trajectory.travel_m[trajectory.segment == segment]
            spans[view] = float(np.nanmin(travel)), float(np.nanmax(travel))
    return spans


def placement_problem(
    cell: CellModel,
    mesh: PartMesh,
    viewpoints: Viewpoints,
    measurability: Measurability,
    reachability: Reachability,
    trajectory: Trajectory,
    *,
    T_world_part: FloatArray,
    harness: Harness,
    moves_base: bool,
    carried: tuple[str, ...],
    follow: FollowSettings,
    stitch: StitchSettings,
    resting: float,
) -> PlacementProblem:
    """Return the problem of the sweeps that a trajectory executes, in the order of their views.

    Bodies no deeper than ``resting`` m in one another rest on each other.

    Raises:
        InvalidInputError: If a body that is to be carried does not stand in the world, or the artefacts do not belong
            together.
    """
    from cellwright.cell.bodies import WORLD
    from cellwright.solvers.placement.problem import PlacementProblem

    built = build_cell(cell, mesh, T_world_part)
    standing = [body.name for body in built.bodies[:-1] if body.parent == WORLD]
    unknown = [name for name in carried if name not in standing]
    if unknown:
        raise InvalidInputError(
            f"layout.carries names {listed(unknown)}, which does not stand in the cell: use one of {listed(standing)}"
        )
    spans = executed_spans(trajectory)
    view = np.array(sorted(spans), np.int64)
    if len(view) and (view[-1] >= len(viewpoints.sample) or not np.isin(view, reachability.view).all()):
        raise InvalidInputError("the trajectory executes views without a piece: these do not belong together")
    return PlacementProblem(
        cell=built,
        harness=harness,
        moves_base=moves_base,
        carried=carried,
        sweeps=_some(sweeps_to_follow(viewpoints, measurability, T_world_part), view),
        required=np.array([spans[row] for row in view.tolist()], float).reshape(-1, 2),
        names=tuple(f"view {row}" for row in view.tolist()),
        follow=follow,
        scan_speed=stitch.scan_speed,
        tool_acceleration=stitch.tool_acceleration,
        returns=stitch.returns,
        most_alternatives=stitch.max_alternatives,
        resting=resting,
        permitted=_declared(cell),
    )


def _declared(cell: CellModel) -> tuple[tuple[int, int], ...]:
    """Return the pairs of rows of bodies that the cell file permits to stand in one another."""
    from cellwright.cell.ignored_pairs import Reason

    return tuple((int(a), int(b)) for a, b in cell.ignored_pair[cell.ignored_reason == Reason.DECLARED])


def _some(sweeps: CandidateSweeps, rows: IntArray) -> CandidateSweeps:
    """Return some of the sweeps, with their samples."""
    from cellwright.solvers.sweeps.poses import CandidateSweeps

    bounds = np.searchsorted(sweeps.sample_sweep, np.stack([rows, rows + 1], -1))
    counts = bounds[:, 1] - bounds[:, 0]
    kept = [np.arange(begin, end) for begin, end in bounds.tolist()]
    return CandidateSweeps(
        sweeps.T_world_scanner[rows],
        sweeps.start[rows],
        sweeps.end[rows],
        np.repeat(np.arange(len(rows)), counts).astype(np.int32),
        sweeps.sample_travel[np.concatenate([np.zeros(0, np.int64), *kept])],
    )
