"""Verify a sequence with a second collision engine, against all limits and all tasks: one that fails is an error.

As `tasks.verify_plan`, and besides: every task is performed once, in an order that is permitted, with the tool where
the task wants it for as long as it wants it, and strokes are straight. During strokes and the dwell between them bodies
that touch at work may touch; on all other motions they may not. Of optimal motions torques are checked in place of
accelerations, or beside them where motions keep both.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from schemas.motion import Verification
from schemas.params import Params
from schemas.payload import PayloadParams
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage
from schemas.tasks import TaskAlternatives, TaskList, TaskSequence

if TYPE_CHECKING:
    from cellwright.arrays import BoolArray
    from cellwright.cell.cell import Cell
    from cellwright.solvers.plan_verification import CollisionProof, Tolerances
    from cellwright.solvers.pose_tasks.verification import Stops


class SequenceVerifyParams(Params):
    """Settings of the verification of a sequence."""

    from_start: bool = Field(default=True, description="Whether it must begin at the start configuration.")
    returns: bool = Field(default=True, description="Whether it must end where it begins.")
    end_rad: tuple[float, ...] | None = Field(default=None, description="Configuration at which it must end.")
    touches: tuple[tuple[str, str], ...] = Field(
        default=(), description="Pairs of bodies that may touch while a task is worked on."
    )
    by_torque: bool = Field(default=False, description="Whether torques are limited, and accelerations are not.")
    keep_accelerations: bool = Field(default=False, description="Whether accelerations are limited beside torques.")
    payload: PayloadParams | None = Field(default=None, description="What the arm carries, where torques are checked.")
    step_m: float = Field(default=1e-3, gt=0, le=1e-3, description="Furthest motion of any point between states.")
    step_rad: float = Field(default=math.radians(0.1), gt=0, le=math.radians(0.1) * (1 + 1e-9))
    position_tolerance_m: float = Field(default=2e-4, gt=0, description="Tool off its task or its straight stroke.")
    angle_tolerance_rad: float = Field(default=math.radians(0.05), gt=0)
    limit_tolerance: float = Field(default=0.01, ge=0, lt=0.1, description="Share by which limits may be exceeded.")

    def tolerances(self) -> Tolerances:
        """Return what may deviate as the library takes it."""
        from cellwright.solvers.plan_verification import Tolerances

        return Tolerances(
            step=self.step_m,
            step_angle=self.step_rad,
            limit_share=self.limit_tolerance,
            position=self.position_tolerance_m,
            angle=self.angle_tolerance_rad,
        )


@stage(version=3)
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

    from cellwright.errors import InvalidInputError
    from cellwright.solvers import plan_verification as verification
    from cellwright.solvers.pose_tasks.verification import NO_OWN_STOP, check_tasks, is_own_work
    from cellwright.solvers.torque_verification import check_torques
    from schemas.cell_objects import build_cell
    from schemas.plan_objects import verification_of
    from schemas.task_objects import MOTION, WORK, pose_tasks, timed_plan

    if not (np.all(sequence.alternative < len(alternatives.task)) and np.all(sequence.task < len(tasks.name))):
        raise InvalidInputError(
            "the sequence names alternatives or tasks that there are not: these do not belong together"
        )
    built, plan = build_cell(cell), timed_plan(sequence)
    if not params.from_start:
        built = replace(built, start=sequence.position_rad[0].copy())
    tolerances = params.tolerances()
    checks = verification.check_order(plan)
    kind = np.array(sequence.kind)
    own = is_own_work(kind == WORK, sequence.stop, len(sequence.task))
    strangers = np.flatnonzero(~own & (kind != MOTION))
    where = f"segment {strangers[0]}, at {sequence.start_s[strangers[0]]:.3f} s" if len(strangers) else ""
    checks.append(verification.Check(NO_OWN_STOP, float(len(strangers)), 0.0, "segments", where))
    verification.require(checks)
    limits = verification.check_limits(plan, built, tolerances, returns=params.returns and params.end_rad is None)
    if params.by_torque:
        if not params.keep_accelerations:
            limits = [check for check in limits if "acceleration" not in check.name]
        payload = None if params.payload is None else params.payload.payload()
        limits.append(check_torques(plan, built, payload, tolerances))
    checks += limits
    end = None if params.end_rad is None else np.array(params.end_rad)
    checks += check_tasks(plan, built, pose_tasks(tasks), _stops(sequence, own), tasks.before, tolerances, end)
    verification.require(checks)
    # without strokes nothing may touch at all
    touching = own & (tasks.approach_m[sequence.task[np.where(own, sequence.stop, 0)]] > 0.0)
    proof, engine = _proof(sequence, built, touching, params, progress)
    checks += proof.checks
    verification.require(checks)
    return verification_of(checks, proof, engine)


def _stops(sequence: TaskSequence, own: BoolArray) -> Stops:
    """Return when each task is worked on; without a segment of its own it begins and ends at the pose."""
    from cellwright.solvers.pose_tasks.verification import Stops

    begin, end = sequence.arrive_s.copy(), sequence.leave_s.copy()
    begin[sequence.stop[own]] = sequence.start_s[own]
    end[sequence.stop[own]] = sequence.end_s[own]
    return Stops(sequence.task, begin, end, sequence.arrive_s, sequence.leave_s)


def _proof(
    sequence: TaskSequence, built: Cell, touching: BoolArray, params: SequenceVerifyParams, progress: Progress
) -> tuple[CollisionProof, str]:
    """Check for collisions, ``touching`` segments in the cell in which bodies may touch; name the engine."""
    from cellwright.cell.verification_scene import VerificationScene
    from cellwright.solvers.pose_tasks.verification import joined_proof
    from schemas.task_objects import at_work, runs_of, timed_plan

    runs = runs_of(touching.tolist() if params.touches else [False] * len(touching))
    cells = {False: built, True: at_work(built, params.touches)}
    scenes = {works: VerificationScene(cells[works]) for works in {works for works, _ in runs}}
    proof = joined_proof(
        [(timed_plan(sequence, run), cells[works], scenes[works]) for works, run in runs],
        params.tolerances(),
        progress,
    )
    return proof, next(iter(scenes.values())).engine
