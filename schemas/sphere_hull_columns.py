"""Pack fitted hulls into the columns of a `SphereHull`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from cellwright.solvers.spheres.fitting import SphereFit


LENGTHS = ("protrusion_mean", "protrusion_p95", "protrusion_max", "gap_mean", "gap_p95", "gap_max")
"""Lengths of a hull's metrics; their columns end in ``_m``."""


def hull_columns(names: Sequence[str], fits: Sequence[Sequence[SphereFit]]) -> dict[str, Any]:
    """Return the columns of bodies, spheres and trials.

    ``fits`` holds, for each body, the hull that is kept and then those of other numbers; none for a body left out.
    """
    kept = [found[0] if found else None for found in fits]
    counts = np.array([len(fit.radii) if fit else 0 for fit in kept], np.int32)
    there = [fit for fit in kept if fit]
    trials = [(row, place == 0, fit) for row, found in enumerate(fits) for place, fit in enumerate(found)]
    measured = [fit.metrics for _, _, fit in trials]
    return {
        "body": tuple(names),
        "first_sphere": (np.cumsum(counts) - counts).astype(np.int32),
        "n_spheres": counts,
        "surface_covered": np.array([fit is not None and fit.surface_covered for fit in kept]),
        "interior": tuple(fit.interior if fit else "not covered" for fit in kept),
        "volume_kind": tuple(fit.volume_kind if fit else "" for fit in kept),
        "margin_m": np.array([fit.margin if fit else 0.0 for fit in kept]),
        "centre_m": np.concatenate([fit.centres for fit in there]),
        "radius_m": np.concatenate([fit.radii for fit in there]),
        "overshoot_m": np.concatenate([fit.overshoot for fit in there]),
        "trial_body": np.array([row for row, _, _ in trials], np.int32),
        "trial_n_spheres": np.array([found.n_spheres for found in measured], np.int32),
        "trial_chosen": np.array([chosen for _, chosen, _ in trials]),
        "coverage": np.array([found.coverage for found in measured]),
        **{f"{name}_m": np.array([getattr(found, name) for found in measured]) for name in LENGTHS},
        "overshoot_max_m": np.array([found.overshoot for found in measured]),
        "volume_m3": np.array([found.volume for found in measured]),
        "volume_ratio": np.array([found.volume_ratio for found in measured]),
    }
