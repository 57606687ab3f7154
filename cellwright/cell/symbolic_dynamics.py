"""Rigid-body dynamics of a serial arm as CasADi expressions: energies, mass matrix, gravity, for nonlinear programs.

Masses, centres of mass and inertia tensors come from the arm's pinocchio model, so that whatever hangs on fixed joints
counts. Link velocities are propagated along the chain (Featherstone 2008, section 2.4), the kinetic energy is their sum
of squares; mass matrix and generalised forces are its exact derivatives. Equal to pinocchio's mass matrix, gravity and
inverse dynamics to 1e-10.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from cellwright.arrays import FloatArray
from cellwright.cell.serial_arm import SerialArm
from cellwright.cell.symbolic_model import SymbolicModel, constant, motion_expression, symbolic_model
from cellwright.errors import InfeasibleError, InvalidInputError

GRAVITY = (0.0, 0.0, -9.81)
"""Standard gravity as pinocchio has it, m/s^2, in the frame of a base that stands on the floor."""


@dataclass(frozen=True, eq=False)
class Payload:
    """What the arm carries: a rigid body on its flange.

    Attributes:
        mass: In kg.
        centre: Centre of mass in the flange frame, (3,) in m.
        inertia: Tensor about the centre of mass, flange axes, (3, 3) in kg m^2.
    """

    mass: float
    centre: FloatArray
    inertia: FloatArray

    @classmethod
    def point(cls, mass: float, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Payload:
        """Return a payload without extent, ``centre`` (3,) in the flange frame in m."""
        return cls(float(mass), np.array(centre, float), np.zeros((3, 3)))


@dataclass(frozen=True, eq=False)
class SymbolicDynamics:
    """An arm's dynamics; make it by `symbolic_dynamics`.

    Attributes:
        joint_names: Moving joints, base to flange.
        kinematics: The chain.
        mass: Of the links behind the joints, (joints,) in kg.
        centre: Centres of mass in the link frames, (joints, 3) in m.
        inertia: Tensors about the centres of mass, link axes, (joints, 3, 3) in kg m^2.
        gravity: In the base frame, (3,) in m/s^2.
        max_effort: Joint torque or force limits, (joints,) in N m or N; NaN where the URDF states none.
        lower, upper: Joint limits in rad or m, (joints,).
        max_velocity: In rad/s or m/s, (joints,).
        model: The pinocchio model with payload and gravity in it: the peer of the expressions.
    """

    joint_names: tuple[str, ...]
    kinematics: SymbolicModel
    mass: FloatArray
    centre: FloatArray
    inertia: FloatArray
    gravity: FloatArray
    max_effort: FloatArray
    lower: FloatArray
    upper: FloatArray
    max_velocity: FloatArray
    model: Any

    @property
    def n_joints(self) -> int:
        """The number of joints."""
        return len(self.mass)

    def energies(self, q: Any, v: Any) -> tuple[Any, Any]:
        """Return kinetic and potential energy in J at joint positions ``q`` and velocities ``v``, CasADi columns.

        The potential energy is zero where all masses lie in the base's origin.
        """
        kin = self.kinematics
        turn, shift = casadi.SX.zeros(3), casadi.SX.zeros(3)  # of the link's origin, in link axes
        rotation, origin = casadi.SX.eye(3), casadi.SX.zeros(3)
        kinetic, potential = casadi.SX(0.0), casadi.SX(0.0)
        for joint in range(self.n_joints):
            T = constant(kin.T_parent_joint[joint]) @ motion_expression(
                bool(kin.revolute[joint]), kin.axis[joint], q[joint]
            )
            R, p = T[:3, :3], T[:3, 3]
            axis = constant(kin.axis[joint])
            shift = R.T @ (shift + casadi.cross(turn, p))
            turn = R.T @ turn
            if kin.revolute[joint]:
                turn = turn + axis * v[joint]
            else:
                shift = shift + axis * v[joint]
            origin = origin + rotation @ p
            rotation = rotation @ R
            centre = constant(self.centre[joint])
            speed = shift + casadi.cross(turn, centre)
            kinetic += 0.5 * self.mass[joint] * casadi.dot(speed, speed)
            kinetic += 0.5 * casadi.dot(turn, constant(self.inertia[joint]) @ turn)
            potential -= self.mass[joint] * casadi.dot(constant(self.gravity), origin + rotation @ centre)
        return kinetic, potential

    def lagrangian(self, q: Any, v: Any) -> Any:
        """Return kinetic less potential energy in J."""
        kinetic, potential = self.energies(q, v)
        return kinetic - potential

    def _symbols(self) -> tuple[Any, Any]:
        return casadi.SX.sym("q", self.n_joints), casadi.SX.sym("v", self.n_joints)

    @cached_property
    def energies_function(self) -> Any:
        """Kinetic and potential energy as a CasADi function of (q, v)."""
        q, v = self._symbols()
        return casadi.Function("energies", [q, v], list(self.energies(q, v)))

    @cached_property
    def mass_matrix_function(self) -> Any:
        """The mass matrix (joints x joints) as a CasADi function of q."""
        q, v = self._symbols()
        return casadi.Function("mass_matrix", [q], [casadi.hessian(self.energies(q, v)[0], v)[0]])

    @cached_property
    def gravity_function(self) -> Any:
        """The torques (joints,) that hold the arm still, as a CasADi function of q."""
        q, v = self._symbols()
        return casadi.Function("gravity", [q], [casadi.gradient(self.energies(q, v)[1], q)])

    @cached_property
    def momentum_function(self) -> Any:
        """dL/dv and dL/dq, both (joints,), as a CasADi function of (q, v)."""
        q, v = self._symbols()
        L = self.lagrangian(q, v)
        return casadi.Function("momentum", [q, v], [casadi.gradient(L, v), casadi.gradient(L, q)])

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """Return the mass matrix (joints, joints) at ``q`` (joints,)."""
        return np.asarray(self.mass_matrix_function(q))

    def holding_torque(self, q: FloatArray) -> FloatArray:
        """Return the torques (..., joints) in N m or N that hold the arm still at ``q`` (..., joints)."""
        q = np.asarray(q, float)
        rows = q.reshape(-1, self.n_joints)
        return np.asarray(self.gravity_function(rows.T)).T.reshape(q.shape)

    def torques(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return pinocchio's inverse dynamics (states, joints) of states (states, joints) each."""
        import pinocchio

        data = self.model.createData()
        return np.array([pinocchio.rnea(self.model, data, *row) for row in zip(q, v, a)]).reshape(np.shape(q))

    def check_holds(self, q: FloatArray, effort: FloatArray, where: str) -> None:
        """Check that the torque limits ``effort`` (joints,) hold the arm still at ``q`` (joints,), named by ``where``.

        Raises:
            InfeasibleError: If a joint is too weak.
        """
        needed = np.abs(self.holding_torque(q))
        for row in np.flatnonzero(needed > effort):
            unit = "N m" if self.kinematics.revolute[row] else "N"
            raise InfeasibleError(
                f"joint {self.joint_names[row]!r} needs {needed[row]:.6g} {unit} to hold the arm at {where}, but its "
                f"limit is {effort[row]:.6g} {unit}: raise the limit, carry less, or choose another configuration"
            )


def symbolic_dynamics(
    arm: SerialArm, *, payload: Payload | None = None, T_world_base: FloatArray | None = None
) -> SymbolicDynamics:
    """Return the symbolic dynamics of an arm.

    Args:
        arm: The arm; its URDF states masses and inertias.
        payload: What it carries on its flange.
        T_world_base: Pose of its base, (4, 4); gravity points down the world's z. Upright if left out.

    Raises:
        InvalidInputError: If a link or the payload has no mass that makes sense, or the arm is no serial chain.
    """
    import pinocchio

    model = arm.model.copy()
    if payload is not None:
        _check_payload(payload)
        body = pinocchio.Inertia(payload.mass, payload.centre, payload.inertia)
        model.appendBodyToJoint(arm.n_joints, body, pinocchio.SE3(arm.T_last_flange))
    down = np.array(GRAVITY) if T_world_base is None else T_world_base[:3, :3].T @ np.array(GRAVITY)
    model.gravity.linear = down
    bodies = [model.inertias[joint] for joint in range(1, model.njoints)]
    mass = np.array([body.mass for body in bodies])
    inertia = np.array([body.inertia for body in bodies])
    _check_bodies(arm, mass, inertia)
    return SymbolicDynamics(
        arm.joint_names,
        symbolic_model(arm),
        mass,
        np.array([body.lever for body in bodies]),
        inertia,
        down,
        arm.max_effort.copy(),
        arm.lower.copy(),
        arm.upper.copy(),
        arm.max_velocity.copy(),
        model,
    )


def _check_payload(payload: Payload) -> None:
    if not (np.isfinite(payload.mass) and payload.mass >= 0.0):
        raise InvalidInputError(f"the payload's mass is {payload.mass:g} kg: give a finite one of at least 0")
    if np.shape(payload.centre) != (3,) or np.shape(payload.inertia) != (3, 3):
        raise InvalidInputError(
            f"the payload's centre has shape {np.shape(payload.centre)} and its inertia {np.shape(payload.inertia)}: "
            "give (3,) in m and (3, 3) in kg m^2"
        )


def _check_bodies(arm: SerialArm, mass: FloatArray, inertia: FloatArray) -> None:
    if not (np.isfinite(mass).all() and np.isfinite(inertia).all()):
        raise InvalidInputError(f"{arm.name!r} has a mass or inertia that is not finite: mend its <inertial> elements")
    negative = np.flatnonzero(mass < 0.0)
    if len(negative):
        raise InvalidInputError(
            f"the link behind joint {arm.joint_names[negative[0]]!r} has {mass[negative[0]]:g} kg: mend its <mass>"
        )
    for row, name in enumerate(arm.joint_names):
        # a joint that moves nothing has no dynamics: its torque would be free and its motion without cost
        beyond = mass[row:].sum() + np.abs(inertia[row:]).sum()
        if beyond <= 0.0:
            raise InvalidInputError(
                f"joint {name!r} of {arm.name!r} moves no mass: add <inertial> to the links of its URDF, or a payload"
            )
