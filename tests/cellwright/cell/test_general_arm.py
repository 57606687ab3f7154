from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.arrays import FloatArray
from cellwright.cell import inverse_kinematics as ik
from cellwright.cell.chain_kinematics import flange_poses, jacobian
from cellwright.cell.robot import Chain, Robot
from cellwright.cell.transforms import pose, rotation_from_rpy
from tests.cellwright.cell.robots import chain_of_facts, random_chain, urdf_of
from tests.cellwright.cell.test_inverse_kinematics import as_sets, assert_complete, poses_of, ur10e


def eliminated(chain: Chain) -> ik.InverseKinematics:
    return ik._by_elimination(chain)


def regular(chain: Chain, n: int, seed: int) -> FloatArray:
    """Random configurations that are not next to a singular one, where roots run together."""
    q = np.random.default_rng(seed).uniform(-math.pi, math.pi, (n, 6))
    J = np.array([jacobian(chain.T_parent_joint, chain.axis, chain.T_last_flange, row) for row in q])
    return q[np.linalg.svd(J, compute_uv=False)[:, -1] > 1e-3]


def calibrated(chain: Chain) -> Chain:
    """The arm with axes that are off by what calibration finds: no family knows it any more."""
    fixed = chain.T_parent_joint.copy()
    for joint, row in enumerate(np.random.default_rng(5).uniform(-1e-3, 1e-3, (6, 3))):
        fixed[joint] = fixed[joint] @ pose(row, rotation_from_rpy(*row[::-1]))
    return Chain(fixed, chain.axis, chain.T_last_flange, *(np.ones(6),) * 4)


@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_any_arm_of_six_turning_joints_has_all_its_branches(seed: int) -> None:
    generator = np.random.default_rng(seed)
    chain = Robot.from_urdf(urdf_of(random_chain(generator))).chain
    solver = ik.inverse_kinematics_for(chain)
    assert solver.family == ik.ELIMINATION and solver.slow
    assert_complete(chain, solver, regular(chain, 20, seed))


@pytest.mark.parametrize("name", ["kr180_r2500_extra", "crx10ial"])
def test_it_finds_what_the_solvers_of_special_families_find(name: str) -> None:
    chain = chain_of_facts(name)
    q = np.random.default_rng(1).uniform(-math.pi, math.pi, (60, 6))
    poses = poses_of(chain, q)
    ours, theirs = eliminated(chain).solve(poses), ik.inverse_kinematics_for(chain).solve(poses)
    agreeing = sum(
        len(a) == len(b) and bool(np.abs(np.remainder(a - b + math.pi, 2 * math.pi) - math.pi).max(initial=0) < 1e-3)
        for a, b in zip(as_sets(ours), as_sets(theirs))
    )
    assert agreeing >= 59, "close to a singular pose the two may count a double root differently"


def test_the_crx_has_all_sixteen_branches_of_gautier() -> None:
    chain = chain_of_facts("crx10ial")
    target = pose(np.array([[-0.2406, -0.1188, 0.5603]]), rotation_from_rpy(2.6204, 1.1236, 0.4276))
    assert len(as_sets(eliminated(chain).solve(target))[0]) == 16


def test_a_calibrated_arm_is_near_its_nominal_one() -> None:
    nominal, chain = ur10e(), calibrated(ur10e())
    solver = ik.inverse_kinematics_for(chain)
    assert solver.family == ik.ELIMINATION
    q = regular(chain, 60, 2)
    found = assert_complete(chain, solver, q)
    expected = ik.inverse_kinematics_for(nominal).solve(poses_of(chain, q))
    same = [len(a) == len(b) for a, b in zip(as_sets(found), as_sets(expected))]
    assert np.mean(same) > 0.9, "the workspace's border moves by a millimetre, the branches inside stay"


def test_the_niryo_ned_is_solved() -> None:
    chain = chain_of_facts("niryo_ned")
    solver = ik.inverse_kinematics_for(chain)
    assert solver.family == ik.ELIMINATION
    assert_complete(chain, solver, regular(chain, 60, 3))


def test_poses_out_of_reach_have_none() -> None:
    chain = random_chain(np.random.default_rng(6))
    far = flange_poses(chain.T_parent_joint, chain.axis, chain.T_last_flange, np.zeros((1, 6)))
    far[0, :3, 3] += 50.0
    assert np.isnan(eliminated(chain).solve(far)).all()


def test_poses_do_not_depend_on_their_company() -> None:
    chain = random_chain(np.random.default_rng(7))
    solver = eliminated(chain)
    poses = poses_of(chain, np.random.default_rng(8).uniform(-math.pi, math.pi, (9, 6)))
    alone = np.concatenate([solver.solve(poses[row : row + 1]) for row in range(9)])
    assert np.array_equal(alone, solver.solve(poses), equal_nan=True)
