"""Set up the candidate sweeps: a grid of tilts and standoffs at every surface sample (Kaiser 2021, section 4.2)."""

from __future__ import annotations

import math

from pydantic import Field, field_validator

from cellwright.errors import InvalidInputError
from schemas.params import Params
from schemas.part import SurfaceSamples
from schemas.stage import stage
from schemas.views import Viewpoints

_THIRD = math.radians(120.0)
_TILT = math.radians(45.0)
_STRIP_M2 = 0.1
"""What one sweep sees at most: a laser line of 0.1 m along a part of 1 m."""
_MOST_MEASUREMENTS = 200_000_000
"""Pairs of sweep and sample; twice those of half a million samples a square metre on a plate as large as a page,
which take 3 GB and minutes."""


class ViewpointParams(Params):
    """Settings of viewpoint sampling; ``(0,)`` for all three angles is the paper's planning without tilts."""

    standoff_m: tuple[float, ...] = Field(
        default=(0.182,), min_length=1, description="Distances from the sample along the viewing axis."
    )
    delta_rot_rad: tuple[float, ...] = Field(
        default=(0.0, _THIRD, 2 * _THIRD), min_length=1, description="Rotations about the viewing axis z."
    )
    theta_tilt_rad: tuple[float, ...] = Field(
        default=(-_TILT, 0.0, _TILT), min_length=1, description="Tilts about the sweep's axis x."
    )
    psi_tilt_rad: tuple[float, ...] = Field(
        default=(-_TILT, 0.0, _TILT), min_length=1, description="Tilts about the laser line y."
    )

    @field_validator("standoff_m")
    @classmethod
    def _positive(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if min(value) <= 0:
            raise ValueError(f"standoff {min(value)} m is not positive")
        return value

    @field_validator("theta_tilt_rad", "psi_tilt_rad")
    @classmethod
    def _in_front(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        worst = max(value, key=abs)
        if abs(worst) >= math.pi / 2:
            raise ValueError(f"tilt {worst:.4g} rad looks along the surface or from behind: stay below pi/2")
        return value


@stage(version=1)
def sample_viewpoints(samples: SurfaceSamples, *, params: ViewpointParams) -> Viewpoints:
    """Return one candidate sweep for each sample, standoff and tilt, sample by sample.

    Raises:
        InvalidInputError: If there are more candidates than can be handled.
    """
    from cellwright.cell.transforms import quaternion_from_rotation
    from cellwright.solvers.viewpoints import TiltGrid, candidate_poses

    grid = TiltGrid(params.standoff_m, params.delta_rot_rad, params.theta_tilt_rad, params.psi_tilt_rad)
    _check_number(samples, len(grid.combinations()))
    poses = candidate_poses(samples.points_m, samples.normals, grid)
    return Viewpoints(
        sample=poses.sample,
        position_m=poses.position,
        quaternion=quaternion_from_rotation(poses.rotation),
        delta_rot_rad=poses.tilt[:, 1],
        theta_tilt_rad=poses.tilt[:, 2],
        psi_tilt_rad=poses.tilt[:, 3],
        standoff_m=poses.tilt[:, 0],
    )


def _check_number(samples: SurfaceSamples, n_directions: int) -> None:
    n_samples = len(samples.points_m)
    n_measurements = n_samples * n_directions * min(n_samples, math.ceil(_STRIP_M2 * samples.density_per_m2))
    if n_measurements > _MOST_MEASUREMENTS:
        raise InvalidInputError(
            f"{n_samples} samples with {n_directions} tilts and standoffs each are {n_samples * n_directions} "
            f"candidate sweeps and up to {n_measurements:.2g} measurements, but at most {_MOST_MEASUREMENTS:.2g} can "
            "be handled: lower density_per_m2 or leave out tilts"
        )
