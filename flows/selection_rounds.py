"""Rounds of the inspection chain that select views again: to close gaps, and in place of what cannot be connected.

A later round is not always better than an earlier one, so both keep the best of what they have seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

import tasks
from flows.requests import InspectionRequest
from flows.runner import Step, Steps
from schemas.plan_objects import covered_samples, unconnected_views
from schemas.sweep_params import StitchParams
from storage.lake import Lake

RESELECTIONS = 3
"""Times that views are selected again without those that could not be executed or connected."""


@dataclass(frozen=True)
class Candidates:
    """The steps that every round draws on: the cell, the part, and the candidates with their executable pieces."""

    cell: Step
    mesh: Step
    surroundings: Step
    viewpoints: Step
    reachability: Step


@dataclass(frozen=True)
class Choice:
    """A selection, the measurability that it was made from, and the gaps in ``cloud`` that went into that, in order."""

    selection: Step
    measurable: Step
    gaps: tuple[Step, ...] = ()
    cloud: Step | None = None


class Connected(NamedTuple):
    """A selection, its trajectory, and the earlier trajectory whose left-out views it does without."""

    selection: Step
    trajectory: Step
    earlier: Step | None = None


def close_gaps(step: Steps, request: InspectionRequest, lake: Lake, candidates: Candidates, choice: Choice) -> Choice:
    """Add what the selection misses between the samples to what must be covered, and select again, for some rounds.

    Equally small selections differ in what they miss between the samples, so that a later round may miss more than an
    earlier one: the selection with the fewest gaps is returned, the earliest of several, with what it was made from.
    """
    if request.refinement_rounds == 0:
        return choice
    cloud = step(tasks.sample_surface, request.refinement_cloud, label="refinement", mesh=candidates.mesh)
    seen = {
        "mesh": candidates.mesh,
        "surroundings": candidates.surroundings,
        "cloud": cloud,
        "viewpoints": candidates.viewpoints,
        "reachability": candidates.reachability,
    }
    earlier: tuple[Step, ...] = ()
    best, fewest = choice, None
    for number in range(1, request.refinement_rounds + 2):
        gaps = step(
            tasks.find_gaps,
            request.gaps,
            label=f"round {number}" if number <= request.refinement_rounds else "last",
            **seen,
            selection=choice.selection,
            earlier=earlier,
        )
        found: Any = lake.load(gaps.ref())
        if fewest is None or len(found.point) < fewest:
            best, fewest = choice, len(found.point)
        if fewest == 0 or number > request.refinement_rounds:
            break
        label = f"round {number}"
        measurable = step(
            tasks.extend_measurability,
            request.extension,
            label=label,
            **seen,
            gaps=gaps,
            measurability=choice.measurable,
        )
        selection = step(tasks.select_views, request.cover, label=label, measurability=measurable)
        earlier = (*earlier, gaps)
        choice = Choice(selection, measurable, earlier, cloud)
    return best


def connect_sweeps(
    step: Steps,
    request: InspectionRequest,
    lake: Lake,
    candidates: Candidates,
    choice: Choice,
    stitching: StitchParams,
) -> Connected:
    """Stitch the selected sweeps; select again without those that had to be left out, for some rounds.

    Returns the selection and its trajectory of the round whose executed sweeps measure the most samples; of several
    the one that leaves the fewest out, and the earliest. What it leaves out is a finding; a plan without any sweep is
    an error.
    """
    selection, measurable = choice.selection, choice.measurable
    earlier: Step | None = None
    best: Connected | None = None
    most = -1, 0
    for number in range(RESELECTIONS + 1):
        label = f"round {number + 1}" if number else ""
        if number:
            selection = step(
                tasks.select_views,
                request.cover,
                label=f"without unconnected, {label}",
                measurability=measurable,
                earlier=earlier,
            )
        must_move = number == RESELECTIONS and most[0] <= 0
        trajectory = step(
            tasks.stitch_sweeps,
            stitching.model_copy(update={"min_sweeps": 1 if must_move else 0}),
            label=label,
            cell=candidates.cell,
            mesh=candidates.mesh,
            viewpoints=candidates.viewpoints,
            reachability=candidates.reachability,
            selection=selection,
            earlier=earlier,
        )
        found: Any = lake.load(trajectory.ref())
        n_left_out = len(found.left_out_view)
        if number == 0 and n_left_out == 0:
            return Connected(selection, trajectory)
        entries: Any = lake.load(measurable.ref())
        reached = int(covered_samples(entries, found).sum()), -n_left_out
        if best is None or reached > most:
            best, most = Connected(selection, trajectory, earlier), reached
        is_spent = most[0] > 0 and np.isin(entries.view, list(unconnected_views(found))).all()
        if n_left_out == 0 or is_spent:
            break
        earlier = trajectory
    return best or Connected(selection, trajectory, earlier)
