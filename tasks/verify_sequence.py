"""Verify a sequence with a second collision engine, against all limits and all tasks: one that fails is an error.

As `tasks.verify_plan`, and besides: every task is performed once, in an order that is permitted, with the tool where
the task wants it for as long as it wants it, and strokes are straight. While a task is worked on, bodies that touch at
work may touch; on all other motions they may not. Of optimal motions torques are checked in place of accelerations.
"""

from __future__ import annotations

import math

from pydantic import Field

from schemas.motion import Verification
from schemas.params import Params
from schemas.payload import PayloadParams
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage
from schemas.tasks import TaskAlternatives, TaskList, TaskSequence


class SequenceVerifyParams(Params):
    """Settings of the verification of a sequence."""

    from_start: bool = Field(default=True, description="Whether it must begin at the start configuration.")
    returns: bool = Field(default=True, description="Whether it must end where it begins.")
    end_rad: tuple[float, ...] | None = Field(default=None, description="Configuration at which it must end.")
    touches: tuple[tuple[str, str], ...] = Field(
        default=(), description="Pairs of bodies that may touch while a task is worked on."
    )
    by_torque: bool = Field(default=False, description="Whether torques are limited, and accelerations are not.")
    payload: PayloadParams | None = Field(default=None, description="What the arm carries, where torques are checked.")
    step_m: float = Field(default=1e-3, gt=0, le=1e-3, description="Furthest motion of any point between states.")
    step_rad: float = Field(default=math.radians(0.1), gt=0, le=math.radians(0.1) * (1 + 1e-9))
    position_tolerance_m: float = Field(default=2e-4, gt=0, description="Tool off its task or its straight stroke.")
    angle_tolerance_rad: float = Field(default=math.radians(0.05), gt=0)
    limit_tolerance: float = Field(default=0.01, ge=0, lt=0.1, description="Share by which limits may be exceeded.")


@stage(version=2)
def verify_sequence(
    cell: CellModel,
    tasks: TaskList,
    alternatives: TaskAlternatives,
    sequence: TaskSequence,
    *,
    params: SequenceVerifyParams,
    progress: Progress = no_progress,
) -> Verification:
    """Check that the sequence can run and does all tasks.

    Raises:
        InfeasibleError: If any check fails; it names the check, the time, the bodies and the amount.
        InvalidInputError: If the artefacts do not belong together.
    """
    from dataclasses import replace

    import numpy as np

    from cellwright.cell.verification_scene import VerificationScene
    from cellwright.errors import InvalidInputError
    from cellwright.solvers import plan_verification as verification
    from cellwright.solvers.pose_tasks.verification import Stops, check_tasks, check_torques, joined_proof
    from schemas.cell_objects import build_cell
    from schemas.plan_objects import verification_of
    from schemas.task_objects import MOTION, at_work, pose_tasks, runs_of, timed_plan

    if len(sequence.kind) and not np.all(sequence.alternative < len(alternatives.task)):
        raise InvalidInputError("the sequence names alternatives that there are not: these do not belong together")
    built, plan = build_cell(cell), timed_plan(sequence)
    if not params.from_start:
        built = replace(built, start=sequence.position_rad[0].copy())
    tolerances = verification.Tolerances(
        step=params.step_m,
        step_angle=params.step_rad,
        limit_share=params.limit_tolerance,
        position=params.position_tolerance_m,
        angle=params.angle_tolerance_rad,
    )
    checks = verification.check_order(plan)
    verification.require(checks)
    limits = verification.check_limits(plan, built, tolerances, returns=params.returns and params.end_rad is None)
    if params.by_torque:
        limits = [check for check in limits if "acceleration" not in check.name]
        payload = None if params.payload is None else params.payload.payload()
        limits.append(check_torques(plan, built, payload, tolerances))
    checks += limits
    end = None if params.end_rad is None else np.array(params.end_rad)
    begin, end_of_work = sequence.arrive_s.copy(), sequence.leave_s.copy()  # without strokes they are the same
    working_at = sequence.stop >= 0
    begin[sequence.stop[working_at]] = sequence.start_s[working_at]
    end_of_work[sequence.stop[working_at]] = sequence.end_s[working_at]
    stops = Stops(sequence.task, begin, end_of_work, sequence.arrive_s, sequence.leave_s)
    checks += check_tasks(plan, built, pose_tasks(tasks), stops, tasks.before, tolerances, end)
    verification.require(checks)
    working = at_work(built, params.touches)
    cells = {kind: built if kind == MOTION else working for kind in set(sequence.kind)}
    runs = runs_of(sequence) if params.touches else [(MOTION, slice(0, len(sequence.kind)))]
    scenes = {kind: VerificationScene(cells.get(kind, built)) for kind, _ in runs}
    proof = joined_proof(
        [(timed_plan(sequence, run), cells.get(kind, built), scenes[kind]) for kind, run in runs], tolerances, progress
    )
    checks += proof.checks
    verification.require(checks)
    return verification_of(checks, proof, next(iter(scenes.values())).engine)
