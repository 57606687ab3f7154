"""Take the sequenced plan where it is cheaper, else the stitched one: either is a trajectory like any other."""

from __future__ import annotations

from dataclasses import replace

from schemas.motion import Trajectory
from schemas.params import Params
from schemas.sequencing import MOTION_COLUMNS, SweepSequence
from schemas.stage import stage


class TakenSequenceParams(Params):
    """Settings of the choice: none, the cost has decided."""


@stage(version=1)
def take_sequence(sequence: SweepSequence, trajectory: Trajectory, *, params: TakenSequenceParams) -> Trajectory:
    """Return the plan that costs less, with all orders that were compared.

    The bound of the stitched orders says nothing of a plan with other motions, so that the new one has none.
    """
    import numpy as np

    if not sequence.is_taken:
        return trajectory
    return replace(
        trajectory,
        **{column: getattr(sequence, column) for column in MOTION_COLUMNS},
        order_method=(*trajectory.order_method, sequence.name),
        order_duration_s=np.append(trajectory.order_duration_s, sequence.time_s[-1]),
        order_chosen=np.append(np.zeros(len(trajectory.order_method), bool), True),
        order_lower_bound_s=0.0,
        order_proven=False,
    )
