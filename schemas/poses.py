"""A pose as a stage parameter."""

from __future__ import annotations

import numpy as np
from pydantic import Field, field_validator

from cellwright.arrays import FloatArray
from cellwright.cell.transforms import pose, quaternion_from_rotation, rotation_from_quaternion
from schemas.params import Params


class Pose(Params):
    """Position and orientation of a frame in its parent."""

    position_m: tuple[float, float, float] = Field(default=(0.0, 0.0, 0.0), description="Position in m.")
    quaternion: tuple[float, float, float, float] = Field(
        default=(1.0, 0.0, 0.0, 0.0), description="Orientation (w, x, y, z), unit length."
    )

    @field_validator("quaternion")
    @classmethod
    def _unit_length(cls, value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        norm = float(np.linalg.norm(value))
        if abs(norm - 1.0) > 1e-6:
            raise ValueError(f"quaternion {value} has length {norm:.6g}: normalise it to 1")
        return value

    def matrix(self) -> FloatArray:
        """Return the pose as a 4x4 matrix."""
        return pose(np.array(self.position_m), rotation_from_quaternion(np.array(self.quaternion)))

    @classmethod
    def of(cls, T: FloatArray) -> Pose:
        """Make the parameter of a 4x4 matrix."""
        position, quaternion = T[:3, 3].tolist(), quaternion_from_rotation(T[:3, :3]).tolist()
        return cls(position_m=tuple(position), quaternion=tuple(quaternion))
