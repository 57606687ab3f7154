from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellwright.cell.built_in_robots import BUILT_IN, built_in_arm
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_dynamics import Payload, SymbolicDynamics, symbolic_dynamics
from cellwright.cell.transforms import pose, rotation_from_rpy
from cellwright.errors import InfeasibleError, InvalidInputError
from tests.cellwright.cell.random_arms import random_urdf
from tests.cellwright.solvers.optimal_control.planar_arm import planar_urdf

PAYLOAD = Payload(3.0, np.array([0.1, -0.05, 0.2]), np.diag([0.02, 0.03, 0.04]))
TILTED = pose(np.array([1.0, 2.0, 3.0]), rotation_from_rpy(0.4, -0.5, 0.6))


def with_bodies(urdf: str, seed: int) -> str:
    """Give every link of a random arm a body."""
    rng = np.random.default_rng(seed)
    number = 0
    while f'<link name="link{number}"/>' in urdf:
        x, y, z = rng.normal(0, 0.2, 3)
        a, b, c = rng.uniform(0.05, 0.1, 3)
        body = (
            f'<inertial><origin xyz="{x} {y} {z}" rpy="0.1 0.2 0.3"/><mass value="{rng.uniform(0.5, 5)}"/>'
            f'<inertia ixx="{a}" ixy="0.01" ixz="0.002" iyy="{b}" iyz="-0.003" izz="{c}"/></inertial>'
        )
        urdf = urdf.replace(f'<link name="link{number}"/>', f'<link name="link{number}">{body}</link>')
        number += 1
    return urdf


def assert_equal_to_pinocchio(dynamics: SymbolicDynamics, seed: int, count: int = 5) -> None:
    model, data, rng = dynamics.model, dynamics.model.createData(), np.random.default_rng(seed)
    for q in rng.uniform(dynamics.lower, dynamics.upper, (count, dynamics.n_joints)):
        v, a = rng.normal(size=(2, dynamics.n_joints))
        upper = np.triu(pinocchio.crba(model, data, q))
        M = upper + np.triu(upper, 1).T
        scale = max(1.0, np.abs(M).max())
        gravity = pinocchio.computeGeneralizedGravity(model, data, q)
        kinetic, potential = (float(value) for value in dynamics.energies_function(q, v))
        np.testing.assert_allclose(dynamics.mass_matrix(q), M, atol=1e-10, rtol=1e-12)
        np.testing.assert_allclose(dynamics.holding_torque(q), gravity, atol=1e-10, rtol=1e-12)
        assert kinetic == pytest.approx(pinocchio.computeKineticEnergy(model, data, q, v), abs=1e-10, rel=1e-12)
        assert potential == pytest.approx(pinocchio.computePotentialEnergy(model, data, q), abs=1e-10, rel=1e-12)
        # the Euler-Lagrange equation of these energies is pinocchio's inverse dynamics: d/dt p by central differences
        tau, h = dynamics.torques(q[None], v[None], a[None])[0], 1e-5
        ahead, behind = (np.asarray(dynamics.momentum_function(q + s * h * v, v + s * h * a)[0])[:, 0] for s in (1, -1))
        force = np.asarray(dynamics.momentum_function(q, v)[1])[:, 0]
        np.testing.assert_allclose((ahead - behind) / (2 * h) - force, tau, atol=1e-5 * scale)


@pytest.mark.parametrize("name", [entry.name for entry in BUILT_IN])
def test_every_built_in_robot_has_a_dynamics_equal_to_pinocchio(name: str) -> None:
    assert_equal_to_pinocchio(symbolic_dynamics(built_in_arm(name)), 1)
    assert_equal_to_pinocchio(symbolic_dynamics(built_in_arm(name), payload=PAYLOAD, T_world_base=TILTED), 2)


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_any_serial_chain_has_a_dynamics_equal_to_pinocchio(seed: int) -> None:
    assert_equal_to_pinocchio(symbolic_dynamics(SerialArm.from_urdf(with_bodies(random_urdf(seed), seed))), seed, 2)


def test_a_payload_adds_its_weight_and_a_tilted_base_turns_gravity() -> None:
    arm = SerialArm.from_urdf(planar_urdf("0 1 0"))
    q = np.zeros(2)
    bare, laden = symbolic_dynamics(arm), symbolic_dynamics(arm, payload=Payload.point(2.0, (0.5, 0.0, 0.0)))
    np.testing.assert_allclose(laden.holding_torque(q) - bare.holding_torque(q), [-2 * 9.81 * 1.1, -2 * 9.81 * 0.5])
    upside_down = symbolic_dynamics(arm, T_world_base=pose(np.zeros(3), rotation_from_rpy(np.pi, 0.0, 0.0)))
    np.testing.assert_allclose(upside_down.holding_torque(q), -bare.holding_torque(q), atol=1e-12)


def test_many_configurations_are_held_at_once() -> None:
    dynamics = symbolic_dynamics(built_in_arm("ur10e"))
    q = np.random.default_rng(0).normal(size=(3, 4, 6))
    torque = dynamics.holding_torque(q)
    assert torque.shape == (3, 4, 6)
    np.testing.assert_array_equal(torque[1, 2], dynamics.holding_torque(q[1, 2]))


def test_a_joint_too_weak_to_hold_the_arm_is_named_with_both_torques() -> None:
    dynamics = symbolic_dynamics(built_in_arm("ur10e"))
    q = np.zeros(6)  # stretched out
    needed = np.abs(dynamics.holding_torque(q))
    effort = dynamics.max_effort.copy()
    dynamics.check_holds(q, effort, "home")
    effort[1] = 50.0
    with pytest.raises(InfeasibleError, match=rf"'shoulder_lift_joint' needs {needed[1]:.6g} N m .* at home.*50 N m"):
        dynamics.check_holds(q, effort, "home")


def test_an_arm_whose_stated_force_is_below_its_weight_is_told_which_joint_and_by_how_much() -> None:
    dynamics = symbolic_dynamics(built_in_arm("scara"), payload=Payload.point(2.0))
    with pytest.raises(InfeasibleError, match=r"'joint_3' needs .* N to hold .* limit is 50 N"):
        dynamics.check_holds(0.5 * (dynamics.lower + dynamics.upper), dynamics.max_effort, "the start")


def test_an_arm_without_masses_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="moves no mass: add <inertial>"):
        symbolic_dynamics(SerialArm.from_urdf(random_urdf(3)))


def test_a_payload_without_sense_is_refused() -> None:
    arm = built_in_arm("ur10e")
    with pytest.raises(InvalidInputError, match="mass is -1 kg"):
        symbolic_dynamics(arm, payload=Payload.point(-1.0))
    with pytest.raises(InvalidInputError, match="mass is nan kg"):
        symbolic_dynamics(arm, payload=Payload.point(np.nan))
    with pytest.raises(InvalidInputError, match=r"centre has shape \(2,\)"):
        symbolic_dynamics(arm, payload=Payload.point(1.0, (0.0, 0.0)))
