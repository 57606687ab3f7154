"""The torques of a timed motion at its states, by inverse dynamics of the URDF's masses and a payload on the flange.

A state's own acceleration counts, but where the arm stands still just before or just after the state, the torque that
holds it: a motion that has slowed down for a dwell still has its acceleration in the state in which the dwell begins,
and a line from there to the next state would be wrong for as long as the arm stands. Pinocchio's recursive Newton-Euler
algorithm, one or two microseconds a state.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellwright.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from cellwright.cell.symbolic_dynamics import SymbolicDynamics
    from cellwright.solvers.path_timing import TimedMotion

STILL = 1e-6
"""rad/s or m/s: far above rounding, and what any motion has left behind some microseconds after it begins."""


def state_torques(dynamics: SymbolicDynamics, motion: TimedMotion) -> FloatArray:
    """Return the torques (states, joints) in N m, on slides the forces in N, at the states of a motion.

    Args:
        dynamics: The arm with its payload.
        motion: The motion; coordinates beyond the arm's joints are left out.
    """
    n = dynamics.n_joints
    acceleration = np.where(stands_still(motion)[:, None], 0.0, motion.acceleration[:, :n])
    return dynamics.torques(motion.position[:, :n], motion.velocity[:, :n], acceleration)


def stands_still(motion: TimedMotion) -> BoolArray:
    """Return whether the arm stands still just before or just after each state, (states,)."""
    at_rest = np.all(np.abs(motion.velocity) <= STILL, axis=1)
    pace = np.abs(np.diff(motion.position, axis=0)) / np.diff(motion.time)[:, None]
    still = at_rest[:-1] & at_rest[1:] & np.all(pace <= STILL, axis=1)  # (intervals,)
    return np.asarray(np.append(still, False) | np.append(False, still))
