"""Between the artefacts of reachability and the library: which sweeps to follow, what following found."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import BoolArray, FloatArray
from cellwright.cell.transforms import pose, rotation_from_quaternion
from cellwright.errors import InvalidInputError
from schemas.part import SurfaceSamples
from schemas.views import Measurability, Reachability, Viewpoints

if TYPE_CHECKING:
    from cellwright.solvers.sweeps.following import FollowedSweeps
    from cellwright.solvers.sweeps.poses import CandidateSweeps


def entry_travel(
    viewpoints: Viewpoints, measurability: Measurability, points_m: FloatArray, known: BoolArray
) -> FloatArray:
    """Return the travel (entries,) in m at which each entry's view measures its sample; NaN where it is not known.

    ``points_m`` (samples, 3) in the frame `part`; ``known`` (samples,).
    """
    axis = rotation_from_quaternion(viewpoints.quaternion)[:, :, 0]
    away = points_m[measurability.sample] - viewpoints.position_m[measurability.view]
    travel = np.einsum("ij,ij->i", away, axis[measurability.view])
    return np.where(known[measurability.sample], travel, np.nan)


def check_belong(viewpoints: Viewpoints, measurability: Measurability, samples: SurfaceSamples | None = None) -> None:
    """Check that views and samples of a measurability are rows of the other artefacts.

    Raises:
        InvalidInputError: If not.
    """
    n_views, n_samples = len(viewpoints.sample), len(measurability.cause)
    if len(measurability.start_m) != n_views:
        raise InvalidInputError(
            f"measurability has {len(measurability.start_m)} views but there are {n_views} viewpoints: "
            "these do not belong together"
        )
    if samples is not None and len(samples.points_m) != n_samples:
        raise InvalidInputError(
            f"measurability has {n_samples} samples but the surface has {len(samples.points_m)}: "
            "these do not belong together"
        )
    for name, rows, count in (("view", measurability.view, n_views), ("sample", measurability.sample, n_samples)):
        if len(rows) and not (int(rows.min()) >= 0 and int(rows.max()) < count):
            raise InvalidInputError(
                f"measurability names {name} {int(rows.max())} of {count}: these do not belong together"
            )


def sweeps_to_follow(viewpoints: Viewpoints, measurability: Measurability, T_world_part: FloatArray) -> CandidateSweeps:
    """Return all views as sweeps in the world.

    The surface itself is not needed: each view looks at its own sample, so the views give away where samples are.
    A sample without a view of its own counts at the ends of the useful interval only.

    Raises:
        InvalidInputError: If the two artefacts do not belong together.
    """
    from cellwright.solvers.sweeps.poses import CandidateSweeps, sort_within

    check_belong(viewpoints, measurability)
    R = rotation_from_quaternion(viewpoints.quaternion)
    n_samples = len(measurability.cause)
    own = np.flatnonzero((viewpoints.sample >= 0) & (viewpoints.sample < n_samples))
    points, known = np.zeros((n_samples, 3)), np.zeros(n_samples, bool)
    points[viewpoints.sample[own]] = (viewpoints.position_m + viewpoints.standoff_m[:, None] * R[:, :, 2])[own]
    known[viewpoints.sample[own]] = True
    travel = entry_travel(viewpoints, measurability, points, known)
    sure = np.isfinite(travel)
    useful = np.flatnonzero(np.isfinite(measurability.start_m))
    # the ends of the interval stand for samples of unknown place, once for each view that has such
    unsure = np.intersect1d(useful, measurability.view[~sure])
    view = np.concatenate([measurability.view[sure], unsure, unsure])
    travel = np.concatenate([travel[sure], measurability.start_m[unsure], measurability.end_m[unsure]])
    if np.any(view[1:] < view[:-1]):
        order = np.argsort(view, kind="stable")
        view, travel = view[order], travel[order]
    sort_within(np.searchsorted(view, np.arange(len(viewpoints.sample) + 1)), travel)
    return CandidateSweeps(
        T_world_part @ pose(viewpoints.position_m, R),
        measurability.start_m,
        measurability.end_m,
        view.astype(np.int32),
        travel,
    )


def reachability_of(followed: FollowedSweeps, body: tuple[str, ...]) -> Reachability:
    """Return the artefact of followed sweeps; ``body``: names of the bodies in the cell."""
    return Reachability(
        view=followed.sweep,
        branch=followed.branch,
        start_m=followed.start,
        end_m=followed.end,
        q_start_rad=followed.q_start,
        outcome=followed.outcome,
        blocked_by=followed.blocked_by,
        body=body,
        n_exact_checks=followed.n_exact_checks,
        n_unsettled=followed.n_unsettled,
    )
