from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cellwright.arrays import FloatArray
from cellwright.errors import InfeasibleError
from cellwright.solvers.motion_cost import CostedMotion
from cellwright.solvers.optimal_control.program import CostWeights
from cellwright.solvers.path_timing import Limits, TimedMotion, time_straight
from cellwright.solvers.sweeps.passing import ALL_ENDS, PASSING, STOPPING, PassedOption
from cellwright.solvers.sweeps.sequenced_plan import ControlledArm, ControlledPaths, SweepCosts, executable_options
from tests.cellwright.solvers.optimal_control.planar_arm import dynamics_of

DYNAMICS = dynamics_of("ur10e")
Q_A, Q_B = np.array([0.3, -1.2, 0.8, 0.2, 0.4, 0.1]), np.array([1.0, -0.6, 0.3, -0.4, 0.9, 0.5])


def arm(share: float) -> ControlledArm:
    return ControlledArm(DYNAMICS, share * DYNAMICS.max_effort, CostWeights(), 8)


def straight(acceleration: float) -> TimedMotion:
    return time_straight(Q_A, Q_B, Limits(DYNAMICS.max_velocity, np.full(6, acceleration)), 0.02)


class Planned:
    """Stands for planned paths: always the same one."""

    def __init__(self, motion: TimedMotion) -> None:
        self.planned = motion

    def bound(self, q_a: FloatArray, q_b: FloatArray) -> FloatArray:
        return np.zeros(np.broadcast_shapes(q_a.shape, q_b.shape)[:-1])

    def motion(self, q_a: FloatArray, q_b: FloatArray) -> CostedMotion:
        return CostedMotion(self.planned.duration, self.planned, None, "direct")


def paths(acceleration: float, controlled: ControlledArm) -> ControlledPaths:
    planned: Any = Planned(straight(acceleration))
    return ControlledPaths(planned, controlled)


def test_a_path_within_its_torques_stays_as_it_is_timed() -> None:
    found = paths(1.0, arm(1.0)).motion(Q_A, Q_B)
    assert found is not None and found.motion.duration == straight(1.0).duration
    assert found.cost == pytest.approx(arm(1.0).measure(straight(1.0)).cost)


def test_a_path_that_asks_for_too_much_torque_is_slowed_until_it_does_not() -> None:
    weak = arm(0.35)
    assert weak.measure(straight(20.0)).torque_share > 1.05
    found = paths(20.0, weak).motion(Q_A, Q_B)
    assert found is not None and found.motion.duration > 1.05 * straight(20.0).duration
    assert 0.95 < weak.measure(found.motion).torque_share <= 1.0 + 1e-6
    assert found.cost == pytest.approx(weak.measure(found.motion).cost)


def test_a_path_on_which_the_arm_cannot_be_held_is_none() -> None:
    assert paths(1.0, arm(0.1)).motion(Q_A, Q_B) is None


def option(hasty: bool) -> PassedOption:
    def motion(speed: float) -> TimedMotion:
        found = straight(speed)
        travel = np.linspace(0.0, 0.1, len(found.time))[:, None]
        return TimedMotion(
            found.time,
            np.hstack([found.position, travel]),
            np.hstack([found.velocity, 0.0 * travel]),
            np.hstack([found.acceleration, 0.0 * travel]),
        )

    motions = {ends: motion(20.0 if hasty or ends == PASSING else 1.0) for ends in ALL_ENDS}
    return PassedOption(0, (0, 0, ()), (0, 0), 0, 1, motions)


def test_ways_to_pass_a_sweep_that_torques_do_not_allow_are_left_out() -> None:
    sweeps: Any = [SimpleNamespace(name="sweep 1")]
    weak, strong = arm(0.35), arm(1.5)
    (kept,) = executable_options([option(False)], weak, SweepCosts(weak), Q_A, sweeps)
    assert set(kept.motions) == set(ALL_ENDS) - {PASSING} and STOPPING in kept.motions and not kept.passes
    (whole,) = executable_options([option(False)], strong, SweepCosts(strong), Q_A, sweeps)
    assert whole.passes


def test_a_sweep_that_no_torque_allows_is_named_with_what_it_asks_for() -> None:
    sweeps: Any = [SimpleNamespace(name="sweep 1")]
    weak = arm(0.35)
    with pytest.raises(
        InfeasibleError, match=r"allow no way to execute sweep 1: the easiest asks for 20\d% of a limit"
    ):
        executable_options([option(True)], weak, SweepCosts(weak), Q_A, sweeps)
