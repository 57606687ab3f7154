"""Execute the plan virtually: the scanner's profiles along every sweep, by ray casting.

Profiles are taken at the scanner's rate, from the poses that the joints have at these times: the cubic Hermite curve
of the trajectory through forward kinematics, not the ideal sweep. The part and whatever stands in the world (table,
obstacles) block the rays; only points on the part are kept. Connections measure nothing.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from cellwright.cell.scanner import Scanner
from cellwright.errors import InvalidInputError
from schemas.motion import ScanCloud, Trajectory
from schemas.part import PartMesh, Surroundings
from schemas.poses import Pose
from schemas.scanner import SensingParams
from schemas.sources import CellModel
from schemas.stage import Progress, no_progress, stage

_MOST_RAYS = 20_000_000
"""More need over 2 GB while they are kept."""


class ScanParams(SensingParams):
    """Settings of the scan simulation."""

    T_world_part: Pose = Field(default=Pose(), description="Pose of the part in the world.")
    noise: bool = Field(
        default=False, description="Add normal noise along the laser rays, one predicted uncertainty as deviation."
    )
    seed: int = Field(default=0, ge=0, description="Seed of the noise.")


@stage(version=1)
def simulate_scan(
    cell: CellModel,
    mesh: PartMesh,
    surroundings: Surroundings,
    trajectory: Trajectory,
    *,
    params: ScanParams,
    progress: Progress = no_progress,
) -> ScanCloud:
    """Return what the scanner measures along the trajectory, in the frame `part`.

    Raises:
        InvalidInputError: If the trajectory does not belong to the cell, or the scanner would take more points than
            can be handled.
    """
    from cellwright.cell.transforms import quaternion_from_rotation
    from cellwright.solvers.hermite import states_at
    from cellwright.solvers.scan_simulation import (
        PartSurface,
        profile_times,
        scanner_poses,
        simulate_profiles,
    )
    from schemas.cell_objects import build_cell
    from schemas.sweep_objects import occluder_of

    T_world_part = params.T_world_part.matrix()
    built = build_cell(cell, mesh, T_world_part)
    sweeps = np.flatnonzero(np.array(trajectory.kind) == "sweep")
    scanner = params.scanner.scanner()
    _check_number_of_rays(scanner, float((trajectory.end_s[sweeps] - trajectory.start_s[sweeps]).sum()))
    times, sweep = profile_times(trajectory.start_s[sweeps], trajectory.end_s[sweeps], scanner.profile_rate)
    if len(times):
        q, _ = states_at(trajectory.time_s, trajectory.position_rad, trajectory.velocity_rad_s, times)
        T_part_scanner = scanner_poses(built, T_world_part, q)
    else:
        T_part_scanner = np.empty((0, 4, 4))
    found = simulate_profiles(
        scanner,
        params.max_uncertainty_m,
        occluder_of(mesh, surroundings),
        PartSurface(mesh.normals, mesh.two_sided),
        T_part_scanner[:, :3, 3],
        T_part_scanner[:, :3, :3],
        rng=np.random.default_rng(params.seed) if params.noise else None,
        progress=progress,
    )
    return ScanCloud(
        points_m=found.points.astype(np.float32),
        uncertainty_m=found.uncertainty,
        face=found.face,
        profile=found.profile,
        time_s=times,
        position_m=T_part_scanner[:, :3, 3],
        quaternion=quaternion_from_rotation(T_part_scanner[:, :3, :3]),
        segment=sweeps[sweep].astype(np.int32),
    )


def _check_number_of_rays(scanner: Scanner, scanning_s: float) -> None:
    n_rays = scanner.profile_rate * scanner.points_per_profile * scanning_s
    if n_rays > _MOST_RAYS:
        raise InvalidInputError(
            f"{scanner.points_per_profile} points a profile at {scanner.profile_rate:g} Hz in {scanning_s:.1f} s of "
            f"scanning are {n_rays:.3g} points but at most {_MOST_RAYS:.3g} can be handled: lower "
            "points_per_profile or profile_rate_hz, or raise scan_speed_m_s"
        )
