from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cellwright.causes import Cause
from cellwright.cell import inverse_kinematics
from cellwright.cell.bodies import Body, Box
from cellwright.cell.cell import Cell
from cellwright.cell.chain_kinematics import track_pose
from cellwright.cell.inverse_kinematics import inverse_kinematics_for
from cellwright.cell.robot import Robot
from cellwright.cell.scene import Scene
from cellwright.cell.transforms import inverse, pose
from cellwright.errors import InvalidInputError
from cellwright.solvers.joint_branches import greatest_changes, unwrapped
from cellwright.solvers.sweeps.following import FollowedSweeps, follow_sweeps
from cellwright.solvers.sweeps.poses import CandidateSweeps, FollowSettings, sweep_poses
from tests.cellwright.cell.cells import at, bumpy_part, scanning_cell
from tests.cellwright.cell.robots import chain_of_facts, urdf_of
from tests.cellwright.cell.test_sphere_filter import crx_at_a_part

SETTINGS = FollowSettings(scan_speed=0.1)
PART_AT = np.array([0.75, 0.0, 0.35])


@cache
def cell() -> Cell:
    """A UR10e whose scanner looks out of its housing, around a part that is not convex."""
    built = scanning_cell()
    return Cell(
        built.robot,
        built.bodies,
        built.ignored_pairs,
        built.T_world_base,
        at(0.155, 0.0, 0.20),
        np.array([0.0, -1.9, 1.5, -1.2, -1.57, 0.0]),
    ).with_part(bumpy_part(2), at(*PART_AT))


def sweeps_around(n: int, seed: int = 0, centre=PART_AT, reach: float = 0.14 + 0.1) -> CandidateSweeps:
    """Random sweeps that look at a point near the part from all sides but below."""
    rng = np.random.default_rng(seed)
    T = np.empty((n, 4, 4))
    for row in range(n):
        normal = rng.normal(size=3)
        normal[2] = abs(normal[2])
        z = -normal / np.linalg.norm(normal)
        x = np.cross(z, rng.normal(size=3))
        x /= np.linalg.norm(x)
        T[row] = pose(centre - reach * z, np.stack([x, np.cross(z, x), z], 1))
    start, end = -rng.uniform(0.02, 0.12, n), rng.uniform(0.02, 0.12, n)
    between = start + (end - start) * rng.random((3, n))
    travel = np.sort(np.vstack([start, end, between]).T, axis=1)
    return CandidateSweeps(T, start, end, np.repeat(np.arange(n, dtype=np.int32), 5), travel.ravel())


def longest_by_brute_force(built: Cell, sweeps: CandidateSweeps, settings: FollowSettings):
    """Per sweep and branch the longest executable piece in poses, by plain loops and the exact scene alone."""
    chain, scene, solver = (
        built.robot.chain,
        Scene(built, settings.clearance),
        inverse_kinematics_for(built.robot.chain),
    )
    poses = sweep_poses(built, sweeps, settings)
    best: dict[tuple[int, int], int] = {}
    for row, sweep in enumerate(poses.sweep.tolist()):
        travel = np.arange(poses.n_poses[row]) * poses.step[row]
        T = np.tile(poses.T_base_flange[row], (len(travel), 1, 1))
        T[:, :3, 3] += travel[:, None] * poses.direction[row]
        q = solver.solve(T)
        greatest = greatest_changes(chain.max_velocity, poses.step[row], settings.scan_speed)
        for branch in range(q.shape[1]):
            run: list[np.ndarray] = []
            for k in range(len(travel)):
                state = q[k, branch]
                good = np.isfinite(state).all() and not scene.collides(state)
                if good and run:
                    state = np.array([unwrapped(a, b) for a, b in zip(state, run[-1])])
                    good = bool((np.abs(state - run[-1]) <= greatest).all())
                if not good:
                    run = []
                    continue
                run = [*run, state]
                while not has_winding(np.array(run), chain):
                    run = run[1:]
                if len(run) - 1 >= np.ceil(settings.shortest / poses.step[row] - 1e-6):
                    best[sweep, branch] = max(best.get((sweep, branch), 0), len(run) - 1)
    return best


def has_winding(path, chain) -> bool:
    turns = 2 * np.pi * np.arange(-3, 4)[:, None]
    fits = (path.min(axis=0) + turns >= chain.lower - 1e-9) & (path.max(axis=0) + turns <= chain.upper + 1e-9)
    return bool(fits.any(axis=0).all())


def traced(built: Cell, T_world_scanner, q_start, start: float, end: float, step: float):
    """Follow a piece by Newton's method in fine steps, (n, joints)."""
    chain = built.robot.chain
    q, path = np.array(q_start), []
    for travel in np.linspace(start, end, int(np.ceil((end - start) / step)) + 1):
        T = inverse(built.T_world_base) @ T_world_scanner @ at(travel, 0, 0) @ inverse(built.T_flange_scanner)
        following, reached = track_pose(chain.T_parent_joint, chain.axis, chain.T_last_flange, q, T, 1e-8, 20)
        assert reached
        path.append(following)
        q = following
    return np.array(path)


@cache
def followed(n: int = 120) -> tuple[CandidateSweeps, FollowedSweeps]:
    sweeps = sweeps_around(n)
    return sweeps, follow_sweeps(cell(), sweeps, settings=SETTINGS, exact=Scene(cell(), SETTINGS.clearance).collides)


def test_it_finds_what_brute_force_finds_and_never_more():
    sweeps, found = followed()
    n = 40
    few = CandidateSweeps(
        sweeps.T_world_scanner[:n],
        sweeps.start[:n],
        sweeps.end[:n],
        sweeps.sample_sweep[: 5 * n],
        sweeps.sample_travel[: 5 * n],
    )
    brute = longest_by_brute_force(cell(), few, SETTINGS)
    step = sweep_poses(cell(), sweeps, SETTINGS).step
    ours = {
        (int(sweep), int(branch)): round((end - start) / step[sweep])
        for sweep, branch, start, end in zip(found.sweep, found.branch, found.start, found.end)
        if sweep < n
    }
    assert len(brute) > 40
    for key, length in ours.items():
        assert length <= brute[key]
    assert sum(ours.values()) >= 0.98 * sum(brute.values())
    assert {sweep for sweep, _ in ours} == {sweep for sweep, _ in brute}


def test_pieces_stay_free_of_collisions_on_branch_in_limits_and_speed_between_the_poses_too():
    sweeps, found = followed()
    touching, chain = Scene(cell(), 0.0), cell().robot.chain
    assert len(found.sweep) > 100
    for row in range(len(found.sweep)):
        q = traced(
            cell(),
            sweeps.T_world_scanner[found.sweep[row]],
            found.q_start[row],
            found.start[row],
            found.end[row],
            0.0005,
        )
        assert not touching.collide_all(q).any()
        assert (q >= chain.lower - 1e-6).all() and (q <= chain.upper + 1e-6).all()
        poses = q[::10]
        assert (np.abs(np.diff(poses, axis=0)) <= 1.05 * greatest_changes(chain.max_velocity, 0.005, 0.1)).all()


def test_all_pieces_keep_the_clearance_at_their_poses():
    sweeps, found = followed()
    scene, step = Scene(cell(), SETTINGS.clearance), sweep_poses(cell(), sweeps, SETTINGS).step
    for row in range(0, len(found.sweep), 3):
        sweep = found.sweep[row]
        q = traced(
            cell(), sweeps.T_world_scanner[sweep], found.q_start[row], found.start[row], found.end[row], step[sweep]
        )
        assert not scene.collide_all(q).any()


def test_the_first_piece_of_a_sweep_measures_most():
    sweeps, found = followed()
    assert (np.diff(found.sweep) >= 0).all()
    for sweep in np.unique(found.sweep):
        rows = np.flatnonzero(found.sweep == sweep)
        travel = sweeps.sample_travel[sweeps.sample_sweep == sweep]
        counts = [
            np.count_nonzero((travel >= found.start[row] - 1e-9) & (travel <= found.end[row] + 1e-9)) for row in rows
        ]
        assert counts == found.n_samples[rows].tolist()
        ranks = [
            (-count, found.start[row] - found.end[row], found.branch[row]) for count, row in zip(counts, rows.tolist())
        ]
        assert [rank[0] for rank in ranks] == sorted(rank[0] for rank in ranks)
        assert ranks == sorted(ranks, key=lambda rank: (rank[0], round(rank[1], 9), rank[2]))


def test_the_result_does_not_depend_on_the_number_of_threads():
    sweeps = sweeps_around(60, seed=5)
    one, many = (
        follow_sweeps(cell(), sweeps, settings=SETTINGS, exact=Scene(cell(), 0.005).collides, n_threads=n)
        for n in (1, 4)
    )
    for name in FollowedSweeps.__dataclass_fields__:
        assert np.array_equal(getattr(one, name), getattr(many, name)), name


def test_sweeps_that_measure_nothing_are_left_alone():
    T, nan = sweeps_around(3).T_world_scanner, np.full(3, np.nan)
    idle = CandidateSweeps(T, nan, nan, np.zeros(0, np.int32), np.zeros(0))
    found = follow_sweeps(cell(), idle, settings=SETTINGS)
    assert len(found.sweep) == 0
    assert (found.outcome == Cause.NONE).all()


def test_an_interval_that_ends_before_it_starts_is_refused():
    sweeps = sweeps_around(3)
    with pytest.raises(InvalidInputError, match="view 0 measures from"):
        follow_sweeps(
            cell(),
            CandidateSweeps(
                sweeps.T_world_scanner, sweeps.end, sweeps.start, sweeps.sample_sweep, sweeps.sample_travel
            ),
            settings=SETTINGS,
        )


def test_exact_checks_are_counted_and_capped():
    sweeps = sweeps_around(80, seed=3)
    scene = Scene(cell(), SETTINGS.clearance)
    asked = []

    def exact(q) -> bool:
        asked.append(q)
        return scene.collides(q)

    full = follow_sweeps(cell(), sweeps, settings=SETTINGS, exact=exact)
    assert len(asked) == full.n_exact_checks
    for limit in (full.n_exact_checks // 3, full.n_exact_checks // 2):
        asked.clear()
        few = FollowSettings(scan_speed=0.1, max_exact_checks=limit)
        some = follow_sweeps(cell(), sweeps, settings=few, exact=exact)
        assert some.n_unsettled > 0
        assert some.n_exact_checks == len(asked) <= limit
    none = follow_sweeps(cell(), sweeps, settings=FollowSettings(scan_speed=0.1, max_exact_checks=0), exact=exact)
    assert full.n_unsettled == 0
    assert none.n_exact_checks == 0
    assert (none.n_unsettled > 0) == (full.n_exact_checks > 0)
    assert set(zip(none.sweep.tolist(), none.branch.tolist())) <= set(zip(full.sweep.tolist(), full.branch.tolist()))


def test_an_arm_with_sixteen_branches_follows_sweeps_too():
    built = crx_at_a_part()
    centre = np.array([0.5, 0.0, 0.5])
    sweeps = sweeps_around(12, centre=centre, reach=0.35)
    scene = Scene(built, SETTINGS.clearance)
    found = follow_sweeps(built, sweeps, settings=SETTINGS, exact=scene.collides)
    assert len(np.unique(found.sweep)) >= 4
    touching = Scene(built, 0.0)
    for row in range(0, len(found.sweep), 3):
        q = traced(
            built, sweeps.T_world_scanner[found.sweep[row]], found.q_start[row], found.start[row], found.end[row], 0.001
        )
        assert not touching.collide_all(q).any()
        assert np.abs(np.diff(q, axis=0)).max() < 0.12
        assert (q >= built.robot.chain.lower - 1e-6).all() and (q <= built.robot.chain.upper + 1e-6).all()


def test_a_slow_solver_asked_at_few_poses_gives_the_pieces_of_the_closed_form(monkeypatch):
    sweeps = sweeps_around(30)
    expected = follow_sweeps(cell(), sweeps, settings=SETTINGS)
    solver = inverse_kinematics._by_elimination(cell().robot.chain)
    assert solver.slow
    monkeypatch.setattr("cellwright.solvers.sweeps.following.inverse_kinematics_for", lambda chain: solver)
    found = follow_sweeps(cell(), sweeps, settings=SETTINGS)
    assert len(expected.sweep) > 10
    assert pieces_of(found) == pieces_of(expected)


def pieces_of(found: FollowedSweeps) -> list[tuple[int, float, float, int]]:
    columns = (found.sweep, found.start.round(9), found.end.round(9), found.n_samples)
    return sorted(zip(*(column.tolist() for column in columns)))


@pytest.mark.parametrize("name", ["kr180_r2500_extra", "irb6640_irb6400"])
def test_big_arms_with_spherical_wrists_follow_sweeps(name):
    robot = Robot.from_urdf(urdf_of(chain_of_facts(name)))
    housing = Body("housing", Box((0.1, 0.08, 0.1)), 6, robot.chain.T_last_flange @ at(0, 0, 0.05))
    bare = Cell(robot, (housing,), np.empty((0, 2), np.int32), np.eye(4), at(0, 0, 0.2), np.zeros(6))
    centre = np.array([1.6, 0.0, 0.9])
    built = bare.with_part(bumpy_part(2), at(*centre))
    sweeps = sweeps_around(20, centre=centre, reach=0.35)
    found = follow_sweeps(built, sweeps, settings=SETTINGS)
    assert len(np.unique(found.sweep)) >= 5
    for row in range(0, len(found.sweep), 3):
        q = traced(
            built, sweeps.T_world_scanner[found.sweep[row]], found.q_start[row], found.start[row], found.end[row], 0.001
        )
        assert not Scene(built, 0.0).collide_all(q).any()
