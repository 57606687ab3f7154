"""The last planning round of the inspection chain: sequence the sweeps of the plan anew under the cost asked for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import tasks
from cellwright.errors import UnsafePlanError
from flows.placed_plan import PlacedPlan, Prepared, scanned, verified
from flows.requests import InspectionRequest
from flows.runner import Step, Steps
from flows.selection_rounds import Choice
from storage.lake import Lake

SEQUENCED = "sequenced"
"""Label of the steps that execute the new sequence."""


def sequenced_plan(
    step: Steps, request: InspectionRequest, lake: Lake, prepared: Prepared, first: PlacedPlan, plan: PlacedPlan
) -> tuple[PlacedPlan, Step | None]:
    """Return the cheaper plan of the sweeps and what was compared; without `sequencing` in the cell file the plan.

    Args:
        step: Runs the stages.
        request: The request.
        lake: Where they keep what they make.
        prepared: What stays the same wherever anything stands.
        first: The plan in the cell file's placement.
        plan: The plan where it is to run.
    """
    if request.sequencing is None:
        return plan, None
    standing, connected = plan.standing, plan.connected
    sequence = step(
        tasks.sequence_sweeps,
        request.sequencing.model_copy(update={"T_world_part": standing.request.sweeps.T_world_part}),
        cell=standing.cell,
        mesh=prepared.mesh,
        viewpoints=prepared.viewpoints,
        reachability=standing.reachability,
        selection=connected.selection,
        trajectory=connected.trajectory,
        before=None if plan is first else first.connected.trajectory,
    )
    found: Any = lake.load(sequence.ref())
    if not found.is_taken:
        return plan, sequence
    trajectory = step(tasks.take_sequence, request.taken_sequence, sequence=sequence, trajectory=connected.trajectory)
    choice = Choice(connected.selection, plan.measurable)
    new = connected._replace(trajectory=trajectory)
    again = scanned(step, prepared, standing, choice, new, label=SEQUENCED)
    sequenced = replace(plan, connected=new, scan=again.scan, coverage=again.coverage)
    try:
        return verified(step, prepared, sequenced, label=SEQUENCED), sequence
    except UnsafePlanError as error:
        step.forgive(error)
        step.note(f"the stitched plan stays: a cheaper sequence of its sweeps fails its verification: {error}")
        return plan, None
