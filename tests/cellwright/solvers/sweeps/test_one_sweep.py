"""One sweep past one body: the piece that is found, or the cause that is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellwright.causes import Cause
from cellwright.cell.bodies import WORLD, Body, Box
from cellwright.cell.cell import Cell
from cellwright.cell.scene import Scene
from cellwright.cell.transforms import pose
from cellwright.solvers.sweeps.following import follow_sweeps
from cellwright.solvers.sweeps.poses import CandidateSweeps, FollowSettings
from tests.cellwright.cell.cells import at, scanning_cell
from tests.cellwright.solvers.sweeps.test_following import SETTINGS, sweeps_around, traced


def one_sweep(centre, half: float = 0.05) -> CandidateSweeps:
    """A sweep along y that looks straight down at a point."""
    R = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    T = pose(np.asarray(centre, float), R)[None]
    return CandidateSweeps(T, np.array([-half]), np.array([half]), np.zeros(3, np.int32), np.array([-half, 0.0, half]))


def bare_cell(*bodies: Body, limits=None) -> Cell:
    """The UR10e with nothing but the given bodies around."""
    built = scanning_cell()
    links = tuple(body for body in built.bodies if body.parent >= 0)
    chain = built.robot.chain
    robot = built.robot if limits is None else replace(built.robot, chain=replace(chain, **limits))
    kept = built.ignored_pairs[(built.ignored_pairs < len(links)).all(axis=1)]
    return Cell(robot, (*links, *bodies), kept, np.eye(4), at(0.155, 0.0, 0.20), built.start)


def outcome_of(built: Cell, sweeps: CandidateSweeps, settings: FollowSettings = SETTINGS) -> tuple[Cause, str]:
    found = follow_sweeps(built, sweeps, settings=settings, exact=Scene(built, settings.clearance).collides)
    blocked_by = int(found.blocked_by[0])
    return Cause(int(found.outcome[0])), built.bodies[blocked_by].name if blocked_by >= 0 else ""


REACHABLE = (0.7, 0.1, 0.4)


def test_a_free_sweep_has_pieces_over_its_whole_length():
    found = follow_sweeps(bare_cell(), one_sweep(REACHABLE), settings=SETTINGS)
    assert found.outcome[0] == Cause.NONE
    assert found.start[0] == pytest.approx(-0.08) and found.end[0] == pytest.approx(0.08)
    assert found.n_samples[0] == 3


def test_a_far_sweep_is_out_of_reach():
    assert outcome_of(bare_cell(), one_sweep((2.0, 0.0, 0.4))) == (Cause.OUT_OF_REACH, "")


def test_tight_limits_are_named():
    chain = bare_cell().robot.chain
    limits = {"lower": chain.lower * 0 + 3.0, "upper": chain.lower * 0 + 3.01}
    assert outcome_of(bare_cell(limits=limits), one_sweep(REACHABLE)) == (Cause.JOINT_LIMIT, "")


def test_the_body_in_the_way_is_named():
    wall = Body("wall", Box((0.3, 0.5, 0.3)), WORLD, at(0.7, 0.1, 0.55))
    assert outcome_of(bare_cell(wall), one_sweep(REACHABLE)) == (Cause.COLLISION, "wall")


def test_a_scan_too_fast_for_the_joints_is_named():
    settings = FollowSettings(scan_speed=50.0)
    assert outcome_of(bare_cell(), one_sweep(REACHABLE), settings) == (Cause.JOINT_SPEED, "")


def test_a_piece_shorter_than_the_shortest_is_named():
    # the first joint turns some 0.23 rad along the sweep; limits leave it 0.05 rad in the middle
    sweeps, chain = one_sweep(REACHABLE), bare_cell().robot.chain
    free = follow_sweeps(bare_cell(), sweeps, settings=SETTINGS)
    middle = traced(bare_cell(), sweeps.T_world_scanner[0], free.q_start[0], free.start[0], free.end[0], 0.01)[8]
    lower, upper = chain.lower.copy(), chain.upper.copy()
    lower[0], upper[0] = middle[0] - 0.025, middle[0] + 0.025
    built = bare_cell(limits={"lower": lower, "upper": upper})
    short = follow_sweeps(built, sweeps, settings=FollowSettings(shortest=0.01, margin=0.06))
    assert 0.01 <= (short.end - short.start).max() < 0.05
    assert outcome_of(built, sweeps) == (Cause.TOO_SHORT, "")
    assert outcome_of(bare_cell(), one_sweep(REACHABLE, 0.01), FollowSettings(margin=0.005)) == (Cause.TOO_SHORT, "")


def test_faster_scans_leave_less():
    def total(speed: float) -> float:
        found = follow_sweeps(bare_cell(), sweeps_around(40, seed=2), settings=FollowSettings(scan_speed=speed))
        return float((found.end - found.start).sum())

    assert total(0.1) > total(1.0) > total(3.0) > 0.0


def test_a_piece_starts_in_the_winding_nearest_to_the_start_configuration():
    built = bare_cell()
    for turns in ((0, 0, 0, 0, 0, 0), (1, 0, 0, -1, 0, 1)):
        start = built.start + 2 * np.pi * np.array(turns)
        start = np.clip(start, built.robot.chain.lower, built.robot.chain.upper)
        found = follow_sweeps(replace(built, start=start), one_sweep(REACHABLE), settings=SETTINGS)
        for q in found.q_start:
            others = q + 2 * np.pi * np.array([-1, 0, 1])[:, None]
            allowed = (others >= built.robot.chain.lower) & (others <= built.robot.chain.upper)
            nearest = np.where(allowed, np.abs(others - start), np.inf).min(axis=0)
            # the whole piece must fit, which the piece itself moves by less than a turn: nearest unless at a limit
            near_limit = np.minimum(np.abs(q - built.robot.chain.lower), np.abs(q - built.robot.chain.upper)) < 0.5
            close = np.abs(q - start) <= nearest + 1e-9
            assert (close | near_limit | (nearest > np.pi - 0.6)).all()


def test_joints_run_through_half_a_turn_without_breaking_a_piece():
    # the sweep crosses the half plane behind the base, where the first joint jumps from pi to -pi
    sweeps = one_sweep((-0.7, 0.17415, 0.4), 0.1)
    built = bare_cell()
    found = follow_sweeps(built, sweeps, settings=SETTINGS)
    chain = built.robot.chain
    crossing = 0
    for row in range(len(found.sweep)):
        q = traced(built, sweeps.T_world_scanner[0], found.q_start[row], found.start[row], found.end[row], 0.005)
        assert (q >= chain.lower).all() and (q <= chain.upper).all()
        crossing += bool((np.floor((q[0] + np.pi) / (2 * np.pi)) != np.floor((q[-1] + np.pi) / (2 * np.pi))).any())
    assert crossing > 0
    assert (found.end - found.start).max() == pytest.approx(0.26)
