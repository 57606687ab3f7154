from __future__ import annotations

import itertools

import numpy as np
import pytest

from cellwright.solvers.path_timing import Limits
from cellwright.solvers.sweeps import alternatives as sweep_alternatives
from cellwright.solvers.sweeps.alternatives import (
    SweepSettings,
    flange_targets,
    nearest_windings,
    sweep_options,
    trace_sweep,
    windings,
)
from tests.cellwright.solvers import scanning_cell


def traced(number=0, start=-0.06, interval=(-0.05, 0.06), step=0.004):
    sweep = scanning_cell.sweeps()[number]
    piece = sweep.pieces[0]
    return trace_sweep(scanning_cell.cell(), sweep.T_world_scanner, piece.q_start, piece.branch, start, interval, step)


@pytest.mark.parametrize("number", range(3))
def test_a_traced_sweep_keeps_the_scanner_on_its_line_between_the_traced_poses_too(number):
    from scipy.interpolate import CubicSpline

    cell, sweep = scanning_cell.cell(), scanning_cell.sweeps()[number]
    path = traced(number)
    assert path.travel[[0, -1]] == pytest.approx([-0.05, 0.06], abs=1e-15)
    travel = np.linspace(-0.05, 0.06, 300)
    wanted = flange_targets(cell, sweep.T_world_scanner, travel)
    for q, T in zip(CubicSpline(path.travel, path.position)(travel), wanted, strict=True):
        assert cell.robot.flange_pose(q) == pytest.approx(T, abs=2e-6)


def test_a_sweep_out_of_reach_is_not_traced():
    assert traced(interval=(-0.05, 1.5)) is None


def test_windings_are_all_turns_that_the_limits_leave_room_for():
    chain = scanning_cell.cell().robot.chain
    path = traced()
    found = {tuple(np.round(row / (2 * np.pi)).astype(int)) for row in windings(path, chain)}
    wanted = {
        turns
        for turns in itertools.product((-2, -1, 0, 1, 2), repeat=6)
        if np.all(path.position + 2 * np.pi * np.array(turns) >= chain.lower - 1e-9)
        and np.all(path.position + 2 * np.pi * np.array(turns) <= chain.upper + 1e-9)
    }
    assert found == wanted


def test_the_nearest_windings_come_first_and_no_more_than_asked_for():
    chain, paths = scanning_cell.cell().robot.chain, [traced(0), traced(1)]
    every = nearest_windings(paths, chain, scanning_cell.START, 10_000)
    few = nearest_windings(paths, chain, scanning_cell.START, 5)
    away = [
        np.abs(
            (paths[number].position[len(paths[number].position) // 2] + turns - scanning_cell.START)
            / chain.max_velocity
        ).max()
        for number, turns in every
    ]
    assert len(every) == sum(len(windings(path, chain)) for path in paths)
    assert np.all(np.diff(away) >= -1e-8)
    assert [(n, t.tolist()) for n, t in few] == [(n, t.tolist()) for n, t in every[:5]]


def found_options(count, number=0):
    chain = scanning_cell.cell().robot.chain
    settings = SweepSettings(Limits(chain.max_velocity, chain.max_acceleration), 0.1, 1.0, 0.008, 0.004)
    return sweep_options(scanning_cell.cell(), scanning_cell.sweeps()[number], number, settings, count)


def told(options):
    """What each alternative is called, and its joint positions halfway."""
    return {o.alternative: o.motion.position[len(o.motion.position) // 2].tolist() for o in options[::2]}


def test_an_alternative_is_called_the_same_however_many_are_asked_for():
    few, many = told(found_options(2)), told(found_options(12))
    assert len(few) == 2 and len(many) == 12
    assert {name: many[name] for name in few} == few


def test_alternatives_of_a_finer_trace_are_never_taken_for_those_of_the_usual_one(monkeypatch):
    usual = found_options(8)
    with monkeypatch.context() as patch:
        patch.setattr(sweep_alternatives, "trace_sweep", lambda *a: None if a[-1] > 0.002 else trace_sweep(*a))
        finer = found_options(8)
    assert len(usual) == len(finer) == 16
    for name in ("alternative", "path"):
        assert not {getattr(option, name) for option in usual} & {getattr(option, name) for option in finer}


def test_a_path_is_called_the_same_whether_or_not_other_pieces_can_be_followed(monkeypatch):
    every = found_options(10_000)
    first = scanning_cell.sweeps()[0].pieces[0].branch
    monkeypatch.setattr(sweep_alternatives, "trace_sweep", lambda *a: None if a[3] == first else trace_sweep(*a))
    rest = found_options(10_000)
    assert 0 < len(rest) < len(every)
    assert {o.path: o.branch for o in rest}.items() <= {o.path: o.branch for o in every}.items()


def test_a_timed_sweep_moves_at_scan_speed_and_ends_at_rest():
    chain = scanning_cell.cell().robot.chain
    motion = traced().timed(Limits(chain.max_velocity, chain.max_acceleration), 0.1, 1.0, 0.008)
    assert motion.velocity[:, -1].max() == pytest.approx(0.1, rel=1e-6)
    assert not motion.velocity[[0, -1]].any()
    assert motion.position[[0, -1], -1] == pytest.approx([-0.05, 0.06])
    assert motion.duration == pytest.approx(0.11 / 0.1 + 0.1 / 1.0, rel=0.01)
