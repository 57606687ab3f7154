from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell import inverse_kinematics as ik
from cellwright.cell.built_in_robots import built_in_robot
from cellwright.cell.chain_kinematics import flange_poses
from cellwright.cell.inverse_kinematics import inverse_kinematics_for, windings
from cellwright.cell.parallel_axes import parallel_axes_geometry
from cellwright.cell.robot import Chain, Robot
from cellwright.cell.transforms import inverse, pose, rotation_from_rpy
from cellwright.errors import InvalidInputError
from tests.cellwright.cell.robots import chain_of_facts, random_chain, shared


def poses_of(chain: Chain, q: FloatArray) -> FloatArray:
    found: FloatArray = flange_poses(chain.T_parent_joint, chain.axis, chain.T_last_flange, q)
    return found


def ur10e() -> Chain:
    return built_in_robot("ur10e").chain


def relocated(chain: Chain, generator: np.random.Generator) -> Chain:
    """The same arm described by other frames: turned about and shifted along its axes, some axes reversed."""
    fixed, axis, last = chain.T_parent_joint.copy(), chain.axis.copy(), chain.T_last_flange.copy()
    frames = pose(
        generator.normal(size=(7, 3)), np.array([rotation_from_rpy(*row) for row in generator.normal(size=(7, 3))])
    )
    fixed[0] = frames[6] @ fixed[0]
    for joint in range(6):
        along = pose(generator.normal() * axis[joint], np.eye(3))
        change = along @ pose(np.zeros(3), frames[joint][:3, :3])
        fixed[joint] = fixed[joint] @ change
        axis[joint] = change[:3, :3].T @ axis[joint] * (1 if joint % 2 else -1)
        if joint < 5:
            fixed[joint + 1] = inverse(change) @ fixed[joint + 1]
        else:
            last = inverse(change) @ last
    return Chain(fixed, axis, last @ frames[5], chain.lower, chain.upper, chain.max_velocity, chain.max_acceleration)


def assert_complete(chain: Chain, solver: ik.InverseKinematics, q: FloatArray) -> FloatArray:
    """Every branch meets its pose, none is double, and the configurations behind the poses are among them."""
    poses = poses_of(chain, q)
    found = solver.solve(poses)
    assert found.shape == (len(q), solver.n_branches, 6)
    there = np.isfinite(found).all(axis=2)
    errors = poses_of(chain, found[there]) - np.repeat(poses, there.sum(axis=1), axis=0)
    assert np.abs(errors).max() < 1e-6
    assert (found[there] <= math.pi).all() and (found[there] > -math.pi).all()
    apart = np.abs(np.remainder(found - q[:, None] + math.pi, 2 * math.pi) - math.pi).max(axis=2)
    assert (np.where(there, apart, np.inf).min(axis=1) < 1e-3).all()
    return found


def as_sets(found: FloatArray) -> list[FloatArray]:
    return [np.array(sorted(rows[np.isfinite(rows).all(axis=1)].round(5).tolist())) for rows in found]


def test_the_ur10e_agrees_with_eaik_branch_for_branch() -> None:
    chain = ur10e()
    solver = inverse_kinematics_for(chain)
    assert (solver.family, solver.n_branches) == (ik.PARALLEL_AXES, 8)
    q = np.random.default_rng(0).uniform(-math.pi, math.pi, (500, 6))
    found = assert_complete(chain, solver, q)
    peer = ik._by_eaik(chain)
    assert peer is not None
    theirs = peer.solve(poses_of(chain, q))
    for ours, other in zip(as_sets(found), as_sets(theirs)):
        assert len(ours) == len(other)
        nearest = np.abs(np.remainder(ours[:, None] - other + math.pi, 2 * math.pi) - math.pi).max(axis=2).min(axis=1)
        assert nearest.max() < 1e-3


def test_the_ur10e_agrees_with_ssik() -> None:
    chain = ur10e()
    q = np.random.default_rng(1).uniform(-math.pi, math.pi, (20, 6))
    poses = poses_of(chain, q)
    ours, theirs = inverse_kinematics_for(chain).solve(poses), ik._by_ssik(chain).solve(poses)
    assert [len(rows) for rows in as_sets(ours)] == [len(rows) for rows in as_sets(theirs)]


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_closed_form_does_not_depend_on_the_frames_of_the_urdf(seed: int) -> None:
    generator = np.random.default_rng(seed)
    chain = relocated(ur10e(), generator)
    solver = inverse_kinematics_for(chain)
    assert solver.family == ik.PARALLEL_AXES
    assert_complete(chain, solver, generator.uniform(-math.pi, math.pi, (20, 6)))


def test_published_ur_files_belong_to_the_closed_form() -> None:
    for path in ("robots/ur10e/ur10e.urdf", "motion/ur5/ur5.urdf"):
        chain = Robot.from_urdf(shared(path).read_text()).chain
        solver = inverse_kinematics_for(chain)
        assert solver.family == ik.PARALLEL_AXES
        assert_complete(chain, solver, np.random.default_rng(2).uniform(-math.pi, math.pi, (200, 6)))


@pytest.mark.parametrize(
    "q",
    [
        [0.3, -1.0, 1.2, 0.4, 0.0, 0.7],  # axes 4 and 6 in line
        [0.3, -1.0, 1.2, 0.4, math.pi, 0.7],
        [0.3, -1.0, 0.0, 0.4, 1.0, 0.7],  # arm stretched
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ],
)
def test_singular_poses_have_solutions(q: list[float]) -> None:
    chain = ur10e()
    pose_asked = poses_of(chain, np.array([q]))
    found = inverse_kinematics_for(chain).solve(pose_asked)[0]
    found = found[np.isfinite(found).all(axis=1)]
    assert len(found) > 0
    assert np.abs(poses_of(chain, found) - pose_asked).max() < 1e-6


def test_a_branch_keeps_its_row_along_a_path() -> None:
    chain = ur10e()
    q = np.array([0.3, -1.2, 1.3, -0.8, -1.2, 0.2]) + np.linspace(0, 0.5, 200)[:, None] * [0.5, 0.4, -0.7, 0.6, 0.3, 1]
    found = inverse_kinematics_for(chain).solve(poses_of(chain, q))
    there = np.isfinite(found).all(axis=2)
    steps = np.abs(np.remainder(np.diff(found, axis=0) + math.pi, 2 * math.pi) - math.pi).max(axis=2)
    assert there.all(axis=0).sum() >= 4
    assert np.nanmax(steps) < 0.1


def test_poses_out_of_reach_have_none() -> None:
    far = pose(np.array([[2.0, 0, 0]]), np.eye(3))
    assert np.isnan(inverse_kinematics_for(ur10e()).solve(far)).all()


@pytest.mark.parametrize("name", ["kr180_r2500_extra", "comau_nj290", "irb6640_irb6400"])
def test_spherical_wrists_are_solved_by_eaik(name: str) -> None:
    chain = chain_of_facts(name)
    solver = inverse_kinematics_for(chain)
    assert "SPHERICAL" in solver.family
    assert_complete(chain, solver, np.random.default_rng(3).uniform(-math.pi, math.pi, (300, 6)))


def test_the_crx_has_all_sixteen_branches() -> None:
    """The pose of Gautier 2025, Table 3 and Figure 2: x, y, z, roll, pitch, yaw of the tool frame."""
    chain = chain_of_facts("crx10ial")
    target = pose(np.array([[-0.2406, -0.1188, 0.5603]]), rotation_from_rpy(2.6204, 1.1236, 0.4276))
    solver = inverse_kinematics_for(chain)
    assert (solver.family, solver.n_branches) == (ik.OFFSET_WRIST, 16)
    found = solver.solve(target)[0]
    assert np.isfinite(found).all()
    assert np.abs(poses_of(chain, found) - target).max() < 1e-6
    apart = np.abs(np.remainder(found[:, None] - found + math.pi, 2 * math.pi) - math.pi).max(axis=2)
    assert (apart[~np.eye(16, dtype=bool)] > 0.01).all()


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_offset_wrists_are_solved_whatever_the_frames(seed: int) -> None:
    generator = np.random.default_rng(seed)
    chain = relocated(chain_of_facts("crx10ial"), generator)
    solver = inverse_kinematics_for(chain)
    assert solver.family == ik.OFFSET_WRIST
    assert_complete(chain, solver, generator.uniform(-math.pi, math.pi, (20, 6)))


def test_the_offset_wrist_agrees_with_the_prebuilt_solver_of_ssik() -> None:
    from ssik.prebuilt.fanuc import crx10ial_ik

    chain = chain_of_facts("crx10ial")
    q = np.random.default_rng(4).uniform(-math.pi, math.pi, (30, 6))
    poses = poses_of(chain, q)
    ours = inverse_kinematics_for(chain).solve(poses)
    # their tool frame is turned against ours: match their configuration's own pose
    at_zero = np.asarray(crx10ial_ik.fk(np.zeros(6)))
    change = inverse(poses_of(chain, np.zeros((1, 6)))[0]) @ at_zero
    for rows, T in zip(as_sets(ours), poses):
        theirs = crx10ial_ik.solve(T @ change, respect_limits=False)
        assert len(rows) == len(theirs)


def test_only_six_joints_have_branches() -> None:
    with pytest.raises(InvalidInputError, match="5 joints"):
        inverse_kinematics_for(random_chain(np.random.default_rng(0), 5))


@pytest.mark.parametrize("bad", [np.zeros((4, 4)), np.full((1, 4, 4), np.nan)])
def test_poses_must_be_poses(bad: FloatArray) -> None:
    with pytest.raises(InvalidInputError, match="pose"):
        inverse_kinematics_for(ur10e()).solve(bad)


def test_no_poses_have_no_branches() -> None:
    assert inverse_kinematics_for(ur10e()).solve(np.empty((0, 4, 4))).shape == (0, 8, 6)


def test_least_squares_answers_and_doubles_are_dropped() -> None:
    chain = ur10e()
    q = np.array([0.3, -1.2, 1.3, -0.8, -1.2, 0.2])
    candidates = np.array([[q, q + 2 * math.pi, q + 1e-8, q + 0.1, np.full(6, np.nan)]])
    ik.certify(chain.T_parent_joint, chain.axis, chain.T_last_flange, poses_of(chain, q[None]), candidates)
    assert np.isfinite(candidates[0]).all(axis=1).tolist() == [True, False, False, False, False]


def test_a_solver_that_misses_roots_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    def half(chain: Chain) -> ik.InverseKinematics:
        whole = inner(chain)
        assert whole is not None

        def first_four(poses: FloatArray) -> FloatArray:
            found = whole.candidates(poses)
            found[:, 4:] = np.nan
            return found

        return ik.InverseKinematics("half", 8, chain, first_four)

    inner = ik._by_parallel_axes
    monkeypatch.setattr(ik, "_by_parallel_axes", half)
    assert "THREE_INNER_PARALLEL" in inverse_kinematics_for(ur10e()).family


def test_calibrated_arms_are_another_family() -> None:
    chain = ur10e()
    fixed = chain.T_parent_joint.copy()
    fixed[2] = fixed[2] @ pose(np.zeros(3), rotation_from_rpy(1e-4, 0, 0))
    tilted = Chain(fixed, chain.axis, chain.T_last_flange, *(np.ones(6),) * 4)
    assert parallel_axes_geometry(tilted) is None


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_windings_are_all_full_turns_within_the_limits(seed: int) -> None:
    generator = np.random.default_rng(seed)
    q = generator.uniform(-math.pi, math.pi, 3)
    lower, upper = generator.uniform(-8, 0, 3), generator.uniform(0, 8, 3)
    found = windings(q, lower, upper)
    counts = [
        sum(low <= value + 2 * math.pi * k <= high for k in range(-3, 4)) for value, low, high in zip(q, lower, upper)
    ]
    assert len(found) == len(np.unique(found, axis=0)) == np.prod(counts)
    assert ((found >= lower) & (found <= upper)).all()
    turns = (found - q) / (2 * math.pi)
    assert np.abs(turns - turns.round()).max(initial=0.0) < 1e-12


def test_a_value_on_the_limit_keeps_its_winding() -> None:
    limit = np.array([2 * math.pi])
    assert windings(np.array([0.0]), -limit, limit).ravel() == pytest.approx([-2 * math.pi, 0.0, 2 * math.pi])
    just_over = np.array([math.nextafter(math.pi, 4)])
    assert (windings(just_over, np.array([-math.pi]), np.array([math.pi])) <= math.pi).all()
