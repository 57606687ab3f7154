from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.cell.verification_scene import VerificationScene
from cellwright.errors import InfeasibleError, InvalidInputError
from cellwright.solvers import plan_verification as verification
from cellwright.solvers.plan_verification import Tolerances
from cellwright.solvers.torque_verification import TORQUE
from schemas.plan_objects import timed_plan
from tests.cellwright.solvers import scanning_cell

SPEED = scanning_cell.SETTINGS.scan_speed
COARSE = Tolerances(step=0.01, step_angle=0.02)


@cache
def sound():
    return timed_plan(scanning_cell.trajectory(), scanning_cell.selection())


def changed(**arrays):
    return replace(sound(), **arrays)


def cell():
    return scanning_cell.cell()


def failed(checks):
    return {check.name for check in checks if not check.passed}


def quick_checks(plan, *, in_cell=None, sweeps=None, speed=SPEED):
    in_cell = in_cell or cell()
    return (
        verification.check_limits(plan, in_cell, COARSE)
        + verification.check_sweeps(plan, in_cell, sweeps or scanning_cell.sweeps(), speed, COARSE)
    )  # fmt: skip


def sweep_rows(number=0):
    """Rows of the states of the number-th sweep that is executed, and the sweep itself."""
    segments = [i for i, segment in enumerate(sound().segments) if segment.sweep >= 0]
    return np.flatnonzero(sound().segment == segments[number]), sound().segments[segments[number]].sweep


def test_a_sound_plan_passes_every_check():
    progress = []
    checks = verification.check_order(sound()) + quick_checks(sound())
    proof = verification.check_collisions(
        sound(), cell(), VerificationScene(cell()), Tolerances(step=3e-3, step_angle=0.005), progress.append
    )
    assert failed(checks + proof.checks) == set()
    verification.require(checks + proof.checks)
    assert proof.n_states > len(sound().time)
    assert progress == sorted(progress) and progress[-1] == 1.0
    assert any(verification.STATES_SHARE < share < 1.0 for share in progress), "the proof tells how far it is, too"
    assert len({check.name for check in checks}) == len(checks)


def test_a_body_in_the_way_is_found_by_the_second_engine_with_time_and_names():
    _, sweep = sweep_rows(2)
    T = scanning_cell.sweeps()[sweep].T_world_scanner
    wall = Body("wall", Box((0.02, 0.02, 0.02)), WORLD, T @ pose(np.array([0.0, 0.0, -0.03]), np.eye(3)))
    blocked = replace(cell(), bodies=(*cell().bodies, wall))
    checks = verification.check_collisions(sound(), blocked, VerificationScene(blocked), COARSE).checks
    assert failed(checks) == {"colliding states"}
    with pytest.raises(
        InfeasibleError, match=r"colliding states is 1 .* at \d+\.\d+ s: (scanner touches wall|wall touches scanner)"
    ):
        verification.require(checks)


def test_a_collision_between_two_states_is_found():
    class Between:
        def collision(self, q):
            return ("link", "hair") if np.abs(q - crossing).max() < 0.002 else None

    q = sound().position
    row = int(np.argmax(np.abs(np.diff(q, axis=0)).max(axis=1)))
    crossing = 0.5 * (q[row] + q[row + 1])
    assert np.abs(q - crossing).max(axis=1).min() > 0.002
    found = verification.check_collisions(sound(), cell(), Between(), Tolerances(step_angle=0.003, step=0.1))
    assert "colliding states" in failed(found.checks)


def test_the_least_distance_is_proven_between_the_states_too():
    proof = verification.check_collisions(sound(), cell(), VerificationScene(cell()), COARSE)
    check = next(check for check in proof.checks if check.name == "distance of bodies, between checked states too")
    scene = VerificationScene(cell())
    found, proven = proof.clearance.found, proof.clearance.proven
    assert (
        0.0 < check.permitted < check.found == proven <= found <= min(scene.distance(q) for q in sound().position[::50])
    )
    assert check.passed and check.at_least and check.where.startswith("at ")
    touching = replace(check, found=0.0)
    assert not touching.passed
    with pytest.raises(InfeasibleError, match=r"between checked states too is 0 m where 1e-06 m is demanded, at \d"):
        verification.require([touching])


def test_too_fast_a_plan_fails_speed_and_acceleration():
    plan = changed(time=sound().time / 2, velocity=sound().velocity * 2, acceleration=sound().acceleration * 4)
    plan = replace(plan, segments=tuple(replace(s, start=s.start / 2, end=s.end / 2) for s in plan.segments))
    assert {
        "joint speed of the curve",
        "stated joint speed",
        "joint speed by differences",
        "joint acceleration of the curve",
        "stated joint acceleration",
        "joint acceleration by differences",
        "scanner speed on a sweep",
    } <= failed(quick_checks(plan))


def test_an_overstated_velocity_or_acceleration_fails():
    velocity, acceleration = sound().velocity.copy(), sound().acceleration.copy()
    velocity[40, 2], acceleration[40, 3] = 10.0, -100.0
    assert "stated joint speed" in failed(quick_checks(changed(velocity=velocity)))
    assert failed(quick_checks(changed(acceleration=acceleration))) == {"stated joint acceleration"}


def test_a_jump_between_segments_fails():
    rows, _ = sweep_rows(1)
    position = sound().position.copy()
    position[rows[0] :, 1] += 0.1
    checks = quick_checks(changed(position=position))
    assert {"jump between segments", "joint speed by differences"} <= failed(checks)
    jump = next(check for check in checks if check.name == "jump between segments")
    assert jump.where.endswith("in joint 2") and 0.05 < jump.found <= 0.1


def test_a_plan_from_elsewhere_or_not_at_rest_fails():
    assert "deviation from the start configuration" in failed(
        quick_checks(sound(), in_cell=replace(cell(), start=scanning_cell.START + 1e-4))
    )
    velocity = sound().velocity.copy()
    velocity[-1, 0] = 1e-3
    assert "joint speed at start and end" in failed(quick_checks(changed(velocity=velocity)))


def test_a_joint_beyond_its_limit_fails_even_between_states():
    robot = cell().robot
    _, high = verification.position_extremes(sound().time, sound().position, sound().velocity)
    upper = robot.chain.upper.copy()
    upper[2] = high[:, 2].max() - 1e-5
    narrow = replace(cell(), robot=replace(robot, chain=replace(robot.chain, upper=upper)))
    assert failed(quick_checks(sound(), in_cell=narrow)) == {"overshoot of a joint limit"}


def test_a_missing_sweep_is_named():
    _, sweep = sweep_rows(3)
    plan = changed(segments=tuple(replace(s, sweep=-1) if s.sweep == sweep else s for s in sound().segments))
    checks = quick_checks(plan)
    assert failed(checks) == {"sweeps not executed"}
    with pytest.raises(InfeasibleError, match=f"sweeps not executed is 1 where 0 is permitted, view {sweep}"):
        verification.require(checks)


@pytest.mark.parametrize(
    ("T", "fails"),
    [
        (pose(np.array([0.0, 3e-4, 0.0]), np.eye(3)), {"scanner off its planned line"}),
        (pose(np.array([0.0, 0.0, 3e-4]), np.eye(3)), {"scanner off its planned line"}),
        (
            pose(np.zeros(3), rotation_from_rpy(np.deg2rad(0.08), 0.0, 0.0)),
            {"scanner turned off its planned orientation"},
        ),
        (
            pose(np.array([4e-4, 0.0, 0.0]), np.eye(3)),
            {"stated travel off the executed one", "sweep interval not executed", "travel beyond the sweep interval"},
        ),
    ],
)
def test_a_scanner_off_its_planned_sweep_fails(T, fails):
    moved = [replace(sweep, T_world_scanner=sweep.T_world_scanner @ T) for sweep in scanning_cell.sweeps()]
    assert failed(quick_checks(sound(), sweeps=moved)) == fails


def test_a_scanner_that_turns_during_a_sweep_fails():
    rows, _ = sweep_rows(0)
    position = sound().position.copy()
    position[rows, 5] += np.deg2rad(0.2) * np.sin(np.linspace(0, np.pi, len(rows)))
    assert {"scanner turning during a sweep", "scanner turned off its planned orientation"} <= failed(
        quick_checks(changed(position=position))
    )


def test_a_sweep_that_is_cut_short_or_scanned_too_fast_fails():
    longer = [replace(sweep, interval=(-0.06, 0.0605)) for sweep in scanning_cell.sweeps()]
    assert failed(quick_checks(sound(), sweeps=longer)) == {"sweep interval not executed"}
    assert failed(quick_checks(sound(), speed=0.9 * SPEED)) == {"scanner speed on a sweep"}


def test_a_sweep_that_goes_on_beyond_its_interval_fails():
    shorter = [replace(sweep, interval=(-0.06, 0.0595)) for sweep in scanning_cell.sweeps()]
    assert failed(quick_checks(sound(), sweeps=shorter)) == {"travel beyond the sweep interval"}


def test_a_sweep_that_is_executed_twice_is_named():
    rows, sweep = sweep_rows(1)
    number = int(sound().segment[rows[0]])
    segments = list(sound().segments)
    segments.insert(number, segments[number])
    checks = quick_checks(changed(segments=tuple(segments)))
    assert failed(checks) == {"sweeps executed more than once"}
    assert next(check.where for check in checks if not check.passed) == f"view {sweep}"


def test_the_scanner_accelerates_as_permitted_and_no_more():
    def failed_at(permitted):
        return failed(
            verification.check_sweeps(
                sound(), cell(), scanning_cell.sweeps(), SPEED, COARSE, max_acceleration=permitted
            )
        )

    assert failed_at(scanning_cell.SETTINGS.tool_acceleration) == set()
    assert failed_at(0.98 * scanning_cell.SETTINGS.tool_acceleration) == {"scanner acceleration on a sweep"}


def test_a_plan_that_must_return_ends_where_it_starts():
    returned = replace(sound(), position=np.concatenate([sound().position[:-1], [scanning_cell.START]]))
    name = "end off the start configuration"
    assert name in failed(verification.check_limits(sound(), cell(), COARSE, returns=True))
    assert name not in failed(verification.check_limits(returned, cell(), COARSE, returns=True))
    assert name not in failed(verification.check_limits(sound(), cell(), COARSE))


def test_states_out_of_order_or_not_finite_fail_first():
    time, position = sound().time.copy(), sound().position.copy()
    time[[7, 8]] = time[[8, 7]]
    position[5, 0] = np.nan
    gap = tuple(replace(s, end=s.end - 0.01) if i == 2 else s for i, s in enumerate(sound().segments))
    name = "states that are not finite or do not follow in time"
    assert name in failed(verification.check_order(changed(time=time)))
    assert name in failed(verification.check_order(changed(position=position)))
    assert {"gap between segments", "states outside their segment"} <= failed(
        verification.check_order(changed(segments=gap))
    )


def test_an_empty_plan_is_invalid():
    plan = changed(segments=())
    with pytest.raises(InvalidInputError, match="0 segments"):
        verification.check_order(plan)


@pytest.mark.parametrize(
    ("name", "helps", "not_this"),
    [
        ("scanner acceleration on a sweep", "tool_acceleration_m_s2", "clearance_m"),
        ("joint acceleration of the curve", "max_acceleration_rad_s2", "clearance_m"),
        ("colliding states", "clearance_m", "max_acceleration_rad_s2"),
        ("gap between segments", "no setting mends this", "clearance_m"),
    ],
)
def test_the_error_names_only_what_can_help(name, helps, not_this):
    with pytest.raises(InfeasibleError, match=f"{name} is 2 .*{helps}") as found:
        verification.require([verification.Check(name, 2.0, 1.0, "of the limit")])
    assert not_this not in str(found.value)


def test_every_mend_belongs_to_a_check():
    names = {check.name for check in quick_checks(sound())}
    proof = verification.check_collisions(sound(), cell(), VerificationScene(cell()), COARSE)
    assert set(verification.MENDS) <= names | {check.name for check in proof.checks} | {TORQUE}
