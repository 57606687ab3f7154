"""Candidate sweeps: for each surface sample a grid of scanner poses that look at it (Kaiser 2021, section 4.2).

A laser-emitter frame is set on the sample with z along the negative normal, turned about its own z, x and y axes by
the tilt angles, and drawn back along its z axis by the standoff. Before turning, its x axis is the coordinate axis that
is least aligned with the normal, projected into the tangent plane: the frame is a function of the normal alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellwright.arrays import FloatArray, Int32Array


@dataclass(frozen=True, eq=False)
class TiltGrid:
    """The poses that are tried at every sample: all combinations, angles in rad, standoffs in m."""

    standoff: tuple[float, ...]
    delta: tuple[float, ...]
    theta: tuple[float, ...]
    psi: tuple[float, ...]

    def combinations(self) -> FloatArray:
        """Return (tilts, 4): standoff, delta, theta, psi; the last varies fastest."""
        axes = np.meshgrid(self.standoff, self.delta, self.theta, self.psi, indexing="ij")
        return np.stack([axis.ravel() for axis in axes], axis=1)


@dataclass(frozen=True, eq=False)
class CandidatePoses:
    """Candidate sweeps at travel 0, one row each, sample by sample.

    Attributes:
        sample: Sample that the sweep was made for, (views,).
        position: Origin of the laser-emitter frame, (views, 3) in m.
        rotation: Its axes as columns, (views, 3, 3).
        tilt: Standoff in m, delta, theta and psi in rad, (views, 4).
    """

    sample: Int32Array
    position: FloatArray
    rotation: FloatArray
    tilt: FloatArray


def untilted_frames(normals: FloatArray) -> FloatArray:
    """Return rotations (samples, 3, 3) whose z axis is the negative normal; ``normals`` (samples, 3), unit length."""
    normals = np.asarray(normals, float)
    least = np.argmin(np.abs(normals), axis=1)
    x = np.eye(3)[least] - normals * np.take_along_axis(normals, least[:, None], axis=1)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(-normals, x), -normals], axis=2)


def tilt_rotations(tilts: FloatArray) -> FloatArray:
    """Return ``Rz(delta) Rx(theta) Ry(psi)``, (tilts, 3, 3), of ``tilts`` (tilts, 3) in rad."""
    (cd, ct, cp), (sd, st, sp) = np.cos(tilts).T, np.sin(tilts).T
    rows = [
        [cd * cp - sd * st * sp, -sd * ct, cd * sp + sd * st * cp],
        [sd * cp + cd * st * sp, cd * ct, sd * sp - cd * st * cp],
        [-ct * sp, st, ct * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def candidate_poses(points: FloatArray, normals: FloatArray, grid: TiltGrid) -> CandidatePoses:
    """Return the poses of all samples and tilts.

    Args:
        points: Samples, (samples, 3) in m.
        normals: Outward unit normals, (samples, 3).
        grid: Tilts and standoffs.
    """
    tilts = grid.combinations()
    rotation = untilted_frames(normals)[:, None] @ tilt_rotations(tilts[:, 1:])[None]  # (samples, tilts, 3, 3)
    position = np.asarray(points, float)[:, None] - tilts[None, :, :1] * rotation[..., 2]
    n_samples, n_tilts = len(points), len(tilts)
    return CandidatePoses(
        sample=np.repeat(np.arange(n_samples, dtype=np.int32), n_tilts),
        position=position.reshape(-1, 3),
        rotation=rotation.reshape(-1, 3, 3),
        tilt=np.tile(tilts, (n_samples, 1)),
    )
