from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from cellwright.cell.built_in_robots import built_in_robot
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import track_pose
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.solvers.hermite import shares_of_limits
from cellwright.solvers.path_timing import Limits, TimedMotion
from cellwright.solvers.plan_verification import Check, ExecutedSegment, TimedPlan, Tolerances, check_sweeps
from cellwright.solvers.scanner_motion import scanner_acceleration, steps_that_bend
from cellwright.solvers.sweeps import alternatives as sweep_alternatives
from cellwright.solvers.sweeps.alternatives import SweepSettings, flange_targets, sweep_options, trace_sweep
from cellwright.solvers.sweeps.planned import ExecutablePiece, PlannedSweep

SPEED, ACCELERATION, SAMPLE, STEP, HALF_TRAVEL = 0.1, 1.0, 0.008, 0.002, 0.04
COARSE = Tolerances(step=0.01, step_angle=0.02)
ARMS = {
    "ur10e": (0.1, -1.8, 2.0, -1.77, -1.5, 0.3),
    "crx10ia_l": (0.1, 0.4, -0.3, 0.2, -1.2, 0.1),
    "irb6640": (0.1, 0.2, 0.1, 0.3, 1.0, 0.1),
}
"""A usual configuration of an arm with parallel axes, one with an offset wrist and one with a spherical wrist."""


@cache
def robot(name: str):
    return built_in_robot(name)


def cell_of(name: str, rpy=(0.0, 0.0, 0.0)) -> Cell:
    T_flange_scanner = pose(np.array([0.03, 0.0, 0.16]), rotation_from_rpy(*rpy))
    found = robot(name)
    return Cell(found, (), np.empty((0, 2), np.int32), np.eye(4), T_flange_scanner, np.zeros(found.chain.n_joints))


def limits_of(cell: Cell) -> Limits:
    return Limits(cell.robot.chain.max_velocity, cell.robot.chain.max_acceleration)


def how(cell: Cell) -> SweepSettings:
    return SweepSettings(limits_of(cell), SPEED, ACCELERATION, SAMPLE, STEP)


def sweep_through(cell: Cell, q_middle) -> PlannedSweep | None:
    """Return the sweep along the scanner's x axis whose middle is ``q_middle``; none if its start is not reached."""
    chain, q = cell.robot.chain, np.array(q_middle, float)
    T = cell.robot.flange_pose(q) @ cell.T_flange_scanner
    for target in flange_targets(cell, T, np.linspace(0.0, -HALF_TRAVEL, 161)):
        q, reached = track_pose(chain.T_parent_joint, chain.axis, chain.T_last_flange, q, target, 1e-9, 40)
        if not reached:
            return None
    piece = ExecutablePiece(0, -HALF_TRAVEL, HALF_TRAVEL, q)
    return PlannedSweep("sweep", T, (-HALF_TRAVEL, HALF_TRAVEL), (piece,))


def sweep_checks(cell: Cell, sweep: PlannedSweep, motion: TimedMotion) -> list[Check]:
    plan = TimedPlan(
        motion.time, motion.position[:, :-1], motion.velocity[:, :-1], motion.acceleration[:, :-1],
        np.zeros(len(motion.time), np.int32), motion.position[:, -1], (ExecutedSegment(0, 0.0, motion.duration),),
    )  # fmt: skip
    return check_sweeps(plan, cell, [sweep], SPEED, COARSE, max_acceleration=ACCELERATION)


def keeps_joint_limits(cell: Cell, motion: TimedMotion) -> bool:
    joints, limits = motion.of_first(cell.robot.chain.n_joints), limits_of(cell)
    shares = shares_of_limits(joints.time, joints.position, joints.velocity, limits.velocity, limits.acceleration)
    return bool(max(share.max() for share in shares) <= 1.01)


def failures(checks: list[Check]) -> list[str]:
    return [f"{check.name} {check.found:.5g} > {check.permitted:.5g}" for check in checks if not check.passed]


def plainly_timed(cell: Cell, sweep: PlannedSweep) -> TimedMotion | None:
    """Time the path in its usual trace and states, without a look at the scanner."""
    piece = sweep.pieces[0]
    path = trace_sweep(cell, sweep.T_world_scanner, piece.q_start, 0, piece.start, sweep.interval, STEP)
    return path and path.timed(limits_of(cell), SPEED, ACCELERATION, SAMPLE)


@pytest.mark.parametrize("name", ARMS)
@given(
    off=st.tuples(*[st.floats(-0.4, 0.4)] * 6),
    rpy=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    wrist=st.none() | st.floats(-0.2, 0.2),
)
@settings(max_examples=25, deadline=None)
def test_a_timed_sweep_passes_its_verification_near_singular_poses_too(name, off, rpy, wrist):
    cell = cell_of(name, rpy)
    q = np.add(ARMS[name], off)
    if wrist is not None:
        q[4] = wrist
    sweep = sweep_through(cell, q)
    assume(sweep is not None)
    for option in sweep_options(cell, sweep, 0, how(cell), 1):
        assert failures(sweep_checks(cell, sweep, option.motion)) == []
        assert keeps_joint_limits(cell, option.motion)


def singular_sweep() -> tuple[Cell, PlannedSweep]:
    """Axis 5 of the offset wrist passes through 0 on this sweep; the usual trace shakes the scanner there."""
    cell = cell_of("crx10ia_l", (1.83, -0.38, 1.59))
    sweep = sweep_through(cell, (-0.17, 0.52, -0.67, 0.57, 0.064, -0.17))
    assert sweep is not None
    return cell, sweep


def test_a_sweep_on_which_axis_5_passes_through_0_is_as_fast_as_before_and_passes_its_verification():
    cell, sweep = singular_sweep()
    plain = plainly_timed(cell, sweep)
    assert plain is not None and plain.position[:, 4].min() < 0.0 < plain.position[:, 4].max()
    shaking = {check.name: check.found for check in sweep_checks(cell, sweep, plain) if not check.passed}
    assert shaking == {"scanner acceleration on a sweep": pytest.approx(1.22, abs=0.02)}, "else nothing is tried here"
    for option in sweep_options(cell, sweep, 0, how(cell), 2):
        assert failures(sweep_checks(cell, sweep, option.motion)) == []
        assert keeps_joint_limits(cell, option.motion)
        assert option.motion.duration == pytest.approx(plain.duration, rel=0.01)


def test_a_sweep_that_cannot_be_traced_finer_is_slowed_until_it_passes(monkeypatch):
    cell, sweep = singular_sweep()
    plain = plainly_timed(cell, sweep)
    monkeypatch.setattr(sweep_alternatives, "steps_that_bend", lambda *a: np.empty(0))
    (option, _) = sweep_options(cell, sweep, 0, how(cell), 1)
    assert failures(sweep_checks(cell, sweep, option.motion)) == []
    assert plain.duration * 1.02 < option.motion.duration < plain.duration * 1.3


def test_a_path_that_is_straight_enough_is_not_traced_again():
    cell = cell_of("ur10e")
    sweep = sweep_through(cell, ARMS["ur10e"])
    (option, _) = sweep_options(cell, sweep, 0, how(cell), 1)
    plain = plainly_timed(cell, sweep)
    for name in ("time", "position", "velocity", "acceleration"):
        assert np.array_equal(getattr(option.motion, name), getattr(plain, name))


@given(start=st.floats(-2.0, 2.0), speed=st.floats(-2.0, 2.0), force=st.floats(-5.0, 5.0))
@settings(max_examples=40, deadline=None)
def test_the_acceleration_on_a_circle_is_that_of_its_closed_form(start, speed, force):
    cell, q = cell_of("ur10e"), np.array(ARMS["ur10e"])
    radius = float(np.linalg.norm((cell.robot.flange_pose(q) @ cell.T_flange_scanner)[:2, 3]))
    time = np.array([0.0, 0.01, 0.03])
    position, velocity = np.tile(q, (3, 1)), np.zeros((3, 6))
    position[:, 0] = start + speed * time + 0.5 * force * time**2
    velocity[:, 0] = speed + force * time
    found = scanner_acceleration(cell, TimedMotion(time, position, velocity, np.zeros((3, 6))))
    at_states = radius * np.hypot(force, velocity[:, 0] ** 2)
    middle = radius * np.hypot(force, (0.5 * (velocity[:-1, 0] + velocity[1:, 0])) ** 2)
    assert found == pytest.approx(np.maximum(np.maximum(at_states[:-1], at_states[1:]), middle), rel=1e-4, abs=1e-5)


def test_a_circle_bends_by_its_curvature():
    cell, q = cell_of("ur10e"), np.array(ARMS["ur10e"])
    radius = float(np.linalg.norm((cell.robot.flange_pose(q) @ cell.T_flange_scanner)[:2, 3]))
    travel = np.linspace(0.0, 0.1, 6)
    position = np.tile(q, (6, 1))
    position[:, 0] += travel / radius
    path = CubicSpline(travel, position)
    assert len(steps_that_bend(cell, path, travel, 1.001 / radius)) == 0
    assert steps_that_bend(cell, path, travel, 0.999 / radius) == pytest.approx(0.5 * (travel[:-1] + travel[1:]))
