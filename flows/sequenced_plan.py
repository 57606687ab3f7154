"""The last planning round of the inspection chain: sequence the sweeps of the plan anew under the cost asked for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import tasks
from cellwright.errors import UnsafePlanError
from flows.placed_plan import PlacedPlan, Prepared, scanned, verified
from flows.requests import InspectionRequest
from flows.runner import Step, Steps
from flows.selection_rounds import Choice
from schemas.payload import PayloadParams
from schemas.sequencing import SweepSequence
from storage.lake import Lake
from tasks.sequence_sweeps import SweepSequenceParams

SEQUENCED = "sequenced"
"""Label of the steps that execute the new sequence."""
STITCHED = "stitched"
"""Label of the step that keeps the plan as it was stitched."""


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
    for note in _payload_notes(request, found):
        step.note(note)
    if not found.is_taken:
        return _stitched(step, request, plan, sequence, found), sequence
    trajectory = step(tasks.take_sequence, request.taken_sequence, sequence=sequence, trajectory=connected.trajectory)
    choice = Choice(connected.selection, plan.measurable)
    new = connected._replace(trajectory=trajectory)
    again = scanned(step, prepared, standing, choice, new, label=SEQUENCED)
    standing = replace(standing, request=_with_torques(standing.request, request.sequencing))
    sequenced = replace(plan, standing=standing, connected=new, scan=again.scan, coverage=again.coverage)
    try:
        return verified(step, prepared, sequenced, label=SEQUENCED), sequence
    except UnsafePlanError as error:
        step.forgive(error)
        step.note(f"the stitched plan stays: a cheaper sequence of its sweeps fails its verification: {error}")
        return _stitched(step, request, plan, sequence, found), None


def _payload_notes(request: InspectionRequest, found: SweepSequence) -> list[str]:
    """Return what is to be said of the payload: something only if no plan has torques to compare."""
    return [request.payload_note] if request.payload_note and bool(np.isnan(found.work_j).all()) else []


def _stitched(
    step: Steps, request: InspectionRequest, plan: PlacedPlan, sequence: Step, found: SweepSequence
) -> PlacedPlan:
    """Return the stitched plan with its torques, if there are any: the motion is the same, so are scan and coverage."""
    if not len(found.stitched_torque_nm):
        return plan
    connected = plan.connected
    kept = request.taken_sequence.model_copy(update={"keep_stitched": True})
    trajectory = step(tasks.take_sequence, kept, label=STITCHED, sequence=sequence, trajectory=connected.trajectory)
    return replace(plan, connected=connected._replace(trajectory=trajectory))


def _with_torques(request: InspectionRequest, sequencing: SweepSequenceParams) -> InspectionRequest:
    """Return a request whose verification looks at torques too, if they are what the sequence was chosen by."""
    if sequencing.cost != "optimal_control":
        return request
    payload = PayloadParams(mass_kg=sequencing.payload_kg, centre_m=sequencing.payload_centre_m)
    verification = request.verification.model_copy(update={"by_torque": True, "payload": payload})
    return request.model_copy(update={"verification": verification})
