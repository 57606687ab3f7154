"""What a light-section scanner measures from given poses: one fan of rays a profile (Kaiser 2021, section 3.2).

Each laser ray ends on the first face that it meets. That point is measured if the face belongs to the part, lies
between the working distances, turns its front to emitter and detector within the permitted incidence, is certain
enough, and is seen by the detector. Cost: about 0.3 us a laser ray on one core.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numba
import numpy as np

from cellwright.arrays import AnyArray, Float32Array, FloatArray, Int32Array
from cellwright.cell.bounding_volumes import MISS, trace_rays
from cellwright.cell.cell import Cell
from cellwright.cell.occlusion import Occluder, trace_segments
from cellwright.cell.scanner import Scanner
from cellwright.cell.transforms import inverse
from cellwright.errors import InvalidInputError
from cellwright.solvers.measurability import sensor_limits
from cellwright.threads import map_slices

_PROFILES_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class PartSurface:
    """The faces that can be measured: the first ones of the occluder.

    Attributes:
        normals: Outward unit normals, (faces, 3).
        two_sided: Whether both sides of a face can be measured.
    """

    normals: FloatArray
    two_sided: bool


@dataclass(frozen=True, eq=False)
class ScanPoints:
    """Measured points, by profile, then along the laser line.

    Attributes:
        points: (points, 3) in m.
        uncertainty: Predicted uncertainty, (points,) in m.
        face: Face of the part, (points,).
        profile: Row of the poses, (points,).
    """

    points: FloatArray
    uncertainty: Float32Array
    face: Int32Array
    profile: Int32Array


def simulate_profiles(
    scanner: Scanner,
    max_uncertainty: float,
    occluder: Occluder,
    surface: PartSurface,
    position: FloatArray,
    rotation: FloatArray,
    *,
    rng: np.random.Generator | None = None,
    n_threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> ScanPoints:
    """Take one profile at each pose.

    Args:
        scanner: The sensor model; its rays are spread over the fan at equal angles, both borders included.
        max_uncertainty: Largest permitted uncertainty, m.
        occluder: What stands in the way; its first faces are those of ``surface``.
        surface: The part.
        position: Origins of the laser-emitter frame, (profiles, 3) in m.
        rotation: Its axes as columns, (profiles, 3, 3).
        rng: Adds noise along the laser ray if given: normal, its standard deviation the predicted uncertainty, which
            Scott 2009 defines as that of the measured range (a standard uncertainty, coverage factor 1).
        n_threads: Threads; ``None`` takes the cores that the process may use.
        progress: Called with the share done.
    """
    angles = np.linspace(-scanner.aperture / 2, scanner.aperture / 2, scanner.points_per_profile)
    # own copies: numba would compile the kernel again for read-only arrays
    position, rotation = np.array(position, float, order="C"), np.array(rotation, float, order="C")
    normals = np.array(surface.normals, float, order="C")
    limits = sensor_limits(scanner, max_uncertainty)
    work = partial(_profile_slice, limits, occluder, normals, surface.two_sided, np.tan(angles), position, rotation)
    parts = []
    for part in map_slices(work, len(position), _PROFILES_AT_ONCE, n_threads=n_threads):
        parts.append(part)
        if progress is not None:
            progress(min(1.0, len(parts) * _PROFILES_AT_ONCE / len(position)))
    points = np.concatenate([np.empty((0, 3)), *(part[0] for part in parts)])
    uncertainty = np.concatenate([np.empty(0), *(part[1] for part in parts)])
    face = np.concatenate([np.empty(0, np.int32), *(part[2] for part in parts)])
    profile = np.concatenate([np.empty(0, np.int32), *(part[3] for part in parts)])
    if rng is not None:
        rays = points - position[profile]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        points = points + rays * (uncertainty * rng.standard_normal(len(points)))[:, None]
    return ScanPoints(points, uncertainty.astype(np.float32), face, profile)


def profile_times(start: FloatArray, end: FloatArray, rate: float) -> tuple[FloatArray, Int32Array]:
    """Return the times of the profiles of a scanner that runs freely at ``rate`` Hz, and the interval of each.

    Args:
        start, end: Intervals in which profiles are kept, (intervals,) in s; each includes both its ends.
        rate: Profiles a second; one is taken at time 0.
    """
    first = np.ceil(start * rate - 1e-9).astype(np.int64)
    last = np.floor(end * rate + 1e-9).astype(np.int64)
    times = [np.clip(np.arange(i, j + 1) / rate, a, b) for i, j, a, b in zip(first, last, start, end, strict=True)]
    interval = np.repeat(np.arange(len(start), dtype=np.int32), [len(some) for some in times])
    return np.concatenate([np.empty(0), *times]), interval


def scanner_poses(cell: Cell, T_world_part: FloatArray, q: FloatArray) -> FloatArray:
    """Return the poses of the laser-emitter frame in the part, (states, 4, 4), at ``q`` (states, joints) in rad.

    Raises:
        InvalidInputError: If ``q`` has another number of joints than the robot.
    """
    from cellwright.cell.chain_kinematics import flange_poses

    chain = cell.robot.chain
    if q.shape[1] != len(chain.axis):
        raise InvalidInputError(
            f"the trajectory moves {q.shape[1]} joints but the robot has {len(chain.axis)}: plan it for this cell"
        )
    T_base_flange = flange_poses(chain.T_parent_joint, chain.axis, chain.T_last_flange, np.array(q, float, order="C"))
    return np.asarray(inverse(T_world_part) @ cell.T_world_base @ T_base_flange @ cell.T_flange_scanner)


def _profile_slice(
    limits: tuple[float, ...],
    occluder: Occluder,
    normals: FloatArray,
    two_sided: bool,
    slopes: FloatArray,
    position: FloatArray,
    rotation: FloatArray,
    rows: slice,
) -> tuple[AnyArray, ...]:
    n_rays = (rows.stop - rows.start) * len(slopes)
    points, uncertainty = np.empty((n_rays, 3)), np.empty(n_rays)
    face, profile = np.empty(n_rays, np.int32), np.empty(n_rays, np.int32)
    n = _profile_kernel(
        limits,
        occluder.tree,
        occluder.contact,
        normals,
        two_sided,
        slopes,
        position,
        rotation,
        rows.start,
        rows.stop,
        points,
        uncertainty,
        face,
        profile,
    )
    return points[:n].copy(), uncertainty[:n].copy(), face[:n].copy(), profile[:n].copy()


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _profile_kernel(  # type: ignore[no-untyped-def]
    limits,
    tree,
    contact,
    normals,
    two_sided,
    slopes,
    position,
    rotation,
    begin,
    end,
    out_point,
    out_uncertainty,
    out_face,
    out_profile,
):
    """Take the profiles ``begin`` to ``end``; returns how many points were written."""
    z_min, z_max, _, cos_min, constant, quadratic, u_max, baseline = limits
    n_rays, n_faces = len(slopes), len(normals)
    starts, along = np.empty((n_rays, 3)), np.empty((n_rays, 3))
    near, far, hit = np.empty(n_rays), np.empty(n_rays), np.empty(n_rays, np.int32)
    face, uncertainty = np.empty(n_rays, np.int32), np.empty(n_rays)
    n = 0
    for i in range(begin, end):
        x, y, z = rotation[i, :, 0], rotation[i, :, 1], rotation[i, :, 2]
        for ray in range(n_rays):  # t is the standoff, as the component of a direction along z is 1
            starts[ray] = position[i]
            for k in range(3):
                along[ray, k] = z[k] + slopes[ray] * y[k]
            near[ray], far[ray] = 0.0, z_max
        trace_rays(tree, n_rays, starts, along, near, far, False, hit)
        n_lit = 0
        for ray in range(n_rays):
            standoff = far[ray]
            if hit[ray] == MISS or standoff < z_min or tree.face[hit[ray]] >= n_faces:
                continue
            found = tree.face[hit[ray]]
            length = math.sqrt(1.0 + slopes[ray] * slopes[ray])
            facing = offset = 0.0
            for k in range(3):
                facing -= normals[found, k] * along[ray, k]
                offset += normals[found, k] * x[k]
            if two_sided and facing < 0:
                facing, offset = -facing, -offset
            cos_emitter = facing / length
            reach = math.sqrt(standoff * standoff * length * length + baseline * baseline)
            cos_detector = (facing * standoff - baseline * offset) / reach
            if not (cos_emitter >= cos_min and cos_detector >= cos_min):
                continue
            predicted = (constant + quadratic * standoff * standoff) / cos_emitter
            if predicted > u_max:
                continue
            for k in range(3):
                starts[n_lit, k] = position[i, k] + standoff * along[ray, k]
            face[n_lit], uncertainty[n_lit] = found, predicted
            n_lit += 1
        for j in range(n_lit):
            for k in range(3):
                along[j, k] = position[i, k] - baseline * x[k] - starts[j, k]
        trace_segments(tree, contact, n_lit, starts, along, near, far, hit)
        for j in range(n_lit):
            if hit[j] == MISS:
                out_point[n] = starts[j]
                out_uncertainty[n], out_face[n], out_profile[n] = uncertainty[j], face[j], i
                n += 1
    return n
