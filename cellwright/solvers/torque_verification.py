"""Check the torques of a timed plan by inverse dynamics of the URDF's masses and a payload on the flange.

As in `cellwright.solvers.plan_verification` the motion is read as the cubic Hermite curve through its states; each
interval is looked at at both ends and between, as accelerations may jump between intervals.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwright.cell.cell import Cell
from cellwright.solvers.hermite import interval_states
from cellwright.solvers.plan_verification import Check, TimedPlan, Tolerances

if TYPE_CHECKING:
    from cellwright.cell.symbolic_dynamics import Payload

TORQUE = "joint torque"
STATES = 4
"""States of each interval at which torques are looked at."""


def check_torques(plan: TimedPlan, cell: Cell, payload: Payload | None, tolerances: Tolerances) -> Check:
    """Check that no torque of the motion exceeds its limit.

    Raises:
        InvalidInputError: If the URDF states no masses or torque limits that make sense.
    """
    from cellwright.cell.serial_arm import SerialArm
    from cellwright.cell.symbolic_dynamics import symbolic_dynamics
    from cellwright.solvers.optimal_control.program import effort_limits

    dynamics = symbolic_dynamics(
        SerialArm.from_robot(cell.robot), payload=payload, T_world_base=np.asarray(cell.T_world_base)
    )
    limits = effort_limits(dynamics, None)
    u = np.linspace(0.0, 1.0, STATES)
    states = interval_states(plan.time, plan.position, plan.velocity, u)
    n_joints = plan.position.shape[1]
    share = np.abs(dynamics.torques(*(each.reshape(-1, n_joints) for each in states))) / limits
    row, joint = np.unravel_index(int(np.argmax(np.nan_to_num(share, nan=np.inf))), share.shape)
    interval, part = divmod(int(row), STATES)
    when = float(plan.time[interval] + u[part] * (plan.time[interval + 1] - plan.time[interval]))
    where = f"at {when:.3f} s in joint {int(joint) + 1}"
    return Check(TORQUE, float(share[row, joint]), 1.0 + tolerances.limit_share, "of its limit", where, time=when)
