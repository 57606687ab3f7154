"""Verify a plan with a second collision engine and against all its limits: a plan that fails is an error.

Independent of the planner: another collision engine (FCL on trimesh bodies), its own forward kinematics, and the
motion itself instead of what the planner thought it was. Steps are so small that no point of the robot moves
further than ``step_m`` and no joint turns more than ``step_rad`` between two checked states; that nothing touches
between them either is proven by distances, and the least distance of the whole motion is bounded from below.
Plans that were sequenced by dynamics are checked against torque limits too.
"""

from __future__ import annotations

import math

from pydantic import Field

from schemas.motion import Trajectory, Verification
from schemas.params import Params
from schemas.part import PartMesh
from schemas.payload import PayloadParams
from schemas.poses import Pose
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage
from schemas.views import Reachability, Viewpoints, ViewSelection


class VerifyParams(Params):
    """Settings of the verification stage."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    scan_speed_m_s: float = Field(default=0.1, gt=0, description="Speed that the scanner may have on a sweep.")
    tool_acceleration_m_s2: float = Field(default=1.0, gt=0, description="Acceleration that the scanner may have.")
    return_to_start: bool = Field(default=False, description="Whether the plan must end where it starts.")
    by_torque: bool = Field(default=False, description="Whether torques are checked as well.")
    payload: PayloadParams | None = Field(default=None, description="What the arm carries, where torques are checked.")
    step_m: float = Field(default=1e-3, gt=0, le=1e-3, description="Furthest motion of any point between states.")
    step_rad: float = Field(default=math.radians(0.1), gt=0, le=math.radians(0.1) * (1 + 1e-9))
    position_tolerance_m: float = Field(default=2e-4, gt=0, description="Scanner off its planned sweep.")
    angle_tolerance_rad: float = Field(default=math.radians(0.05), gt=0)
    limit_tolerance: float = Field(default=0.01, ge=0, lt=0.1, description="Share by which limits may be exceeded.")


@stage(version=3)
def verify_plan(
    cell: CellModel,
    mesh: PartMesh,
    viewpoints: Viewpoints,
    reachability: Reachability,
    selection: ViewSelection,
    trajectory: Trajectory,
    *,
    params: VerifyParams,
    progress: Progress = no_progress,
) -> Verification:
    """Check that the plan can run and does what was selected.

    Every selected view that the trajectory does not leave out must be executed over the interval of its best piece in
    ``reachability``.

    Raises:
        InfeasibleError: If any check fails; it names the check, the time, the bodies and the amount.
        InvalidInputError: If the artefacts do not belong together, or torques are asked for and the URDF states no
            masses or torque limits.
    """
    from cellwright.cell.verification_scene import VerificationScene
    from cellwright.solvers import plan_verification as verification
    from cellwright.solvers.torque_verification import check_torques
    from schemas.cell_objects import build_cell
    from schemas.plan_objects import executed_views, planned_sweeps, timed_plan, verification_of

    selection = executed_views(selection, trajectory)
    built = build_cell(cell, mesh, params.T_world_part.matrix())
    sweeps = planned_sweeps(viewpoints, reachability, selection, params.T_world_part.matrix())
    plan = timed_plan(trajectory, selection)
    tolerances = verification.Tolerances(
        step=params.step_m,
        step_angle=params.step_rad,
        limit_share=params.limit_tolerance,
        position=params.position_tolerance_m,
        angle=params.angle_tolerance_rad,
    )
    checks = verification.check_order(plan)
    verification.require(checks)
    checks += verification.check_limits(plan, built, tolerances, returns=params.return_to_start)
    if params.by_torque:
        payload = None if params.payload is None else params.payload.payload()
        checks.append(check_torques(plan, built, payload, tolerances))
    checks += verification.check_sweeps(
        plan,
        built,
        sweeps,
        params.scan_speed_m_s,
        tolerances,
        max_acceleration=params.tool_acceleration_m_s2,
    )
    verification.require(checks)
    scene = VerificationScene(built)
    proof = verification.check_collisions(plan, built, scene, tolerances, progress)
    checks += proof.checks
    verification.require(checks)
    return verification_of(checks, proof, scene.engine)
