from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_dynamics import symbolic_dynamics
from cellwright.errors import SolverError
from cellwright.solvers.optimal_control.discrete_mechanics import DiscreteMechanics, explicit_euler
from tests.cellwright.solvers.optimal_control.planar_arm import dynamics_of, pendulum, planar_urdf

FOLDED = np.array([0.3, -1.2, 0.8, 0.2, 0.4, 0.1])


def drift(energy: np.ndarray) -> tuple[float, float]:
    """Largest excursion of the energy, and how far its mean of the last tenth is from that of the first."""
    tenth = len(energy) // 10
    return float(np.abs(energy - energy[0]).max()), abs(float(energy[-tenth:].mean() - energy[:tenth].mean()))


def test_a_free_pendulum_keeps_its_energy_over_a_hundred_swings_where_euler_does_not() -> None:
    dynamics = pendulum()
    mechanics = DiscreteMechanics(dynamics)
    q, v, h, n = np.array([0.5]), np.zeros(1), 0.02, 6_000
    swing = mechanics.energy(np.array([[np.pi / 2.0]]), np.zeros((1, 1))) - mechanics.energy(q[None], v[None])
    E = mechanics.energy(*mechanics.integrate(q, v, h, n))
    excursion, secular = drift(E)
    assert excursion < 0.02 * abs(float(swing[0]))
    assert secular < 0.01 * excursion  # bounded, not growing
    euler = mechanics.energy(*explicit_euler(dynamics, q, v, h, 500))
    assert drift(euler)[0] > 20.0 * excursion


def test_the_excursion_of_the_energy_falls_with_the_square_of_the_step() -> None:
    mechanics = DiscreteMechanics(pendulum())
    excursion = [drift(mechanics.energy(*mechanics.integrate(np.array([0.5]), np.zeros(1), h, int(20 / h))))[0]
                 for h in (0.04, 0.02, 0.01)]  # fmt: skip
    np.testing.assert_allclose(np.divide(excursion[:-1], excursion[1:]), 4.0, rtol=0.1)


def test_a_free_six_axis_arm_drifts_no_more_than_a_symplectic_method_should() -> None:
    dynamics = dynamics_of("ur10e")
    mechanics = DiscreteMechanics(dynamics)
    E = mechanics.energy(*mechanics.integrate(FOLDED, np.zeros(6), 0.001, 2000))
    euler = mechanics.energy(*explicit_euler(dynamics, FOLDED, np.zeros(6), 0.001, 2000))
    excursion, secular = drift(E)
    assert excursion < 0.05 and secular < 0.005  # J, of 140 J
    assert drift(euler)[1] > 2.0


def test_the_momentum_about_a_vertical_first_axis_is_kept_exactly() -> None:
    # gravity pulls along the axis, so turning all about it changes nothing: Noether's theorem holds step by step
    mechanics = DiscreteMechanics(dynamics_of("ur10e"))
    q, v = mechanics.integrate(FOLDED, np.array([0.8, 0.0, 0.3, 0.0, 0.0, 0.0]), 0.002, 300)
    about = np.array([mechanics.momentum(*state)[0] for state in zip(q, v)])
    np.testing.assert_allclose(about, about[0], rtol=1e-9)
    lift = np.array([mechanics.momentum(*state)[1] for state in zip(q, v)])
    assert np.ptp(lift) > 1.0  # the second axis has no such symmetry


@given(st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_a_step_back_undoes_a_step(seed: int) -> None:
    mechanics = DiscreteMechanics(symbolic_dynamics(SerialArm.from_urdf(planar_urdf("0 1 0"))))
    rng = np.random.default_rng(seed)
    q, p, torque = rng.normal(size=2), rng.normal(size=2), rng.normal(size=2)
    there = mechanics.step(q, p, 0.01, torque)
    back = mechanics.step(there[0], -there[1], 0.01, torque)
    np.testing.assert_allclose(back[0], q, atol=1e-10)
    np.testing.assert_allclose(-back[1], p, atol=1e-9)


def test_motions_converge_to_the_true_one_with_the_square_of_the_step() -> None:
    import pinocchio

    dynamics = symbolic_dynamics(SerialArm.from_urdf(planar_urdf("0 1 0")))
    mechanics, data = DiscreteMechanics(dynamics), dynamics.model.createData()
    q, v, torque = np.array([0.4, -0.7]), np.array([0.5, 1.0]), np.array([-20.0, 3.0])

    def rate(_: float, state: np.ndarray) -> np.ndarray:
        return np.concatenate([state[2:], pinocchio.aba(dynamics.model, data, state[:2], state[2:], torque)])

    true = solve_ivp(rate, (0.0, 1.0), np.concatenate([q, v]), rtol=1e-11, atol=1e-12).y[:, -1]
    error = []
    for n in (50, 100, 200):
        positions, velocities = mechanics.integrate(q, v, 1.0 / n, n, np.tile(torque, (n, 1)))
        error.append(np.abs(np.concatenate([positions[-1], velocities[-1]]) - true).max())
        np.testing.assert_allclose(
            mechanics.node_velocities(positions, np.tile(torque, (n, 1)), 1.0 / n), velocities, atol=1e-7
        )
    np.testing.assert_allclose(np.divide(error[:-1], error[1:]), 4.0, rtol=0.15)


def test_a_step_too_long_for_newton_is_told() -> None:
    mechanics = DiscreteMechanics(dynamics_of("ur10e"))
    with pytest.raises(SolverError, match=r"a step of 5 s has a momentum residual .* shorten it"):
        mechanics.integrate(FOLDED, np.full(6, 3.0), 5.0, 20)
