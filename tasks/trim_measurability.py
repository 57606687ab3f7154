"""Recompute what each view measures once it is cut to its best executable piece (Kaiser 2021, section 4.2)."""

from __future__ import annotations

from schemas.params import Params
from schemas.part import SurfaceSamples
from schemas.stage import stage
from schemas.views import Measurability, Reachability, Viewpoints


class TrimParams(Params):
    """Settings of the trimming stage: it has none."""


@stage(version=1)
def trim_measurability(
    samples: SurfaceSamples,
    viewpoints: Viewpoints,
    measurability: Measurability,
    reachability: Reachability,
    *,
    params: TrimParams,
) -> Measurability:
    """Keep the entries that a view's first piece measures.

    A sample that was measurable and is no more gets the furthest cause among the views that measured it; a view
    with a piece that ends before the sample counts as too short.

    Raises:
        InvalidInputError: If the inputs do not belong together.
    """
    import numpy as np

    from cellwright.errors import InvalidInputError
    from cellwright.solvers.sweeps.trimming import trim_entries
    from schemas.reach_objects import check_belong, entry_travel
    from schemas.sweep_objects import best_pieces

    check_belong(viewpoints, measurability, samples)
    n_views = len(viewpoints.sample)
    if len(reachability.outcome) != n_views:
        raise InvalidInputError(
            f"reachability has {len(reachability.outcome)} views but there are {n_views} viewpoints: "
            "these do not belong together"
        )
    first = best_pieces(reachability)
    start, end = np.full(n_views, np.nan), np.full(n_views, np.nan)
    start[reachability.view[first]] = reachability.start_m[first]
    end[reachability.view[first]] = reachability.end_m[first]
    trimmed = trim_entries(
        measurability.view,
        measurability.sample,
        entry_travel(viewpoints, measurability, samples.points_m, np.ones(len(samples.points_m), bool)),
        piece_start=start,
        piece_end=end,
        outcome=reachability.outcome,
        cause=measurability.cause,
    )
    return Measurability(
        view=measurability.view[trimmed.kept],
        sample=measurability.sample[trimmed.kept],
        uncertainty_m=measurability.uncertainty_m[trimmed.kept],
        start_m=trimmed.start,
        end_m=trimmed.end,
        cause=trimmed.cause,
    )
