"""The layout rounds of the inspection chain: move part or robot, plan there again, and keep the better placement.

The search proposes a placement. There the request is posed anew and the same stages run again, from what blocks the
scanner's sight to the simulated scan; the selected sweeps stay. Only what these stages say decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import tasks
from cellwright.errors import UnsafePlanError
from flows.placed_plan import PlacedPlan, Prepared, Standing, scanned, stand, verified
from flows.requests import InspectionRequest
from flows.runner import Step, Steps
from flows.selection_rounds import Choice, Connected
from storage.lake import Lake
from tasks.compare_placements import ComparisonParams
from tasks.optimise_placement import PlacementParams

MOVED = "moved"
"""Label of the steps in the new placement."""


@dataclass(frozen=True)
class Hulls:
    """The steps that cover the part, and the bodies of the cell, with spheres."""

    part: Step
    cell: Step


def cover_with_spheres(step: Steps, request: InspectionRequest, mesh: Step, cell: Step) -> Hulls | None:
    """Cover part and cell with spheres that are proven to hold them; ``None`` where no layout would use them."""
    if request.part_hull is None or request.cell_hull is None:
        return None
    return Hulls(
        step(tasks.fit_spheres, request.part_hull, label="part", cell=None, mesh=mesh),
        step(tasks.fit_spheres, request.cell_hull, label="cell", cell=cell, mesh=None),
    )


def better_placement(
    step: Steps,
    request: InspectionRequest,
    lake: Lake,
    prepared: Prepared,
    choice: Choice,
    plan: PlacedPlan,
    hulls: Hulls | None = None,
) -> tuple[PlacedPlan, Step | None]:
    """Return the plan in the better placement, and what was compared; without `layout` in the cell file the plan.

    Args:
        step: Runs the stages.
        request: The request.
        lake: Where they keep what they make.
        prepared: What stays the same wherever anything stands.
        choice: The selection and what it was made from.
        plan: The plan in the cell file's placement.
        hulls: Spheres between which the gradient is followed; without them it is not.
    """
    if request.placement is None:
        return plan, None
    placement = _searched(step, request.placement, prepared, plan, hulls)
    found: Any = lake.load(placement.ref())
    moved, failure = None, ""
    if found.is_better:
        moved = _planned_anew(step, plan.standing.request.moved(found), lake, prepared, choice, plan)
        moved, failure = _verified(step, prepared, moved)
    outcome = _compared(
        step, request.comparison.model_copy(update={"failure": failure}), prepared, placement, plan, moved
    )
    compared: Any = lake.load(outcome.ref())
    return (plan if moved is None or not compared.moved else moved), outcome


def _searched(step: Steps, params: PlacementParams, prepared: Prepared, plan: PlacedPlan, hulls: Hulls | None) -> Step:
    """Search for a better placement of the plan's sweeps."""
    standing = plan.standing
    return step(
        tasks.optimise_placement,
        params.model_copy(update={"T_world_part": standing.request.sweeps.T_world_part}),
        cell=standing.cell,
        mesh=prepared.mesh,
        viewpoints=prepared.viewpoints,
        measurability=standing.seen,
        reachability=standing.reachability,
        trajectory=plan.connected.trajectory,
        part_hull=hulls and hulls.part,
        cell_hull=hulls and hulls.cell,
    )


def _verified(step: Steps, prepared: Prepared, plan: PlacedPlan) -> tuple[PlacedPlan, str]:
    """Return a plan with its verification, or as it is and why it fails; a plan without a motion is not verified."""
    if plan.scan is None:
        return plan, ""
    try:
        return verified(step, prepared, plan, label=MOVED), ""
    except UnsafePlanError as error:
        step.forgive(error)
        return plan, str(error)


def _compared(
    step: Steps,
    params: ComparisonParams,
    prepared: Prepared,
    placement: Step,
    plan: PlacedPlan,
    moved: PlacedPlan | None,
) -> Step:
    """Compare a plan with the one in the placement found."""
    return step(
        tasks.compare_placements,
        params,
        placement=placement,
        cell=plan.standing.cell,
        mesh=prepared.mesh,
        trajectory=plan.connected.trajectory,
        coverage=plan.coverage,
        overlaps=plan.standing.overlaps,
        moved_cell=moved and moved.standing.cell,
        moved_trajectory=moved and moved.connected.trajectory,
        moved_coverage=moved and moved.coverage,
        moved_overlaps=moved and moved.standing.overlaps,
    )


def _planned_anew(
    step: Steps, request: InspectionRequest, lake: Lake, prepared: Prepared, choice: Choice, plan: PlacedPlan
) -> PlacedPlan:
    """Return the plan of the same selection in the placement of ``request``."""
    cell = step(tasks.assemble_cell, request.cell, label=MOVED, files=prepared.files)
    standing = stand(step, request, prepared, cell, label=MOVED)
    measurable = _with_gaps(step, prepared, standing, choice)
    connected = plan.connected
    trajectory = step(
        tasks.stitch_sweeps,
        request.stitching.model_copy(update={"min_sweeps": 0}),
        label=MOVED,
        cell=cell,
        mesh=prepared.mesh,
        viewpoints=prepared.viewpoints,
        reachability=standing.reachability,
        selection=connected.selection,
        earlier=connected.earlier,
    )
    again = Connected(connected.selection, trajectory, connected.earlier)
    stitched: Any = lake.load(trajectory.ref())
    if not stitched.kind:
        return PlacedPlan(standing, measurable, again)
    return scanned(step, prepared, standing, Choice(connected.selection, measurable), again, label=MOVED)


def _with_gaps(step: Steps, prepared: Prepared, standing: Standing, choice: Choice) -> Step:
    """Return what is measurable in a placement, with the gaps that the selection was to close."""
    measurable, request = standing.measurable, standing.request
    if choice.cloud is None:
        return measurable
    for number, gaps in enumerate(choice.gaps, 1):
        measurable = step(
            tasks.extend_measurability,
            request.extension,
            label=f"round {number}, {MOVED}",
            mesh=prepared.mesh,
            surroundings=standing.surroundings,
            cloud=choice.cloud,
            viewpoints=prepared.viewpoints,
            reachability=standing.reachability,
            gaps=gaps,
            measurability=measurable,
        )
    return measurable
