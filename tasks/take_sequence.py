"""Take the sequenced plan where it is cheaper, else the stitched one: either is a trajectory like any other.

Where the sequence was found by dynamics, the plan's torques come with it, whichever plan it is.
"""

from __future__ import annotations

from dataclasses import replace

from pydantic import Field

from schemas.motion import Trajectory
from schemas.params import Params
from schemas.sequencing import MOTION_COLUMNS, SweepSequence
from schemas.stage import stage


class TakenSequenceParams(Params):
    """Settings of the choice: the cost has decided, unless its plan failed."""

    keep_stitched: bool = Field(default=False, description="Whether the stitched plan stays although it costs more.")


@stage(version=1)
def take_sequence(sequence: SweepSequence, trajectory: Trajectory, *, params: TakenSequenceParams) -> Trajectory:
    """Return the plan that costs less, with all orders that were compared, or the stitched one as it is.

    The bound of the stitched orders says nothing of a plan with other motions, so that the new one has none.
    """
    import numpy as np

    if params.keep_stitched or not sequence.is_taken:
        torques = sequence.stitched_torque_nm
        return replace(trajectory, torque_nm=torques) if len(torques) else trajectory
    return replace(
        trajectory,
        **{column: getattr(sequence, column) for column in MOTION_COLUMNS},
        order_method=(*trajectory.order_method, sequence.name),
        order_duration_s=np.append(trajectory.order_duration_s, sequence.time_s[-1]),
        order_chosen=np.append(np.zeros(len(trajectory.order_method), bool), True),
        order_lower_bound_s=0.0,
        order_proven=False,
    )
