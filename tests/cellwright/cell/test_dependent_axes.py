from __future__ import annotations

import math

import numpy as np
import pytest

from cellwright.cell import inverse_kinematics as ik
from cellwright.cell.axis_frames import axes_at_zero
from cellwright.cell.dependent_axes import dependent_axes
from cellwright.cell.inverse_kinematics import inverse_kinematics_for
from cellwright.cell.robot import Chain
from cellwright.cell.transforms import pose
from cellwright.errors import InvalidInputError
from tests.cellwright.cell.robots import chain_of_facts, random_chain
from tests.cellwright.cell.test_inverse_kinematics import ur10e


def with_axes(chain: Chain, directions: dict[int, np.ndarray], points: dict[int, np.ndarray]) -> Chain:
    """The chain with some axes, given in the base at q = 0, and frames that are all parallel to the base."""
    h, p, T_base_flange = axes_at_zero(chain)
    for joint, direction in directions.items():
        h[joint] = direction / np.linalg.norm(direction)
    for joint, point in points.items():
        p[joint] = point
    steps = np.diff(np.vstack([np.zeros((1, 3)), p]), axis=0)
    last = T_base_flange.copy()
    last[:3, 3] -= p[5]
    return Chain(np.array([pose(step, np.eye(3)) for step in steps]), h, last, *(np.ones(6),) * 4)


def collinear(seed: int = 0) -> Chain:
    """A random arm whose axes 5 and 6 are one line."""
    chain = random_chain(np.random.default_rng(seed))
    h, p, _ = axes_at_zero(chain)
    return with_axes(chain, {5: -h[4]}, {5: p[4] + 0.2 * h[4]})


def parallel(*joints: int) -> Chain:
    chain = random_chain(np.random.default_rng(1))
    return with_axes(chain, dict.fromkeys(joints, np.array([0.3, -0.5, 0.8])), {})


def meeting() -> Chain:
    chain = random_chain(np.random.default_rng(2))
    return with_axes(chain, {}, dict.fromkeys((1, 2, 3, 4), np.array([0.1, 0.4, 0.3])))


SINGULAR = [
    (collinear(), "axes 5 and 6 are collinear"),
    (parallel(1, 2, 3, 4), "axes 2, 3, 4 and 5 are parallel"),
    (parallel(0, 1, 2, 3, 4, 5), "axes 1, 2, 3, 4, 5 and 6 are parallel"),
    (meeting(), "axes 2, 3, 4 and 5 depend on one another"),
]


@pytest.mark.parametrize(("chain", "says"), SINGULAR)
def test_an_arm_singular_everywhere_is_refused_with_the_axes_that_make_it_so(chain: Chain, says: str) -> None:
    with pytest.raises(InvalidInputError, match=f"singular in every configuration: {says}"):
        inverse_kinematics_for(chain)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_the_size_of_the_arm_does_not_count(scale: float) -> None:
    for chain, says in [*SINGULAR, (ur10e(), None)]:
        fixed, last = chain.T_parent_joint.copy(), chain.T_last_flange.copy()
        fixed[:, :3, 3] *= scale
        last[:3, 3] *= scale
        assert dependent_axes(Chain(fixed, chain.axis, last, *(np.ones(6),) * 4)) == says


@pytest.mark.parametrize("name", ["kr180_r2500_extra", "crx10ial", "niryo_ned", "comau_nj290"])
def test_arms_that_are_singular_somewhere_only_are_let_through(name: str) -> None:
    assert dependent_axes(chain_of_facts(name)) is None


def test_axes_next_to_one_line_are_not_in_one_line() -> None:
    chain = collinear()
    axis = chain.axis.copy()
    axis[5] += 1e-4
    assert dependent_axes(Chain(chain.T_parent_joint, axis, chain.T_last_flange, *(np.ones(6),) * 4)) is None


def test_without_regular_trials_nothing_is_proven(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ik, "singular_fault", lambda chain: None)
    for maker in ("_by_parallel_axes", "_by_eaik", "_by_offset_wrist"):
        monkeypatch.setattr(ik, maker, lambda chain: None)
    monkeypatch.setattr(ik, "_by_ssik", lambda chain: None)
    with pytest.raises(InvalidInputError, match=r"by elimination: only 0 of 400 random configurations are far enough"):
        inverse_kinematics_for(collinear())


def test_an_elimination_that_fails_is_listed_with_the_trials_that_count(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(chain: Chain, arms: object, poses: np.ndarray) -> np.ndarray:
        return np.full((len(poses), 24, 6), math.nan)

    monkeypatch.setattr("cellwright.cell.general_arm.candidates", nothing)
    monkeypatch.setattr(ik, "_by_ssik", lambda chain: None)
    with pytest.raises(InvalidInputError, match=r"general six-axis, by elimination: (\d+) of \1 not found\)"):
        inverse_kinematics_for(random_chain(np.random.default_rng(3)))


def test_eaik_without_solutions_has_none() -> None:
    for joints in ((1, 2, 3, 4), (0, 1, 2, 3, 4, 5)):
        solver = ik._by_eaik(parallel(*joints))
        assert solver is not None
        assert np.isnan(solver.solve(pose(np.array([[9.0, 0, 0], [0.3, 0.1, 0.2]]), np.eye(3)))).all()
