"""Kinematics of a serial arm as CasADi expressions, for nonlinear programs.

Built from the arm's pinocchio model (joint placements and motion axes), so that every serial URDF that pinocchio reads
is covered: revolute, continuous, prismatic and fixed joints. Equal to pinocchio to 1e-12. The inertias of the same
model are what a symbolic mass matrix would be built from.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from cellwright.arrays import BoolArray, FloatArray
from cellwright.cell.serial_arm import SerialArm
from cellwright.errors import InvalidInputError


def constant(T: FloatArray) -> Any:
    """Return an array as a CasADi constant with exact zeros left out, so that expressions stay sparse."""
    return casadi.sparsify(casadi.DM(np.asarray(T, float)))


def motion_expression(revolute: bool, axis: FloatArray, value: Any) -> Any:
    """Return the displacement (4 x 4) of one joint by ``value`` (rad or m) along the unit ``axis`` (3,)."""
    if not revolute:
        T = casadi.SX.eye(4)
        T[:3, 3] = constant(axis) * value
        return T
    x, y, z = axis
    cross = constant(np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
    along = np.outer(axis, axis)
    rotation = constant(along) + casadi.cos(value) * constant(np.eye(3) - along) + casadi.sin(value) * cross
    return casadi.diagcat(rotation, casadi.SX(1.0))


def chain_expressions(T_parent_joint: FloatArray, axis: FloatArray, revolute: BoolArray, values: Any) -> list[Any]:
    """Return the poses (4 x 4) of the root (identity) and of the frame behind each joint, as `chain_poses` does."""
    poses = [casadi.SX.eye(4)]
    for joint in range(len(axis)):
        moved = motion_expression(bool(revolute[joint]), axis[joint], values[joint])
        poses.append(poses[-1] @ constant(T_parent_joint[joint]) @ moved)
    return poses


@dataclass(frozen=True, eq=False)
class SymbolicModel:
    """An arm's kinematics as CasADi expressions; make it by `symbolic_model`.

    Attributes:
        T_parent_joint: Fixed pose of each joint frame on the link before it, (joints, 4, 4).
        axis: Unit axes in the joint frames, (joints, 3).
        revolute: Whether a joint turns, (joints,).
        T_last_tip: Pose of flange or tool on the last link, (4, 4).
    """

    T_parent_joint: FloatArray
    axis: FloatArray
    revolute: BoolArray
    T_last_tip: FloatArray

    @property
    def n_joints(self) -> int:
        """The number of joints."""
        return len(self.axis)

    def link_poses(self, q: Any) -> list[Any]:
        """Return the poses (4 x 4) of base (first) and of the link behind each joint in the base frame."""
        return chain_expressions(self.T_parent_joint, self.axis, self.revolute, q)

    def tip_pose(self, q: Any) -> Any:
        """Return the pose (4 x 4) of the tip in the base frame."""
        return self.link_poses(q)[-1] @ constant(self.T_last_tip)

    def jacobian(self, q: Any) -> Any:
        """Return the geometric Jacobian (6 x joints) of the tip in the base frame, linear rows first."""
        links = self.link_poses(q)
        tip = (links[-1] @ constant(self.T_last_tip))[:3, 3]
        columns = []
        for joint in range(self.n_joints):
            axis = links[joint + 1][:3, :3] @ constant(self.axis[joint])
            if self.revolute[joint]:
                origin = (links[joint] @ constant(self.T_parent_joint[joint]))[:3, 3]
                columns.append(casadi.vertcat(casadi.cross(axis, tip - origin), axis))
            else:
                columns.append(casadi.vertcat(axis, casadi.SX.zeros(3)))
        return casadi.horzcat(*columns)

    @cached_property
    def tip_function(self) -> Any:
        """The tip's pose as a CasADi function of q."""
        q = casadi.SX.sym("q", self.n_joints)
        return casadi.Function("tip", [q], [self.tip_pose(q)])

    @cached_property
    def links_function(self) -> Any:
        """The links' poses side by side (4 x 4 (joints + 1)) as a CasADi function of q."""
        q = casadi.SX.sym("q", self.n_joints)
        return casadi.Function("links", [q], [casadi.horzcat(*self.link_poses(q))])

    @cached_property
    def jacobian_function(self) -> Any:
        """The tip's Jacobian as a CasADi function of q."""
        q = casadi.SX.sym("q", self.n_joints)
        return casadi.Function("jacobian", [q], [self.jacobian(q)])


def symbolic_model(arm: SerialArm, T_flange_tool: FloatArray | None = None) -> SymbolicModel:
    """Return the symbolic kinematics of an arm whose tip is its flange, or a tool on it.

    Raises:
        InvalidInputError: If the model is no serial chain of one-axis joints.
    """
    T_last_tip = arm.T_last_flange if T_flange_tool is None else arm.T_last_flange @ T_flange_tool
    return from_pinocchio(arm.model, T_last_tip)


def from_pinocchio(model: Any, T_last_tip: FloatArray) -> SymbolicModel:
    """Return the symbolic kinematics of a pinocchio model whose tip sits on the last link at ``T_last_tip`` (4, 4).

    Raises:
        InvalidInputError: If the model is no serial chain of one-axis joints.
    """
    placements, axes, revolute = [], [], []
    for index in range(1, model.njoints):
        joint = model.joints[index]
        if model.parents[index] != index - 1 or joint.nv != 1 or joint.nq != 1:
            raise InvalidInputError(
                f"joint {model.names[index]!r} of {model.name!r} is {joint.shortname()} on joint "
                f"{model.parents[index]}: a serial chain has one-axis joints one behind the other"
            )
        data = joint.createData()
        joint.calc(data, np.zeros(model.nq))
        subspace = np.asarray(data.S, float).reshape(6)
        turns = bool(np.linalg.norm(subspace[3:]) > 0.5)
        placements.append(model.jointPlacements[index].homogeneous)
        axes.append(subspace[3:] if turns else subspace[:3])
        revolute.append(turns)
    return SymbolicModel(
        np.array(placements).reshape(-1, 4, 4),
        np.array(axes).reshape(-1, 3),
        np.array(revolute, bool),
        np.array(T_last_tip, float),
    )
