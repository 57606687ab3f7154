from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.built_in_robots import BUILT_IN, built_in_arm
from cellwright.cell.robot import Robot
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_model import from_pinocchio, symbolic_model
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.errors import InvalidInputError
from tests.cellwright.cell.random_arms import random_urdf

CRX = Path(__file__).parents[4] / "shared" / "data" / "robots" / "crx10ia_l"
TOOL = pose(np.array([0.1, -0.2, 0.3]), rotation_from_rpy(0.4, 0.5, -0.6))


def assert_equal_to_pinocchio(arm: SerialArm, seed: int) -> None:
    symbols = symbolic_model(arm, TOOL)
    model = arm.model
    frame = model.addFrame(
        pinocchio.Frame(
            "tool",
            model.njoints - 1,
            pinocchio.SE3(arm.T_last_flange @ TOOL),
            pinocchio.FrameType.OP_FRAME,
        )
    )
    data = model.createData()
    for q in np.random.default_rng(seed).uniform(arm.lower, arm.upper, (4, arm.n_joints)):
        pinocchio.framesForwardKinematics(model, data, q)
        J = pinocchio.computeFrameJacobian(model, data, q, frame, pinocchio.LOCAL_WORLD_ALIGNED).reshape(6, -1)
        np.testing.assert_allclose(symbols.tip_function(q), data.oMf[frame].homogeneous, atol=1e-12)
        np.testing.assert_allclose(symbols.jacobian_function(q), J, atol=1e-12)
        links = np.asarray(symbols.links_function(q)).reshape(4, -1, 4).transpose(1, 0, 2)
        for joint in range(1, arm.n_joints + 1):
            np.testing.assert_allclose(links[joint], data.oMi[joint].homogeneous, atol=1e-12)


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_expressions_of_any_serial_chain_equal_pinocchio(seed: int) -> None:
    assert_equal_to_pinocchio(SerialArm.from_urdf(random_urdf(seed)), seed)


@pytest.mark.parametrize("name", [entry.name for entry in BUILT_IN])
def test_expressions_of_every_built_in_robot_equal_pinocchio(name: str) -> None:
    assert_equal_to_pinocchio(built_in_arm(name), 1)


def test_expressions_of_the_crx_equal_pinocchio() -> None:
    files = sorted(CRX.glob("*.urdf")) if CRX.exists() else []
    if not files:
        pytest.skip("the CRX-10iA/L is not among the shared data here")
    assert_equal_to_pinocchio(SerialArm.from_robot(Robot.from_urdf(files[0].read_text())), 2)


def test_joints_with_more_than_one_axis_are_refused() -> None:
    model = pinocchio.Model()
    model.addJoint(0, pinocchio.JointModelSpherical(), pinocchio.SE3.Identity(), "ball")
    with pytest.raises(InvalidInputError, match="ball"):
        from_pinocchio(model, np.eye(4))
